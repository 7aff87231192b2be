"""One thread of linear algebra: matrices of a fit are small, so that threads only wait for one another and for other runs."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")
VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""What libraries that are loaded later, and processes that are started, read when they begin."""


@contextmanager
def one_thread() -> Iterator[None]:
    """Inside, libraries of linear algebra use one thread, those loaded already and those to come; afterwards as before.

    A number that the environment states for libraries to come stands.
    """
    import numpy.linalg  # noqa: F401  a library that is loaded can be limited
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
    """Every call of the function inside `one_thread`."""

    @wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        with one_thread():
            return function(*args, **kwargs)

    return limited
