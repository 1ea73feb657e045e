"""Pushes inclusions apart until all keep their gap.

With the overlap o_ij = gap − (distance of i and j) where that is positive, the energy Σ o_ij² is
minimised over the centres (L-BFGS-B, its bounds are the edges); at zero everything fits. This is how
soft discs are brought to any density below that of jamming.
"""

import numpy as np

DENSEST = 0.92  # of discs with half their gap around them: beyond it nothing that is random fits
ROUNDS = 60  # of finding neighbours anew
ITERATIONS = 60  # between them
STALLED = 0.9  # of the energy before, after a round: no less is left
PATIENCE = 4  # such rounds


def push_apart(room) -> bool:
    """Move the centres of a `placement.Room` until its gaps are kept, and say whether they are."""
    if room.density() > DENSEST:
        return False
    spare = 2e-3 * room.radius.min()  # aimed at above the gap, so that the gap itself is reached
    least, most = (limit.reshape(-1) for limit in room.limits(np.arange(len(room.radius))))
    energy, stalled = np.inf, 0
    for _ in range(ROUNDS):
        first, second = neighbours(room, room.gap + 0.5 * room.radius.min())
        apart, _ = room.separation(first, second)
        if (apart >= room.gap).all() and (room.periodic or _inside(room, least, most)):
            return True
        before, energy = energy, _relax(room, first, second, room.gap + spare, least, most)
        stalled = stalled + 1 if energy > STALLED * before else 0
        if stalled == PATIENCE:
            break
    return False


def _inside(room, least, most) -> bool:
    flat = room.centres.reshape(-1)
    return bool(((flat >= least) & (flat <= most)).all())


def neighbours(room, within: float) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of inclusions whose circles around them are less than `within` mm apart."""
    from scipy.spatial import cKDTree

    if room.periodic:
        room.centres[:] = room.low + np.mod(room.centres - room.low, room.span)
    box = room.span if room.periodic else None
    # modulo may round up to the span itself
    places = np.minimum(room.centres - room.low, np.nextafter(room.span, 0)) if room.periodic else room.centres
    tree = cKDTree(places, boxsize=box)
    pairs = tree.query_pairs(2 * room.reach.max() + within, output_type="ndarray")
    first, second = pairs[np.lexsort(pairs.T)].T  # in an order that is always the same
    way = room.centres[second] - room.centres[first]
    if room.periodic:
        way -= room.span * np.rint(way / room.span)
    near = np.hypot(*way.T) < room.reach[first] + room.reach[second] + within
    return first[near], second[near]


def _relax(room, first, second, gap, least, most) -> float:
    """Some iterations with fixed neighbours; returns the energy left, mm²."""
    from scipy.optimize import minimize

    def energy(flat):
        room.centres[:] = flat.reshape(-1, 2)
        apart, direction = room.separation(first, second)
        overlap = np.maximum(gap - apart, 0.0)
        pull = 2 * overlap[:, None] * direction
        slope = np.empty_like(room.centres)
        for c in (0, 1):
            count = len(slope)
            slope[:, c] = np.bincount(first, pull[:, c], count) - np.bincount(second, pull[:, c], count)
        return (overlap**2).sum(), slope.reshape(-1)

    start = np.clip(room.centres.reshape(-1), least, most)
    options = {"maxiter": ITERATIONS, "ftol": 0.0, "gtol": 1e-9}
    found = minimize(energy, start, jac=True, method="L-BFGS-B", bounds=np.stack([least, most], axis=1), options=options)
    room.centres[:] = found.x.reshape(-1, 2)
    return float(found.fun)
