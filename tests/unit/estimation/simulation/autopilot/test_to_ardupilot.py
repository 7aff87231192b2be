"""Exports to ArduPilot's SITL, by its equations restated here from its source with nothing of the program."""

import json
import re
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from click.testing import CliRunner, Result

from sideslip.cli import cli
from tests.unit.estimation.simulation.autopilot.aircraft import Array, RandomAircraft, flown, textbook

NUMBERS = (
    "s b c c_lift_0 c_lift_deltae c_lift_a c_lift_q mcoeff oswald alpha_stall c_drag_q c_drag_deltae c_drag_p c_y_0 c_y_b c_y_p"
    " c_y_r c_y_deltaa c_y_deltar c_l_0 c_l_p c_l_b c_l_r c_l_deltaa c_l_deltar c_m_0 c_m_a c_m_q c_m_deltae c_n_0 c_n_b"
    " c_n_p c_n_r c_n_deltaa c_n_deltar deltaa_max deltae_max deltar_max"
).split()
SCHEMA = {
    "type": "object", "additionalProperties": False, "required": [*NUMBERS, "CGOffset"],
    "properties": {
        **{n: {"type": "number"} for n in NUMBERS},
        "CGOffset": {"type": "array", "items": {"type": "number"}, "minItems": 3, "maxItems": 3},
    },
}  # fmt: skip


def export(*words: object) -> Result:
    return CliRunner().invoke(cli, ["export", *map(str, words)], standalone_mode=False)


def as_sitl_loads(path: Path) -> dict[str, float]:
    """As AP_JSON does: from the first brace to the last, # a comment to the end of its line."""
    text = path.read_text(encoding="utf-8")
    body = text[text.index("{") : text.rindex("}") + 1]
    return json.loads(re.sub("#[^\n]*", "", body))


def sitl(k: dict[str, float], x: dict[str, Array], throws: dict[str, float]) -> dict[str, Array]:
    """Accelerations by SIM_Plane: of 2 kg and 1 kg m2; inputs +1 right, nose up, nose right."""
    V = np.sqrt(x["u"] ** 2 + x["v"] ** 2 + x["w"] ** 2)
    alpha, beta = np.arctan2(x["w"], x["u"]), np.arctan2(x["v"], x["u"])
    a, e, r = -x["da"] / throws["delta_a"], -x["de"] / throws["delta_e"], -x["dr"] / throws["delta_r"]
    M, a0 = k["mcoeff"], k["alpha_stall"]
    held = np.clip(alpha, a0 - 0.8, a0 + 0.8)
    sg = (1 + np.exp(-M * (held - a0)) + np.exp(M * (held + a0))) / (
        (1 + np.exp(-M * (held - a0))) * (1 + np.exp(M * (held + a0)))
    )
    CL = (1 - sg) * (k["c_lift_0"] + k["c_lift_a"] * held) + sg * 2 * np.sign(held) * np.sin(held) ** 2 * np.cos(held)
    CD = k["c_drag_p"] + (k["c_lift_0"] + k["c_lift_a"] * alpha) ** 2 / (np.pi * k["oswald"] * k["b"] ** 2 / k["s"])
    ph, qh, rh = x["p"] * k["b"] / 2 / V, x["q"] * k["c"] / 2 / V, x["r"] * k["b"] / 2 / V
    ca, sa = np.cos(alpha), np.sin(alpha)
    f = 0.5 * 1.225 * V**2 * k["s"]
    X = f * (-CD * ca + CL * sa + (-k["c_drag_q"] * ca + k["c_lift_q"] * sa) * qh - k["c_drag_deltae"] * ca * abs(e)
             + k["c_lift_deltae"] * sa * e)  # fmt: skip
    Z = f * (-CD * sa - CL * ca - (k["c_drag_q"] * sa + k["c_lift_q"] * ca) * qh - k["c_drag_deltae"] * sa * abs(e)
             - k["c_lift_deltae"] * ca * e)  # fmt: skip

    def across(c: str) -> Array:
        n = f"c_{c}_"
        return (
            k[n + "0"]
            + k[n + "b"] * beta
            + k[n + "p"] * ph
            + k[n + "r"] * rh
            + k[n + "deltaa"] * a
            + k[n + "deltar"] * r
        )

    pitch = k["c_m_0"] + k["c_m_a"] * alpha + k["c_m_q"] * qh + k["c_m_deltae"] * e
    return {"X": X / 2, "Y": f * across("y") / 2, "Z": Z / 2, "L": f * k["b"] * across("l"), "M": f * k["c"] * pitch,
            "N": f * k["b"] * across("n")}  # fmt: skip


def real(craft: RandomAircraft, x: dict[str, Array]) -> dict[str, Array]:
    """The textbook's accelerations without gyroscopic terms, induced drag by the angle of attack."""
    V = np.sqrt(x["u"] ** 2 + x["v"] ** 2 + x["w"] ** 2)
    lift = craft["CL_0"] + craft["CL_alpha"] * np.arctan2(x["w"], x["u"])
    f = textbook(craft, x, V, 1.225, lift)
    G = craft.Ixx * craft.Izz - craft.Ixz**2
    return {
        **{n: f[n] / craft.m for n in "XYZ"}, "L": (craft.Izz * f["L"] + craft.Ixz * f["N"]) / G, "M": f["M"] / craft.Iyy,
        "N": (craft.Ixx * f["N"] + craft.Ixz * f["L"]) / G,
    }  # fmt: skip


@pytest.mark.parametrize("seed", range(20))
def test_an_aircraft_flies_in_sitl_as_in_the_textbook(seed: int, tmp_path: Path) -> None:
    craft = RandomAircraft(seed)
    out = tmp_path / "out.json"
    done = export(craft.write(tmp_path), "--to", "ardupilot", "-o", out, "--json", tmp_path / "p.json")
    assert done.return_value == 0, done.output
    keys = as_sitl_loads(out)
    jsonschema.validate(keys, SCHEMA)
    x = flown(seed, craft)
    x |= {"de": x["de"]}
    got, want = sitl(keys, x, craft.throws), real(craft, x)
    for axis in "XYZLMN":
        assert np.max(np.abs(got[axis] - want[axis])) < 1e-6 * np.max(np.abs(want[axis])), axis
    proof = json.loads((tmp_path / "p.json").read_text())["proof"]
    assert proof["states"] == 200
    assert set(proof["deviation"]) == set("XYZLMN")
    assert max(proof["deviation"].values()) < 1e-6
    assert {n for n, _ in proof["left_out"]} >= {"induced drag of CL_q", "induced drag of CL_de", "gyroscopic terms"}


@pytest.fixture
def craft() -> RandomAircraft:
    return RandomAircraft(101)


@pytest.fixture
def written(craft: RandomAircraft, tmp_path: Path) -> Path:
    out = tmp_path / "plane.json"
    assert export(craft.write(tmp_path), "--to", "ardupilot", "-o", out).return_value == 0
    return out


@pytest.mark.parametrize(
    "key", ["c_n_r", "c_l_b", "c_m_q", "c_lift_q", "c_y_p", "c_m_deltae", "c_l_deltaa", "c_n_deltar", "c_y_0"]
)
def test_a_wrong_sign_is_found(key: str, written: Path, tmp_path: Path) -> None:
    text = written.read_text()
    value = as_sitl_loads(written)[key]
    written.write_text(text.replace(f'"{key}": {value!r}', f'"{key}": {-value!r}'))
    done = export(tmp_path / "random.toml", "--to", "ardupilot", "-o", written, "--prove")
    assert done.return_value == 1
    axis = {"y": "Y", "l": "L", "m": "M", "n": "N"}[key.split("_")[1][0]] if "lift" not in key else "Z"
    assert re.search(rf"proof failed: at 200 random states [XYZLMN, ]*{axis}", done.output)
    assert "sim_vehicle.py" not in done.output  # it must not be flown
    assert written.read_text() != text  # nothing was written over it


def test_comments_carry_the_real_aircraft_and_no_brace(craft: RandomAircraft, written: Path) -> None:
    above = written.read_text()[: written.read_text().index("\n{")]
    assert all(line.startswith("#") for line in above.splitlines())
    assert "{" not in above
    assert "}" not in written.read_text()[written.read_text().index("\n}") + 2 :]
    for text in (
        f"real mass = {craft.m!r} kg",
        f"real Ixz = {craft.Ixz!r}",
        f"real Cl_p = {craft['Cl_p']!r}",
        "left out: ",
    ):
        assert text in above or text == "left out: "


def test_what_sitl_cannot_say_is_named_with_its_size(craft: RandomAircraft, tmp_path: Path) -> None:
    path = craft.write(tmp_path, CL_da=0.21, Cm_beta=-0.07, CD_beta=0.01, Cn_beta3=0.4)
    done = export(path, "--to", "ardupilot", "-o", tmp_path / "x.json", "--json", tmp_path / "p.json")
    assert done.return_value == 0, done.output
    left = dict(json.loads((tmp_path / "p.json").read_text())["proof"]["left_out"])
    assert left["CL_da"] == pytest.approx(0.21)
    assert left["Cm_beta"] == pytest.approx(-0.07)
    assert left["Cn_beta3"] == pytest.approx(0.4)
    assert "# left out: CL_da (0.21)" in (tmp_path / "x.json").read_text()
    assert "CD_beta" in done.output


@pytest.mark.parametrize(
    "name", ["my-heavy.json", "x-icebird.json", "a-3d/plane.json", "plane.JSON", "plane.txt", "a b.json"]
)
def test_names_that_sitl_would_misread_are_refused(
    name: str, craft: RandomAircraft, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a-3d").mkdir()
    path = craft.write(tmp_path)
    for out in (Path(name), tmp_path / name):
        done = export(path, "--to", "ardupilot", "-o", out)
        assert done.exit_code != 0
        assert "SITL" in str(done.exception)
    assert not (tmp_path / name).exists()


def test_the_command_line_is_printed_as_sitl_takes_the_path(
    written: Path, tmp_path: Path, craft: RandomAircraft
) -> None:
    done = export(tmp_path / "random.toml", "--to", "ardupilot", "-o", written, "--force")
    assert f"cd {tmp_path} && sim_vehicle.py -v Plane --model plane:plane.json" in done.output
    assert f"{craft.thrust / 14.0 / craft.m:.3f} of its range" in done.output or "more than SITL has" in done.output


def test_a_file_that_exists_is_kept(written: Path, tmp_path: Path) -> None:
    before = written.read_bytes()
    done = export(tmp_path / "random.toml", "--to", "ardupilot", "-o", written)
    assert "--force" in str(done.exception)
    assert written.read_bytes() == before


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (("delta_e = ", "# "), "throws of delta_e"),
        (("mass = ", "# "), "mass.mass"),
        (("CD_k = ", "# "), "CD_k"),
        (("Iyy = ", "# "), "mass.Iyy"),
        (("delta_r = ", "delta_r = [-0.3, 0.4] # "), "delta_r goes from"),
    ],
)
def test_missing_parts_are_asked_for(change: tuple[str, str], told: str, craft: RandomAircraft, tmp_path: Path) -> None:
    path = craft.write(tmp_path)
    path.write_text(re.sub(f"^{change[0]}", change[1], path.read_text(), flags=re.M))
    done = export(path, "--to", "ardupilot", "-o", tmp_path / "x.json")
    assert done.exit_code != 0
    assert told in str(done.exception)
    assert not (tmp_path / "x.json").exists()
