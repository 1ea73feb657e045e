"""Samples of an ensemble side by side, each worker a process of its own with one thread."""

import multiprocessing
import os
import queue
import signal
import threading
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path

POLL = 0.5  # s: how often it is looked whether a worker has died


def run_beside(run: Callable, trees: dict[int, dict], directory: Path, jobs: int, ended: Callable[[int], None]) -> None:
    """Call `run(tree, folder)` for every seed in `jobs` processes; `ended(seed)` here after each.

    A worker that dies takes its sample with it, not the others: `ended` is called for that one too, last.
    At KeyboardInterrupt the workers save what they have first.
    """
    jobs = min(jobs, len(trees))
    context = multiprocessing.get_context("spawn")  # JAX has threads, which a fork would not survive
    todo, done = context.Queue(), context.Queue()
    for seed in [*trees, *[None] * jobs]:
        todo.put(seed)
    with _one_thread():
        workers = [context.Process(target=_work, args=(run, trees, directory, todo, done)) for _ in range(jobs)]
        for worker in workers:
            worker.start()
    missing = set(trees)
    try:
        while missing:
            alive = any(worker.is_alive() for worker in workers)
            try:
                seed = done.get(timeout=POLL)
            except queue.Empty:
                if not alive:
                    break
                continue
            missing.discard(seed)
            ended(seed)
        for seed in sorted(missing):
            ended(seed)
    finally:
        todo.cancel_join_thread()
        for worker in workers:
            if missing:
                worker.terminate()
        for worker in workers:
            worker.join()


def _work(run, trees, directory, todo, done):
    from jaxmpm.compilation import keep_compiled
    from jaxmpm.ensemble import folder
    from jaxmpm.run import terminate_as_interrupt

    # Ctrl-C reaches every process of a terminal: the first one passes it on, once.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    keep_compiled()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        with terminate_as_interrupt():
            while (seed := todo.get()) is not None and multiprocessing.parent_process().is_alive():
                run(trees[seed], folder(directory, seed))
                done.put(seed)
    except KeyboardInterrupt:  # the run has saved what it had
        pass


def _end_with_parent():
    """Where the first process is killed, end as if it had asked: with what there is on disk."""
    multiprocessing.parent_process().join()
    os.kill(os.getpid(), signal.SIGTERM)


@contextmanager
def _one_thread():
    """Processes begun inside have one thread each for XLA, which else takes one for every core."""
    before = os.environ.get("NPROC")
    os.environ["NPROC"] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ["NPROC"]
        else:
            os.environ["NPROC"] = before
