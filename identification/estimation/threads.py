"""One thread for linear algebra on many small matrices.

The libraries below NumPy and SciPy each keep threads that wait for one another by spinning. On small matrices they gain
little, and on a machine with other work, or with both libraries in turn, they take ten to fifty times as long.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import ThreadpoolController

Arguments = ParamSpec("Arguments")
R = TypeVar("R")


def single_threaded(function: Callable[Arguments, R]) -> Callable[Arguments, R]:
    """The function, run while linear algebra has one thread."""

    @wraps(function)
    def limited(*args: Arguments.args, **kwargs: Arguments.kwargs) -> R:
        with _controller().limit(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return limited


@cache
def _controller() -> ThreadpoolController:
    """Of the libraries loaded by now; finding them takes milliseconds."""
    return ThreadpoolController()
