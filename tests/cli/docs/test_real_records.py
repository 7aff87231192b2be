"""Pages about other people's records: their commands are followed on simulated records of the same form and traps.

The records themselves are not here. Truth is a short period of the same build-up, integrated by itself at 1 kHz.
"""

import csv
import json
import math
import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.cli.docs.blocks import commands_of
from tests.cli.docs.follow import follow
from tests.studies import t38_points
from tests.unit.estimation.campaign.running import ROOT

PAGES = ROOT / "docs" / "validation"
DEG, KNOT, FOOT, INCH_OF_MERCURY, G = math.pi / 180, 0.514444, 0.3048, 3386.389, 9.80665
AREA, CHORD, MASS, IYY = 15.79, 2.374, 5200.0, 40500.0
TRUTH = {"CL_0": 0.03, "CL_alpha": 3.9, "CL_de": -0.8, "Cm_0": -0.004, "Cm_alpha": -0.6, "Cm_q": -16.0, "Cm_de": -1.2}
PRESSURE, TEMPERATURE = 60_000.0, 265.0
DENSITY = PRESSURE / (287.05287 * TEMPERATURE)


def write(path: Path, rows: list[dict[str, str]]) -> None:
    """A table with a head."""
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def natural_frequency(speed: float) -> tuple[float, float]:
    """[rad/s] and damping ratio of the short period at `speed` [m/s], in closed form."""
    pressure = 0.5 * DENSITY * speed**2
    lift = pressure * AREA * TRUTH["CL_alpha"] / (MASS * speed)
    stiffness = pressure * AREA * CHORD * TRUTH["Cm_alpha"] / IYY
    damping = pressure * AREA * CHORD * TRUTH["Cm_q"] * CHORD / (2 * speed) / IYY
    omega = math.sqrt(-stiffness - lift * damping)
    return omega, (lift - damping) / (2 * omega)


def stretch(start: float, speed: float, rng: np.random.Generator) -> list[dict[str, str]]:
    """40 s of pushes and pulls by the columns that the map reads, and two that it does not."""
    step, rows = 0.001, []
    alpha, q, theta, deflection = 0.03, 0.0, 0.05, -0.02
    for k in range(40_000):
        t = k * step
        wanted = -0.02 + 0.02 * math.copysign(1.0, math.sin(2 * math.pi * t / 7.0)) * (1 if (t // 11) % 2 else -0.7)
        deflection += (wanted - deflection) * step / 0.3
        pressure = 0.5 * DENSITY * speed**2
        lift = TRUTH["CL_0"] + TRUTH["CL_alpha"] * alpha + TRUTH["CL_de"] * deflection
        moment = (
            TRUTH["Cm_0"]
            + TRUTH["Cm_alpha"] * alpha
            + TRUTH["Cm_q"] * q * CHORD / (2 * speed)
            + TRUTH["Cm_de"] * deflection
        )
        normal = pressure * AREA * lift / MASS
        alpha_dot = q - normal / speed + G / speed * math.cos(theta - alpha)
        along = speed * math.sin(alpha) * (q - alpha_dot) + G * math.sin(theta)
        if k % 200 == 0:
            clock = 15 * 3600 + 35 * 60 + start + t
            hour, minute, second = int(clock // 3600), int(clock % 3600 // 60), clock % 60
            noise = rng.normal(size=9)
            rows.append(
                {
                    "IRIG_TIME": f"234:{hour:02d}:{minute:02d}:{second:09.6f}",
                    "Delta_Irig": f"{start + t:.1f}",
                    "EGI_PITCH_RATE_Q": f"{(q + 2e-3 * noise[0]) / DEG:.6f}",
                    "EGI_ROLL_RATE_P": f"{0.02 * noise[1]:.6f}",
                    "EGI_YAW_RATE_R": f"{0.02 * noise[2]:.6f}",
                    "EGI_ROLL_ANGLE": f"{0.5 + 0.02 * noise[8]:.5f}",
                    "EGI_PITCH_ANGLE": f"{theta / DEG:.6f}",
                    "ADC_TRUE_AIRSPEED": f"{speed / KNOT:.5f}",
                    "AOA": f"{(alpha + 1e-3 * noise[3]) / DEG:.6f}",
                    "AOSS": f"{0.05 * noise[4]:.6f}",
                    "NX_LONG_ACCEL": f"{(along + 0.05 * noise[6]) / G:.6f}",
                    "NY_LATERAL_ACCEL": f"{0.004 * noise[7]:.6f}",
                    "NZ_NORMAL_ACCEL": f"{(normal + 0.05 * noise[5]) / G:.6f}",
                    "STAB_POS": f"{deflection / DEG:.6f}",
                    "RUDDER_POS": "0.1",
                    "STATIC_PRESSURE": f"{PRESSURE / INCH_OF_MERCURY:.5f}",
                    "AMB_AIR_TEMP_C": f"{TEMPERATURE - 273.15:.2f}",
                    "PRESS_ALT_IC": f"{4206 / FOOT:.1f}",
                    "PITCH_RATE_Q": f"{noise[0]:.4f}",
                }
            )
        alpha += step * alpha_dot
        q += step * pressure * AREA * CHORD * moment / IYY
        theta += step * q
    return rows


@pytest.mark.usefixtures("unwritten_figures")
def test_short_periods_of_the_page_on_the_t38(tmp_path: Path, rng: np.random.Generator) -> None:
    speeds = (190.0, 230.0)
    rows = [row for i, speed in enumerate(speeds) for row in stretch(400.0 * i, speed, rng)]
    write(tmp_path / "Rollercoasters_20240821.csv", rows)
    shutil.copytree(PAGES, tmp_path / "docs" / "validation")
    commands = commands_of(PAGES / "t38.md")
    assert [c.split()[1] for c in commands] == ["import", "check", "estimate"]
    for command in commands:
        # the gap between the stretches is a failed check of the record, as it is of the real one
        follow(command, tmp_path, ROOT, status=1 if command.split()[1] == "check" else 0)
    table = list(csv.DictReader((tmp_path / "t38-report" / "tables" / "modes.csv").read_text().splitlines()))
    assert len(table) == len(speeds)
    for row, speed in zip(table, speeds, strict=True):
        for column, truth in zip(("natural frequency [rad/s]", "damping ratio"), natural_frequency(speed), strict=True):
            value, bound = map(float, row[column].split(" ± "))
            assert abs(value - truth) < 3 * bound + 0.005 * truth, (column, speed, truth)
            assert bound < 0.2 * truth
    points = list(t38_points.table(json.loads((tmp_path / "t38.json").read_text())))
    assert len([p for p in points if p.startswith("| ")]) == 1 + len(t38_points.PUBLISHED)
    assert sum("above the Mach numbers flown" in p for p in points) == 3


def test_a_line_through_stretches_holds_what_they_scatter(rng: np.random.Generator) -> None:
    """Bounds of half the scatter: 95 % of what further flights have lies inside all the same."""
    inside, count = 0, 300
    for _ in range(count):
        mach = np.array(t38_points.STRETCHES)
        values = -0.6 - 0.5 * (mach - 0.7) + 0.06 * rng.standard_normal(5)
        line = t38_points.Line.through(mach, values, np.full(5, 0.03))
        other = -0.6 - 0.5 * (0.8 - 0.7) + 0.06 * rng.standard_normal()
        low, high = np.quantile(line.draw(0.8, rng, 2000), [0.025, 0.975])
        inside += low < other < high
    assert 0.90 < inside / count < 0.995


def test_the_short_period_of_a_point_is_the_closed_form() -> None:
    """At the speed and density of the standard atmosphere that go with Mach number and dynamic pressure."""
    pressure, mach = 101325.0, 0.6  # sea level: 340.3 m/s of sound
    derivatives = {n: np.array([TRUTH[n]]) for n in t38_points.NAMES}
    frequency, damping = t38_points.short_period(0.7 * pressure * mach**2, mach, derivatives)
    speed, density = mach * 340.294, 1.225
    lift = 0.5 * density * speed * AREA * TRUTH["CL_alpha"] / MASS
    moment = 0.5 * density * speed**2 * AREA * CHORD / IYY
    spin = -moment * TRUTH["Cm_q"] * CHORD / (2 * speed)
    omega = math.sqrt(-moment * TRUTH["Cm_alpha"] + lift * spin)
    assert float(frequency[0]) == pytest.approx(omega / (2 * math.pi), rel=2e-3)
    assert float(damping[0]) == pytest.approx((lift + spin) / (2 * omega), rel=2e-3)


def dutch_roll(damped: bool, rng: np.random.Generator, *, rolls: bool = False) -> list[dict[str, str]]:
    """24 s with a rudder pulse, or rolls from side to side, by linear equations; the side force filtered and reversed as in the
    record."""
    step, rows = 0.001, []
    beta = phi = p = r = shown = 0.0
    for k in range(24_000):
        t = k * step
        pulse = 5.0 * DEG * (1 if 1 < t < 2 else -1 if 2 < t < 3 else 0)
        rudder = pulse - (0.12 * r if damped else 0.0)
        aileron = 2.0 * DEG * (1 if 8 < t < 9 else -1 if 9 < t < 10 else 0)
        if rolls:
            pulse, aileron = 0.0, 2.5 * DEG * (1 if 2 < t < 6 else -1 if 7 < t < 14 else 1 if 16 < t < 19 else 0)
            rudder = 1.0 * DEG * (1 if 20 < t < 21 else 0)
        side = -0.12 * beta * 95 + 2.0 * rudder
        shown += (side - shown) * step / 0.03
        if k % 100 == 0:
            noise = rng.normal(size=8)
            rows.append(
                {
                    "time_s": f"{t:.1f}",
                    "roll_deg": f"{phi / DEG + 0.02 * noise[0]:.5f}",
                    "pitch_deg": f"{4.6 + 0.02 * noise[1]:.5f}",
                    "roll_rate_deg_s": f"{p / DEG + 0.03 * noise[2]:.5f}",
                    "pitch_rate_deg_s": f"{0.03 * noise[3]:.5f}",
                    "yaw_rate_deg_s": f"{r / DEG + 0.03 * noise[4]:.5f}",
                    "lateral_g": f"{-shown / G + 0.001 * noise[5]:.6f}",
                    "aileron_deg": f"{-aileron / DEG:.5f}",
                    "elevator_deg": "0.0",
                    "rudder_deg": f"{-rudder / DEG:.5f}",
                    "tas_knots": f"{185 + 0.05 * noise[6]:.3f}",
                    "altitude_ft": "10147.0",
                    "vane_aoa_deg": f"{5.2 + 0.03 * noise[7]:.4f}",
                }
            )
        beta_dot = side / 95 + G / 95 * phi + 0.09 * p - r
        p_dot = -6.0 * beta - 2.2 * p + 0.9 * r - 4.0 * aileron + 0.5 * rudder
        r_dot = 5.6 * beta - 0.25 * p - 0.35 * r - 2.0 * rudder
        beta, phi, p, r = beta + step * beta_dot, phi + step * (p + 0.08 * r), p + step * p_dot, r + step * r_dot
    return rows


@pytest.mark.usefixtures("unwritten_figures")
def test_dutch_rolls_of_the_page_on_the_citation(tmp_path: Path, rng: np.random.Generator) -> None:
    for name, damped in (("dutch_roll", False), ("dutch_roll_damper_on", True)):
        write(tmp_path / f"{name}.csv", dutch_roll(damped, rng))
    write(tmp_path / "aperiodic_roll.csv", dutch_roll(False, rng, rolls=True))
    shutil.copytree(PAGES, tmp_path / "docs" / "validation")
    commands = commands_of(PAGES / "citation.md")
    assert [c.split()[1] for c in commands] == ["import", "import", "estimate", "import", "estimate"]
    printed = [follow(command, tmp_path, ROOT) for command in commands][2]
    assert "beta not measured" in printed
    assert "is the sign of delta_r turned" not in printed
    table = list(csv.DictReader((tmp_path / "citation-report" / "tables" / "modes.csv").read_text().splitlines()))
    rolls = [float(row["natural frequency [rad/s]"].split(" ± ")[0]) for row in table if row["mode"] == "Dutch roll"]
    assert rolls == pytest.approx([2.55, 2.55], rel=0.05)
    matrix = np.array(
        [[-0.12, 0.09, -1.0, G / 95], [-6.0, -2.2, 0.9, 0.0], [5.6, -0.25, -0.35, 0.0], [0.0, 1.0, 0.08, 0.0]]
    )
    fastest = float(np.linalg.eigvals(matrix).real.min())
    table = list(csv.DictReader((tmp_path / "roll-report" / "tables" / "modes.csv").read_text().splitlines()))
    (roll,) = [row["eigenvalue [1/s]"] for row in table if row["mode"] == "roll"]
    value, bound = (float(v) for v in roll.replace("'", "").split(" ± "))
    assert abs(value - fastest) < 3 * bound + 0.05 * abs(fastest)
