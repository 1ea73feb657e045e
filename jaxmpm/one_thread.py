"""Dense linear algebra on one thread, where its matrices are too small to be shared.

Threads of BLAS wait for each other by spinning. With matrices of a few hundred rows, thousands of times, that costs more than it
saves, and where other processes want the cores, many times as much: the scene den in equilibrium on cells of 5 mm took 6.7 s on
one thread, and on two 9 s alone and 19 s beside another run.
"""

from functools import cache, wraps

from threadpoolctl import ThreadpoolController


@cache
def _controller():
    return ThreadpoolController()  # looks once which libraries are loaded


def on_one_thread(function):
    """The function, during which BLAS keeps to one thread."""

    @wraps(function)
    def limited(*args, **kwargs):
        with _controller().limit(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return limited
