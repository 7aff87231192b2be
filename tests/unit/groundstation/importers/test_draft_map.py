"""`import --draft-map`: columns by name, units by values, servos by the log's parameters, signs by what the aircraft did."""

import struct
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from click.testing import CliRunner

from groundstation.importers.draft import draft_map
from groundstation.importers.draft_names import candidate_columns, rate_that_turns, running_column, unit_in_name
from groundstation.importers.draft_surfaces import sign_of
from groundstation.importers.mapping import load_map
from groundstation.importers.run import import_data
from groundstation.importers.series import TimeSeries
from sideslip.cli import cli

SIGN = {"aileron": 1, "elevator": -1, "rudder": 1}
"""Of the deflection at the upper end of the travel, as the log below was flown."""


def test_names_and_the_units_in_them() -> None:
    names = ["Roll Rate (deg/s)", "bank", "gyro_x", "TAS", "Rudder_Pos", "foo", "psi_deg", "lateral_g"]
    assert candidate_columns(names) == {
        "p": ["Roll Rate (deg/s)", "gyro_x"],
        "phi": ["bank"],
        "V": ["TAS"],
        "delta_r": ["Rudder_Pos"],
        "psi": ["psi_deg"],
    }
    assert [unit_in_name(n) for n in ("roll_rate_deg_s", "psi_deg", "tas_knots", "q", "heading")] == [
        "deg/s",
        "deg",
        "knots",
        None,
        None,
    ]


def test_short_names_of_loggers() -> None:
    """Roll_d is an angle in degrees, v_d a velocity down."""
    names = ["Roll_d", "Pitch_d", "Ail", "Ele", "Ps_hPa", "v_d", "vd"]
    assert candidate_columns(names) == {
        "phi": ["Roll_d"],
        "theta": ["Pitch_d"],
        "delta_a": ["Ail"],
        "delta_e": ["Ele"],
        "p_static": ["Ps_hPa"],
        "vd": ["vd", "v_d"],
    }


def test_load_factors_are_the_specific_forces() -> None:
    assert candidate_columns(["Nx (g)", "Ny (g)", "Nz (g)"]) == {"ax": ["Nx (g)"], "ay": ["Ny (g)"], "az": ["Nz (g)"]}


def test_a_draft_without_servos_says_nothing_of_an_example_s_trim(tmp_path: Path) -> None:
    time = 0.05 * np.arange(60)
    rows = np.column_stack([time, 20 * np.sin(time), 5 * np.cos(time)])
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header="t,Roll Rate (deg/s),Ail (deg)", comments="")
    (tmp_path / "map.toml").write_text(draft_map([tmp_path / "log.csv"]))
    flight = import_data(tmp_path / "log.csv", load_map(tmp_path / "map.toml"))
    assert flight.measured("delta_a")
    assert not any("example" in note.text for note in flight.notes)


def test_vectors_of_a_matlab_file_are_drafted_as_columns_of_a_table(tmp_path: Path) -> None:
    time = np.arange(0.0, 6.0, 0.02)
    phi = 20.0 * np.sin(time)
    vectors = {"t": time, "p_dps": 20.0 * np.cos(time), "phi": phi, "tas": 20.0 + 0.1 * phi, "da": 3.0 * np.cos(time)}
    scipy.io.savemat(tmp_path / "log.mat", vectors)
    (tmp_path / "map.toml").write_text(draft_map([tmp_path / "log.mat"]))
    columns = load_map(tmp_path / "map.toml").columns
    assert {n: (s[0].column, s[0].unit) for n, s in columns.items()} == {
        "p": ("p_dps", "dps"),
        "phi": ("phi", "deg"),
        "V": ("tas", "m/s"),
        "delta_a": ("da", "deg"),
    }
    flight = import_data(tmp_path / "log.mat", load_map(tmp_path / "map.toml"))
    assert np.nanmax(flight["phi"]) == pytest.approx(np.radians(20.0), rel=0.01)


def test_what_rises_evenly_is_time_whatever_its_name() -> None:
    rng = np.random.default_rng(2)
    clock = 812.0 + 0.02 * np.arange(400) + 0.001 * rng.uniform(size=400)
    clock[200:] += 3.0  # a gap
    columns = {"satz": np.arange(400.0), "hoehe": 20.0 + np.cumsum(rng.uniform(0, 1, 400)), "laufzeit": clock}
    assert running_column(columns) == "laufzeit"
    assert running_column({**columns, "Zeit [ms]": 20.0 * np.arange(400)}) == "Zeit [ms]"
    assert running_column({"satz": np.arange(400.0), "p": rng.normal(size=400)}) is None


def test_the_system_before_a_name_and_the_number_behind_it_say_nothing() -> None:
    names = ["EGI_PITCH_ANGLE", "ADC_TRUE_AIRSPEED", "FCC_A_RUDDER_POS", "AHRS_YAW_RATE_2", "INS1_NORMAL_ACCEL", "x_p"]
    names += ["roll_cmd", "EGI_ROLL_VALID", "target_heading", "stick_pitch"]
    assert candidate_columns(names) == {
        "theta": ["EGI_PITCH_ANGLE"],
        "V": ["ADC_TRUE_AIRSPEED"],
        "delta_r": ["FCC_A_RUDDER_POS"],
        "r": ["AHRS_YAW_RATE_2"],
        "az": ["INS1_NORMAL_ACCEL"],
    }
    assert candidate_columns(["EGI_ROLL", "roll_angle"]) == {"phi": ["EGI_ROLL", "roll_angle"]}
    assert candidate_columns(["ADC_COMPUTED_AIRSPEED"]) == {
        "V_cas": ["ADC_COMPUTED_AIRSPEED"]
    }  # as air data computers say it
    assert candidate_columns(["FCC_A_PHI", "phi"])["phi"][0] == "phi"


def test_a_table_is_drafted_with_units_by_its_values(tmp_path: Path) -> None:
    time = np.arange(0.0, 30.0, 0.04)
    phi, theta, psi = 25.0 * np.sin(0.9 * time), 4.0 + 2.0 * np.sin(0.5 * time), 200.0 + 3.0 * time
    f, th = np.radians(phi), np.radians(theta)
    df, dth, dps = (np.radians(np.gradient(x, time)) for x in (phi, theta, psi))
    p, q, r = (
        df - np.sin(th) * dps,
        np.cos(f) * dth + np.sin(f) * np.cos(th) * dps,
        -np.sin(f) * dth + np.cos(f) * np.cos(th) * dps,
    )
    columns = {
        "Time": 1000 * time, "roll": phi, "pitch": theta, "heading": psi % 360, "gyro_x": p, "gyro_y": q, "gyro_z": r,
        "acc_x": np.sin(th), "acc_y": -np.sin(f) * np.cos(th), "acc_z": -np.cos(f) * np.cos(th),
        "static_pressure": 950.0 + 0 * time, "mystery": time,
    }  # fmt: skip
    path, draft = tmp_path / "log.csv", tmp_path / "map.toml"
    np.savetxt(path, np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments="")
    done = CliRunner().invoke(cli, ["import", str(path), "--draft-map", "-o", str(draft)])
    assert done.exit_code == 0, done.output
    text = draft.read_text()
    chosen = load_map(draft)
    assert chosen.time is not None
    assert chosen.time.unit == "ms"
    units = {n: s[0].unit for n, s in chosen.columns.items()}
    assert units == {
        "phi": "deg", "theta": "deg", "psi": "deg", "p": "rad/s", "q": "rad/s", "r": "rad/s", "ax": "g", "ay": "g", "az": "g",
            "p_static": "hPa",
    }  # fmt: skip
    assert "# mystery: UNKNOWN" in text
    assert "# V = UNKNOWN" in text
    flight = import_data(path, draft)
    np.testing.assert_allclose(flight["p"], p, atol=1e-6)
    np.testing.assert_allclose(flight["az"], -9.80665 * np.cos(f) * np.cos(th), atol=1e-5)


def flown(time: np.ndarray, rng: np.random.Generator) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Pulses [us] of three servos, and the rates that they make through a lag."""
    pulses, rates = {}, {}
    for name, rate in (("aileron", "p"), ("elevator", "q"), ("rudder", "r")):
        steps = np.repeat(rng.choice([-1.0, 0.0, 1.0], time.size // 40 + 1), 40)[: time.size]
        y = np.zeros(time.size)
        moved = 0.0
        for k in range(1, time.size):
            moved += (steps[k - 1] - moved) * 0.02 / 0.05
            y[k] = y[k - 1] + 0.02 * (-4.0 * y[k - 1] - 6.0 * SIGN[name] * moved)
        pulses[name], rates[rate] = 1500.0 + 120.0 * steps, y + 0.01 * rng.standard_normal(time.size)
    return pulses, rates


def dataflash(path: Path) -> None:
    def described(kind: int, size: int, name: str, layout: str, labels: str) -> bytes:
        texts = (name.encode(), layout.encode(), labels.encode())
        return struct.pack("<BBBBB4s16s64s", 0xA3, 0x95, 128, kind, size, *texts)

    time = np.arange(0.0, 60.0, 0.02)
    pulses, rates = flown(time, np.random.default_rng(12))
    out = described(128, 89, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")
    out += described(64, 35, "PARM", "QNff", "TimeUS,Name,Value,Default")
    out += described(65, 19, "RCOU", "QHHHH", "TimeUS,C1,C2,C3,C4")
    out += described(66, 35, "IMU", "Qffffff", "TimeUS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    stated = {"SERVO1_FUNCTION": 4, "SERVO2_FUNCTION": 19, "SERVO3_FUNCTION": 70, "SERVO4_FUNCTION": 21,
              "SERVO1_TRIM": 1500, "SERVO2_TRIM": 1500,
              "SERVO4_TRIM": 1500, "SERVO1_MIN": 1080, "SERVO1_MAX": 1920, "SERVO2_MIN": 1100, "SERVO2_MAX": 1900}  # fmt: skip
    for name, value in stated.items():
        out += struct.pack("<BBBQ16sff", 0xA3, 0x95, 64, 0, name.encode(), value, 0.0)
    for k, t in enumerate(time):
        us = round(1e6 * t)
        row = (round(pulses["aileron"][k]), round(pulses["elevator"][k]), 1200 + k % 50, round(pulses["rudder"][k]))
        out += struct.pack("<BBBQHHHH", 0xA3, 0x95, 65, us, *row)
        out += struct.pack(
            "<BBBQffffff", 0xA3, 0x95, 66, us, rates["p"][k], rates["q"][k], rates["r"][k], 0.0, 0.0, -9.8
        )
    path.write_bytes(out)


@pytest.mark.parametrize("irig", [True, False])
def test_of_two_rates_the_one_that_turns_the_angle_is_drafted(tmp_path: Path, irig: bool) -> None:
    """As on a jet with two sets of gyros: the one by the shorter name has an offset, another scale and noise."""
    rng, time = np.random.default_rng(77), np.arange(0.0, 40.0, 0.1)
    q = 6.0 * np.sin(0.8 * time)
    theta, psi = 5.0 + np.cumsum(q) * 0.1, (350.0 + 2.0 * time) % 360.0  # deg; north is passed
    columns = {
        "PITCH_RATE_Q": 0.6 * q + 3.0 + 2.0 * rng.standard_normal(time.size), "EGI_PITCH_RATE_Q": q, "EGI_PITCH_ANGLE": theta,
        "YAW_RATE_R": np.full(time.size, 2.0) + rng.normal(0, 0.1, time.size), "EGI_YAW_RATE_R": np.full(time.size, 2.0),
        "HEADING": psi,
    }  # fmt: skip
    stamps = [f"200:11:00:{t:09.6f}" if irig else f"{t:.2f}" for t in time.tolist()]
    rows = [",".join([s, *(f"{v[i]:.5f}" for v in columns.values())]) for i, s in enumerate(stamps)]
    (file := tmp_path / "jet.csv").write_text("\n".join([",".join(["IRIG_TIME" if irig else "time", *columns]), *rows]))
    (line,) = [row for row in draft_map([file]).splitlines() if row.startswith("q = ")]
    assert 'column = "EGI_PITCH_RATE_Q", unit = "deg/s"' in line
    assert "moves as the slope of EGI_PITCH_ANGLE" in line
    assert "goes with the slope of EGI_PITCH_ANGLE better than the other (EGI_PITCH_RATE_Q 0.99" in line
    assert "also PITCH_RATE_Q" in line


def test_rates_that_cannot_be_told_apart_are_in_the_order_of_their_names() -> None:
    rng, time = np.random.default_rng(78), np.arange(0.0, 20.0, 0.1)
    q = np.sin(time)
    values = {"a": q + 1e-3 * rng.standard_normal(time.size), "b": q + 1e-3 * rng.standard_normal(time.size),
              "theta": np.cumsum(q) * 0.1}  # fmt: skip
    assert rate_that_turns(["a", "b"], "theta", values, time) == ("a", "")
    assert rate_that_turns(["a", "b"], "theta", values, None) == ("a", "")


def test_servos_by_their_functions_signs_by_the_motion(tmp_path: Path) -> None:
    path, draft = tmp_path / "log.bin", tmp_path / "map.toml"
    dataflash(path)
    draft.write_text(draft_map([path]))
    chosen = load_map(draft)
    assert {n: s.column for n, s in chosen.servos.items()} == {
        "aileron": "RCOU.C1",
        "elevator": "RCOU.C2",
        "rudder": "RCOU.C4",
    }
    for name, servo in chosen.servos.items():
        assert np.sign(servo.ends[1][1]) == SIGN[name], name
    assert [end[0] for end in chosen.servos["aileron"].ends] == [1080, 1920]
    text = draft.read_text()
    assert "RCOU.C3" in text
    assert "throttle by SERVO3_FUNCTION" in text
    assert text.count("deflections UNKNOWN") == 3
    assert "UNKNOWN ends" in text  # of the rudder, whose MIN and MAX the log does not state
    assert any("example map" in n.text for n in import_data(path, draft, accept_implausible=True).notes)


@pytest.mark.parametrize("late", [0.0, 0.02])
def test_an_output_that_nothing_follows_has_no_sign(late: float) -> None:
    rng = np.random.default_rng(4)
    time = np.arange(0.0, 60.0, 0.02)
    output = TimeSeries(time, 1500.0 + 100.0 * np.repeat(rng.choice([-1.0, 1.0], 60), 50))
    sign, why = sign_of(output, 1500.0, TimeSeries(time + late, rng.standard_normal(time.size)), -1, "IMU.GyrX")
    assert (sign, why) == (1, "sign UNKNOWN: IMU.GyrX does not tell")
