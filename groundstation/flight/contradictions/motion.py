"""Contradictions of the motion: gyros against attitude, accelerations against velocity, heading against course, commands against
surfaces, and the strength of the magnetic field.

Each function takes time (N,) [s] and the measured columns (N,), SI, and yields nothing where a column that it compares is
missing."""

from collections.abc import Iterator

import numpy as np

from groundstation.flight.arrays import Array, integral, slope_and_agreement, windows
from groundstation.flight.contradictions.contradiction import Contradiction
from groundstation.flight.contradictions.fits import Columns, scale_by_ground
from groundstation.flight.kinematics import EULER_RATES, GYROS, earth_acceleration

Pairs = list[tuple[Array, Array]]

AGREEMENT = 0.9  # least share of one signal's variance that the other explains, before the scale is judged
COMMAND_AGREEMENT = 0.8  # the same of a surface by its command, whose servo lags
COMMAND_SCALE = (0.8, 1.25)  # of a surface over its command: play and load of a servo's linkage lie within
LEAST_COMMAND = np.radians(0.5)  # std of a command in a window, below which a surface shows its own noise
SCALE_TOLERANCE = 0.12
"""Of an angle by its gyro, of velocity by acceleration: scale errors of uncalibrated sensors stay within 3 %, lags within 5 %."""
SCALE_SIGMAS = 2.0  # of a slope's own error, that a scale must exceed, too
LARGEST_SCALE = 2.0  # a scale beyond it, or below its inverse, is another unit, which `quality.plausibility` reports
HEADING_TOLERANCE = np.radians(12.0)
"""Between heading and course: more is a declination that was not corrected, or a compass near a current."""
FIELD = (2.2e-5, 6.7e-5)  # strength of the magnetic field on Earth [T] (IGRF-13)
TYPICAL_FIELD = 4.5e-5  # [T] the middle of these
FIELD_TOLERANCE = 0.15  # relative scatter of the strength: a calibrated magnetometer turned in a uniform field has less
HEADING_SIGMAS = 4.0  # of the fitted turn: by chance once in 16000 flights
RECEIVER_DELAYS = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5)
"""[s] that a receiver's velocity may be late: receivers filter, and fixes are logged when they arrive."""
RECEIVER_AVERAGE = 1.0
"""[s] over which both sides are averaged: 5 Hz fixes and a receiver's filter lose a fifth of a Dutch roll of 1 Hz."""


def gyros_and_attitude(time: Array, c: Columns) -> Iterator[Contradiction]:
    """Each angle of attitude against the integral of its rate by the gyros."""
    if not all(n in c for n in ("p", "q", "r", "phi", "theta", "psi")):
        return
    for angle, gyro in GYROS.items():
        rate = EULER_RATES[angle](c)
        pairs = [(integral(t, b), np.unwrap(a)) for t, a, b in windows(time, c[angle], rate)]
        slope, agreement = slope_and_agreement(pairs)
        std = _slope_std(slope, agreement, pairs)
        if _wrong_scale(slope, agreement, std):
            text = f"{angle} moves {slope:.3g} times as far as {gyro} turns: scale of a gyro, or of time"
            moves = f"derivatives by {gyro} and of its moment by {abs(slope - 1):.0%}"
            yield Contradiction((angle, gyro), text, slope, std=std, moves=moves, stops=True)


def _wrong_scale(slope: float, agreement: float, std: float) -> bool:
    """Whether a slope of 1 is excluded by more than a sensor's scale error and the slope's own error `std`, which is large where
    the flight is a single window."""
    deviation = abs(slope - 1.0)
    significant = deviation > max(SCALE_TOLERANCE, SCALE_SIGMAS * std)
    return agreement > AGREEMENT and significant and 1 / LARGEST_SCALE < slope < LARGEST_SCALE


def acceleration_and_velocity(time: Array, c: Columns) -> Iterator[Contradiction]:
    """The integral of specific force in earth axes, with gravity, against the change of velocity by GNSS."""
    velocities = ("vn", "ve", "vd")
    if not all(n in c for n in ("ax", "ay", "az", "phi", "theta", "psi", *velocities)):
        return
    parts = [
        part
        for name, acceleration in zip(velocities, earth_acceleration(c), strict=True)
        for t, speed, earth in windows(time, c[name], acceleration)
        if (part := _smoothed(t, integral(t, earth), speed)) is not None
    ]
    slope, agreement, pairs = max((_fit_delayed(parts, delay) for delay in RECEIVER_DELAYS), key=lambda fit: fit[1])
    std = _slope_std(slope, agreement, pairs)
    if _wrong_scale(slope, agreement, std):
        text = (
            f"velocity by GNSS changes {slope:.3g} times as much as ax, ay, az with attitude and gravity make it: scale of "
            "either, or of time"
        )
        moves = f"force derivatives by {abs(slope - 1):.0%}, if the accelerometers are wrong"
        yield Contradiction((*velocities, "ax", "ay", "az"), text, slope, std=std, moves=moves, stops=True)


def _smoothed(t: Array, change: Array, speed: Array) -> tuple[Array, Array, Array, int] | None:
    """Time, integrated acceleration, running mean of the velocity and the samples of that mean; None for too short a window."""
    width = max(1, round(RECEIVER_AVERAGE / float(np.median(np.diff(t)))))
    return (t, change, np.convolve(speed, np.full(width, 1.0 / width), "valid"), width) if t.size > 2 * width else None


def _fit_delayed(parts: list[tuple[Array, Array, Array, int]], delay: float) -> tuple[float, float, Pairs]:
    """Slope, agreement and the averaged pairs, for a receiver that is `delay` [s] late. parts: from `_smoothed`."""
    pairs = [
        (np.convolve(np.interp(t - delay, t, change), np.full(width, 1.0 / width), "valid"), speed)
        for t, change, speed, width in parts
    ]
    return (*slope_and_agreement(pairs), pairs)


def heading_and_course(time: Array, c: Columns) -> Iterator[Contradiction]:
    """Heading against the course over ground less a constant wind, flown on several headings."""
    fit = scale_by_ground(time, c)
    if fit is None or not fit[1].differs_from(0.0, HEADING_TOLERANCE, HEADING_SIGMAS):
        return
    turn = fit[1]
    text = (
        f"course by GNSS, wind taken out, lies {np.degrees(turn.value):+.0f} +- {np.degrees(turn.std):.0f} deg from psi: "
        "magnetic declination, a compass that is turned or disturbed, or none"
    )
    moves = "wind, and the constant of a reconstructed sideslip; no derivative of a vane's"
    sides, favoured = ("psi", "vn", "ve"), "vn, ve"
    yield Contradiction(sides, text, None, turn.value, "rad", std=turn.std, favoured=favoured, moves=moves)


def command_and_surface(time: Array, c: Columns) -> Iterator[Contradiction]:
    """Each commanded against the measured surface."""
    for axis in "ear":
        command, surface = f"cmd_{axis}", f"delta_{axis}"
        if command not in c or surface not in c:
            continue
        pairs = [(b, a) for _, a, b in windows(time, c[surface], c[command]) if np.std(b) > LEAST_COMMAND]
        slope, agreement = slope_and_agreement(pairs)
        if agreement > COMMAND_AGREEMENT and not COMMAND_SCALE[0] < slope < COMMAND_SCALE[1]:
            text = f"{surface} moves {slope:.3g} times as far as {command} asks: trim and travel of the servo, or of the sensor"
            moves = f"control derivatives by {abs(slope - 1):.0%}, if the surface is wrong"
            std = _slope_std(slope, agreement, pairs)
            yield Contradiction((surface, command), text, slope, std=std, favoured=surface, moves=moves)


def magnetic_field(time: Array, c: Columns) -> Iterator[Contradiction]:
    """The measured strength of the magnetic field against the Earth's, and its constancy over the flight."""
    if not all(n in c for n in ("mx", "my", "mz")):
        return
    strength = np.sqrt(c["mx"] ** 2 + c["my"] ** 2 + c["mz"] ** 2)
    median = float(np.nanmedian(strength))
    spread = float(np.nanmedian(np.abs(strength - median)))
    if not median > 0.0 or (FIELD[0] <= median <= FIELD[1] and spread < FIELD_TOLERANCE * median):
        return
    text = (
        f"the magnetometer shows {median * 1e6:.3g} +- {spread * 1e6:.2g} uT where the Earth has 22 to 67, and the same in any "
        "attitude: it is not calibrated, and heading from it is not sure"
    )
    sides = ("mx, my, mz", "magnetic field of the Earth")
    yield Contradiction(sides, text, median / TYPICAL_FIELD, std=spread / TYPICAL_FIELD)


def _slope_std(slope: float, agreement: float, pairs: Pairs) -> float:
    """1 sigma of a slope; each window counts as two independent samples."""
    return float(abs(slope) * np.sqrt(max(1.0 - agreement, 0.0) / max(agreement * 2 * len(pairs), 1.0)))
