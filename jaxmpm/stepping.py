"""How far the next increment of equilibrium goes and which cells crack first: the same for either frame."""

import numpy as np
from scipy import ndimage

EASY, HARD = 4, 8  # iterations after which increments grow, and after which they shrink
GROWTH, CUT = 2.0, 0.25
OVERSHOOT = 0.02  # of the strength: by how much a cell may be beyond onset at the end of an increment
NEIGHBOURS = 5  # cells each way in which one at most cracks at a time


def next_size(size, taken, iterations, smallest, largest):
    """The next increment, where one of `size` was meant, `taken` was gone, and Newton's method needed so many iterations."""
    if iterations <= EASY and taken >= 0.5 * size:
        return min(GROWTH * size, largest)
    return max(0.5 * size, smallest) if iterations > HARD else size


def share_to_onset(before, after, overshoot=OVERSHOOT):
    """Share of an increment after which the first cell is as far beyond onset as is aimed at; 1 if none is too far.

    `before`, `after`: strength ratios r̂ of cells at its begin and its end.
    """
    far = after > 1 + overshoot
    if not far.any():
        return 1.0
    rise = np.maximum(after[far] - before[far], 1e-12)
    return float(np.clip((1 + overshoot / 2 - before[far]) / rise, 0.0, 1.0).min())


def critical(ratio, most):
    """Flat indices of the cells beyond onset that crack first, by r̂ (nx, ny): the most critical first, one in each neighbourhood."""
    chosen = (ratio >= 1) & (ratio == ndimage.maximum_filter(ratio, NEIGHBOURS, mode="constant"))
    cells = np.flatnonzero(chosen)
    return cells[np.argsort(-ratio.reshape(-1)[cells], kind="stable")][:most]
