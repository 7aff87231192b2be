"""One estimation session: several methods over several flights, their mean and scatter, and the joint fit.

This is what `sideslip estimate` prints, writes as JSON (names as in the interface description) and hands to the report.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from estimation.aircraft import Aircraft
from estimation.doubts import doubts
from estimation.engine.data import FlightData, Preparation, prepare
from estimation.errors import EstimationError
from estimation.estimators.result import Result, finite
from estimation.models.base import Model
from groundstation.flight import Flight

METHODS = ("ml", "fem", "ls", "ngn", "ngn-improved")
NEURAL = ("ngn", "ngn-improved")
TITLES = {
    "ml": "maximum likelihood, output error",
    "fem": "maximum likelihood, filter error",
    "ls": "equation error, least squares",
    "ngn": "neural Gauss-Newton, as published",
    "ngn-improved": "neural Gauss-Newton, interval means",
}


@dataclass(frozen=True)
class Scatter:
    """One parameter over flights. std: sample standard deviation; bound: rms of the flights' corrected bounds;
    ratio: std/bound; probability: of a chi-square as large, were the bounds right (None with fewer than two flights)."""

    mean: float
    std: float
    bound: float
    ratio: float
    probability: float | None
    count: int
    trim: bool = False  # a constant that differs from flight to flight with trim and sensor offsets

    @property
    def text(self) -> str:
        """The verdict on the bounds, empty where scatter and bounds agree."""
        if self.trim or self.probability is None or self.probability > 0.01:
            return ""
        return f"scatter over {self.count} flights is {self.ratio:.1f} times the bounds: these bounds are too small"


@dataclass(frozen=True)
class FlightEstimates:
    """Results of every method on one flight; failures: method -> why it could not be used."""

    flight: Flight
    results: Mapping[str, Result]
    failures: Mapping[str, str] = field(default_factory=dict)

    @property
    def notes(self) -> tuple[str, ...]:
        """What was done to the data, and what of the first method's answer asks for a second look."""
        first = next((r for r in self.results.values() if r.flights), None)
        return self.flight.notes if first is None else (*first.flights[0].notes, *doubts(first))


@dataclass(frozen=True)
class Extras:
    """Uncertainty on demand. profile: parameters (ml); bootstrap: replicates (0: none for ml, the usual number for ngn);
    seed: of its noise, and of the networks. raw_inputs: ml, fem and ls take measured inputs with their noise.
    stepwise: ls chooses its terms by partial F."""

    profile: tuple[str, ...] = ()
    bootstrap: int = 0
    seed: int = 0
    raw_inputs: bool = False
    stepwise: bool = False


NO_EXTRAS = Extras()


@dataclass(frozen=True)
class Session:
    """Everything one call of `estimate` found. truth: derivatives of simulated flights, to be shown beside the means."""

    aircraft: Aircraft
    model: Model
    methods: tuple[str, ...]
    flights: tuple[FlightEstimates, ...]
    joint: Mapping[str, Result]
    mean: Mapping[str, Mapping[str, Scatter]]
    truth: Mapping[str, float] = field(default_factory=dict)

    @property
    def converged(self) -> bool:
        """Whether every method came to a usable end on every flight."""
        each = [r for f in self.flights for r in f.results.values()] + list(self.joint.values())
        return bool(each) and all(r.converged for r in each) and not any(f.failures for f in self.flights)

    @property
    def text(self) -> str:
        """One sentence on how it went."""
        bad = [f"{f.flight.name} ({m})" for f in self.flights for m, r in f.results.items() if not r.converged]
        bad += [f"{f.flight.name} ({m})" for f in self.flights for m in f.failures]
        bad += [f"joint ({m})" for m, r in self.joint.items() if not r.converged]
        if bad:
            return f"not converged: {', '.join(bad)}"
        blind = sorted(
            {n for f in self.flights for r in f.results.values() for n, e in r.parameters.items() if not e.identifiable}
        )
        said = f"{len(self.flights)} flight{'s' if len(self.flights) > 1 else ''} estimated"
        if not blind:
            return said
        return f"{said}; in some flights the data cannot tell {', '.join(blind)}{self._together(blind)}"

    def _together(self, blind: list[str]) -> str:
        """What the joint estimate makes of parameters that some flights cannot tell."""
        joint = next(iter(self.joint.values()), None)
        if joint is None:
            return ""
        left = [n for n in blind if n in joint.parameters and not joint.parameters[n].identifiable]
        return f"; nor can all together tell {', '.join(left)}" if left else "; all together can"

    def to_json(self) -> dict[str, Any]:
        """As the interface description has it."""
        first = self.joint or (self.flights[0].results if self.flights else {})
        collinear = next((r.collinear for r in first.values()), ())
        return {
            "version": 1,
            "aircraft": self.aircraft.name,
            "model": self.model.name,
            "status": self.text,
            "flights": [_flight_json(f) for f in self.flights],
            "mean": {
                method: {n: {"mean": finite(s.mean), "std": finite(s.std)} for n, s in table.items()}
                for method, table in self.mean.items()
            },
            "joint": {method: r.to_json() for method, r in self.joint.items()},
            "collinear": [list(pair) for pair in collinear],
            **({"truth": dict(self.truth)} if self.truth else {}),
            "scatter": {
                method: {
                    n: {"ratio": finite(s.ratio), "probability": s.probability, "text": s.text}
                    for n, s in table.items()
                    if s.count > 1
                }
                for method, table in self.mean.items()
            },
        }


def _flight_json(f: FlightEstimates) -> dict[str, Any]:
    data: dict[str, Any] = {
        "name": f.flight.name,
        "samples": len(f.flight),
        "methods": {m: r.to_json() for m, r in f.results.items()},
    }
    for method, why in f.failures.items():
        data["methods"][method] = {"converged": False, "status": why, "parameters": {}, "fit": {}}
    data["notes"] = list(f.notes)
    data["provenance"] = {"path": f.flight.provenance.path, "sha256": f.flight.provenance.sha256}
    return data


def estimate(
    model: Model,
    flights: Sequence[Flight],
    aircraft: Aircraft,
    methods: Sequence[str] = ("ml",),
    *,
    joint: bool = False,
    device: str = "cpu",
    progress: Callable[[str], None] | None = None,
    extras: Extras = NO_EXTRAS,
) -> Session:
    """Run every method on every flight, and on all of them together where `joint`.

    device: where networks are trained. progress: told each piece of work as it begins. Raises EstimationError for an
    unknown method, and what the first method raises when a flight cannot feed the model.
    """
    if not methods:
        raise EstimationError(f"no method given; choose from {', '.join(METHODS)}")
    unknown = [m for m in methods if m not in METHODS]
    if unknown:
        raise EstimationError(f"method {unknown[0]!r} is unknown; known are {', '.join(METHODS)}")
    _check_extras(extras, model, methods)
    flights = unique_names(flights)
    tell = progress or (lambda _: None)
    neural: dict[str, list[Result]] = {}
    for method in (m for m in methods if m in NEURAL):
        tell(f"networks of {len(flights)} flight{'s' if len(flights) > 1 else ''}: {TITLES[method]}")
        neural[method] = _neural(method, model, flights, aircraft, device, extras)
    done = []
    for number, flight in enumerate(flights):
        results: dict[str, Result] = {}
        for method in methods:
            if method in NEURAL:
                results[method] = neural[method][number]
                continue
            tell(f"{flight.name}: {TITLES[method]}")
            used = _as_asked(model, [flight], extras)
            found = run_method(method, model, used, aircraft, device, extras)
            results[method] = with_extras(found, model, used, extras, number, tell) if method == "ml" else found
        done.append(FlightEstimates(flight, results))
    together: dict[str, Result] = {}
    if joint:
        for method in methods:
            tell(f"joint over {len(flights)} flights: {TITLES[method]}")
            shared = joint_model(model)
            together_used = flights if method in NEURAL else _as_asked(shared, flights, extras)
            found = run_method(method, shared, together_used, aircraft, device, extras)
            if method == "ml":
                found = with_extras(found, shared, together_used, extras, len(flights), tell)
            together[method] = found
    mean = {m: scatter([f.results[m] for f in done]) for m in methods}
    return Session(aircraft, model, tuple(methods), tuple(done), together, mean)


def _check_extras(extras: Extras, model: Model, methods: Sequence[str]) -> None:
    """EstimationError before any work is done for extras that cannot be had."""
    if extras.stepwise and "ls" not in methods:
        raise EstimationError("--stepwise is for method ls: add ls to --method")
    if replace(extras, raw_inputs=False, stepwise=False) == NO_EXTRAS:
        return
    if extras.profile and "ml" not in methods:
        raise EstimationError("--profile refines method ml: add ml to --method")
    if not {"ml", *NEURAL} & set(methods):
        raise EstimationError("--bootstrap and --seed are for methods ml, ngn and ngn-improved: add ml to --method")
    if extras.bootstrap:
        from estimation.estimators.bootstrap import check_replicates

        check_replicates(extras.bootstrap)
    if extras.seed < 0:
        raise EstimationError(f"--seed {extras.seed}: give a whole number from 0")
    for name in extras.profile:
        if model.parameter(name).fixed:
            raise EstimationError(f"model {model.name}: {name} is fixed, so it has no profile; free it first")


def _as_asked(model: Model, flights: Sequence[Flight], extras: Extras) -> Sequence[Flight | FlightData]:
    """The flights, or already prepared with their inputs as measured."""
    return [prepare(model, f, Preparation(denoise=False)) for f in flights] if extras.raw_inputs else flights


def with_extras(
    result: Result,
    model: Model,
    flights: Sequence[Flight | FlightData],
    extras: Extras,
    number: int,
    tell: Callable[[str], None],
) -> Result:
    """A maximum-likelihood result with its profiles and bootstrap. number: of the fit, so that each has noise of its own."""
    if extras.profile:
        from estimation.estimators.profile import profile_likelihood

        tell(f"profiles of {', '.join(extras.profile)}")
        curves = {name: profile_likelihood(model, flights, name, result) for name in extras.profile}
        result = replace(result, profile=curves)
    if extras.bootstrap:
        from estimation.estimators.bootstrap import parametric_bootstrap

        tell(f"{extras.bootstrap} bootstrap replicates")
        rng = np.random.default_rng([extras.seed, number])
        result = replace(result, bootstrap=parametric_bootstrap(model, flights, result, extras.bootstrap, rng))
    return result


def joint_model(model: Model) -> Model:
    """The model for a joint fit: constant coefficients (CY_0 Cl_0 Cn_0 ...) are each flight's own.

    They hold the trim, the centre of gravity and the sensor offsets of the day as much as the aircraft.
    """
    return model.with_local(*(n for n in model.free_names if is_trim(n)))


def is_trim(name: str) -> bool:
    """Whether a parameter is a constant coefficient that trim, centre of gravity and sensor offsets change."""
    return name.endswith("_0") and name != "CD_0"


def run_method(
    method: str,
    model: Model,
    flights: Sequence[Flight | FlightData],
    aircraft: Aircraft,
    device: str = "cpu",
    extras: Extras = NO_EXTRAS,
) -> Result:
    """One method over one flight or several together; heavy packages are imported only for the method that needs them."""
    if method == "ml":
        from estimation.estimators.output_error import output_error

        return output_error(model, flights)
    if method == "ls":
        from estimation.estimators.equation_error import equation_error

        return equation_error(model, flights, stepwise=extras.stepwise)
    if method == "fem":
        from estimation.estimators.filter_error import filter_error

        return filter_error(model, flights)
    from estimation.estimators.neural_gauss_newton import estimate_ngn

    improved, bootstraps = method == "ngn-improved", extras.bootstrap or None
    return estimate_ngn(
        aircraft, [f for f in flights if isinstance(f, Flight)], model=model, improved=improved, device=device,
        bootstraps=bootstraps, seed=extras.seed,
    )  # fmt: skip


def _neural(
    method: str, model: Model, flights: Sequence[Flight], aircraft: Aircraft, device: str, extras: Extras
) -> list[Result]:
    """Each flight by itself, the networks of all of them trained side by side."""
    from estimation.estimators.neural_gauss_newton import estimate_campaign

    improved, bootstraps = method == "ngn-improved", extras.bootstrap or None
    return estimate_campaign(
        aircraft, flights, model=model, improved=improved, device=device, bootstraps=bootstraps, seed=extras.seed
    )


def unique_names(flights: Sequence[Flight]) -> list[Flight]:
    """Flights with names of their own, so that no result hides another."""
    seen: dict[str, int] = {}
    result = []
    for flight in flights:
        seen[flight.name] = seen.get(flight.name, 0) + 1
        count = seen[flight.name]
        result.append(flight if count == 1 else replace(flight, name=f"{flight.name}#{count}"))
    return result


def scatter(results: Sequence[Result]) -> dict[str, Scatter]:
    """Mean and scatter of each parameter over the flights that could tell it, against their bounds."""
    table = {}
    for name in results[0].parameters:
        usable = [r.parameters[name] for r in results if r.converged and name in r.parameters]
        told = [e for e in usable if e.identifiable]
        if not told:
            continue
        x = np.array([e.estimate for e in told])
        bounds = np.array([e.std_coloured for e in told])
        std = float(np.std(x, ddof=1)) if x.size > 1 else math.nan
        bound = float(np.sqrt(np.mean(bounds**2)))
        probability = None
        if x.size > 1 and np.all(bounds > 0):
            weighted = np.sum(x / bounds**2) / np.sum(1 / bounds**2)
            probability = chi_square_tail(float(np.sum(((x - weighted) / bounds) ** 2)), x.size - 1)
        table[name] = Scatter(
            float(x.mean()), std, bound, std / bound if bound > 0 else math.nan, probability, x.size, is_trim(name)
        )
    return table


def chi_square_tail(value: float, freedom: int) -> float:
    """Probability of a chi-square above `value`: regularised incomplete gamma Q(freedom/2, value/2).

    Exact finite sums (Abramowitz and Stegun 26.4.4, 26.4.5); no need of scipy for one number.
    """
    if value <= 0.0:
        return 1.0
    half = 0.5 * value
    if freedom % 2 == 0:
        term = total = math.exp(-half)
        for k in range(1, freedom // 2):
            term *= half / k
            total += term
        return min(1.0, total)
    total = math.erfc(math.sqrt(half))
    term = math.sqrt(half) * math.exp(-half) / math.gamma(1.5)
    for k in range(freedom // 2):
        total += term
        term *= half / (k + 1.5)
    return min(1.0, total)
