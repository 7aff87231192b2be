"""Contradictions of motion: gyros, attitude, accelerations, velocity, course, commands and the magnetic field."""

from collections.abc import Iterator

import numpy as np

from groundstation.flight.arrays import Array, integral, slope_and_agreement, windows
from groundstation.flight.contradictions.contradiction import Contradiction
from groundstation.flight.contradictions.fits import Columns, scale_by_ground
from groundstation.flight.kinematics import EULER_RATES, GYROS, earth_acceleration

Pairs = list[tuple[Array, Array]]

AGREEMENT = 0.9  # share of a motion that has to be explained before its scale is judged
SCALE_TOLERANCE = 0.12
"""Of an angle by its gyro, of velocity by acceleration: scale errors of uncalibrated sensors stay within 3 %, lags within 5 %."""
BY_CHANCE = 2.0  # sigmas of a scale over all windows that chance is given beside the tolerance
MOST_SCALE = 2.0  # A scale beyond it is another unit, which `quality.plausibility` names
HEADING_TOLERANCE = np.radians(12.0)
"""Between heading and course: declination that was not allowed for, or a compass beside a current."""
FIELD = (2.2e-5, 6.7e-5)  # strength of the magnetic field on Earth [T] (IGRF-13)
FIELD_TOLERANCE = 0.15
SIGMAS = 4.0
RECEIVER_LATE = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5)
"""[s] by which a receiver's velocity may be late: they filter, and are logged when they have come."""
RECEIVER_SMOOTHS = 1.0
"""[s] over which both sides are averaged: fixes of 5 Hz and a receiver's filter lose a fifth of a Dutch roll of 1 Hz."""


def gyros_and_attitude(time: Array, c: Columns) -> Iterator[Contradiction]:
    """Each angle of attitude against what the gyros turn."""
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
    """Whether a scale is none of a sensor, nor of chance: a flight of some seconds is one window, and a share that is not
    explained there may lie in the slope."""
    off = abs(slope - 1.0)
    return agreement > AGREEMENT and off > max(SCALE_TOLERANCE, BY_CHANCE * std) and 1 / MOST_SCALE < slope < MOST_SCALE


def acceleration_and_velocity(time: Array, c: Columns) -> Iterator[Contradiction]:
    """Specific force turned by attitude, with gravity, against the change of velocity by GNSS."""
    velocities = ("vn", "ve", "vd")
    if not all(n in c for n in ("ax", "ay", "az", "phi", "theta", "psi", *velocities)):
        return
    parts = [
        part
        for name, acceleration in zip(velocities, earth_acceleration(c), strict=True)
        for t, speed, push in windows(time, c[name], acceleration)
        if (part := _smoothed(t, integral(t, push), speed)) is not None
    ]
    slope, agreement, pairs = max((_as_late(parts, delay) for delay in RECEIVER_LATE), key=lambda fit: fit[1])
    std = _slope_std(slope, agreement, pairs)
    if _wrong_scale(slope, agreement, std):
        text = (
            f"velocity by GNSS changes {slope:.3g} times as much as ax, ay, az with attitude and gravity make it: scale of "
            "either, or of time"
        )
        moves = f"force derivatives by {abs(slope - 1):.0%}, if the accelerometers are wrong"
        yield Contradiction((*velocities, "ax", "ay", "az"), text, slope, std=std, moves=moves, stops=True)


def _smoothed(t: Array, push: Array, speed: Array) -> tuple[Array, Array, Array, int] | None:
    """Time, what pushes, velocity without what a receiver cannot follow, and samples of that mean; None where it is too short."""
    width = max(1, round(RECEIVER_SMOOTHS / float(np.median(np.diff(t)))))
    return (t, push, np.convolve(speed, np.full(width, 1.0 / width), "valid"), width) if t.size > 2 * width else None


def _as_late(parts: list[tuple[Array, Array, Array, int]], late: float) -> tuple[float, float, Pairs]:
    """Slope, agreement and their pairs for a receiver so many seconds late, both sides without what it cannot follow."""
    pairs = [
        (np.convolve(np.interp(t - late, t, push), np.full(width, 1.0 / width), "valid"), speed)
        for t, push, speed, width in parts
    ]
    return (*slope_and_agreement(pairs), pairs)


def heading_and_course(time: Array, c: Columns) -> Iterator[Contradiction]:
    """Heading against the course over ground, wind taken out, on several headings."""
    fit = scale_by_ground(time, c)
    if fit is None or not fit[1].differs_from(0.0, HEADING_TOLERANCE, SIGMAS):
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
        pairs = [(b, a) for _, a, b in windows(time, c[surface], c[command]) if np.std(b) > np.radians(0.5)]
        slope, agreement = slope_and_agreement(pairs)
        if agreement > 0.8 and not 0.8 < slope < 1.25:
            text = f"{surface} moves {slope:.3g} times as far as {command} asks: trim and travel of the servo, or of the sensor"
            moves = f"control derivatives by {abs(slope - 1):.0%}, if the surface is wrong"
            std = _slope_std(slope, agreement, pairs)
            yield Contradiction((surface, command), text, slope, std=std, favoured=surface, moves=moves)


def magnetic_field(time: Array, c: Columns) -> Iterator[Contradiction]:
    """Strength of the measured magnetic field against what there is on Earth, and its constancy."""
    if not all(n in c for n in ("mx", "my", "mz")):
        return
    size = np.sqrt(c["mx"] ** 2 + c["my"] ** 2 + c["mz"] ** 2)
    middle = float(np.nanmedian(size))
    spread = float(np.nanmedian(np.abs(size - middle)))
    if not middle > 0.0 or (FIELD[0] <= middle <= FIELD[1] and spread < FIELD_TOLERANCE * middle):
        return
    text = (
        f"the magnetometer shows {middle * 1e6:.3g} +- {spread * 1e6:.2g} uT where the Earth has 22 to 67, and the same in any "
        "attitude: it is not calibrated, and heading from it is not sure"
    )
    yield Contradiction(("mx, my, mz", "magnetic field of the Earth"), text, middle / 4.5e-5, std=spread / 4.5e-5)


def _slope_std(slope: float, agreement: float, pairs: Pairs) -> float:
    """1 sigma of a slope over windows, each of which counts for two."""
    return float(abs(slope) * np.sqrt(max(1.0 - agreement, 0.0) / max(agreement * 2 * len(pairs), 1.0)))
