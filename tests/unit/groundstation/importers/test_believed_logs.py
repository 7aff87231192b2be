"""What autopilots' logs say of themselves: which sensor, whether it measured at all, when, and what is not to be believed."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from estimation.session.recipe import recipe
from groundstation.flight import Flight
from groundstation.flight.contradictions import contradictions
from groundstation.importers.about import is_foreign_log, log_info
from groundstation.importers.errors import ImportDataError
from groundstation.importers.run import import_data
from tests.unit.groundstation.importers import autopilots
from tests.unit.groundstation.turning import Columns

MAP = """format = 1
[servos.aileron]
column = "{aileron}"
trim = 1500
travel = [[1100, -20.0], [1900, 20.0]]
unit = "deg"
[columns]
delta_a = {{ column = "servo.aileron" }}
"""


def imported(tmp_path: Path, name: str, data: bytes, mapping: str | None = None) -> Flight:
    path = tmp_path / name
    path.write_bytes(data)
    if mapping is None:
        return import_data(path)
    written = tmp_path / "map.toml"
    written.write_text(mapping)
    return import_data(path, written)


def said(flight: Flight) -> str:
    return "\n".join(n.text for n in flight.notes)


def off(flight: Flight, column: str, truth: np.ndarray, times: np.ndarray) -> float:
    """Root-mean-square difference to the truth, where it is measured."""
    return float(np.sqrt(np.nanmean((flight[column] - np.interp(flight.time - autopilots.BOOT, times, truth)) ** 2)))


def test_a_rate_that_takes_information_from_the_log_is_told(tmp_path: Path) -> None:
    path = tmp_path / "log.bin"
    path.write_bytes(autopilots.dataflash(autopilots.ardupilot(autopilots.flight())))
    assert "averaged to the 10 Hz asked for" in said(import_data(path, rate_hz=10.0))
    for rate in (None, 40.0, 100.0):
        assert "asked for" not in said(import_data(path, rate_hz=rate))


# ------------------------------------------------------------------------------------------------------------ ArduPilot


@pytest.mark.parametrize("rho", [1.21, 0.94])
def test_airspeed_is_true_and_density_is_of_the_air_flown_in(tmp_path: Path, rho: float) -> None:
    f = autopilots.flight(rho)
    flight = imported(tmp_path, "a.bin", autopilots.dataflash(autopilots.ardupilot(f)))
    assert off(flight, "V", f["V"], f["time"]) < 0.3
    assert np.nanmedian(flight["rho"]) == pytest.approx(rho, rel=0.001)
    assert flight.channels["V"]["from"] == "CTUN.As*CTUN.E2T"
    assert flight.channels["V"]["kind"] == "measured"
    assert flight.channels["phi"]["kind"] == "computed"
    assert flight.channels["p"] == {
        "from": "IMU.GyrX",
        "kind": "measured",
        "rate_hz": pytest.approx(25, rel=0.01),
        "column": "p",
    }
    assert not any(c.stops for c in contradictions(flight))


def test_without_e2t_equivalent_airspeed_is_made_true_by_the_pressure(tmp_path: Path) -> None:
    f = autopilots.flight(0.94)
    flight = imported(tmp_path, "a.bin", autopilots.dataflash(autopilots.ardupilot(f, e2t=False)))
    assert off(flight, "V", f["V"], f["time"]) < 0.05 * 21
    assert np.nanmedian(flight["V"]) / np.median(f["eas"]) > 1.1
    assert "made true by the density of p_static" in said(flight)


@pytest.mark.parametrize(("gyro", "accelerometer"), [(30.0, 10.0), (0.0, 15.0)])
def test_what_a_filter_delays_is_dated_back_by_its_own_frequency(
    tmp_path: Path, gyro: float, accelerometer: float
) -> None:
    """A low-pass of second order delays a slow motion by sqrt(2)/(2 pi f); a filter that is off delays nothing."""
    tables = autopilots.ardupilot(autopilots.flight())
    plain = imported(tmp_path, "plain.bin", autopilots.dataflash(tables))
    names, values = [b"INS_GYRO_FILTER", b"INS_ACCEL_FILTER"], [gyro, accelerometer]
    stated = {"PARM": ("Nf", "Name,Value", np.array([tables["IMU"][2][0]] * 2), [names, values]), **tables}
    dated = imported(tmp_path, "dated.bin", autopilots.dataflash(stated))
    for column, frequency in (("p", gyro), ("ay", accelerometer), ("phi", 0.0)):
        delay = np.sqrt(2.0) / (2.0 * np.pi * frequency) if frequency else 0.0
        inside = slice(20, -20)
        expected = np.interp(dated.time[inside] + delay, plain.time, plain[column])
        step = np.max(np.abs(np.diff(plain[column])))
        assert np.max(np.abs(dated[column][inside] - expected)) < 0.2 * step, column
    assert ("INS_GYRO_FILTER" in said(dated)) == (gyro > 0.0)
    assert "INS_ACCEL_FILTER" in said(dated)


@pytest.mark.parametrize("ratio", [1.9936, 2.4])
def test_a_pitot_ratio_that_is_not_bernoullis_is_told_and_moves_nothing(tmp_path: Path, ratio: float) -> None:
    f = autopilots.flight()
    flight = imported(tmp_path, "a.bin", autopilots.dataflash(autopilots.ardupilot(f, ratio=ratio)))
    (told,) = (c for c in contradictions(flight) if set(c.between) == {"V", "p_dynamic"})
    assert told.ratio == pytest.approx(ratio / 1.633, rel=0.02)
    assert (told.favoured, told.stops) == ("V", False)
    assert np.nanmedian(flight["rho"]) == pytest.approx(1.104, rel=0.001)


@pytest.mark.parametrize(
    ("pitots", "health", "taken", "stops"),
    [
        ((0.6, 1.0, 1), (1, 1), "instance 1 is taken, the log names it the primary", False),
        ((1.0, 0.6, 0), (1, 1), "", False),
        ((0.6, 1.0, -1), (0, 1), "instance 1 is taken, 0 is not healthy", False),
        ((0.6, 1.0, -1), (1, 1), "", True),
    ],
)
def test_of_two_pitots_the_one_in_use_is_taken_and_a_difference_told(
    tmp_path: Path, pitots: tuple[float, float, int], health: tuple[int, int], taken: str, stops: bool
) -> None:
    f = autopilots.flight()
    flight = imported(tmp_path, "a.bin", autopilots.dataflash(autopilots.ardupilot(f, pitots=pitots, health=health)))
    assert taken in said(flight)
    pair = next(c for c in contradictions(flight) if c.between[0].startswith("ARSP"))
    assert pair.stops == stops
    assert pair.ratio is not None
    assert min(pair.ratio, 1 / pair.ratio) == pytest.approx(0.6, rel=0.01)
    if not stops:
        assert np.nanmedian(flight["p_dynamic"]) == pytest.approx(np.median(f["p_dynamic"]), rel=0.02)
        assert pair.favoured == pair.between[1]


def test_a_primary_that_changes_in_flight_is_followed(tmp_path: Path) -> None:
    f = autopilots.flight()
    tables = autopilots.ardupilot(f, pitots=(0.6, 1.0, 1))
    letters, labels, time, fields = tables["ARSP"]
    early = time < autopilots.BOOT + 20
    fields[2] = np.where(early, fields[2] * np.where(fields[0] == 0, 1 / 0.6, 0.5), fields[2])
    fields[-1] = np.where(early, 0, 1)
    tables["ARSP"] = (letters, labels, time, fields)
    flight = imported(tmp_path, "a.bin", autopilots.dataflash(tables))
    assert "the instance in use changes in flight" in said(flight)
    assert off(flight, "p_dynamic", f["p_dynamic"], f["time"]) < 0.03 * np.median(f["p_dynamic"])


@pytest.mark.parametrize("kind", [0, 2, 3])
def test_a_synthetic_airspeed_is_not_measured(tmp_path: Path, kind: int) -> None:
    tables = autopilots.ardupilot(autopilots.flight(), airspeed_type=kind)
    del tables["ARSP"]
    flight = imported(tmp_path, "a.bin", autopilots.dataflash(tables))
    assert "V" not in flight
    assert flight.channels["V"]["kind"] == "computed"
    found = recipe(flight)
    assert "an airspeed by a pitot" in found.air
    assert "V" not in found.measured


def test_nothing_that_says_a_pitot_measured_is_assumed_and_said(tmp_path: Path) -> None:
    tables = autopilots.ardupilot(autopilots.flight(), airspeed_type=None)
    del tables["ARSP"]
    flight = imported(tmp_path, "a.bin", autopilots.dataflash(tables))
    assert flight.channels["V"]["kind"] == "assumed"
    assert "nothing in the log says that a pitot measured" in said(flight)


def test_flow_angles_of_the_autopilot_are_no_vanes(tmp_path: Path) -> None:
    flight = imported(tmp_path, "a.bin", autopilots.dataflash(autopilots.ardupilot(autopilots.flight(), aoa=True)))
    assert "alpha" not in flight
    assert np.nanmedian(flight["alpha_computed"]) == pytest.approx(np.radians(3), abs=0.01)
    found = recipe(flight)
    assert {"alpha", "beta", "phi"} <= set(found.computed)
    assert "reconstruct" in found.air
    assert not {"alpha", "beta", "alpha_computed"} & set(found.measured)


def test_velocities_without_a_fix_are_none(tmp_path: Path) -> None:
    f = autopilots.flight()
    flight = imported(tmp_path, "a.bin", autopilots.dataflash(autopilots.ardupilot(f, fix_lost=(20.0, 27.0))))
    inside = (flight.time > autopilots.BOOT + 21) & (flight.time < autopilots.BOOT + 26)
    assert np.isnan(flight["vn"][inside]).all()
    assert off(flight, "vn", f["vn"], f["time"]) < 0.3
    assert "without a fix" in said(flight)


def test_old_logs_and_the_text_form_are_the_binary_ones(tmp_path: Path) -> None:
    tables = autopilots.ardupilot(autopilots.flight(), parameters=[("SERVO1_TRIM", 1512.0)])
    new = imported(tmp_path, "new.bin", autopilots.dataflash(tables))
    old = imported(tmp_path, "old.bin", autopilots.dataflash(tables, unit=1e-3))
    text = imported(tmp_path, "text.log", autopilots.dataflash_text(tables).encode())
    for other in (old, text):
        assert set(other.columns) == set(new.columns)
        for name in ("V", "p", "phi", "vn", "p_static"):
            difference = np.interp(other.time, new.time, new[name]) - other[name]
            assert np.nanstd(difference) < 0.02 * np.nanstd(new[name]) + 1e-3, name
            assert np.isfinite(difference).mean() > 0.95


def test_a_log_whose_beginning_is_lost_says_so(tmp_path: Path) -> None:
    data = autopilots.dataflash(autopilots.ardupilot(autopilots.flight(seconds=10)))
    with pytest.raises(ImportDataError, match="beginning of this ArduPilot log is lost"):
        imported(tmp_path, "a.bin", data[4321:])
    with pytest.raises(ImportDataError, match="not an ArduPilot dataflash log"):
        imported(tmp_path, "b.bin", np.random.default_rng(7).bytes(300_000))


@pytest.mark.parametrize(("lost", "known", "unknown"), [(2, "V", "p"), (4, "vn", "p_dynamic")])
def test_of_a_log_whose_first_descriptions_are_lost_the_rest_is_read(
    tmp_path: Path, lost: int, known: str, unknown: str
) -> None:
    """Descriptions are 89 bytes each: of all messages, then IMU, ATT, ARSP, BARO and so on."""
    data = autopilots.dataflash(autopilots.ardupilot(autopilots.flight(seconds=20)))
    flight = imported(tmp_path, "a.bin", data[89 * (1 + lost) - 40 :])
    assert flight.measured(known)
    assert not flight.measured(unknown)
    assert "its first bytes are lost, and messages described only there" in said(flight)


@pytest.mark.parametrize(
    ("name", "write", "kind"),
    [
        ("a.bin", lambda f: autopilots.dataflash(autopilots.ardupilot(f)), "dataflash"),
        ("old.bin", lambda f: autopilots.dataflash(autopilots.ardupilot(f), unit=1e-3), "dataflash"),
        ("a.log", lambda f: autopilots.dataflash_text(autopilots.ardupilot(f)).encode(), "dataflash"),
        ("a.ulg", autopilots.px4, "ulog"),
        ("a.tlog", autopilots.telemetry, "tlog"),
        ("v1.tlog", lambda f: autopilots.telemetry(f, version=1), "tlog"),
    ],
)
def test_info_knows_the_log(tmp_path: Path, name: str, write: Callable[[Columns], bytes], kind: str) -> None:
    path = tmp_path / name
    path.write_bytes(write(autopilots.flight(seconds=14)))
    assert is_foreign_log(path)
    info = log_info(path)
    assert (info["kind"], info["duration_s"]) == (kind, pytest.approx(14.0, abs=0.2))
    assert len(info["channels"]) > 15
    assert all(c["samples"] > 1 for c in info["channels"])


@pytest.mark.parametrize(("function", "told"), [(4, ""), (77, ""), (21, "moves the rudder"), (33, "moves the motor 1")])
def test_outputs_that_move_something_else_are_told(tmp_path: Path, function: int, told: str) -> None:
    tables = autopilots.ardupilot(autopilots.flight(), parameters=[("SERVO1_FUNCTION", float(function))])
    flight = imported(tmp_path, "a.bin", autopilots.dataflash(tables), MAP.format(aileron="RCOU.C1"))
    found = [c for c in contradictions(flight) if "SERVO1_FUNCTION" in c.between]
    assert bool(found) == bool(told)
    assert all(told in c.text and c.stops for c in found)


# ------------------------------------------------------------------------------------------------------------------ PX4


@pytest.mark.parametrize(("source", "kind"), [(1, "measured"), (2, "measured"), (0, "computed"), (4, "computed")])
def test_the_source_of_px4s_airspeed_counts(tmp_path: Path, source: int, kind: str) -> None:
    data = autopilots.px4(autopilots.flight(), source=source, pitot=kind == "measured")
    flight = imported(tmp_path, "a.ulg", data)
    assert flight.channels["V"]["kind"] == kind
    assert ("V" in flight) == (kind == "measured")
    assert ("pitot" in recipe(flight).air) == (kind == "computed")


def test_px4_without_a_fix_has_no_velocity(tmp_path: Path) -> None:
    f = autopilots.flight()
    flight = imported(tmp_path, "a.ulg", autopilots.px4(f, fix_lost=(30.0, 36.0)))
    inside = (flight.time > autopilots.BOOT + 31) & (flight.time < autopilots.BOOT + 35)
    assert np.isnan(flight["ve"][inside]).all()
    assert off(flight, "ve", f["ve"], f["time"]) < 0.3


def test_outputs_on_another_instance_are_named(tmp_path: Path) -> None:
    data = autopilots.px4(autopilots.flight(), outputs=1)
    flight = imported(tmp_path, "a.ulg", data, MAP.format(aileron="actuator_outputs.output[0]"))
    assert not flight.measured("delta_a")
    assert "actuator_outputs[1].output[0] moves: name it in the mapping" in said(flight)


# -------------------------------------------------------------------------------------------------------------- MAVLink


def test_telemetry_airspeed_is_equivalent_and_made_true(tmp_path: Path) -> None:
    f = autopilots.flight(0.94)
    flight = imported(tmp_path, "a.tlog", autopilots.telemetry(f))
    assert np.nanmedian(flight["V"]) == pytest.approx(np.median(f["V"]), rel=0.05)
    assert "equivalent airspeed: made true" in said(flight)
    assert flight.channels["rho"]["kind"] == "computed"
    assert flight.channels["temperature"]["kind"] == "assumed"


def test_ground_speed_shown_as_airspeed_is_not_measured(tmp_path: Path) -> None:
    flight = imported(tmp_path, "a.tlog", autopilots.telemetry(autopilots.flight(), pitot=False))
    assert "V" not in flight
    assert "never moves" in said(flight)


def test_two_boots_are_two_records_and_never_mixed(tmp_path: Path) -> None:
    first, second = autopilots.flight(seed=1, seconds=14), autopilots.flight(seed=2, seconds=12)
    second["psi"] = second["psi"] + 1.3
    data = autopilots.telemetry(first) + autopilots.telemetry(second, start=200.0, boot=autopilots.BOOT + 0.017)
    flight = imported(tmp_path, "a.tlog", data)
    assert len(flight.segments) == 2
    for part, f, zero in zip(flight.segments, (first, second), (0.0, 200.0), strict=True):
        time = flight.time[part] - autopilots.BOOT - zero
        assert time[-1] - time[0] == pytest.approx(f["time"][-1], abs=0.2)
        psi = np.interp(time, f["time"], f["psi"])
        assert np.nanmax(np.abs(np.sin(flight["psi"][part] - psi))) < 0.05


def test_bursts_of_a_radio_leave_each_message_its_time(tmp_path: Path) -> None:
    f = autopilots.flight()
    late = autopilots.telemetry(f, arrival=lambda t: np.floor(t / 1.4) * 1.4 + 1.4 + 0.01 * (t % 1.4))
    flight = imported(tmp_path, "a.tlog", late)
    assert 1 / flight.sample_interval == pytest.approx(12.5, rel=0.03)
    lag = [
        float(np.sqrt(np.nanmean((flight["V"] - np.interp(flight.time - autopilots.BOOT - s, f["time"], f["V"])) ** 2)))
        for s in (0.0, 0.7)
    ]
    assert lag[0] < 0.6
    assert flight.native_rate("V") == pytest.approx(12.5, rel=0.05)


def test_a_gimbal_and_a_second_port_are_series_of_their_own(tmp_path: Path) -> None:
    f = autopilots.flight(seconds=20)
    data = autopilots.telemetry(f, gimbal=True, ports=True)
    flight = imported(tmp_path, "a.tlog", data, MAP.format(aileron="SERVO_OUTPUT_RAW.servo1_raw"))
    assert off(flight, "phi", f["phi"], f["time"]) < 0.05
    assert np.nanmax(np.abs(flight["delta_a"])) < np.radians(3)
    aux = imported(tmp_path, "a.tlog", data, MAP.format(aileron="SERVO_OUTPUT_RAW[1].servo1_raw"))
    assert np.nanmin(aux["delta_a"]) == pytest.approx(np.radians(20))
    assert "154:ATTITUDE.roll" in said(flight)


def test_a_receivers_clock_of_another_rate_is_told(tmp_path: Path) -> None:
    data = autopilots.telemetry(autopilots.flight(), arrival=lambda t: 1.25 * t)
    flight = imported(tmp_path, "a.tlog", data)
    clocks = next(c for c in contradictions(flight) if "receiver's clock" in c.between)
    assert clocks.ratio == pytest.approx(1.25, rel=0.02)
    assert clocks.stops


def test_slow_telemetry_is_too_slow_for_any_model(tmp_path: Path) -> None:
    flight = imported(tmp_path, "a.tlog", autopilots.telemetry(autopilots.flight(), every=25))
    models = recipe(flight).to_json()["models"]
    assert isinstance(models, list)
    assert not any(m["possible"] for m in models)
    assert all("1 Hz, too slow" in m["too_slow"] for m in models)


def test_mavlink_1_is_read_too(tmp_path: Path) -> None:
    f = autopilots.flight(seconds=20)
    flight = imported(tmp_path, "a.tlog", autopilots.telemetry(f, version=1))
    assert off(flight, "phi", f["phi"], f["time"]) < 0.05


# --------------------------------------------------------------------------------------------------------------- MATLAB


@pytest.mark.parametrize("form", ["labels", "structs"])
def test_mission_planners_matrices_and_structs_by_message_are_the_log(tmp_path: Path, form: str) -> None:
    scipy_io = pytest.importorskip("scipy.io")
    tables = autopilots.ardupilot(autopilots.flight(), pitots=(0.6, 1.0, 1))
    content: dict[str, object] = {}
    for name, (_, labels, time, fields) in tables.items():
        columns = {
            "LineNo": np.arange(time.size),
            "TimeUS": np.round(time * 1e6),
            **dict(zip(labels.split(","), fields, strict=True)),
        }
        if form == "labels":
            content[name] = np.column_stack([np.asarray(c, float) for c in columns.values()])
            content[f"{name}_label"] = np.array(list(columns), object).reshape(-1, 1)
        else:
            content[name] = {n: np.asarray(c, float) for n, c in columns.items()}
    path = tmp_path / "log.mat"
    scipy_io.savemat(path, content)
    flight = import_data(path)
    direct = imported(tmp_path, "a.bin", autopilots.dataflash(tables))
    assert {"V", "p", "phi", "vn", "rho"} <= set(flight.columns)
    for name in ("V", "phi", "p_dynamic"):
        difference = flight[name] - np.interp(flight.time, direct.time, direct[name])
        assert np.nanstd(difference) < 0.02 * np.nanstd(direct[name])
    assert "instance 1 is taken" in said(flight)


def test_a_dataflash_log_of_two_boots_is_two_records(tmp_path: Path) -> None:
    first, second = autopilots.flight(seed=3, seconds=12), autopilots.flight(seed=4, seconds=15)
    data = [autopilots.dataflash(autopilots.ardupilot(f)) for f in (first, second)]
    flight = imported(tmp_path, "two.bin", b"".join(data))
    assert len(flight.segments) == 2
    lengths = [flight.time[s][-1] - flight.time[s][0] for s in flight.segments]
    assert lengths == pytest.approx([12, 15], abs=0.1)
    assert "boot 2 of 2" in said(flight)
