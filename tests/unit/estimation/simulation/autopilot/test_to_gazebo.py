"""Exports to Gazebo, by the equations of AdvancedLiftDrag restated here from its source with nothing of the program."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from lxml import etree

from tests.unit.estimation.simulation.autopilot.aircraft import Array, RandomAircraft, flown, textbook
from tests.unit.estimation.simulation.autopilot.test_to_ardupilot import export

SCHEMA = etree.XMLSchema(etree.parse(str(Path(__file__).with_name("model.xsd"))))
RHO = 1.225


def plugin_of(path: Path) -> tuple[dict[str, float], list[dict[str, float | str]]]:
    """Keys and control surfaces, as Gazebo reads them."""
    plugin = etree.parse(str(path)).find(".//plugin[@name='gz::sim::systems::AdvancedLiftDrag']")
    keys = {
        e.tag: float(e.text)
        for e in plugin
        if len(e) == 0 and len((e.text or "").split()) == 1 and e.tag != "link_name"
    }
    assert plugin.findtext("cp").split() == ["0", "0", "0"]
    surfaces = [
        {e.tag: e.text if e.tag == "name" else float(e.text) for e in s} for s in plugin.findall("control_surface")
    ]
    assert keys["num_ctrl_surfaces"] == len(surfaces)
    return keys, surfaces


def lift_drag(k: dict[str, float], surfaces: list, joints: dict[str, Array], x: dict[str, Array]) -> dict[str, Array]:
    """Force and moment by the plugin with pull 3817, axes turned to forward, right, down."""
    V = np.hypot(x["u"], x["w"])
    alpha, beta = np.arctan2(x["w"], x["u"]), np.arctan2(x["v"], x["u"])
    b, M, a0 = np.sqrt(k["area"] * k["AR"]), 15.0, k["alpha_stall"]
    ph, qh, rh = x["p"] * b / 2 / V, x["q"] * k["mac"] / 2 / V, x["r"] * b / 2 / V
    sg = (1 + np.exp(-M * (alpha - a0)) + np.exp(M * (alpha + a0))) / (
        (1 + np.exp(-M * (alpha - a0))) * (1 + np.exp(M * (alpha + a0)))
    )

    def control(c: str) -> Array:
        return sum(s[f"{c}_ctrl"] * s["direction"] * np.degrees(joints[s["name"]]) for s in surfaces)

    def rates(c: str) -> Array:
        return k[f"{c}p"] * ph + k[f"{c}q"] * qh + k[f"{c}r"] * rh

    base = (1 - sg) * (k["CL0"] + k["CLa"] * alpha) + sg * 2 * np.sign(alpha) * np.sin(alpha) ** 2 * np.cos(alpha)
    base = base + k["CLb"] * beta + control("CL")
    fp = 2 / (1 + np.exp(-0.224 - 0.115 * max(k["AR"], 1 / k["AR"])))
    CD = (1 - sg) * (k["CD0"] + base**2 / (np.pi * k["AR"] * k["eff"])) + sg * abs(fp * (1 - np.cos(2 * alpha)) / 2)
    CD = CD + control("CD") + rates("CD")
    CL = base + rates("CL")
    CY, Cl, Cn, Cm = (
        k[f"{c}a"] * alpha + k[f"{c}b"] * beta + control(c) + rates(c) for c in ("CY", "Cell", "Cen", "Cem")
    )
    Cm = Cm + k["Cem0"]
    f = 0.5 * k["air_density"] * V**2 * k["area"]
    return {"X": f * (CL * np.sin(alpha) - CD * np.cos(alpha)), "Y": f * CY, "Z": -f * (CL * np.cos(alpha) + CD * np.sin(alpha)),
            "L": f * b * Cl, "M": f * k["mac"] * Cm, "N": f * b * Cn}  # fmt: skip


def inertia_of(path: Path) -> tuple[float, Array, Array]:
    """Mass, centre and inertia of all links, forward, left, up."""
    parts = []
    for link in etree.parse(str(path)).iter("link"):
        pose = [float(v) for v in (link.findtext("pose") or "0 0 0 0 0 0").split()]
        c, s = np.cos(pose[4]), np.sin(pose[4])
        R = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
        assert pose[3] == pose[5] == 0.0
        inside = [float(v) for v in link.findtext("inertial/pose").split()[:3]]
        i = {n: float(link.findtext(f"inertial/inertia/{n}")) for n in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")}
        own = np.array([[i["ixx"], i["ixy"], i["ixz"]], [i["ixy"], i["iyy"], i["iyz"]], [i["ixz"], i["iyz"], i["izz"]]])
        parts.append((float(link.findtext("inertial/mass")), np.array(pose[:3]) + R @ inside, R @ own @ R.T))
    m = sum(p[0] for p in parts)
    centre = sum(p[0] * p[1] for p in parts) / m
    total = sum(
        own + mass * ((r - centre) @ (r - centre) * np.eye(3) - np.outer(r - centre, r - centre))
        for mass, r, own in parts
    )
    return m, centre, total


@pytest.mark.parametrize("seed", range(20))
def test_an_aircraft_has_the_forces_of_the_textbook_in_gazebo(seed: int, tmp_path: Path) -> None:
    craft = RandomAircraft(seed, without=("CY_0", "Cl_0", "Cn_0"))
    done = export(craft.write(tmp_path), "--to", "gazebo", "-o", tmp_path / "out", "--json", tmp_path / "p.json")
    assert done.return_value == 0, done.output
    sdf = tmp_path / "out" / "model.sdf"
    SCHEMA.assertValid(etree.parse(str(sdf)))
    keys, surfaces = plugin_of(sdf)
    x = flown(seed, craft)
    joints = {
        "servo_0": x["da"],
        "servo_1": -x["da"],
        "servo_2": -x["de"],
        "servo_3": -x["dr"],
    }  # + edge up, to starboard
    lift = craft["CL_0"] + craft["CL_alpha"] * np.arctan2(x["w"], x["u"]) + craft["CL_de"] * x["de"]
    want = textbook(craft, x, np.hypot(x["u"], x["w"]), RHO, lift)
    got = lift_drag(keys, surfaces, joints, x)
    for axis in "XYZLMN":
        assert np.max(np.abs(got[axis] - want[axis])) < 1e-9 * np.max(np.abs(want[axis])), axis
    m, centre, total = inertia_of(sdf)
    assert m == pytest.approx(craft.m, rel=1e-12)
    assert np.max(np.abs(centre)) < 1e-12
    wanted = np.array([[craft.Ixx, 0, craft.Ixz], [0, craft.Iyy, 0], [craft.Ixz, 0, craft.Izz]])
    np.testing.assert_allclose(total, wanted, atol=1e-12 * craft.Izz)
    proof = json.loads((tmp_path / "p.json").read_text())["proof"]
    assert max(proof["deviation"].values()) < 1e-9
    assert set(proof["deviation"]) == {*"XYZLMN", "mass", "inertia"}


@pytest.fixture
def craft() -> RandomAircraft:
    return RandomAircraft(202)


@pytest.fixture
def folder(craft: RandomAircraft, tmp_path: Path) -> Path:
    assert export(craft.write(tmp_path), "--to", "gazebo", "-o", tmp_path / "plane").return_value == 0
    return tmp_path / "plane"


@pytest.mark.parametrize("key", ["Cenr", "Cellb", "Cemq", "CLq", "CYp", "Cema", "Cem0", "CLa", "ixz"])
def test_a_wrong_sign_is_found(key: str, folder: Path, tmp_path: Path) -> None:
    sdf = folder / "model.sdf"
    text = sdf.read_text()
    value = re.search(f"<{key}>(.*?)</{key}>", text)[1]
    sdf.write_text(text.replace(f"<{key}>{value}<", f"<{key}>{-float(value)!r}<", 1))
    done = export(tmp_path / "random.toml", "--to", "gazebo", "-o", folder, "--prove")
    assert done.return_value == 1
    assert "proof failed" in done.output
    assert "px4_sitl" not in done.output


def test_a_surface_turned_over_is_found(folder: Path, tmp_path: Path) -> None:
    sdf = folder / "model.sdf"
    text = sdf.read_text()
    place = text.index("<name>servo_2</name>")
    sdf.write_text(text[:place] + text[place:].replace("<direction>1<", "<direction>-1<", 1))
    assert export(tmp_path / "random.toml", "--to", "gazebo", "-o", folder, "--prove").return_value == 1


def test_what_px4_is_told(folder: Path, craft: RandomAircraft, tmp_path: Path) -> None:
    told = (folder / "22500_gz_plane").read_text()
    for i, name in enumerate(("delta_a", "delta_a", "delta_e", "delta_r"), 1):
        assert f"SIM_GZ_SV_MAXA{i} {np.degrees(craft.throws[name]):.6g}\n" in told
        assert f"SIM_GZ_SV_MINA{i} {-np.degrees(craft.throws[name]):.6g}\n" in told
    motor = etree.parse(str(folder / "model.sdf"))
    constant = float(motor.findtext(".//motorConstant"))
    assert constant * 1600.0**2 == pytest.approx(craft.thrust)
    assert "model.sdf" in (folder / "model.config").read_text()
    done = export(tmp_path / "random.toml", "--to", "gazebo", "-o", folder, "--force")
    assert "3817" in done.output
    assert "gz_plane" in done.output


def test_a_stall_that_is_near_is_told_apart(folder: Path, tmp_path: Path) -> None:
    done = export(tmp_path / "random.toml", "--to", "gazebo", "-o", folder, "--force", "--alpha-stall", "0.34",
                  "--json", tmp_path / "p.json")  # fmt: skip
    assert done.return_value == 0, done.output
    left = dict(json.loads((tmp_path / "p.json").read_text())["proof"]["left_out"])
    assert left["blend into the stall"] > 0.01


def test_constants_that_the_plugin_lacks_are_named(craft: RandomAircraft, tmp_path: Path) -> None:
    done = export(craft.write(tmp_path), "--to", "gazebo", "-o", tmp_path / "other", "--json", tmp_path / "p.json")
    assert done.return_value == 0
    left = dict(json.loads((tmp_path / "p.json").read_text())["proof"]["left_out"])
    assert left["Cl_0"] == pytest.approx(craft["Cl_0"])
    assert {"CY_0", "Cn_0"} < set(left)


def test_thrust_that_nobody_states_is_asked_for(craft: RandomAircraft, tmp_path: Path) -> None:
    path = craft.write(tmp_path)
    path.write_text(path.read_text().replace("[engine]", "").replace("static_thrust", "# ").replace("thrust_fall", "#")
                    .replace("lag = 0.1", ""))  # fmt: skip
    done = export(path, "--to", "gazebo", "-o", tmp_path / "g")
    assert "static thrust" in str(done.exception)
    assert not (tmp_path / "g").exists()
    assert export(path, "--to", "gazebo", "-o", tmp_path / "g", "--thrust", "0").return_value == 0
    assert "MulticopterMotorModel" not in (tmp_path / "g" / "model.sdf").read_text()


@pytest.mark.parametrize("name", ["a-b", "a b", "ä"])
def test_a_name_that_px4_cannot_call_is_refused(name: str, craft: RandomAircraft, tmp_path: Path) -> None:
    done = export(craft.write(tmp_path), "--to", "gazebo", "-o", tmp_path / name)
    assert "letters, digits" in str(done.exception)
