"""Logs that say what is not so, to the end: derivatives are those flown, or nothing is recommended."""

import contextlib
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daq.utilities.errors import UserError
from estimation.aircraft import load_aircraft
from estimation.compatibility.air_data import reconstruct_air, with_air
from estimation.errors import DataError
from estimation.models import load_model
from estimation.session.recipe import recipe
from estimation.session.runner import estimate
from estimation.session.session import FlightEstimates
from firmware_sim.physics.aerodynamics import LATERAL, true_derivatives
from firmware_sim.world.scenario import load_scenario
from firmware_sim.world.world import simulate_many
from groundstation.flight import Flight
from groundstation.importers.records import with_aircraft
from groundstation.importers.run import import_data
from tests.chain.autopilot_logs import pulses
from tests.unit.groundstation.importers import autopilots

pytestmark = [pytest.mark.timeout(300)]
MAP = """format = 1
[servos.left]
column = "RCOU.C1"
trim = 1520
travel = [[1100, -24.0], [1900, 22.0]]
unit = "deg"
[servos.right]
column = "RCOU.C2"
trim = 1480
travel = [[1100, 22.0], [1900, -24.0]]
unit = "deg"
[servos.rudder]
column = "RCOU.C4"
trim = 1500
travel = [[1100, -25.0], [1900, 25.0]]
unit = "deg"
[columns]
delta_a = { terms = [{ column = "servo.right", factor = 0.5 }, { column = "servo.left", factor = -0.5 }] }
delta_r = { column = "servo.rudder" }
"""
NOISE = {"p": 0.005, "q": 0.005, "r": 0.005, "ax": 0.05, "ay": 0.05, "az": 0.08, "phi": 0.004, "theta": 0.004, "psi": 0.004,
         "V": 0.15, "vn": 0.15, "ve": 0.15, "vd": 0.2}  # fmt: skip


@pytest.fixture(scope="module")
def truth() -> dict[str, np.ndarray]:
    scenario = load_scenario("rich").altered(wind={"gust_deg": 0.1, "speed_m_s": 6.0, "from_deg": 200.0})
    return simulate_many([scenario], [4], 50.0)[0]


def measured(truth: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(8)
    f = {n: np.unwrap(v) if n == "psi" else v for n, v in truth.items() if v.ndim == 1}
    f |= {n: f[n] + s * rng.standard_normal(f[n].size) for n, s in NOISE.items()}
    return f | {"eas": f["V"] * np.sqrt(f["rho"] / 1.225)}


def log(truth: dict[str, np.ndarray], **options: object) -> bytes:
    f = measured(truth)
    airspeed = float(options.pop("airspeed", 1.0))  # type: ignore[arg-type]
    tables = autopilots.ardupilot(f, **options)  # type: ignore[arg-type]
    _, labels, _, fields = tables["ARSP"]
    fields[labels.split(",").index("Temp")][:] = np.median(f["p_static"] / f["rho"]) / 287.05 - 273.15  # of its own air
    servo = pulses(truth)
    letters, labels, time, _ = tables["RCOU"]
    tables["RCOU"] = (letters, labels, time, [servo["left"], servo["right"], 0 * time, servo["rudder"]])
    letters, labels, time, fields = tables["CTUN"]
    tables["CTUN"] = (letters, labels, time, [fields[0] * airspeed, *fields[1:]])
    return autopilots.dataflash(tables)


def followed(
    tmp_path: Path, data: bytes, methods: Sequence[str] = ("ml",), name: str = "log.bin"
) -> tuple[Flight, FlightEstimates]:
    (tmp_path / name).write_bytes(data)
    mapping = MAP if name.endswith(".bin") else re.sub(r"RCOU\.C(\d)", r"SERVO_OUTPUT_RAW.servo\1_raw", MAP)
    (tmp_path / "map.toml").write_text(mapping)
    flight = with_aircraft(import_data(tmp_path / name, tmp_path / "map.toml"), "cdfp")
    flight = with_air(flight, reconstruct_air(flight))
    aircraft = load_aircraft("cdfp")
    return flight, estimate(load_model("lateral", "cdfp"), [flight], aircraft, methods).flights[0]


def telemetry(truth: dict[str, np.ndarray], rows: slice, **options: Any) -> bytes:
    """A .tlog of some seconds of the flight, its clock from zero."""
    f = {n: v[rows] for n, v in measured(truth).items()}
    f["time"] = f["time"] - f["time"][0]
    servo = [v[rows] for v in pulses(truth).values()]
    still = np.full(f["time"].size, 1400.0)
    return autopilots.telemetry(f, servos=[*servo[:2], still, servo[2]], **options)


def bounds_off(found: FlightEstimates, scale: float = 1.0, share: float = 0.0) -> dict[str, float]:
    """How far the recommended derivatives are off `scale` times the true ones, in bounds; share: of each, that the density may
    be off by, which no bound of a log without a thermometer in the air knows of."""
    true = true_derivatives(load_aircraft("cdfp"), {})
    parameters = found.results["ml"].parameters
    return {
        n: (parameters[n].estimate - scale * true[n]) / np.hypot(parameters[n].std_coloured, share * true[n])
        for n in LATERAL
        if not n.endswith("_0")
    }


@pytest.mark.parametrize(
    "options",
    [{}, {"ratio": 1.9936}, {"pitots": (0.62, 1.0, 1)}, {"aoa": True}, {"fix_lost": (12.0, 15.0)}],
    ids=["as it is", "ratio", "two pitots", "computed angles", "fix lost"],
)
def test_what_is_told_and_moves_nothing_ends_right(
    tmp_path: Path, truth: dict[str, np.ndarray], options: dict[str, object]
) -> None:
    _, found = followed(tmp_path, log(truth, **options))
    assert found.verdict.recommended.method == "ml"
    away = bounds_off(found)
    assert max(map(abs, away.values())) < 3.5, away
    true, parameters = true_derivatives(load_aircraft("cdfp"), {}), found.results["ml"].parameters
    assert parameters["Cl_p"].std_coloured < 0.15 * abs(true["Cl_p"])


@pytest.mark.parametrize(
    "options", [{"airspeed": 1.25}, {"parameters": [("SERVO4_FUNCTION", 4.0)]}], ids=["airspeed", "outputs"]
)
def test_what_moves_derivatives_is_not_recommended(
    tmp_path: Path, truth: dict[str, np.ndarray], options: dict[str, object]
) -> None:
    _, found = followed(tmp_path, log(truth, **options))
    assert found.verdict.recommended.method == "none"


@pytest.mark.parametrize("e2t", [True, False], ids=["E2T", "by pressure"])
def test_a_high_field_has_the_density_of_its_pressure(tmp_path: Path, truth: dict[str, np.ndarray], e2t: bool) -> None:
    """The same motion in thinner air is that of larger derivatives; BARO.Alt counts from the field, and As is equivalent."""
    thinner = 0.84
    f = {n: v * thinner if n in ("rho", "p_static") else v for n, v in truth.items()}
    flight, found = followed(tmp_path, log(f, e2t=e2t))
    assert np.nanmedian(flight["rho"]) == pytest.approx(thinner * np.median(truth["rho"]), rel=0.005)
    assert found.verdict.recommended.method == "ml"
    away = bounds_off(found, 1.0 / thinner)
    assert max(map(abs, away.values())) < 3.5, away


def test_boots_ports_and_a_gimbal_are_not_mixed_into_one_motion(tmp_path: Path, truth: dict[str, np.ndarray]) -> None:
    half = truth["time"].size // 2
    options = {"every": 1, "gimbal": True, "ports": True, "boot": 3.0}
    data = telemetry(truth, slice(0, half), **options) + telemetry(truth, slice(half, None), start=700.0, **options)
    flight, found = followed(tmp_path, data, name="log.tlog")
    assert len(flight.segments) == 2
    away = bounds_off(found, share=0.04)
    assert max(map(abs, away.values())) < 3.5, away


@pytest.mark.parametrize("hz", [2.0, 4.0])
def test_slow_telemetry_is_not_recommended(tmp_path: Path, truth: dict[str, np.ndarray], hz: float) -> None:
    data = telemetry(truth, slice(None), every=round(50.0 / hz))
    (tmp_path / "log.tlog").write_bytes(data)
    models = recipe(import_data(tmp_path / "log.tlog")).models
    assert not any(m.able for m in models)
    with contextlib.suppress(UserError):  # refused is as good
        _, found = followed(tmp_path, data, ("ls",), "log.tlog")
        assert found.verdict.recommended.method == "none"


def test_without_a_pitot_nothing_is_reconstructed(tmp_path: Path, truth: dict[str, np.ndarray]) -> None:
    (tmp_path / "log.bin").write_bytes(log(truth, airspeed_type=2, pitots=None))
    flight = import_data(tmp_path / "log.bin")
    columns = {n: v for n, v in flight.columns.items() if n not in ("p_dynamic", "V_cas")}
    with pytest.raises(DataError, match="no airspeed"):
        reconstruct_air(Flight.build("log", flight.time, columns))


@pytest.mark.parametrize(("ways", "plain", "corrected"), [(False, 0.1, 0.25), (True, 0.08, 0.25)])
def test_bounds_do_not_depend_on_the_grid(
    tmp_path: Path,
    truth: dict[str, np.ndarray],
    monkeypatch: pytest.MonkeyPatch,
    ways: bool,
    plain: float,
    corrected: float,
) -> None:
    """A log whose messages come at 10 Hz has the information of 10 Hz on a grid of 10 as of 50 Hz. ways: with what is not known
    of a surface between two samples, as ever; without, plain bounds are of the samples alone, and a step of a control, drawn as
    a ramp on the faster grid, seems surer of its time. Corrected bounds rest on the colour of the residuals, which fewer samples
    tell less well."""
    if not ways:
        monkeypatch.setattr("estimation.estimators.output_error.with_paths", lambda model, data: model)
    tenth = {n: v[::5] for n, v in truth.items()}
    (tmp_path / "log.bin").write_bytes(log(tenth))
    (tmp_path / "map.toml").write_text(MAP)
    aircraft = load_aircraft("cdfp")
    bounds = {}
    for hz in (10.0, 50.0):
        flight = with_aircraft(import_data(tmp_path / "log.bin", tmp_path / "map.toml", rate_hz=hz), "cdfp")
        flight = with_air(flight, reconstruct_air(flight))
        found = estimate(load_model("lateral", "cdfp"), [flight], aircraft, ("ml",)).flights[0].results["ml"].parameters
        bounds[hz] = {
            n: (found[n].std, found[n].std_coloured) for n in ("CY_beta", "Cl_p", "Cl_da", "Cn_beta", "Cn_dr")
        }
    for name, (std, coloured) in bounds[10.0].items():
        assert bounds[50.0][name][0] == pytest.approx(std, rel=plain), name
        assert bounds[50.0][name][1] == pytest.approx(coloured, rel=corrected), name
