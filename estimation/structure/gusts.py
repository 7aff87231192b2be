"""Whether the process noise of a filter error looks like gusts. Where it does not, the filter has taken up what model or record
lack, and its estimates are no more to be believed than those of a model without a filter.

Gusts, however rough: what they do cannot be foretold from what the controls did before (`follows_controls`); the filter leaves
white innovations, whose periodogram is flat (`coloured_spectrum`); and they turn the relative wind before the aircraft answers
by its moments (`turns_no_wind`). That they do not follow the motion is asked term by term (`score_test`).
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from estimation.engine.simulate import Simulator
from estimation.estimators.result import Result
from estimation.models.dependence import driven_outputs
from estimation.prepare.flight_data import FlightData

Array = NDArray[np.float64]

STEPS = 8  # samples of the past that count: what lacks shows within half a second of a movement
FOLLOWS = 0.08
"""Share of the innovations of one output that past movements of the controls foretell: 0.03 at most in plain and gusty
flights, 0.13 to 0.35 with a late vane, a late rudder or another product of inertia (random aeroplanes, docs/validation.md)."""
FOLLOWS_BY_CHANCE = 1e-6  # probability of so much by chance

NO_GUSTS = "its process noise is no gusts"


def not_gusts(result: Result, data: Sequence[FlightData]) -> str:
    """A sentence on why the process noise of a filter error is no gusts; empty where it may be.

    result: of a filter error; data: its flights, prepared for its model.
    """
    tests = (
        follows_controls(result, data),
        coloured_spectrum(result, data),
        turns_no_wind(result, data),
    )
    return next((text for text in tests if text), "")


def _driven(result: Result) -> list[int]:
    """Columns of the outputs that forces move."""
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
        f"{NO_GUSTS}: what the controls did before foretells {largest:.0%} of its innovations of {name}, where"
        f" in rough air they foretell {FOLLOWS:.0%} at most; the model, a channel or the record of a control lacks something"
    )


def _rows(result: Result, data: Sequence[FlightData], controls: list[int], output: int) -> tuple[Array, Array]:
    """(N, controls STEPS) past movements and (N,) innovations of one output, over all flights."""
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


BY_CHANCE = 1e-4  # probability of a spectrum as far out by chance
UNEVEN = 0.18
"""Most that the share of the innovations' power below some frequency may differ from that frequency's share of the band: 0.14 at
most in gusts, 0.22 to 0.55 with backlash, a lag or a curved derivative left out (docs/validation.md)."""


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
        off = np.abs(total / total[-1] - SHARES)
        limit = max(UNEVEN, float(np.sqrt(-0.5 * np.log(0.5 * BY_CHANCE) / bins)), furthest)
        if off.max() > limit:
            furthest, name, where = float(off.max()), result.model.output_names[c], rate * SHARES[int(np.argmax(off))]
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
"""Of what turns the angle by the moment, over what turns it as a gust does: 0.3 at most in gusts of 0.4 to 1.2 deg, 1.2 to 17
with something left out in calm air (docs/validation.md). Roll is no part of it: rolling air is as real as side gusts."""


def turns_no_wind(result: Result, data: Sequence[FlightData]) -> str:
    """A sentence where what drives the filter are moments, and not gusts, which turn the relative wind; empty where it is gusts.

    White noise w_r of a yawing acceleration turns sideslip as much as white noise w_r / sqrt(N_beta) of its rate does, where
    N_beta is the stiffness [1/s2]: the natural mode makes one of the other within its own time.
    """
    from estimation.estimators.filter_error import mean_matrices  # with scipy

    states, gain = result.model.state_names, result.extra.get("gain", {})
    pairs = [
        (a, r) for a, r in WIND if {a, r} <= set(states) and a in result.model.output_names and {a, r} <= set(gain)
    ]
    if not pairs:
        return ""
    A, _ = mean_matrices(Simulator.build(result.model), data, result.values)
    drives = {s: _driving(result, gain[s]) for pair in pairs for s in pair}
    worst, which = 0.0, pairs[0]
    for angle, rate in pairs:
        stiffness = abs(float(A[states.index(rate), states.index(angle)]))
        if stiffness > 0.0 and drives[angle] > 0.0:
            ratio = drives[rate] / (np.sqrt(stiffness) * drives[angle])
            worst, which = max((worst, which), (ratio, (angle, rate)))
    if worst <= MOMENTS:
        return ""
    return (
        f"{NO_GUSTS}: gusts turn {which[0]} first, and here the moment that drives {which[1]} does {worst:.1f} times as much as"
        f" they (in rough air {MOMENTS:g} at most); the model or a control lacks something"
    )


def _driving(result: Result, gains: dict[str, float]) -> float:
    """Root-mean-square correction of one state by the filter."""
    row = np.array([gains.get(o, 0.0) for o in result.model.output_names])
    corrections = np.concatenate([np.where(np.isfinite(f.residuals), f.residuals, 0.0) @ row for f in result.flights])
    return float(np.sqrt(np.mean(corrections**2)))
