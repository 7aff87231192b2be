"""Linear algebra in one thread: the matrices of a fit are so small that several threads mostly wait for one another."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")
VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Read at start by libraries that are loaded later and by child processes."""


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit libraries of linear algebra, loaded already or later, to one thread; restore the former state at the end.

    A number that the environment states for libraries loaded later is kept.
    """
    import numpy.linalg  # noqa: F401  threadpool_limits reaches only libraries that are loaded
    import scipy.linalg  # noqa: F401
    from threadpoolctl import threadpool_limits

    variables = [name for name in VARIABLES if name not in os.environ]
    os.environ.update(dict.fromkeys(variables, "1"))
    try:
        with threadpool_limits(1):
            yield
    finally:
        for name in variables:
            os.environ.pop(name, None)


def single_threaded(function: Callable[P, R]) -> Callable[P, R]:
    """Decorator: every call of the function runs inside `one_thread`."""

    @wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        with one_thread():
            return function(*args, **kwargs)

    return limited
