"""A JSBSim aircraft as coefficients: against what JSBSim itself has while it flies."""

import re
import socket
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("jsbsim", reason="the package jsbsim is not installed")

from estimation.simulation.attach import simulation_of
from estimation.simulation.jsbsim.library import loaded
from estimation.simulation.oracle import COEFFICIENTS, VARIABLES, Simulation, SimulationError, States
from tests.studies import jsbsim_flights as truth

FOOT, POUND = 0.3048, 4.4482216152605


def still(count: int = 1, **changes: float) -> States:
    """States of level flight at 50 m/s, near sea level, with `changes`."""
    values = {n: np.full(count, changes.get(n, 50.0 if n == "V" else 0.0)) for n in VARIABLES}
    return States(values, np.full(count, 1.1), np.full(count, changes.get("alpha_dot", 0.0)))


@pytest.fixture(scope="module")
def cessna() -> Simulation:
    return simulation_of("jsbsim:c172p")


def test_coefficients_are_those_that_jsbsim_flies_with(cessna: Simulation) -> None:
    """Two seconds of tumbling flight by JSBSim's own steps, engine still: state, alphadot, forces and moments read from it."""
    fdm = truth._executive(truth.OWN / "c172p" / "c172p.xml")
    fdm["ic/vt-fps"], fdm["ic/alpha-rad"], fdm["ic/beta-rad"], fdm["ic/phi-rad"] = 160.0, 0.06, 0.05, 0.3
    fdm.run_ic()
    rows, wanted = [], []
    for k in range(400):
        surfaces = 0.05 * np.sin(k / 40), 0.1 * np.sin(k / 30), 0.08 * np.cos(k / 50)
        truth._surfaces(fdm, *surfaces)
        fdm.run()
        if k % 40 == 39:
            rows.append([fdm["velocities/vt-fps"] * FOOT, fdm["aero/alpha-rad"], fdm["aero/beta-rad"],
                         *(fdm[f"velocities/{n}-aero-rad_sec"] for n in "pqr"), *surfaces, 0.0,
                         fdm["atmosphere/rho-slugs_ft3"] * 515.378818, fdm["aero/alphadot-rad_sec"]])  # fmt: skip
            force = [fdm[f"forces/fb{n}-aero-lbs"] for n in "xyz"] + [fdm[f"moments/{n}-aero-lbsft"] for n in "lmn"]
            lengths = np.array([1, 1, 1, fdm["metrics/bw-ft"], fdm["metrics/cbarw-ft"], fdm["metrics/bw-ft"]])
            wanted.append(np.array(force) / fdm["aero/qbar-psf"] / fdm["metrics/Sw-sqft"] / lengths)
    table = np.array(rows)
    states = States(dict(zip(VARIABLES, table.T[:10], strict=True)), table[:, 10], table[:, 11])
    assert np.ptp(table[:, 2]) > 0.05
    assert np.abs(table[:, 11]).max() > 0.05  # where alphadot matters
    # the lateral sideslip of the propeller's wash is nothing: no engine runs. JSBSim reads slopes of its last step: 1e-5
    np.testing.assert_allclose(cessna.oracle.coefficients(states), np.array(wanted), atol=2e-5)


def test_the_answer_does_not_depend_on_what_was_asked_before(cessna: Simulation) -> None:
    first = cessna.oracle.coefficients(still(alpha=0.05, q=0.1))
    cessna.oracle.coefficients(still(alpha=-0.1, q=-0.3, beta=0.2, V=80.0, delta_e=0.2))
    np.testing.assert_allclose(cessna.oracle.coefficients(still(alpha=0.05, q=0.1)), first, atol=1e-10)


def test_a_rate_of_alpha_acts_as_the_file_says(cessna: Simulation) -> None:
    """c172p: Cm_alphadot = -7.27 per alphadot c/2V. About the CG a lift of CL_alphadot = 1.7 at its arm adds to it."""
    change = cessna.oracle.coefficients(still(alpha_dot=0.2)) - cessna.oracle.coefficients(still())
    assert cessna.aircraft is not None
    per = 0.2 * cessna.aircraft.chord / 100.0
    lift, moment = -change[0, 2] / per, change[0, COEFFICIENTS.index("Cm")] / per
    arm = (43.2 - 42.117) * 0.0254 / cessna.aircraft.chord  # AERORP behind the CG as loaded [chords]
    assert lift == pytest.approx(1.7, rel=1e-3)
    assert moment == pytest.approx(-7.27 - arm * lift, rel=1e-2)


def test_surfaces_have_the_signs_of_the_flight_columns(cessna: Simulation) -> None:
    none = cessna.oracle.coefficients(still())[0]
    roll = (cessna.oracle.coefficients(still(delta_a=0.1))[0] - none)[COEFFICIENTS.index("Cl")]
    pitch = (cessna.oracle.coefficients(still(delta_e=0.1))[0] - none)[COEFFICIENTS.index("Cm")]
    yaw = (cessna.oracle.coefficients(still(delta_r=0.1))[0] - none)[
        [COEFFICIENTS.index("CY"), COEFFICIENTS.index("Cn")]
    ]
    assert roll == pytest.approx(-0.0229, rel=1e-3)  # Clda 0.229 per left aileron
    assert pitch < -0.1  # nose down
    assert yaw[0] > 0.0 > yaw[1]  # force to +y, nose left


def test_mass_and_inertia_turn_moments_into_the_rates_that_jsbsim_has(cessna: Simulation) -> None:
    """Angular acceleration from rest, by our equation with our Ixz, against JSBSim's."""
    craft = cessna.aircraft
    assert craft is not None
    fdm = truth._executive(truth.OWN / "c172p" / "c172p.xml")
    fdm["ic/vt-fps"] = 160.0
    rows = []
    for aileron, rudder in ((0.0, 0.0), (0.1, 0.1)):  # the difference has no pitching moment
        truth._surfaces(fdm, 0.0, aileron, rudder)
        for _ in range(3):
            fdm.run_ic()
        rows.append(
            [
                *(fdm[f"moments/{n}-total-lbsft"] * POUND * FOOT for n in "ln"),
                *(fdm[f"accelerations/{n}dot-rad_sec2"] for n in "pr"),
            ]
        )
    roll, yaw, p_dot, r_dot = np.diff(rows, axis=0)[0]
    inertia = craft.Ixx * craft.Izz - craft.Ixz**2
    # products of inertia with y, which our equations do not have, are 0.3 % of these
    assert (craft.Izz * roll + craft.Ixz * yaw) / inertia == pytest.approx(p_dot, rel=1e-3)
    assert (craft.Ixx * yaw + craft.Ixz * roll) / inertia == pytest.approx(r_dot, rel=1e-3)
    assert craft.mass == pytest.approx(fdm["inertia/weight-lbs"] * 0.45359237, rel=1e-3)


def test_what_is_held_or_unread_is_told(cessna: Simulation) -> None:
    assert "fcs/flap-pos-deg" in " ".join(cessna.notes)
    assert "delta_a" in " ".join(simulation_of("jsbsim:c172x").notes)  # its ailerons go by a name of its own


def test_no_aircraft_writes_its_files_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    simulation_of("jsbsim:B17").oracle.coefficients(still())
    assert not list(tmp_path.iterdir())


def test_no_aircraft_opens_a_port(tmp_path: Path) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    copied = truth.changed(
        tmp_path, "c172p", lambda text: text.replace("</fdm_config>", f'<input port="{port}"/></fdm_config>')
    )
    kept = loaded(copied)
    with socket.socket() as client:
        assert client.connect_ex(("127.0.0.1", port)) != 0
    assert kept is not None


def test_a_normalised_position_follows_the_scale_of_the_file(tmp_path: Path) -> None:
    def scaled(text: str) -> str:
        return text.replace(
            "<property>fcs/rudder-pos-rad</property>", "<property>fcs/rudder-pos-norm</property>"
        ).replace(
            "</flight_control>",
            '<channel name="n"><aerosurface_scale name="s"><input>fcs/rudder-pos-rad</input><domain><min>-0.2</min>'
            "<max>0.4</max></domain><range><min>-1</min><max>1</max></range><output>fcs/rudder-pos-norm</output>"
            "</aerosurface_scale></channel></flight_control>",
        )

    by_norm = simulation_of(f"jsbsim:{truth.changed(tmp_path, 'c172p', scaled).parent}")
    plain = simulation_of("jsbsim:c172p")
    none = plain.oracle.coefficients(still())
    for angle, share in ((0.1, 0.25), (-0.1, -0.5)):
        per_rad = (plain.oracle.coefficients(still(delta_r=angle)) - none)[0, 5] / angle
        per_norm = (by_norm.oracle.coefficients(still(delta_r=angle)) - none)[0, 5] / share
        assert per_norm == pytest.approx(per_rad, rel=1e-6)


@pytest.mark.parametrize(
    ("spec", "told"),
    [
        ("jsbsim:c127p", "neither an aircraft of JSBSim"),
        ("jsbsim:blank", "no section <aerodynamics>"),
        ("jsbsim:f104", "module:function"),
        ("jsbsim:", "neither"),
        ("c172p", "jsbsim:AIRCRAFT"),
    ],
)
def test_what_cannot_be_asked_is_refused_in_one_sentence(spec: str, told: str) -> None:
    with pytest.raises(SimulationError, match=told) as error:
        simulation_of(spec)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "state", [{"beta": 4.0}, {"alpha": -1.6}, {"V": 0.0}, {"V": -5.0}, {"V": np.inf}, {"p": np.nan}]
)
def test_a_state_that_is_none_is_refused_and_leaves_nothing_behind(cessna: Simulation, state: dict[str, float]) -> None:
    before = cessna.oracle.coefficients(still())
    with pytest.raises(SimulationError, match="radians"):
        cessna.oracle.coefficients(still(**state))
    np.testing.assert_allclose(cessna.oracle.coefficients(still()), before, atol=1e-9)


IMPOSSIBLE = [
    ("wingarea", "-174", "area"),
    ("wingarea", "0", "area"),
    ("wingarea", "1e300", "area"),
    ("wingspan", "-36", "span"),
    ("chord", "0", "chord"),
    ("emptywt", "-90000", "mass"),
    ("ixx", "-94800", "Ixx"),
    ("iyy", "1e300", "Iyy"),
    ("ixz", "1e7", "Ixz"),
    ("wingarea", "nan", "cannot load"),
    ("izz", "inf", "cannot load"),
]


@pytest.mark.parametrize(("tag", "number", "named"), IMPOSSIBLE)
def test_numbers_that_no_aircraft_has_are_one_sentence(tmp_path: Path, tag: str, number: str, named: str) -> None:
    text = (truth.OWN / "c172p" / "c172p.xml").read_text()
    spoilt, count = re.subn(rf"(<{tag}\s[^>]*>)[^<]*(</{tag}>)", rf"\g<1>{number}\g<2>", text, count=1)
    if not count:
        assert tag == "ixz"  # the file leaves it out
        spoilt = text.replace("</izz>", f"</izz><ixz unit='SLUG*FT2'>{number}</ixz>", 1)
    folder = tmp_path / "aircraft" / "odd"
    folder.mkdir(parents=True)
    (folder / "odd.xml").write_text(spoilt)
    with pytest.raises(SimulationError, match=named) as refused:
        simulation_of(f"jsbsim:{folder / 'odd.xml'}")
    assert "\n" not in str(refused.value)
