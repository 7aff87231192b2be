"""Where a surface was between the samples of its record, as unknowns of a fit.

A servo that lags takes some share of its way within the first interval after an edge. Where edges come at any time of an
interval that share scatters from nothing to all that the servo can do; where a sequencer steps on the sampling clock it is the
same at every edge, does not average out, and cannot be read off the samples; nor can it where what is logged is a command,
whatever its edges look like (`clocked_controls`).

There two numbers a control stand for what the record does not say: how much later than its samples the surface acts (earlier,
where negative: a command that was logged up to one logging interval after it was given), and how far beyond the straight line it
is half-way between two samples (a servo of first order that starts on a sample is there at 1 / (1 + exp(-dt / 2T)) of the step).
Both have priors as wide as a logging interval and a servo make them; what the data cannot tell of them stays in the bounds of the
derivatives, which are taken from the inverse of the whole information.
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
from groundstation.flight.findings import Finding, FindingKind

FEWEST_EDGES = 4  # from which the scatter of a share says something: four at random are as alike in one of fifty
ALIKE = 0.2  # scatter of the share over its mean; 0.58 where edges come at any time of an interval
FAST = 0.15  # share of the way within one interval from which the way between samples matters
LARGE = 0.3  # of the largest edge of a control: smaller ones are steering, not an input made on purpose
REST = 0.05  # of an edge: a control that moves less was at rest before it
NOISY = 8.0  # noise levels that an edge has to stand out by
LONGEST = 8  # samples that one edge takes at most


def clocked_controls(model: Model, flights: Sequence[FlightData]) -> tuple[str, ...]:
    """Controls of a model that are recorded commands, or whose edges are alike at the samples of these flights."""
    clocked = []
    commands = {n for f in flights for n in f.commands}
    for i, signal in enumerate(model.inputs):
        if not signal.control:
            continue
        noise = max((f.noise.get(signal.name, (0.0, 0.0))[0] for f in flights), default=0.0)
        edges = np.concatenate([_edges_from_rest(s.u[:, i], noise) for f in flights for s in f.segments])
        if signal.name in commands or _alike(edges):
            clocked.append(signal.name)
    return tuple(clocked)


def _alike(edges: Array) -> bool:
    """edges: (n, 2) size of each and the share of it in its first interval."""
    if not len(edges):
        return False
    share = edges[edges[:, 0] >= LARGE * edges[:, 0].max(), 1]
    return share.size >= FEWEST_EDGES and bool(share.mean() >= FAST and share.std(ddof=1) <= ALIKE * share.mean())


def _edges_from_rest(u: Array, noise: float) -> Array:
    """(n, 2) size and first share of each edge of a control (N,) that comes out of rest."""
    step = np.diff(u)
    if step.size < 3:
        return np.zeros((0, 2))
    before = np.maximum(np.abs(step[:-2]), np.abs(step[1:-1]))
    # that an edge from the third step on can have
    most = 1.001 * np.convolve(np.abs(step), np.ones(LONGEST))[LONGEST + 1 :]
    edges, end = [], 0
    for k in (np.flatnonzero((before <= REST * most) & (most > NOISY * noise)) + 2).tolist():
        rise = step[k : k + LONGEST] * np.sign(step[k])
        way = rise[: int(np.argmax(rise <= 0.0)) if (rise <= 0.0).any() else rise.size]
        size = float(way.sum())
        large = size > max(NOISY * noise, 0.0) and way[0] > REST * size
        if k >= end and large and before[k - 2] <= REST * size:
            edges.append((size, float(way[0]) / size))
            end = k + way.size
    return np.array(edges).reshape(-1, 2)


SERVO = 0.04  # s: lags of model servos lie between .02 and .06; a record that is a command is wrong by this
INTERVALS = 0.5  # of an interval of samples, or of a command's records: what an edge on the clock leaves open
HALF_WAY = (
    0.2  # of a step: .12 for a servo as slow as the interval, .38 for one four times as fast, both of either sign
)
MOST_BEND = 0.5  # half-way a surface is between where it was and where it will be
MOST_LAG = 5.0  # of the prior
SURE_OF_WAY = 0.25
"""Of what the ways do to an estimate, what two numbers a control leave open: rms .28 over the yawing derivatives of servos of
35 ms at 20 Hz that start on a sample, whose own error is small beside it."""
PREFIX = {"lag": "lag_of_", "bend": "way_of_"}


@dataclass(frozen=True)
class InputPath:
    """lag, std: s by which a surface acts later than its record, and the bound of that; bend, bend_std: share of a step by which
    it is beyond the straight line half-way between samples."""

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
    """The model with two unknowns for each control whose way between samples is open; itself where there is none."""
    step = float(np.median(np.concatenate([np.diff(s.time) for f in flights for s in f.segments])))
    interval = max((i for f in flights for i in f.commands.values()), default=0.0)
    size = float(np.hypot(SERVO, INTERVALS * max(step, interval)))
    if not model.free_names:
        return model
    busy = {
        t.input for t in model.transforms if t.kind in ("delay", "lag", "bend")
    }  # the model says itself how it follows
    return _with_unknowns(model, [n for n in clocked_controls(model, flights) if n not in busy], size)


def at_paths_of(model: Model, result: Result) -> Model:
    """The model with the ways of the surfaces that a result found, as fixed numbers; itself where it found none."""
    paths: Mapping[str, InputPath] = result.extra.get("input_paths", {})
    values = path_values(result)
    return _with_unknowns(model, list(paths), SERVO).fixed(**values) if values else model


def _with_unknowns(model: Model, controls: Sequence[str], size: float) -> Model:
    """size: s, of the prior of a delay."""
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
    """Values of those unknowns in an earlier result, by the names that `with_paths` gives them."""
    paths: Mapping[str, InputPath] = result.extra.get("input_paths", {})
    lags = {PREFIX["lag"] + n: p.lag for n, p in paths.items()}
    return lags | {PREFIX["bend"] + n: p.bend for n, p in paths.items()}


def in_own_terms(result: Result, model: Model) -> Result:
    """The result in terms of the parameters of `model`, what was found of the inputs in `extra["input_paths"]`."""
    e = result.parameters
    names = [n for n in model.input_names if PREFIX["lag"] + n in e]
    if not names:
        return result
    paths = {n: _path(e[PREFIX["lag"] + n], e[PREFIX["bend"] + n]) for n in names}
    notes = tuple(Finding(FindingKind.OTHER, _sentence(n, path)) for n, path in paths.items() if np.isfinite(path.lag))
    noted = replace(result, flights=tuple(replace(f, notes=(*f.notes, *notes)) for f in result.flights))
    nuisance = set(e) - set(model.free_names)
    return without_nuisance_parameters(_widened(noted, nuisance), model, nuisance, {"input_paths": paths})


def _widened(result: Result, nuisance: set[str]) -> Result:
    """The result with a share of what the ways between samples do to each estimate in its corrected bound."""
    ways = [i for i, n in enumerate(result.names) if n in nuisance]
    numbers = np.array([result.parameters[result.names[i]].estimate for i in ways])
    among = np.linalg.pinv(result.covariance[np.ix_(ways, ways)], hermitian=True)
    moved = SURE_OF_WAY * result.covariance[:, ways] @ among @ numbers
    moved[ways] = 0.0
    parameters = {
        n: replace(e, std_coloured=float(np.hypot(e.std_coloured, moved[i])))
        for i, n in enumerate(result.names)
        for e in (result.parameters[n],)
    }
    wider = result.covariance_coloured + np.outer(moved, moved)
    return replace(result, parameters={**result.parameters, **parameters}, covariance_coloured=wider)


def _sentence(control: str, path: InputPath) -> str:
    return (
        f"{control}: its edges fall on the sampling clock or were logged as steps, so its way between samples was estimated: it "
        f"acts {path.lag * 1e3:+.1f} +- {path.std * 1e3:.1f} ms after its record and is {path.bend:+.2f} +- {path.bend_std:.2f} "
        "of a step beyond a straight line half-way; the bounds count that; log surfaces faster to narrow it"
    )


def _path(lag: Estimate, bend: Estimate) -> InputPath:
    return InputPath(lag.estimate, lag.std_coloured, bend.estimate, bend.std_coloured)


def without_nuisance_parameters(result: Result, model: Model, nuisance: set[str], extra: Mapping[str, Any]) -> Result:
    """The result in terms of the model's own parameters; what else was estimated goes into `extra`."""
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
