"""Ensembles: one scene, many seeds, each an ordinary run in a folder of its own, and what they have in common.

What is on disk is all that is known of a sample, so that an ensemble can be interrupted anywhere,
gone on with, and made larger.
"""

import json
import time as clock
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from jaxmpm import results
from jaxmpm.ensemble_statistics import statistics, table_of
from jaxmpm.ensemble_workers import run_beside
from jaxmpm.errors import RunError, SceneError, written
from jaxmpm.progress import Terminal, screen
from jaxmpm.restart import changed
from jaxmpm.run import run_scene, terminate_as_interrupt
from jaxmpm.scene import Scene

FINAL = ("completed", "stopped", "refused")  # how a sample ends that another try would not change


def with_seed(scene: Scene, seed: int) -> Scene:
    """The scene with `seed` wherever it draws at random: the placing of inclusions, each scatter of strength.

    Those draws are independent of one another at the same seed (`scatter.strength_factor`).
    Raises SceneError where the scene draws nothing.
    """
    tree = scene.to_dict()
    tables = [material["scatter"] for material in tree["materials"].values() if material.get("scatter")]
    if scene.mesostructure and scene.mesostructure.inclusions:
        tables.append(tree["mesostructure"])
    if not tables:
        raise SceneError(
            "mesostructure.inclusions: absent, expected these or a table materials.NAME.scatter for an ensemble "
            "(nothing in the scene is drawn at random: all samples would be the same)"
        )
    for table in tables:
        table["seed"] = int(seed)
    return Scene.from_dict(tree)


def folder(directory, seed: int) -> Path:
    """Where the sample of a seed is."""
    return Path(directory) / f"seed_{seed:04d}"


def run_ensemble(
    scene: Scene, seeds: Sequence[int], directory, resume: bool = False, jobs: int = 1, progress: bool = True,
    pictures: str = "png",
) -> dict:  # fmt: skip
    """Run a scene for each seed and write what the samples have in common; returns that.

    Args:
        scene: something in it is drawn at random; its own seeds do not matter.
        seeds: whole numbers from 0, each once.
        directory: gets seed_0001/ … as of `run_scene`, ensemble.csv (a row a sample), ensemble.json (what
            is returned) and ensemble.png.
        resume: keep the samples there that have ended, and go on with those interrupted.
        jobs: samples run at a time; more than one in processes of their own, one thread each.
        progress: whether to say how far it is, on stderr.
        pictures: png, pdf or svg.

    Returns:
        `completed`, `failed` (reason by seed), `unfinished` (seeds) and `numbers`, the statistics of
        each number of a sample (`ensemble_statistics.statistics`).

    A sample that stops or cannot be built is recorded, the others go on. Raises SceneError where nothing
    is random or no sample can be built, ResultError where `resume` finds another scene; KeyboardInterrupt
    after all that was computed is on disk.
    """
    directory = Path(directory)
    samples = {int(seed): with_seed(scene, seed) for seed in seeds}
    done = _ready(samples, directory, resume)
    todo = {seed: sample.to_dict() for seed, sample in samples.items() if seed not in done}
    told = _Teller(progress, list(samples), len(done))

    def ended(seed):
        told.tell(seed, read_sample(directory, seed))
        write_ensemble(scene, samples, directory, picture=None)

    try:
        with terminate_as_interrupt():
            if jobs > 1:
                run_beside(partial(run_sample, pictures=pictures), todo, directory, jobs, ended)
            else:
                for seed, tree in todo.items():
                    run_sample(tree, folder(directory, seed), told.bar, pictures)
                    ended(seed)
    finally:
        found = write_ensemble(scene, samples, directory, pictures)
    refused = [reason for reason in found["failed"].values() if reason.startswith("refused: ")]
    if len(refused) == len(samples):
        raise SceneError(refused[0].removeprefix("refused: "))
    return found


def run_sample(tree: dict, directory: Path, progress: bool = False, pictures: str = "png") -> None:
    """Run one sample, on from its restart file if it has one; why it failed is in its summary.json."""
    scene = Scene.from_dict(tree)
    try:
        run_scene(scene, directory, resume=True, progress=progress, pictures=pictures)
    except RunError:  # its summary says why
        return
    except SceneError as error:
        directory.mkdir(parents=True, exist_ok=True)
        (directory / "scene.json").write_text(json.dumps(tree, indent=1))
        results.write_summary(directory, {"scene": scene.name, "status": f"refused: {error}"})
        return
    (directory / "restart.h5").unlink()  # a state that nothing goes on from, larger than all else


def read_sample(directory, seed: int) -> dict:
    """The summary of the sample of a seed; {"status": "unfinished"} where it has none."""
    try:
        return results.read_summary(folder(directory, seed))
    except results.ResultError:
        return {"status": "unfinished"}


def write_ensemble(scene: Scene, seeds, directory: Path, picture: str | None = "png") -> dict:
    """Write ensemble.csv, ensemble.json and, of at least one completed sample, ensemble.png; returns what is in the second.

    `picture`: png, pdf or svg; None for no picture.
    """
    summaries = {seed: read_sample(directory, seed) for seed in seeds}
    directory.mkdir(parents=True, exist_ok=True)
    results.write_table(directory / "ensemble.csv", *table_of(summaries))
    found = {"scene": scene.name, "title": scene.title} | statistics(summaries)
    results.write_object(directory / "ensemble.json", found)
    if picture and found["completed"] and scene.response:
        from jaxmpm.plot_ensemble import plot_ensemble

        plot_ensemble(directory, directory / f"ensemble.{picture}")
    return found


def _ready(samples: dict[int, Scene], directory: Path, resume: bool) -> list[int]:
    """Seeds whose sample has ended; without `resume` none, and what was there is no longer taken for a result."""
    done = []
    for seed, scene in samples.items():
        at = folder(directory, seed)
        if not resume:
            for name in ("summary.json", "restart.h5"):
                (at / name).unlink(missing_ok=True)
            continue
        if (at / "scene.json").exists() and (other := changed(at, scene)):
            raise results.ResultError(
                f"{at}: the scene differs from that of the ensemble so far ({other}); go on "
                "with the same scene and --set, or without --resume to start anew"
            )
        if read_sample(directory, seed)["status"].startswith(FINAL):
            done.append(seed)
    return done


class _Teller:
    """Says how far an ensemble is, one line a sample."""

    def __init__(self, wanted: bool, seeds: list[int], done: int):
        self.wanted, self.seeds, self.done = wanted, seeds, done
        self.first, self.began = done, clock.perf_counter()
        self.screen = screen()
        self.bar = wanted and isinstance(self.screen, Terminal)  # for a sample too
        if wanted and done:
            self.screen.line(f"{done} of {len(seeds)} samples are there already")

    def tell(self, seed: int, summary: dict) -> None:
        self.done += 1
        if not self.wanted:
            return
        passed = clock.perf_counter() - self.began
        left = passed / (self.done - self.first) * (len(self.seeds) - self.done)
        text = written(summary["status"]).strip('"')
        if text == "completed" and "peak_load" in summary:
            text = f"peak {summary['peak_load']:.5g} {summary['load_unit']}"
            text += f" at {summary['displacement_at_peak']:.3g} {summary['displacement_unit']}".rstrip()
        self.screen.line(f"seed {seed} ({self.done} of {len(self.seeds)}): {text}, {left:.0f} s left")
