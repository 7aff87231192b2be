"""Aircraft of autopilots' simulators as base models: what they fly is what is compared, and strangers' files are bounded."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from estimation.aircraft import load_aircraft
from estimation.answers.gaps import beside_simulation
from estimation.models import load_model, write_model
from estimation.simulation.attach import attach, simulation_of
from estimation.simulation.oracle import SURFACES, VARIABLES, Array, Simulation, SimulationError, States
from estimation.simulation.own_simulations import text_simulation
from groundstation.flight import Flight, write_flight
from sideslip.cli import cli
from tests.studies import second_truth as truth
from tests.unit.estimation.simulation.autopilot.aircraft import RandomAircraft
from tests.unit.estimation.simulation.autopilot.test_to_ardupilot import export
from tests.unit.estimation.simulation.test_along_flight import states

SITL_KEYS = '{"s": 0.45, "b": 1.88, "c": 0.24, "c_lift_a": 6.9'
ADVANCED = """<?xml version="1.0"?><sdf version="1.9"><model name="a">
<link name="base_link"><inertial><pose>0.05 0 0 0 0 0</pose><mass>1</mass>
<inertia><ixx>0.2</ixx><iyy>0.15</iyy><izz>0.25</izz></inertia></inertial></link>
<link name="w"><pose>0 {y} 0 0 0 0</pose><inertial><mass>1e-8</mass>
<inertia><ixx>1e-6</ixx><iyy>1e-6</iyy><izz>1e-6</izz></inertia></inertial></link>
<joint name="j" type="revolute"><parent>base_link</parent><child>w</child><axis><xyz>{axis}</xyz></axis></joint>
<plugin filename="x" name="gz::sim::systems::AdvancedLiftDrag"><link_name>base_link</link_name>
<area>0.34</area><AR>6.5</AR><mac>0.22</mac>
<eff>0.97</eff><CL0>0.15</CL0><CLa>5.0</CLa><CD0>0.03</CD0><cp>-0.12 0 0</cp><CYb>-0.3</CYb><alpha_stall>2.0</alpha_stall>
<num_ctrl_surfaces>{count}</num_ctrl_surfaces><control_surface><name>j</name><direction>{direction}</direction><CD_ctrl>0</CD_ctrl>
<CY_ctrl>{CY}</CY_ctrl><CL_ctrl>0</CL_ctrl><Cell_ctrl>{Cell}</Cell_ctrl><Cem_ctrl>{Cem}</Cem_ctrl><Cen_ctrl>0</Cen_ctrl></control_surface>
</plugin></model></sdf>"""


def sdf(folder: Path, **changes: object) -> Path:
    told = {"y": 0.0, "axis": "0 1 0", "count": 1, "direction": 1, "CY": 0, "Cell": 0, "Cem": 0, **changes}
    path = folder / "model.sdf"
    path.write_text(ADVANCED.format(**told), encoding="utf-8")
    return path


def asked(file: Path, x: States) -> Array:
    """(N, 6) coefficients of a model of Gazebo."""
    return simulation_of(f"gazebo:{file}").oracle.coefficients(x)


def without_square(craft: RandomAircraft) -> RandomAircraft:
    """Without what simulators cannot say: CD_k on all of lift, constants of Gazebo."""
    craft.d |= {"CD_k": 1e-9, "CY_0": 0.0, "Cl_0": 0.0, "Cn_0": 0.0}
    return craft


@pytest.mark.parametrize(
    ("target", "out", "spec"), [("ardupilot", "x.json", "ardupilot:{}"), ("gazebo", "x", "gazebo:{}/model.sdf")]
)
def test_what_was_exported_reads_as_the_aircraft(target: str, out: str, spec: str, tmp_path: Path) -> None:
    """To what air data differ by: sideslip is zero here."""
    path = without_square(RandomAircraft(31)).write(tmp_path)
    assert export(path, "--to", target, "-o", tmp_path / out).return_value == 0
    model = load_model("six-dof", load_aircraft(path))
    write_model(model, tmp_path / "m.toml")
    x = states(20)
    level = States({**x.values, "beta": np.zeros(20)}, x.rho, x.alpha_dot)
    simulation = simulation_of(spec.format(tmp_path / out))
    np.testing.assert_allclose(
        simulation.oracle.coefficients(level),
        text_simulation(str(tmp_path / "m.toml")).oracle.coefficients(level),
        rtol=2e-5,
        atol=1e-7,
    )
    craft = RandomAircraft(31)
    assert simulation.aircraft is not None
    for name, value in (("mass", craft.m), ("Ixx", craft.Ixx), ("Ixz", craft.Ixz), ("span", craft.b)):
        assert getattr(simulation.aircraft, name) == pytest.approx(value, rel=1e-9)


def test_what_drag_of_sitl_leaves_out_is_estimated_beside_it(tmp_path: Path) -> None:
    """An aircraft whose drag goes with all of its lift: at a share of 1 the model on its own file has just that drag."""
    craft = RandomAircraft(33)
    path = craft.write(tmp_path)
    assert export(path, "--to", "ardupilot", "-o", tmp_path / "x.json").return_value == 0
    (columns,) = truth.fly([truth.Request(4, manoeuvres="longitudinal", duration=6.0)])
    flight = Flight.build("f", columns.pop("time"), columns)
    attached = attach(f"ardupilot:{tmp_path / 'x.json'}", "longitudinal", [flight], load_aircraft(path))
    assert "share_CD" in attached.model.free_names
    assert "CD_0 0 (0), share_CD 0 (0)" in beside_simulation(attached.model)
    polar, d, x = attached.simulation.polar, craft.d, states(20)
    assert polar is not None
    alpha, q_hat = x.values["alpha"], x.values["q"] * craft.c / (2.0 * x.values["V"])
    of_alpha = d["CL_0"] + d["CL_alpha"] * alpha
    CL = of_alpha + d["CL_q"] * q_hat + d["CL_de"] * x.values["delta_e"]
    level = States({**x.values, "beta": np.zeros(20)}, x.rho, x.alpha_dot)
    body = attached.simulation.oracle.coefficients(level)
    flown = -body[:, 0] * np.cos(alpha) - body[:, 2] * np.sin(alpha)
    rest = polar.CD_k * (CL**2 - (polar.CL_0 + polar.CL_alpha * alpha) ** 2)
    np.testing.assert_allclose(flown + rest, d["CD_0"] + d["CD_k"] * CL**2, rtol=1e-6)


def test_accelerations_of_sitl_stand_whatever_aircraft_is_asked_about(tmp_path: Path) -> None:
    """A file without our comments: SITL flies 2 kg and 1 kg m2, and so must the model on it."""
    (tmp_path / "x.json").write_text(SITL_KEYS + "}")
    (columns,) = truth.fly([truth.Request(3, duration=6.0)])
    flight = Flight.build("f", columns.pop("time"), columns)
    told = attach(f"ardupilot:{tmp_path / 'x.json'}", "six-dof", [flight], "cdfp")
    alone = attach(f"ardupilot:{tmp_path / 'x.json'}", "six-dof", [flight])
    assert alone.aircraft.mass == 2.0
    assert told.aircraft.mass == load_aircraft("cdfp").mass
    x, a, b = states(9), told.aircraft, alone.aircraft
    at, own = told.simulation.oracle.coefficients(x), alone.simulation.oracle.coefficients(x)
    np.testing.assert_allclose(at[:, :3] * a.area / a.mass, own[:, :3] * b.area / b.mass)
    np.testing.assert_allclose(at[:, 4] * a.area * a.chord / a.Iyy, own[:, 4] * b.area * b.chord / b.Iyy)
    G = a.Ixx * a.Izz - a.Ixz**2
    np.testing.assert_allclose((a.Izz * at[:, 3] + a.Ixz * at[:, 5]) / G * a.area * a.span, own[:, 3] * b.area * b.span)
    assert any("SITL's own values stand" in n for n in told.notes)
    assert any("throws of 20 deg" in n for n in told.notes)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ('{"s": NaN, "b": 1}', "no JSON"), ('{"s": 1,}', "no JSON"), ('{"s": "1"}', "anything but a number"),
        ('{"s": -1}', "above zero"),
        ('{"s": 1, "CGOffset": [1, 2]}', "three numbers"), ("no object", "braces"),
        ('{"a": ' + "[" * 90 + "]" * 90 + "}", "nested"),
        ('{"s": ' + "[" * 100_000, "braces"), ('{"other": 1}', "none of the keys"), ('{"s": true}', "anything but a number"),
        ('{"s": 1, "b": 1' + "0" * 400 + "}", "anything but a number"), ('# {"s": 1}\n"b": 2}', "no JSON"),
    ],
)  # fmt: skip
def test_a_file_that_sitl_would_stop_at_is_refused(text: str, told: str, tmp_path: Path) -> None:
    (tmp_path / "x.json").write_text(text)
    with pytest.raises(SimulationError, match=told) as error:
        simulation_of(f"ardupilot:{tmp_path / 'x.json'}")
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 600


def test_a_file_that_is_too_long_is_refused(tmp_path: Path) -> None:
    (tmp_path / "x.json").write_bytes(b"{" + b" " * (2**20 + 1) + b"}")
    with pytest.raises(SimulationError, match="at most"):
        simulation_of(f"ardupilot:{tmp_path / 'x.json'}")
    (tmp_path / "model.sdf").write_bytes(b"<sdf>" + b" " * (2**22) + b"</sdf>")
    with pytest.raises(SimulationError, match="at most"):
        simulation_of(f"gazebo:{tmp_path}")


BOMB = (
    '<!DOCTYPE s [<!ENTITY a "'
    + "x" * 1000
    + '">'
    + "".join(f'<!ENTITY a{i} "{"&a" + (str(i - 1) if i else "") + ";"}">' for i in range(9))
    + "]>"
)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (BOMB + "<sdf>&a8;</sdf>", "document type"), ('<!DOCTYPE s SYSTEM "file:///etc/passwd"><sdf/>', "document type"),
        ("<a>" * 100 + "</a>" * 100, "levels"), ("<a>" + "<b/>" * 60_000 + "</a>", "elements"), ("<sdf><model></sdf>", "no XML"),
        ("<sdf/>", "0 plugins"), ("\x00", "no XML"), ("", "no XML"),
    ],
)  # fmt: skip
def test_a_strangers_xml_is_bounded(text: str, told: str, tmp_path: Path) -> None:
    (tmp_path / "model.sdf").write_text(text)
    with pytest.raises(SimulationError, match=told):
        simulation_of(f"gazebo:{tmp_path / 'model.sdf'}")


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"count": 2}, "crashes"), ({"direction": "left"}, "not a number"), ({"axis": "0 0 0"}, "no direction"),
        ({"axis": "0 1"}, "3 numbers"),
        ({"Cem": "1e400"}, "not a number"), ({"axis": "1 0 0"}, "none is known"),
    ],
)  # fmt: skip
def test_a_model_that_gazebo_would_not_fly_is_refused(change: dict[str, object], told: str, tmp_path: Path) -> None:
    with pytest.raises(SimulationError, match=told):
        simulation_of(f"gazebo:{sdf(tmp_path, **change)}")


def test_which_way_a_surface_goes_is_told_by_its_hinge(tmp_path: Path) -> None:
    """+ delta_e edge down, + delta_r edge to port, + delta_a right edge down: by hand from the joint's angle."""
    values = {n: np.array([1e-9]) for n in VARIABLES} | {n: np.array([0.1]) for n in SURFACES}
    x = States({**values, "V": np.array([20.0])}, np.array([1.2]), np.zeros(1))
    degrees = np.degrees(0.1)
    for axis, direction, sign in (("0 1 0", 1, -1), ("0 -1 0", 1, 1), ("0 1 0", -1, 1)):
        with_it, without = (asked(sdf(tmp_path, axis=axis, direction=direction, Cem=c), x) for c in (0.02, 0.0))
        assert (with_it - without)[0, 4] == pytest.approx(0.02 * sign * degrees)
    with_it, without = (asked(sdf(tmp_path, axis="0 0 1", CY=c), x) for c in (0.02, 0.0))
    assert (with_it - without)[0, 1] == pytest.approx(-0.02 * degrees)
    alone = States({**x.values, "delta_e": np.zeros(1)}, x.rho, x.alpha_dot)
    for y, sign in ((-0.5, -1), (0.5, 1)):
        with_it, without = (asked(sdf(tmp_path, y=y, Cell=c), alone) for c in (0.02, 0.0))
        assert (with_it - without)[0, 3] == pytest.approx(0.02 * sign * degrees)


def test_where_the_coefficients_act_is_taken_from_the_centre_of_gravity(tmp_path: Path) -> None:
    """cp 0.12 m behind the link's origin and the centre of gravity 0.05 m ahead of it: lift pitches by 0.17 m of arm."""
    simulation = simulation_of(f"gazebo:{sdf(tmp_path)}")
    x = states(4)
    still = States({**x.values, **{n: np.zeros(4) for n in ("p", "q", "r", "beta")}}, x.rho, x.alpha_dot)
    c = simulation.oracle.coefficients(still)
    np.testing.assert_allclose(c[:, 4], 0.17 * c[:, 2] / 0.22, rtol=1e-6)
    assert simulation.aircraft is not None
    assert simulation.aircraft.mass == pytest.approx(1.0, rel=1e-6)


def test_a_coefficient_that_was_changed_is_named(tmp_path: Path) -> None:
    """SITL believes the roll damping of a file, the flights have 1.35 times that."""
    derivatives = "".join(f"{n} = {v}\n" for n, v in truth.TRUE_DERIVATIVES.items())
    inertia = "".join(f"{n} = {v}\n" for n, v in truth.INERTIA.items())
    geometry = f"span = {truth.SPAN}\narea = {truth.AREA}\nchord = {truth.CHORD}\n"
    (tmp_path / "own.toml").write_text(
        f'name = "own"\n[geometry]\n{geometry}[mass]\nmass = {truth.MASS}\n{inertia}'
        f"[throws]\ndelta_e = 0.4\ndelta_a = 0.3\ndelta_r = 0.5\n[derivatives]\n{derivatives}"
    )
    assert export(tmp_path / "own.toml", "--to", "ardupilot", "-o", tmp_path / "own.json").return_value == 0
    changed = {"Cl_p": 1.35 * truth.TRUE_DERIVATIVES["Cl_p"]}
    paths = []
    for i, columns in enumerate(
        truth.fly([truth.Request(60 + i, 15.0 + 1.5 * i, derivatives=changed, duration=20.0) for i in range(3)])
    ):
        write_flight(Flight.build(f"f{i}", columns.pop("time"), columns), tmp_path / f"f{i}.csv")
        paths.append(str(tmp_path / f"f{i}.csv"))
    words = ["gap", *paths[:2], "--holdout", paths[2], "--simulation", f"ardupilot:{tmp_path / 'own.json'}", "--nulls", "20",
             "--json", str(tmp_path / "gap.json")]  # fmt: skip
    done = CliRunner().invoke(cli, words, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    answer = json.loads((tmp_path / "gap.json").read_text())
    assert answer["steps"][0]["effect"] == "Cl_p"
    assert answer["steps"][0]["parameters"]["Cl_p"]["estimate"] == pytest.approx(changed["Cl_p"], rel=0.05)


def slope(simulation: Simulation, row: int, name: str, step: float) -> float:
    """Of a coefficient with one variable, at 20 m/s and hardly any lift."""
    values = {n: np.full(2, 1e-6) for n in VARIABLES} | {"V": np.full(2, 20.0)}
    values[name] = np.array([1e-6, step])
    c = simulation.oracle.coefficients(States(values, np.full(2, 1.2), np.zeros(2)))
    return float(c[1, row] - c[0, row]) / step


def test_sitls_own_aircraft_has_the_slopes_that_its_own_code_gave(tmp_path: Path) -> None:
    """Measured with SITL's compiled code about the centre of gravity: Cm_alpha -5.2, Cl_beta -0.146, Cn_beta +0.328."""
    (tmp_path / "own.json").write_text('{"s": 0.45}')
    simulation = simulation_of(f"ardupilot:{tmp_path / 'own.json'}")
    assert slope(simulation, 4, "alpha", 0.02) == pytest.approx(-5.2, abs=0.1)
    assert slope(simulation, 3, "beta", 0.02) == pytest.approx(-0.146, abs=0.002)
    assert slope(simulation, 5, "beta", 0.02) == pytest.approx(0.328, abs=0.002)


def test_px4s_own_aeroplane_has_the_slopes_that_gazebos_own_code_gave(tmp_path: Path) -> None:
    """advanced_plane, measured with the compiled plugin: Cm_alpha -2.7, with pull 3817 -3.2; before it Cm_q -19.4 where the file
    says -12.1, CL_q 13.4 for 8.0, because the angle of attack is that at cp."""
    text = ADVANCED.format(y=0.0, axis="0 1 0", count=1, direction=-1, CY=0, Cell=0, Cem=-0.025798)
    text = text.replace("<pose>0.05 0 0 0 0 0</pose>", "").replace("<CL0>0.15</CL0><CLa>5.0</CLa>", "<CLa>5.015</CLa>")
    text = text.replace("<CYb>", "<Cema>{}</Cema><Cemq>-12.14014</Cemq><CLq>7.971792</CLq><CYb>")
    made = []
    for place, slope_of_file in (("before", 0.0), ("with", -0.463966)):
        (tmp_path / place).mkdir()
        (tmp_path / place / "model.sdf").write_text(text.format(slope_of_file))
        made.append(simulation_of(f"gazebo:{tmp_path / place}"))
    before, since = made
    per_hat = 2.0 * 20.0 / 0.22
    assert slope(before, 4, "alpha", 0.01) == pytest.approx(-2.7, abs=0.1)
    assert slope(since, 4, "alpha", 0.01) == pytest.approx(-3.2, abs=0.1)
    assert slope(before, 4, "q", 0.01) * per_hat == pytest.approx(-19.4, abs=0.1)
    assert -slope(before, 2, "q", 0.01) * per_hat == pytest.approx(13.4, abs=0.1)
    assert slope(before, 4, "delta_e", 0.01) < 0.0
