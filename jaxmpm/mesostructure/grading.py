"""Sizes of inclusions that follow a grading curve."""

import numpy as np


def draw_sizes(grading, area: float, random: np.random.Generator) -> np.ndarray:
    """Sizes (n,), mm, the largest first, whose circles have an `area` (mm²) in all.

    The area is filled from the top of the curve down: an inclusion that takes the area S to S + a
    has a size from that part of the curve, at random within it. So the curve of what was drawn is
    never off by much more than one inclusion. Then all are scaled, by less than the last one counts, to
    the area itself, which is that of one of the largest at least.
    """
    sizes, taken, size = [], 0.0, grading.largest
    while True:
        share = (taken + random.random() * circle(size)) / area
        size = float(grading.size_at(1.0 - min(share, 1.0)))
        if taken + 0.5 * circle(size) > area:
            break
        sizes.append(size)
        taken += circle(size)
    return np.sort(sizes)[::-1] * np.sqrt(area / taken)


def circle(size):
    """Area (mm²) of a circle of diameter `size`, mm."""
    return np.pi / 4 * np.square(size)


def measured(sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The curve of given sizes, mm: sizes that increase, and the share by area up to each."""
    sizes = np.sort(sizes)
    share = np.cumsum(circle(sizes))
    return sizes, share / share[-1]
