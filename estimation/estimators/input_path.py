"""The path of a surface between the samples of its record, as unknowns of a fit.

A servo that lags makes some share of its travel within the first interval after an edge. Where edges come at any time within an
interval, that share scatters and averages out. Where a sequencer steps on the sampling clock, it is the same at every edge, does
not average out, and cannot be read off the samples. Nor can it where the record is a command (`clocked_controls`).

Such a control gets two unknowns: by how much later than its samples the surface acts (negative: earlier, as with a command
that was logged up to one logging interval after it was given), and how far beyond the straight line it is half-way between two
samples (a first-order servo that starts on a sample is there at 1 / (1 + exp(-dt / 2T)) of the step). Their priors are as wide as
logging intervals and servos make them. Their uncertainty enters the bounds of the derivatives, which come from the inverse of the
full information.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from estimation.engine.kernel import Array
from estimation.estimators.gauss_newton import Status
from estimation.estimators.result import Estimate, Result, finite_or_none, judge_status
from estimation.models.base import InputTransform, Model, Parameter, ParameterRole
from estimation.prepare.flight_data import FlightData
from groundstation.flight.arrays import MAD_TO_SIGMA
from groundstation.flight.findings import Finding, FindingKind

FEWEST_EDGES = 4  # for a judgement of their scatter: four random ones look alike in one case of fifty
MANY_EDGES = 20  # their median and its deviation are known to a quarter
ALIKE = 0.2  # scatter of the first share over its mean; 0.58 where edges come at any time within an interval
FAST = 0.15  # first share from which the path between samples matters
LARGE = 0.3  # of the largest edge of a control: smaller ones are steering, not a deliberate input
REST = 0.05  # of an edge: a control that moves less was at rest before it
AT_REST = 3.0 * np.sqrt(2.0)  # times the noise: one change between two samples of 370 is larger
NOISY = 8.0  # times the noise: smaller edges do not count
LONGEST = 8  # samples that one edge takes at most
SERVO = 0.04  # s: lags of model servos lie between .02 and .06; a command is ahead of its surface by so much
INTERVALS = 0.5  # of a sample interval, or of one of a command's record: uncertainty of an edge on the clock
HALF_WAY = 0.2  # of a step, std: .12 for a servo as slow as the interval, .38 for one four times as fast, either sign
MOST_BEND = 0.5  # half-way a surface is between its old and its new position
MOST_LAG = 5.0  # times the std of the prior
SURE_OF_WAY = 0.25
"""Of the effect of the estimated paths on an estimate: the part that two unknowns a control leave uncertain. rms .28 over yawing
derivatives with servos of 35 ms at 20 Hz that start on a sample, whose own error is small beside it."""
PREFIX = {"lag": "lag_of_", "bend": "way_of_"}


def clocked_controls(model: Model, flights: Sequence[FlightData]) -> tuple[str, ...]:
    """Controls of a model that are recorded commands, or whose edges look alike at the samples of these flights."""
    clocked = []
    commands = {n for f in flights for n in f.commands}
    for i, signal in enumerate(model.inputs):
        if not signal.control:
            continue
        noise = max((f.noise.get(signal.name, (0.0, 0.0))[0] for f in flights), default=0.0)
        # a control that never rests moves by its noise before an edge, too
        unrest = [AT_REST * noise if signal.name in f.restless else 0.0 for f in flights]
        pairs = [(s.u[:, i], still) for f, still in zip(flights, unrest, strict=True) for s in f.segments]
        edges = np.concatenate([_edges_from_rest(u, noise, still) for u, still in pairs])
        if signal.name in commands or _alike(edges):
            clocked.append(signal.name)
    return tuple(clocked)


def _alike(edges: Array) -> bool:
    """Whether large edges have the same share of their travel in the first interval. edges: (n, 2) size and that share."""
    if not len(edges):
        return False
    share = edges[edges[:, 0] >= LARGE * edges[:, 0].max(), 1]
    if share.size < FEWEST_EDGES:
        return False
    middle, scatter = float(share.mean()), float(share.std(ddof=1))
    if share.size >= MANY_EDGES:  # among so many some begin with a steering movement
        middle = float(np.median(share))
        scatter = MAD_TO_SIGMA * float(np.median(np.abs(share - middle)))
    return middle >= FAST and scatter <= ALIKE * middle


def _edges_from_rest(u: Array, noise: float, unrest: float = 0.0) -> Array:
    """(n, 2) size, and share of it in the first interval, of each edge of a control (N,) that starts from rest. unrest: change
    between two samples that is still rest."""
    step = np.diff(u)
    if step.size < 3:
        return np.zeros((0, 2))
    before = np.maximum(np.abs(step[:-2]), np.abs(step[1:-1]))
    # largest size of an edge from the third step on, and a little more for rounding
    most = 1.001 * np.convolve(np.abs(step), np.ones(LONGEST))[LONGEST + 1 :]
    edges, end = [], 0
    rest = before <= np.maximum(REST * most, unrest)
    starts = np.abs(step[2:]) > unrest
    for k in (np.flatnonzero(rest & starts & (most > NOISY * noise)) + 2).tolist():
        rise = step[k : k + LONGEST] * np.sign(step[k])
        travel = rise[: int(np.argmax(rise <= 0.0)) if (rise <= 0.0).any() else rise.size]
        size = float(travel.sum())
        large = size > max(NOISY * noise, 0.0) and travel[0] > REST * size
        if k >= end and large and before[k - 2] <= max(REST * size, unrest):
            edges.append((size, float(travel[0]) / size))
            end = k + travel.size
    return np.array(edges).reshape(-1, 2)


@dataclass(frozen=True)
class InputPath:
    """lag, std: time [s] by which a surface acts later than its record, and its bound; bend, bend_std: share of a step by which
    the surface is beyond the straight line half-way between samples, and its bound."""

    lag: float
    std: float
    bend: float
    bend_std: float

    def to_json(self) -> dict[str, Any]:
        """An entry of `inputs` in `estimate --json`."""
        return {
            "lag": finite_or_none(self.lag),
            "std": finite_or_none(self.std),
            "model": "delay and way between samples",
            "bend": finite_or_none(self.bend),
            "bend_std": finite_or_none(self.bend_std),
        }


def with_paths(model: Model, flights: Sequence[FlightData]) -> Model:
    """The model with two unknowns for each control whose path between samples is uncertain; itself where there is none."""
    step = float(np.median(np.concatenate([np.diff(s.time) for f in flights for s in f.segments])))
    interval = max((i for f in flights for i in f.commands.values()), default=0.0)
    size = float(np.hypot(SERVO, INTERVALS * max(step, interval)))
    if not model.free_names:
        return model
    modelled = {t.input for t in model.transforms if t.kind in ("delay", "lag", "bend")}  # by the model itself
    return _with_unknowns(model, [n for n in clocked_controls(model, flights) if n not in modelled], size)


def at_paths_of(model: Model, result: Result) -> Model:
    """The model with the surface paths of a result as fixed numbers; itself where the result has none."""
    paths: Mapping[str, InputPath] = result.extra.get("input_paths", {})
    values = path_values(result)
    return _with_unknowns(model, list(paths), SERVO).fixed(**values) if values else model


def _with_unknowns(model: Model, controls: Sequence[str], size: float) -> Model:
    """The model with the two unknowns of each named control. size: std of the prior of a delay [s]."""
    for name in controls:
        lag, bend = PREFIX["lag"] + name, PREFIX["bend"] + name
        model = model.plus(
            parameters=[
                Parameter(lag, "s", 0.0, -MOST_LAG * size, MOST_LAG * size, 0.0, size, role=ParameterRole.CONSTANT),
                Parameter(bend, "1", 0.0, -MOST_BEND, MOST_BEND, 0.0, HALF_WAY, role=ParameterRole.CONSTANT),
            ],
            transforms=[InputTransform("delay", name, (lag,)), InputTransform("bend", name, (bend,))],
        )
    return model


def path_values(result: Result) -> dict[str, float]:
    """Values of the unknowns of surface paths in a result, by the names that `with_paths` gives them."""
    paths: Mapping[str, InputPath] = result.extra.get("input_paths", {})
    lags = {PREFIX["lag"] + n: p.lag for n, p in paths.items()}
    return lags | {PREFIX["bend"] + n: p.bend for n, p in paths.items()}


def in_own_terms(result: Result, model: Model) -> Result:
    """The result in terms of the parameters of `model`, the surface paths in `extra["input_paths"]`."""
    e = result.parameters
    names = [n for n in model.input_names if PREFIX["lag"] + n in e]
    nuisance = set(e) - set(model.free_names)
    if not names or not nuisance:  # nothing to translate
        return result
    paths = {n: _path(e[PREFIX["lag"] + n], e[PREFIX["bend"] + n]) for n in names}
    notes = tuple(Finding(FindingKind.OTHER, _sentence(n, path)) for n, path in paths.items() if np.isfinite(path.lag))
    with_notes = replace(result, flights=tuple(replace(f, notes=(*f.notes, *notes)) for f in result.flights))
    return without_nuisance_parameters(_widened(with_notes, nuisance), model, nuisance, {"input_paths": paths})


def _widened(result: Result, nuisance: set[str]) -> Result:
    """The result with SURE_OF_WAY of the effect of surface paths on each estimate added to its corrected bound."""
    index = [i for i, n in enumerate(result.names) if n in nuisance]
    values = np.array([result.parameters[result.names[i]].estimate for i in index])
    information = np.linalg.pinv(result.covariance[np.ix_(index, index)], hermitian=True)
    effect = SURE_OF_WAY * result.covariance[:, index] @ information @ values
    effect[index] = 0.0
    parameters = {
        n: replace(e, std_coloured=float(np.hypot(e.std_coloured, effect[i])))
        for i, n in enumerate(result.names)
        for e in (result.parameters[n],)
    }
    wider = result.covariance_coloured + np.outer(effect, effect)
    return replace(result, parameters={**result.parameters, **parameters}, covariance_coloured=wider)


def _sentence(control: str, path: InputPath) -> str:
    """The note on an estimated surface path."""
    return (
        f"{control}: its edges fall on the sampling clock or were logged as steps, so its way between samples was estimated: it "
        f"acts {path.lag * 1e3:+.1f} +- {path.std * 1e3:.1f} ms after its record and is {path.bend:+.2f} +- {path.bend_std:.2f} "
        "of a step beyond a straight line half-way; the bounds count that; log surfaces faster to narrow it"
    )


def _path(lag: Estimate, bend: Estimate) -> InputPath:
    return InputPath(lag.estimate, lag.std_coloured, bend.estimate, bend.std_coloured)


def without_nuisance_parameters(result: Result, model: Model, nuisance: set[str], extra: Mapping[str, Any]) -> Result:
    """The result in terms of the parameters of `model`, without the `nuisance` ones; extra: added to the result's."""
    keep = np.array([i for i, n in enumerate(result.names) if n not in nuisance], int)
    parameters = {n: e for n, e in result.parameters.items() if n not in nuisance}
    status, text = result.status, result.text
    if status in (Status.CONVERGED, Status.NOT_IDENTIFIABLE):
        status, text = judge_status(status, parameters)
    pick = np.ix_(keep, keep)
    return replace(
        result,
        model=model,
        status=status,
        text=text,
        names=tuple(n for n in result.names if n not in nuisance),
        parameters=parameters,
        covariance=result.covariance[pick],
        covariance_coloured=result.covariance_coloured[pick],
        collinear=tuple(c for c in result.collinear if not nuisance & {c[0], c[1]}),
        extra={**result.extra, **extra},
    )
