"""The channels and stretches of a flight that the data-compatibility check uses, with notes on what is left out."""

from collections.abc import Collection, Iterator, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from daq.contract.channels import COLUMN_BY_NAME
from estimation.compatibility.kalman import FilterRecord
from estimation.errors import DataError
from estimation.models.base import Model
from estimation.models.kinematic import ATTITUDE, MEASUREMENTS
from estimation.prepare.conditioned import ConditionedFlight, condition_columns, repair_columns
from estimation.signals.denoise import noise_level
from groundstation.flight import Array, Flight
from groundstation.flight.airspeed import FLYING, flies_from
from groundstation.flight.arrays import true_runs, unwrapped
from groundstation.flight.contradictions import no_airspeed
from groundstation.flight.findings import Finding, FindingKind
from groundstation.flight.kinematics import GYROS, attitude_rates

SHORTEST = 40  # samples of a stretch that is reconstructed: 2 s at 20 Hz
PARABOLA = (5, 2)  # samples and order of the local polynomial that smooths and differentiates rates
COLUMNS = ("ax", "ay", "az", "p", "q", "r")
JUMP = 0.1
"""Step [rad] of an attitude between two samples, in excess of the integrated rates, that no aircraft makes."""
JUMP_IN_NOISE = 8.0  # noise levels of the angle that a jump also exceeds
LONGEST_START = 0.5  # of a stretch: an attitude first measured later than that is missing, not starting up
FEWEST_FOR_JUMPS = 8  # samples of an attitude in which jumps are searched
MOSTLY_SLOW = 0.5  # share of airspeeds below flying speed, beyond which a flight without faster ones is refused

ATTITUDE_ERROR = {"phi": 0.01, "theta": 0.01, "psi": 0.03}
"""Slow error of an onboard attitude filter [rad], one sigma, where its calibration states none."""

WRONG_UNIT = 0.2
"""Largest share of implausible samples; with more, a channel is taken to be another one or in another unit."""

_FEWEST_CHANNELS = 3  # outputs: with fewer, instrument factors are not separable


def records_of(model: Model, flight: Flight) -> tuple[list[FilterRecord], list[str]]:
    """Stretches without a gap, in flight, with all accelerations and rates measured; and notes on what is left out.

    Raises MissingColumnError, or DataError when no stretch is long enough.
    """
    flight = with_rate_derivatives(flight, model.input_names)
    flight.require(model.input_names, "the data-compatibility check")
    _refuse_broken(flight, model.input_names)
    compared = [o for o in model.output_names if shows_motion(flight, o)]
    if len(compared) < _FEWEST_CHANNELS:
        raise DataError(
            f"{flight.name}: only {', '.join(compared) or 'none'} of V, alpha, beta, phi, theta, psi measured; "
            "the data-compatibility check needs at least three"
        )
    notes = [
        f"{o} {'is constant' if flight.measured(o) else 'not measured'}: not compared"
        for o in model.output_names
        if o not in compared
    ]
    u = np.column_stack([flight[c] for c in model.input_names])
    nan = np.full(len(flight), np.nan)
    z = np.column_stack([_output(flight, o) if o in compared else nan for o in model.output_names])
    complete = np.all(np.isfinite(u), axis=1)
    usable = complete & _flying(flight, notes)
    jumps = attitude_jumps(flight)
    records: list[FilterRecord] = []
    short: list[slice] = []
    for first, last in unbroken_stretches(flight, usable, jumps):
        if first in jumps:
            notes.append(
                f"{jumps[first]} at t = {flight.time[first]:.2f} s from one sample to the next, which the rates "
                "do not: the attitude filter was set anew; split there"
            )
        begin = _begin(model, flight, z, slice(first, last), notes)
        if last - begin >= SHORTEST:
            records.append(FilterRecord(begin, flight.time[begin:last], u[begin:last], z[begin:last]))
        else:
            short.append(slice(begin, last))
    notes += short_stretches(flight, short, "too short a stretch")
    if not records:
        raise DataError(
            f"{flight.name}: no {SHORTEST} samples in a row, in flight, with {', '.join(COLUMNS)} all measured"
        )
    return records, notes


def short_stretches(flight: Flight, rows: Sequence[slice], why: str) -> list[str]:
    """One note on the stretches left out; none where there are none."""
    if not rows:
        return []
    count = sum(r.stop - r.start for r in rows)
    each = "" if len(rows) == 1 else f", {len(rows)} times"
    return [f"{count} samples from t = {flight.time[rows[0].start]:g} s left out: {why}{each}"]


def unbroken_stretches(flight: Flight, usable: NDArray[np.bool_], jumps: Collection[int]) -> Iterator[tuple[int, int]]:
    """[first, last) of each run of usable samples (N,), cut at the rows where the attitude jumps."""
    for a, b in true_runs(usable, flight.segments):
        yield from pairwise([a, *(j for j in sorted(jumps) if a < j < b), b])


def _refuse_broken(flight: Flight, inputs: Sequence[str]) -> None:
    """Raise DataError for an input that never changes, or a channel with too many implausible samples."""
    for name in inputs:
        if _constant(flight[name]):
            raise DataError(
                f"{flight.name}: {name} is {finite_values(flight[name])[0]:.4g} throughout: no working sensor "
                "behind it; the data-compatibility check needs it"
            )
    for name in (*COLUMNS, "V", "alpha", "beta", *ATTITUDE):
        if flight.measured(name):
            low, high = COLUMN_BY_NAME[name].plausible
            finite = finite_values(flight[name])
            share = float(np.mean((finite < low) | (finite > high)))
            if share > WRONG_UNIT and not _counts_turns(flight, name, low, high):
                raise DataError(
                    f"{flight.name}: {name} is beyond {low:.4g} to {high:.4g} {COLUMN_BY_NAME[name].unit} in {share:.0%} of "
                    "the samples; in another unit? 'sideslip import --map' converts it"
                )


def _counts_turns(flight: Flight, angle: str, low: float, high: float) -> bool:
    """Whether an angle leaves its range because it counts whole turns: it starts within the range and moves at most twice as far
    as its gyro turns. An angle in degrees moves 57 times as far."""
    if angle not in ("phi", "psi") or not flight.measured(GYROS[angle]):
        return False
    for part in flight.segments:
        values = finite_values(flight[angle][part])
        turned = float(np.nansum(np.abs(flight[GYROS[angle]][part]))) * flight.sample_interval
        if values.size and not (low <= values[0] <= high and float(np.ptp(values)) <= 2.0 * turned + np.pi):
            return False
    return True


def shows_motion(flight: Flight, column: str) -> bool:
    """Whether a channel is measured, and not stuck at one value throughout."""
    return flight.measured(column) and not _constant(flight[column])


def _constant(values: Array) -> bool:
    finite = finite_values(values)
    return finite.size > 1 and float(np.ptp(finite)) == 0.0


def _flying(flight: Flight, notes: list[str]) -> NDArray[np.bool_]:
    """(N,) whether the aircraft flies, by its airspeed; all True where that is not measured. Adds to `notes`."""
    if not flight.measured("V"):
        return np.ones(len(flight), bool)
    V = flight["V"]
    from_speed = flies_from(V)
    slow = np.isfinite(V) & (from_speed > V)
    if slow.sum() > MOSTLY_SLOW * np.isfinite(V).sum() and not np.any(from_speed <= V):
        raise DataError(
            f"{flight.name}: V never reaches {FLYING:g} m/s (largest {np.nanmax(V):.3g})"
            + (no_airspeed(flight) or ": not in flight, or V is not in m/s")
        )
    if slow.any():
        notes.append(f"{int(slow.sum())} samples with V below {from_speed:.2g} m/s left out: not in flight")
    return np.asarray(~slow)


def _begin(model: Model, flight: Flight, z: Array, part: slice, notes: list[str]) -> int:
    """First row of a stretch from which on each attitude was measured: a filter that starts up gives none. Adds to `notes`."""
    first = []
    for name in ATTITUDE:
        if name in model.output_names:
            rows = np.flatnonzero(np.isfinite(z[part, model.output_names.index(name)]))
            if rows.size and rows[0] <= LONGEST_START * (part.stop - part.start):
                first.append(int(rows[0]))
    delay = max(first, default=0)
    if delay:
        start, stop = flight.time[part.start], flight.time[part.start + delay]
        notes.append(f"t = {start:.2f} to {stop:.2f} s left out: attitude not measured there yet (filter starting up)")
    return part.start + delay


def attitude_jumps(flight: Flight) -> dict[int, str]:
    """Row -> sentence, for each lasting step of phi, theta or psi by more than JUMP in excess of the integrated rates.

    A single outlier, after which the angle is back, is no step. Empty unless p, q, r, phi and theta are measured.
    """
    if not all(flight.measured(c) for c in ("p", "q", "r", "phi", "theta")):
        return {}
    rates = attitude_rates(*(flight[c] for c in ("p", "q", "r", "phi", "theta")))
    jumps: dict[int, list[str]] = {}
    for name, rate in rates.items():
        if not flight.measured(name):
            continue
        for part in flight.segments:
            for row, size in _lasting_steps(flight.time[part], flight[name][part], rate[part]):
                jumps.setdefault(row + part.start, []).append(f"{name} by {np.degrees(size):.0f} deg")
    return {row: f"attitude jumps ({', '.join(words)})" for row, words in jumps.items()}


def _lasting_steps(time: Array, angle: Array, rate: Array) -> list[tuple[int, float]]:
    """(row, size) of lasting steps between neighbouring measured samples."""
    rows = np.flatnonzero(np.isfinite(angle) & np.isfinite(rate))
    if rows.size < FEWEST_FOR_JUMPS:
        return []
    t, mean = time[rows], 0.5 * (rate[rows][1:] + rate[rows][:-1])
    excess = np.diff(np.unwrap(angle[rows])) - mean * np.diff(t)
    excess = (excess + np.pi) % (2 * np.pi) - np.pi
    excess[np.diff(rows) > 1] = 0.0  # the motion during missing values is not known
    limit = max(JUMP, JUMP_IN_NOISE * noise_level(np.unwrap(angle[rows])))
    steps = []
    for k in np.flatnonzero(np.abs(excess) > limit):
        around = excess[max(k - 2, 0) : k + 3]
        lasting = float(around.sum())
        if abs(lasting) > limit and abs(excess[k]) == np.abs(around).max():
            steps.append((int(rows[k + 1]), float(excess[k])))
    return steps


def attitude_errors(flight: Flight) -> dict[str, float]:
    """Slow error [rad] of each attitude that comes from a filter of the same gyro, 0 for one measured independently.

    An attitude with less noise from sample to sample than the gyro's noise integrates to in one sample interval must come from a
    filter that integrates that gyro. Its error is slow, so that the agreement of neighbouring samples does not show it.
    """
    uncertainty = flight.provenance.detail.get("uncertainty", {})
    errors = {}
    for angle, rate in zip(ATTITUDE, "pqr", strict=True):
        errors[angle] = 0.0
        if flight.measured(angle) and flight.measured(rate):
            attitude_noise = noise_level(finite_values(_output(flight, angle)))
            integrated_noise = noise_level(finite_values(flight[rate])) * flight.sample_interval
            if attitude_noise < integrated_noise:
                errors[angle] = float(uncertainty.get(angle, 0.0)) or ATTITUDE_ERROR[angle]
    return errors


def with_rate_derivatives(flight: Flight, columns_wanted: Sequence[str]) -> Flight:
    """The flight with p_dot, q_dot, r_dot [rad/s2] where wanted and not measured, by local parabolas through 5 samples."""
    columns = {}
    for rate in "pqr":
        if f"{rate}_dot" in columns_wanted and not flight.measured(f"{rate}_dot") and flight.measured(rate):
            from scipy.signal import savgol_filter  # takes half a second to import

            derivative = np.full(len(flight), np.nan)
            for part in flight.segments:
                if part.stop - part.start >= SHORTEST:
                    derivative[part] = savgol_filter(
                        flight[rate][part], *PARABOLA, deriv=1, delta=flight.sample_interval
                    )
            columns[f"{rate}_dot"] = derivative
    return flight.with_columns(**columns) if columns else flight


def finite_values(values: Array) -> Array:
    """The measured values, NaN left out."""
    return values[np.isfinite(values)]


def _output(flight: Flight, name: str) -> Array:
    """A channel as it is compared: psi unwrapped."""
    return unwrapped(flight[name]) if name == "psi" else flight[name]


CHECK = "left out"  # kind of the findings in the quality report


def compared_measurements(flight: Flight, *, keep_held: bool = False) -> tuple[Flight, tuple[Finding, ...]]:
    """The flight as the check compares it, and findings on what was left out.

    Repeated samples become NaN in outputs; in inputs, which are integrated, they are interpolated linearly.
    Raises DataError where time is in another unit.
    """
    inputs = repair_columns(flight, COLUMNS, keep_held=keep_held)
    outputs = condition_columns(inputs.flight, MEASUREMENTS, keep_held=keep_held)
    notes = [*inputs.notes, *outputs.notes]
    columns = {}
    for name in MEASUREMENTS:
        if not shows_motion(outputs.flight, name):
            notes.append(_not_compared(flight, name))
            continue
        columns[name], left_out = _compared(outputs, name)
        notes += left_out
    return outputs.flight.with_columns(**columns), tuple(notes)


def _compared(conditioned: ConditionedFlight, name: str) -> tuple[Array, list[Finding]]:
    values, notes = conditioned.as_output(name)
    # the quality report has the gaps of each channel
    return values, [n for n in notes if n.kind is not FindingKind.NOT_MEASURED]


def _not_compared(flight: Flight, name: str) -> Finding:
    if flight.measured(name):
        return Finding(FindingKind.STUCK, f"{name} is constant: not compared", columns=(name,))
    return Finding(FindingKind.NOT_MEASURED, f"{name} not measured: not compared", columns=(name,))


def left_out_findings(notes: tuple[Finding, ...]) -> tuple[Finding, ...]:
    """One entry of the quality report for each thing left out."""
    return tuple(Finding(CHECK, n.text, "ok" if n.kind is FindingKind.NOT_MEASURED else "warn") for n in notes)
