"""Numerical failures of estimators as one sentence, from whichever library they come.

Every fit of a session runs within `numerical_failures`, and its result passes `mark_not_finite`; so a method need not guard
itself against records that it cannot fit. A programming error (a shape, a name, a type) stays the error that it is.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from estimation.estimators.gauss_newton import Status
from estimation.estimators.result import Result

LINEAR_ALGEBRA = frozenset({"LinAlgError", "_LinAlgError"})
"""Names of the errors that numpy, scipy and torch raise for a matrix that cannot be inverted, factored or decomposed."""

NUMERICAL_WORDS = ("infs or nans", "nan", "infinit", "inf ", "finite", "singular", "converge", "overflow")
"""Words in a ValueError of numpy or scipy that numbers caused; one caused by shapes or types has none of them."""

LIBRARIES = ("numpy", "scipy")

CURE = (
    "the motion is unstable or the record too poor for this method: check units, signs and start values, fit a shorter stretch "
    "about a manoeuvre, or use another method"
)


class NumericalFailure(ArithmeticError):
    """A sentence on a fit whose arithmetic failed: no programming error, and the results of other methods stay valid."""


@contextmanager
def numerical_failures() -> Iterator[None]:
    """Raise NumericalFailure for numerical errors of the code within; other errors pass."""
    try:
        yield
    except NumericalFailure:
        raise
    except Exception as error:
        if not is_numerical(error):
            raise
        raise NumericalFailure(f"failed in its arithmetic ({_one_line(error)}): {CURE}") from error


def is_numerical(error: Exception) -> bool:
    """Whether numbers caused an error: overflow, division, a singular matrix, an infinity that a library refuses."""
    if isinstance(error, ArithmeticError) or LINEAR_ALGEBRA & {c.__name__ for c in type(error).__mro__}:
        return True
    return type(error) is ValueError and _from_library(error) and any(w in str(error).lower() for w in NUMERICAL_WORDS)


def _from_library(error: Exception) -> bool:
    """Whether the error was raised within numpy or scipy."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    module = "" if trace is None else str(trace.tb_frame.f_globals.get("__name__", ""))
    return module.split(".")[0] in LIBRARIES


def _one_line(error: Exception) -> str:
    """The library's message on one line, without a full stop."""
    return " ".join(str(error).split()).rstrip(".") or type(error).__name__


def mark_not_finite(result: Result) -> Result:
    """The result; with status DIVERGED where it claims to have converged on estimates that are not finite."""
    not_finite = [n for n, e in result.parameters.items() if e.identifiable and not np.isfinite(e.estimate)]
    if not result.converged or not not_finite:
        return result
    return replace(result, status=Status.DIVERGED, text=f"no finite estimate of {', '.join(not_finite)}: {CURE}")
