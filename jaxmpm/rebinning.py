"""Points that have left their bin change over to the one where they are.

Where points are outside is kept in the bits of words, and the words are a loop's carry: so few pass
over all points, and none where no point moves.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxmpm.points import Room, joined, separate

MOVERS = 64, 256  # points that change bins together: so many, or one slot in so many
ROUNDS = 3  # of them that may go to the same bin


def rebin(points, address=None):
    """Put points whose place has left their bin into the bin where they are.

    Args:
        points: with places that may be outside [0, 1).
        address: flat index over (slots, *bins) of the point of each band, kept up to date.

    Returns:
        (points, address, the `Room` there was not)
    """
    parts, address, room = rebin_parts(separate(points), address)
    return joined(parts), address, room


def rebin_parts(parts, address=None):
    """The same for points by components. Where there is no room for one others may be left where they are."""
    address = jnp.zeros((0,), jnp.int32) if address is None else address
    inside = True
    for y in parts.place:
        inside &= (y >= 0) & (y < 1)
    words = _packed(~inside & (parts.mass > 0))
    no = jnp.zeros((), bool)

    def go(carry):
        *_, words, room = carry
        return (words != 0).any() & ~(room.slots | room.window | room.wild)

    def batch(carry):
        parts, address, words, room = carry
        word, bit, meant = _first_bits(words, max(MOVERS[0], parts.mass.size // MOVERS[1]))
        parts, address, done, room = _move(parts, address, bit * words.shape[0] + word, meant)
        gone = jnp.where(done, jnp.uint32(1) << bit.astype(jnp.uint32), jnp.uint32(0))
        words = words - jnp.zeros_like(words).at[word].add(gone)  # a word's bits go one by one
        return parts, address, words, room

    parts, address, _, room = lax.while_loop(go, batch, (parts, address, words, Room(no, no, no)))
    return parts, address, room


def _packed(flags):
    """Flags as bits of words (words,): bit b of word w is flag b · words + w."""
    flat = flags.reshape(-1)
    words = -(-flat.size // 32)
    word = jnp.zeros(words, jnp.uint32)
    for b in range(32):
        row = flat[b * words : (b + 1) * words]
        row = row if row.size == words else jnp.pad(row, (0, words - row.size))
        word = word | jnp.where(row, jnp.uint32(1 << b), jnp.uint32(0))
    return word


def _first_bits(words, number):
    """Word and bit of the first `number` bits that are set, and which of them there are."""
    ones = lax.population_count(words).astype(jnp.int32)
    upto = _running_sum(ones)
    k = jnp.arange(number, dtype=jnp.int32)
    count = words.shape[0]
    word, stride = jnp.zeros_like(k), 1 << count.bit_length()
    while stride:  # bisection: how many words end before the k-th bit
        ahead = word + stride
        before = (ahead <= count) & (upto[jnp.minimum(ahead, count) - 1] <= k)
        word, stride = jnp.where(before, ahead, word), stride // 2
    word = jnp.minimum(word, count - 1)
    left, bits, bit = k - (upto[word] - ones[word]), words[word], jnp.zeros_like(k)
    for half in (16, 8, 4, 2, 1):
        low = lax.population_count(bits & jnp.uint32((1 << half) - 1)).astype(jnp.int32)
        high = left >= low
        bit, left = jnp.where(high, bit + half, bit), jnp.where(high, left - low, left)
        bits = jnp.where(high, bits >> half, bits)
    return word, bit, k < upto[-1]


def _running_sum(numbers, side=128):
    """Running sum of (n,), in rows: one long sum costs many passes."""
    count = numbers.shape[0]
    rows = jnp.pad(numbers, (0, -count % side)).reshape(-1, side)
    total = rows.sum(1)
    before = jnp.cumsum(total) - total
    return (jnp.cumsum(rows, 1) + before[:, None]).reshape(-1)[:count]


def _move(parts, address, source, meant):
    """Move the points with flat indices `source` over (slots, *bins), where meant.

    Those that are too many for one bin at a time wait.

    Returns:
        (parts, address, which of the points have gone, the `Room` that others ask for)
    """
    slots, bins = parts.mass.shape[0], parts.mass.shape[1:]
    total = int(np.prod(bins))
    end = slots * total
    source = jnp.where(meant, source, 0)
    taken = jax.tree.map(lambda a: a.reshape(-1)[source], parts._replace(window=()))
    step = [jnp.floor(y) for y in taken.place]
    here = jnp.unravel_index(source % total, bins)
    there = [h + s.astype(jnp.int32) for h, s in zip(here, step, strict=True)]
    inside, wild = meant, False
    for t, s, n in zip(there, step, bins, strict=True):
        inside &= (t >= 0) & (t < n)
        wild |= ~(jnp.abs(s) <= 1)  # NaN too
    target = jnp.ravel_multi_index(there, bins, mode="clip")
    turn = _turns(target, inside, total)
    slot = _free_slot(parts.mass.reshape(slots, total)[:, target] == 0, turn)
    wants = inside & (turn >= 0)
    fits = wants & (slot >= 0)
    away, to = jnp.where(fits, source, end), jnp.where(fits, slot * total + target, end)
    place = tuple(_in_bin(y, s) for y, s in zip(taken.place, step, strict=True))
    parts = _put(parts, taken._replace(place=place), away, to)
    band = jnp.where(fits & (taken.band > 0), taken.band - 1, address.shape[0])
    address = address.at[band].set(to.astype(address.dtype), mode="drop")
    room = Room((wants & ~fits).any(), (meant & ~inside).any(), (meant & wild).any())
    return parts, address, fits, room


def _free_slot(free, turn):
    """Number of the free slot (slots, k) that it is each one's turn to take, -1 where there is none."""
    slot, seen = jnp.full_like(turn, -1), jnp.zeros_like(turn)
    for s, here in enumerate(free):
        slot = jnp.where(here & (seen == turn), s, slot)
        seen = seen + here
    return slot


def _put(parts, new, away, to):
    """Parts with the points `new` in the slots `to`, and the slots `away` free."""
    empty = ("mass", "volume", "band")
    both = jnp.concatenate([away, to])  # no slot is left and taken at once

    def put(a, values):
        return a.reshape(-1).at[to].set(values, mode="drop").reshape(a.shape)

    def swap(a, values):
        values = jnp.concatenate([jnp.zeros_like(values), values])
        return a.reshape(-1).at[both].set(values, mode="drop").reshape(a.shape)

    less = {name: () for name in (*empty, "window")}
    rest = jax.tree.map(put, parts._replace(**less), new._replace(**less))
    swapped = {name: swap(getattr(parts, name), getattr(new, name)) for name in empty}
    return rest._replace(window=parts.window, **swapped)


def _turns(target, wants, total):
    """A number for each of those that want the same target: 0, 1, …; −1 for too many."""
    number = jnp.arange(target.shape[0], dtype=jnp.int32)
    owner = jnp.full(total, -1, jnp.int32)
    rank, left = jnp.full_like(number, -1), wants
    for turn in range(ROUNDS):  # the last to write owns the target
        owner = owner.at[jnp.where(left, target, total)].set(number, mode="drop")
        wins = left & (owner[target] == number)
        rank, left = jnp.where(wins, turn, rank), left & ~wins
    return rank


def _in_bin(place, step):
    """Place in the next bin; kept from rounding up to 1."""
    y = place - step
    return jnp.minimum(y, 1 - jnp.finfo(y.dtype).epsneg)
