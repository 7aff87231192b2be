"""The result of an estimation: estimates with validity and spread, by flight and joint.

`Result.to_json()` is one method's entry of `estimate --json`.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.estimators.gauss_newton import Status
from estimation.models.base import Model, ParameterRole
from estimation.signals.goodness_of_fit import ChannelFit
from groundstation.flight.findings import Finding

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Estimate:
    """One parameter. std: Cramer-Rao bound; std_coloured: corrected for coloured residuals and input errors (both inf where the
    data does not see the parameter); why: reason where it is not identifiable. local: each flight has its own value."""

    name: str
    estimate: float
    std: float
    std_coloured: float
    identifiable: bool = True
    why: str = ""
    unit: str = "1"
    reference: float | None = None
    reference_source: str = ""
    local: bool = False

    def to_json(self) -> dict[str, Any]:
        data: dict[str, Any] = {
            "estimate": finite_or_none(self.estimate),
            "std": finite_or_none(self.std),
            "std_coloured": finite_or_none(self.std_coloured),
            "identifiable": self.identifiable,
            "unit": self.unit,
        }
        if self.reference is not None:
            data |= {"reference": self.reference, "reference_source": self.reference_source}
        return data if self.identifiable else {**data, "why": self.why}


@dataclass(frozen=True)
class FlightFit:
    """One flight within a fit. measured, outputs, residuals: (samples, ny); states: (samples, nx) as the model moves, which its
    instruments may show otherwise; NaN outside the segments, states also where the fit simulates none.

    initial_states: (nx,) of each segment. local: estimates of parameters (biases, trims) of this flight alone.
    """

    name: str
    samples: int
    time: Array
    measured: Array
    outputs: Array
    residuals: Array
    states: Array
    initial_states: tuple[Array, ...]
    local: Mapping[str, Estimate]
    fit: Mapping[str, ChannelFit]
    notes: tuple[Finding, ...] = ()


@dataclass(frozen=True)
class Spread:
    """One parameter over the replicates. std: their standard deviation; bias: their mean minus the estimate of the fit; interval:
    95 %, between percentiles."""

    std: float
    bias: float
    interval: tuple[float, float]


@dataclass(frozen=True)
class Bootstrap:
    """names: parameters the data sees; estimates: (replicates that converged, names), local parameters as mean over flights;
    failed: number of replicates that did not converge; text: why there are no estimates, else empty."""

    names: tuple[str, ...]
    estimates: Array
    parameters: Mapping[str, Spread]
    failed: int
    text: str = ""

    def to_json(self) -> dict[str, Any]:
        data: dict[str, Any] = {
            "replicates": len(self.estimates),
            "failed": self.failed,
            "parameters": {
                n: {"std": s.std, "bias": s.bias, "interval": list(s.interval)} for n, s in self.parameters.items()
            },
        }
        return {**data, "status": self.text} if self.text else data


@dataclass(frozen=True)
class Profile:
    """values, deviance: (points,) ascending in value, the estimate among them. interval: 95 %, for white residuals;
    interval_coloured: widened like the corrected bound. An end is infinite where the data sets none; a limit of the parameter
    ends an interval. text: why there is no curve or no end, else empty."""

    name: str
    estimate: float
    values: Array
    deviance: Array
    interval: tuple[float, float]
    interval_coloured: tuple[float, float]
    text: str = ""

    def to_json(self) -> dict[str, Any]:
        data: dict[str, Any] = {
            "interval": [finite_or_none(v) for v in self.interval],
            "interval_coloured": [finite_or_none(v) for v in self.interval_coloured],
            "values": self.values.tolist(),
            "deviance": self.deviance.tolist(),
        }
        return {**data, "status": self.text} if self.text else data


@dataclass(frozen=True)
class EstimateHistory:
    """Estimates during the flight. time: (n,) s; estimate, std: name -> (n,), NaN while not identifiable."""

    time: Array
    estimate: Mapping[str, Array]
    std: Mapping[str, Array]

    def to_json(self) -> dict[str, Any]:
        """`time` and each parameter by name; null while it is not identifiable, because JSON knows no NaN."""
        parameters = {
            n: {
                "estimate": [finite_or_none(v) for v in self.estimate[n]],
                "std": [finite_or_none(v) for v in self.std[n]],
            }
            for n in self.estimate
        }
        return {"time": self.time.tolist(), **parameters}


@dataclass(frozen=True)
class Result:
    """A fit of one flight or of several together. names: the shared parameters, in the order of the covariances; R: (ny, ny)
    covariance of the residuals; collinear: strongly correlated pairs with their correlation; engine: back end of the
    simulation."""

    model: Model
    method: str
    status: Status
    text: str
    iterations: int
    evaluations: int
    cost: float
    R: Array
    names: tuple[str, ...]
    parameters: Mapping[str, Estimate]
    covariance: Array
    covariance_coloured: Array
    collinear: tuple[tuple[str, str, float], ...]
    flights: tuple[FlightFit, ...]
    engine: str = ""
    extra: Mapping[str, Any] = field(default_factory=dict)
    profile: Mapping[str, Profile] = field(default_factory=dict)
    bootstrap: Bootstrap | None = None
    history: EstimateHistory | None = None

    def __repr__(self) -> str:
        return f"<Result of {self.model.name} by {self.method}: {len(self.parameters)} parameters; {self.text:.120}>"

    @property
    def converged(self) -> bool:
        """Whether the estimates can be used."""
        return self.status.usable

    @property
    def informative(self) -> bool:
        """Whether any derivative is identifiable, or any parameter where the model has no free derivative."""
        names = self.model.free_of(ParameterRole.DERIVATIVE) or tuple(self.parameters)
        return any(self.parameters[n].identifiable for n in names if n in self.parameters)

    @property
    def correlation(self) -> Array:
        """(n, n) correlation of the estimates, from the Cramer-Rao covariance."""
        return correlation_matrix(self.covariance)

    @property
    def std(self) -> dict[str, float]:
        """Cramer-Rao bounds by name."""
        return {n: e.std for n, e in self.parameters.items()}

    @property
    def std_coloured(self) -> dict[str, float]:
        """Corrected bounds by name."""
        return {n: e.std_coloured for n, e in self.parameters.items()}

    @property
    def values(self) -> dict[str, float]:
        """Every parameter of the model by name: estimates (mean over flights for local ones) and fixed values."""
        return {**self.model.starts(), **{n: e.estimate for n, e in self.parameters.items()}}

    @property
    def fitted_model(self) -> Model:
        """The model with the estimates as its values."""
        return self.model.with_starts({n: v for n, v in self.values.items() if math.isfinite(v)})

    @property
    def noise(self) -> dict[str, float]:
        """Residual standard deviation per output."""
        return dict(zip(self.model.output_names, np.sqrt(np.diag(self.R)).tolist(), strict=True))

    def with_method(self, method: str) -> "Result":
        return replace(self, method=method)

    def to_json(self) -> dict[str, Any]:
        """One method's entry of `estimate --json`."""
        data: dict[str, Any] = {
            "converged": self.converged,
            "status": self.text,
            "iterations": self.iterations,
            "cost": finite_or_none(self.cost),
            "R": {n: finite_or_none(v) for n, v in zip(self.model.output_names, np.diag(self.R).tolist(), strict=True)},
            "parameters": {n: e.to_json() for n, e in self.parameters.items()},
            "fit": self._fit_json(),
        }
        if len(self.flights) > 1:
            data["local"] = {f.name: {n: e.to_json() for n, e in f.local.items()} for f in self.flights if f.local}
        if self.profile:
            data["profile"] = {n: p.to_json() for n, p in self.profile.items()}
        if self.bootstrap is not None:
            data["bootstrap"] = self.bootstrap.to_json()
        if paths := self.extra.get("input_paths"):
            data["inputs"] = {n: path.to_json() for n, path in paths.items()}
        if noise := self.extra.get("process_noise"):
            data["process_noise"] = {n: finite_or_none(v) for n, v in noise.items()}
        if self.history is not None:
            data["history"] = self.history.to_json()
        return data

    def _fit_json(self) -> dict[str, Any]:
        if len(self.flights) == 1:
            return {n: f.to_json() for n, f in self.flights[0].fit.items()}
        return {flight.name: {n: f.to_json() for n, f in flight.fit.items()} for flight in self.flights}


def judge_status(status: Status, parameters: Mapping[str, Estimate]) -> tuple[Status, str]:
    """The status of a fit, given which parameters are identifiable, and its sentence."""
    blind = [n for n, e in parameters.items() if not e.identifiable]
    if status in (Status.CONVERGED, Status.NOT_IDENTIFIABLE):
        status = Status.NOT_IDENTIFIABLE if blind else Status.CONVERGED
    return status, status.value + (f": {', '.join(blind)}" if status is Status.NOT_IDENTIFIABLE else "")


def correlation_matrix(covariance: Array) -> Array:
    """(n, n) correlations; zero with a parameter that has no finite, positive variance."""
    d = np.sqrt(np.diag(covariance))
    bounded = np.isfinite(d) & (d > 0)
    scale = np.where(bounded, 1.0 / np.where(bounded, d, 1.0), 0.0)
    result = np.where(np.isfinite(covariance), covariance, 0.0) * scale[:, None] * scale[None, :]
    np.fill_diagonal(result, 1.0)
    return result


def finite_or_none(value: float) -> float | None:
    """The number; None for infinity and NaN, which JSON does not know."""
    return float(value) if math.isfinite(value) else None
