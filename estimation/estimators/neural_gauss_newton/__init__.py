"""Neural Gauss-Newton: a network learns the motion, then finds the aerodynamic parameters that explain it."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from estimation.estimators.neural_gauss_newton.estimate import NgnOptions, estimate_campaign, estimate_ngn

__all__ = ["NgnOptions", "estimate_campaign", "estimate_ngn"]


def __getattr__(name: str) -> Any:
    if name in __all__:
        from estimation.estimators.neural_gauss_newton import estimate

        return getattr(estimate, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
