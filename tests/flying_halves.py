"""A made-up run with points that move: a strip breaks in two, and its right half flies and spins."""

import numpy as np

from jaxmpm.results import write_summary
from jaxmpm.vtkhdf import PointCloudWriter

CELL, NX, NY = 2.0, 12, 6
BREAK = 5  # the column of cells that cracks
FIELDS = {
    "displacement": 3, "stress": 3, "damage": 1, "opening": 1, "normal": 3, "material": 1,
    "side": 1, "velocity": 3,
}  # fmt: skip
CENTRE, FLIGHT, SPIN = np.array([18.0, 6.0]), np.array([1500.0, 400.0]), 60.0  # mm, mm/s, rad/s
TIMES = np.array([0.0, 0.005, 0.01, 0.015, 0.02])


def flying(home, time):
    """Where what is at `home` (N, 2) is at a time, and how far it has turned (N,)."""
    since = max(time - TIMES[1], 0.0)
    right = home[:, 0] > (BREAK + 1) * CELL
    angle = np.where(right, SPIN * since, 0.0)
    arm, (cos, sin) = home - CENTRE, (np.cos(angle), np.sin(angle))
    turned = np.stack([cos * arm[:, 0] - sin * arm[:, 1], sin * arm[:, 0] + cos * arm[:, 1]], axis=1)
    return np.where(right[:, None], CENTRE + turned + FLIGHT * since, home), angle


def points_of(time):
    """Home (N, 2) and side (N,) of the points: at first one a cell, later four, but one in cracks."""
    index = np.stack(np.indices((NX, NY)), axis=-1).reshape(-1, 2)
    centres = (index + 0.5) * CELL
    if time < TIMES[2]:
        return centres, np.full(len(centres), CELL)
    cracked = index[:, 0] == BREAK
    quarters = CELL / 4 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    parts = (centres[~cracked, None] + quarters).reshape(-1, 2)
    side = np.repeat([CELL, CELL / 2], [cracked.sum(), len(parts)])
    return np.concatenate([centres[cracked], parts]), side


def frame_of(time):
    """Points (N, 3) and fields at a time."""
    home, side = points_of(time)
    place, angle = flying(home, time)
    cracked = (np.abs(home[:, 0] - (BREAK + 0.5) * CELL) < 0.1) & (time > 0)
    opening = cracked * time * (1 + home[:, 1] / CELL)
    # Alternately inclined, so that the segments across the points are, too.
    tilt = np.where(home[:, 1] % (2 * CELL) < CELL, 0.0, 0.3)
    normal = cracked[:, None] * np.stack([np.cos(tilt), np.sin(tilt)], axis=1)
    flat = np.zeros(len(home))
    stress = np.stack([3 * home[:, 0] / (NX * CELL), flat, flat], axis=1) * time / TIMES[-1]
    in_space = lambda vectors: np.pad(vectors, ((0, 0), (0, 1)))  # noqa: E731
    return in_space(place), {
        "displacement": in_space(place - home),
        "stress": stress,
        "damage": 0.5 * cracked,
        "opening": opening,
        "normal": in_space(normal),
        "material": (home[:, 1] > NY * CELL / 2).astype(float),
        "side": side,
        "velocity": in_space(FLIGHT * (angle != 0)[:, None]),
    }


def write_halves(directory, times=TIMES, drop=(), **changed):
    """The run's results; `drop`: fields to leave out; `changed`: fields to write otherwise."""
    fields = {name: size for name, size in FIELDS.items() if name not in drop}
    with PointCloudWriter.create(directory / "result.vtkhdf", fields) as writer:
        for time in times:
            points, data = frame_of(time)
            data |= {name: change(data[name]) for name, change in changed.items()}
            writer.write(time, points, {name: data[name] for name in fields})
    known = {"scene": "halves", "title": "A strip in two halves", "cell_size": CELL}
    known |= {"status": "completed", "frame": "total, then updated", "hand_over_time": TIMES[2]}
    write_summary(directory, known)
