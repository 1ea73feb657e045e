"""`python -m tests.benchmarks [FILE.json]`: the table for both precisions, and how time scales."""

import json
import sys

import numpy as np

from tests.benchmarks import compare
from tests.benchmarks.scene import Scene


def main(path=None):
    """Print the table, and write it to a file."""
    if absent := compare.missing():
        sys.exit(f"The comparison needs {', '.join(absent)}: pip install {' '.join(absent)}")
    import jax

    jax.config.update("jax_enable_x64", True)
    scene = Scene(compare.CELLS)
    out = {"points": scene.count, "threads": compare.threads()}
    print(f"{scene.count} points, {out['threads']} threads, million point-steps/s, best of {compare.TURNS}")
    for dtype in (np.float32, np.float64):
        rate = compare.rates(scene, dtype)
        ratio = compare.summary(rate)
        out[dtype.__name__] = {"rate": rate, "summary": ratio}
        for name, value in rate.items():
            times = f"{ratio[name]:8.2f} ×" if name in ratio else ""
            print(f"{dtype.__name__:9}{name:27}{value:9.1f}{times}", flush=True)
    for name in (compare.MOVING, compare.TOTAL):
        for dtype in (np.float32, np.float64):
            rows = out[dtype.__name__].setdefault("scaling", {})[name] = compare.scaling(name, dtype)
            listed = ", ".join(f"{count}: {cost:.2f}" for count, cost in rows.items())
            print(f"{dtype.__name__:9}{name}, ns per point and step: {listed}", flush=True)
    if path:
        with open(path, "w") as file:
            json.dump(out, file, indent=1)


if __name__ == "__main__":
    main(*sys.argv[1:2])
