"""Restart files: the state of a run at its last complete sample, and going on from there."""

import json

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpm import results
from jaxmpm.errors import written
from jaxmpm.moving_simulation import MovingSimulation

NAME = "restart.h5"


def save(recorder) -> None:
    """Write what a `run.Recorder` keeps as of its last complete sample."""
    state, done, frames, most, moving = recorder.safe
    leaves, _ = jax.tree_util.tree_flatten_with_path(state)
    arrays = {_name(path): np.asarray(leaf) for path, leaf in leaves}
    meta = {
        "scene": recorder.scene.to_dict(),
        "done": done,
        "frames": frames,
        "most_energy": most,
        "wall_seconds": recorder.wall_seconds(),
        "run_seconds": recorder.sim.run_seconds,
        "handed_over": recorder.handed_over,
        "messages": recorder.messages,
        "moving": moving,
    }
    results.save_restart(recorder.directory / NAME, arrays, meta)


def restore(recorder) -> None:
    """Put a recorder where its restart file was written; raises ResultError where that is of another scene."""
    path, scene = recorder.directory / NAME, recorder.scene
    arrays, meta = results.load_restart(path)
    now = json.loads(json.dumps(scene.to_dict()))
    if meta["scene"] != now:
        raise results.ResultError(
            f"{path}: the scene differs from the one that was interrupted "
            f"({difference(meta['scene'], now)}); run it with the same scene and --set, or "
            "without --resume to start anew"
        )
    if meta["moving"] is not None and not recorder.moves and not recorder.static:
        recorder.sim = MovingSimulation.blank(recorder.sim)
    sim = recorder.sim
    leaves, tree = jax.tree_util.tree_flatten_with_path(sim.state)
    names = [_name(path) for path, _ in leaves]
    sim.state = jax.tree.unflatten(tree, [jnp.asarray(arrays[name]) for name in names])
    if recorder.moves or recorder.static:
        sim.resume(meta["moving"])
    recorder.handed_over, recorder.messages = meta["handed_over"], meta["messages"]
    recorder.done, recorder.frames, recorder.most = meta["done"], meta["frames"], meta["most_energy"]
    recorder.keep()
    recorder.wall_before, sim.run_seconds = meta["wall_seconds"], meta["run_seconds"]


def changed(directory, scene) -> str:
    """The first key in which scene.json of a directory (a Path) differs from a scene, and both its values; "" where none does."""
    before, now = results.read_object(directory / "scene.json"), json.loads(json.dumps(scene.to_dict()))
    return difference(before, now) if before != now else ""


def difference(before, now, path=""):
    """The first key in which two scenes differ, and both its values, for a message."""
    if type(before) is type(now) and isinstance(now, dict | list) and before != now:
        keys = [*before, *now] if isinstance(now, dict) else range(max(len(before), len(now)))
        absent = "absent"
        for key in keys:
            pair = [_item(tree, key, absent) for tree in (before, now)]
            if pair[0] != pair[1]:
                return difference(*pair, f"{path}.{key}" if path else str(key))
    return f"{path} was {written(before)} and is {written(now)}"


def _item(tree, key, absent):
    try:
        return tree[key]
    except (KeyError, IndexError):
        return absent


def _name(path) -> str:
    return jax.tree_util.keystr(path, simple=True, separator=".")
