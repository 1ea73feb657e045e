"""Which bodies a body has broken into: cells that hang together by more than a broken band."""

import numpy as np
from scipy import ndimage

HOLDS = 2e-2  # cohesion of a band, over its strength, that still holds a cell together
MOST = 6  # fragments that move in velocity fields of their own
LEAST = 0.005  # of all cells, below which a fragment goes with the one next to it


def fragments(owner, cohesion):
    """Fragment of each cell (nx, ny), the largest first, and how many smaller ones there are.

    Args:
        owner: body of each cell, -1 where empty.
        cohesion: what its band still holds, 1 where uncracked.
    """
    whole = (owner >= 0) & (cohesion > HOLDS)
    label = np.zeros(owner.shape, int)
    count = 0
    for body in np.unique(owner[owner >= 0]):
        found, number = ndimage.label(whole & (owner == body))
        label = np.where(found > 0, found + count, label)
        count += number
    sizes = np.bincount(label.reshape(-1), minlength=count + 1)
    sizes[0] = 0
    order = np.argsort(-sizes, kind="stable")[: min(count, MOST)]
    kept = [k for k in order if sizes[k] >= LEAST * (owner >= 0).sum()]
    for body in np.unique(owner[owner >= 0]):  # each body has a field of its own, however small
        own = np.unique(label[(owner == body) & (label > 0)])
        if len(own) and not set(own) & set(kept):
            kept.append(own[np.argmax(sizes[own])])
    rank = np.full(count + 1, -1)
    rank[kept] = np.arange(len(kept))
    number = rank[label]
    # the broken cells between, and crumbs, go with the nearest fragment of their body
    for body in np.unique(owner[owner >= 0]):
        mine = owner == body
        known = mine & (number >= 0)
        if known.any():
            nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
            number = np.where(mine & (number < 0), number[tuple(nearest)], number)
        else:
            number = np.where(mine, 0, number)
    return np.maximum(number, 0), count - len(kept)
