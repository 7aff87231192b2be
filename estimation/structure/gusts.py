"""Whether the process noise of a filter error looks like gusts. Where it does not, the filter has absorbed an error of the model
or of the record, and its estimates are no better than those without a filter.

Gusts have three properties. They cannot be predicted from past movements of the controls (`follows_controls`). The innovations of
the filter are white, with a flat periodogram (`coloured_spectrum`). And they change the relative wind before the aircraft
responds with its moments (`turns_no_wind`). That they do not depend on the motion is tested term by term (`score_test`).
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from estimation.engine.simulate import Simulator
from estimation.estimators.result import Result
from estimation.models.dependence import driven_outputs
from estimation.prepare.flight_data import FlightData

Array = NDArray[np.float64]

STEPS = 8  # past samples of the controls: an error of the model shows within half a second of a movement
FOLLOWS = 0.08
"""Share of the innovations of one output that past movements of the controls predict, from which they follow the controls: at
most 0.03 in calm and gusty flights, 0.13 to 0.35 with a late vane, a late rudder or another product of inertia (random
aeroplanes, docs/validation.md)."""
FOLLOWS_BY_CHANCE = 1e-6  # probability of such a share by chance, above which it is not reported

NO_GUSTS = "its process noise is no gusts"


def not_gusts(result: Result, data: Sequence[FlightData]) -> str:
    """A sentence on why the process noise of a filter error is not gusts; empty where it may be.

    result: of a filter error; data: its flights, prepared for its model.
    """
    tests = (
        follows_controls(result, data),
        coloured_spectrum(result, data),
        turns_no_wind(result, data),
    )
    return next((text for text in tests if text), "")


def _driven(result: Result) -> list[int]:
    """Columns of the outputs that depend on forces or moments."""
    outputs = driven_outputs(result.model)
    return [c for c, name in enumerate(result.model.output_names) if name in outputs]


def follows_controls(result: Result, data: Sequence[FlightData]) -> str:
    """A sentence on the output whose innovations follow the controls most; empty where none does beyond FOLLOWS.

    result: of a filter error; data: its flights, prepared for its model.
    """
    from scipy.special import chdtrc

    controls = [i for i, s in enumerate(result.model.inputs) if s.control]
    largest, name = 0.0, ""
    for c in _driven(result) if controls else ():
        history, rest = _rows(result, data, controls, c)
        if len(rest) < 4 * history.shape[1] or not rest.any():
            continue
        unexplained = rest - history @ np.linalg.lstsq(history, rest, rcond=1e-9)[0]
        share = 1.0 - float(unexplained @ unexplained) / float(rest @ rest)
        if share > max(largest, FOLLOWS) and chdtrc(history.shape[1], len(rest) * share) < FOLLOWS_BY_CHANCE:
            largest, name = share, result.model.output_names[c]
    if not name:
        return ""
    return (
        f"{NO_GUSTS}: past movements of the controls predict {largest:.0%} of its innovations of {name}, in rough air"
        f" {FOLLOWS:.0%} at most; the model, a channel or the record of a control lacks something"
    )


def _rows(result: Result, data: Sequence[FlightData], controls: list[int], output: int) -> tuple[Array, Array]:
    """(N, controls * STEPS) past movements and (N,) innovations of one output about their mean, over all flights."""
    history, rest = [np.zeros((0, len(controls) * STEPS))], [np.zeros(0)]
    for fit, flight in zip(result.flights, data, strict=True):
        for s in flight.segments:
            movements = np.diff(s.u[:, controls], axis=0, prepend=s.u[:1, controls])
            if len(s) <= 2 * STEPS:
                continue
            rows = np.concatenate([movements[STEPS - k : len(s) - k] for k in range(STEPS)], axis=1)
            e = fit.residuals[s.first + STEPS : s.first + len(s), output]
            measured = np.isfinite(e)
            history.append(rows[measured])
            rest.append(e[measured] - e[measured].mean() if measured.any() else e[measured])
    return np.concatenate(history), np.concatenate(rest)


BY_CHANCE = 1e-4  # probability of such a deviation by chance, above which it is not reported
UNEVEN = 0.18
"""Largest deviation of the cumulated periodogram of white innovations from a straight line: at most 0.14 in gusts, 0.22 to 0.55
where the model lacks backlash, a lag or a curved derivative (docs/validation.md)."""


def coloured_spectrum(result: Result, data: Sequence[FlightData]) -> str:
    """A sentence on the output whose innovations are least white (cumulated periodogram; Bartlett 1955); empty where none is."""
    furthest, name, where = 0.0, "", 0.0
    for c in _driven(result):
        total, bins, rate = np.zeros(BINS), 0, 0.0
        for fit, flight in zip(result.flights, data, strict=True):
            for s in flight.segments:
                e = fit.residuals[s.first : s.first + len(s), c]
                e = np.where(np.isfinite(e), e - np.nanmean(e), 0.0) if np.isfinite(e).any() else np.zeros(0)
                if e.size >= 2 * STEPS:
                    power = np.abs(np.fft.rfft(e)[1:]) ** 2
                    total += np.interp(SHARES, np.arange(power.size + 1) / power.size, np.append(0.0, np.cumsum(power)))
                    bins += power.size
                    rate = max(rate, 0.5 / float(np.median(np.diff(s.time))))
        if not bins or total[-1] <= 0.0:
            continue
        deviation = np.abs(total / total[-1] - SHARES)
        limit = max(UNEVEN, float(np.sqrt(-0.5 * np.log(0.5 * BY_CHANCE) / bins)), furthest)
        if deviation.max() > limit:
            furthest, name = float(deviation.max()), result.model.output_names[c]
            where = rate * SHARES[int(np.argmax(deviation))]
    if not name:
        return ""
    return (
        f"{NO_GUSTS}: the spectrum of its innovations of {name} is not flat (off by {furthest:.0%} of its power at {where:.2g}"
        f" Hz, in rough air by {UNEVEN:.0%} at most); the model or a channel lacks something, or something shakes or swings"
    )


BINS = 256
SHARES = np.linspace(0.0, 1.0, BINS)  # of the band, at which cumulated power is compared

WIND: tuple[tuple[str, str], ...] = (("beta", "r"), ("alpha", "q"))
"""Angle of the relative wind, and the rate that turns the aircraft into it."""
MOMENTS = 0.8
"""Effect of the process noise on the angle through the moment, over its direct effect as a gust: at most 0.3 in gusts of 0.4 to
1.2 deg, 1.2 to 17 in calm air where the model lacks something (docs/validation.md). Roll is not tested: the air does roll."""


def turns_no_wind(result: Result, data: Sequence[FlightData]) -> str:
    """A sentence where the process noise acts on moments rather than on the relative wind, as gusts do; empty for gusts.

    White noise w_r of the yaw acceleration changes sideslip by as much as white noise w_r / sqrt(N_beta) of the rate of sideslip,
    where N_beta is the stiffness [1/s2]: the natural mode converts one into the other within its period.
    """
    from estimation.estimators.filter_error import mean_matrices  # with scipy

    states, gain = result.model.state_names, result.extra.get("gain", {})
    pairs = [
        (a, r) for a, r in WIND if {a, r} <= set(states) and a in result.model.output_names and {a, r} <= set(gain)
    ]
    if not pairs:
        return ""
    A, _ = mean_matrices(Simulator.build(result.model), data, result.values)
    corrections = {s: _rms_correction(result, gain[s]) for pair in pairs for s in pair}
    worst, which = 0.0, pairs[0]
    for angle, rate in pairs:
        stiffness = abs(float(A[states.index(rate), states.index(angle)]))
        if stiffness > 0.0 and corrections[angle] > 0.0:
            ratio = corrections[rate] / (np.sqrt(stiffness) * corrections[angle])
            worst, which = max((worst, which), (ratio, (angle, rate)))
    if worst <= MOMENTS:
        return ""
    return (
        f"{NO_GUSTS}: gusts turn {which[0]} first, but here the moment that drives {which[1]} has {worst:.1f} times their effect"
        f" (in rough air {MOMENTS:g} at most); the model or a control lacks something"
    )


def _rms_correction(result: Result, gains: dict[str, float]) -> float:
    """Root-mean-square correction of one state by the filter."""
    row = np.array([gains.get(o, 0.0) for o in result.model.output_names])
    corrections = np.concatenate([np.where(np.isfinite(f.residuals), f.residuals, 0.0) @ row for f in result.flights])
    return float(np.sqrt(np.mean(corrections**2)))
