"""Models as files for simulators: what is taken from where, what is refused, and the neutral form."""

import json
import runpy
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from estimation.aircraft import load_aircraft
from estimation.models import load_model, write_model
from estimation.models.base import Model
from estimation.simulation.own_simulations import text_simulation
from tests.support.paths import ROOT
from tests.unit.estimation.simulation.autopilot.aircraft import RandomAircraft
from tests.unit.estimation.simulation.autopilot.test_to_ardupilot import as_sitl_loads, export
from tests.unit.estimation.simulation.test_along_flight import states

EXAMPLES = ROOT / "docs" / "examples"
THROWS = ("--throw", "delta_e=25deg", "--throw", "delta_a=0.3", "--throw", "delta_r=0.4")


@pytest.fixture
def aircraft(tmp_path: Path) -> Path:
    return RandomAircraft(7).write(tmp_path)


def model_file(which: str, aircraft: Path, folder: Path, change: object = None) -> Path:
    model = load_model(which, load_aircraft(aircraft))
    if callable(change):
        model = change(model)
    write_model(model, folder / "model.toml")
    return folder / "model.toml"


def test_a_whole_model_is_what_its_aircraft_is(aircraft: Path, tmp_path: Path) -> None:
    path = model_file("six-dof", aircraft, tmp_path)
    for source, more in ((aircraft, ()), (path, ("--aircraft", aircraft))):
        out = tmp_path / f"{source.stem}.json"
        assert export(source, "--to", "ardupilot", "-o", out, *more).return_value == 0
    one, two = as_sitl_loads(tmp_path / "random.json"), as_sitl_loads(tmp_path / "model.json")
    for key, value in one.items():
        np.testing.assert_allclose(two[key], value, rtol=1e-9, atol=1e-12, err_msg=key)


def test_what_a_lateral_model_lacks_comes_from_the_aircraft_file_with_its_source(
    aircraft: Path, tmp_path: Path
) -> None:
    path = model_file("lateral", aircraft, tmp_path, lambda m: m.with_starts(Cl_p=-0.6))
    done = export(path, "--to", "ardupilot", "-o", tmp_path / "x.json", "--aircraft", aircraft)
    assert done.return_value == 0, done.output
    assert "CL_alpha" in done.output
    assert "engineering estimate" in done.output
    text = (tmp_path / "x.json").read_text()
    assert "# real Cl_p = -0.6 (model lateral)" in text
    assert "(engineering estimate)" in text


@pytest.mark.parametrize("target", ["ardupilot", "gazebo", "neutral"])
def test_a_lateral_model_alone_is_refused_with_the_list(target: str, aircraft: Path, tmp_path: Path) -> None:
    path = model_file("lateral", aircraft, tmp_path)
    done = export(path, "--to", target, "-o", tmp_path / ("x" if target == "gazebo" else "x.json"), *THROWS)
    for name in ("CL_alpha", "CD_0", "Cm_q", "Cm_de"):
        assert name in str(done.exception)
    assert "\n" not in str(done.exception)


@pytest.mark.parametrize("target", ["ardupilot", "gazebo", "neutral"])
def test_an_aircraft_beside_an_aircraft_file_is_refused(target: str, aircraft: Path, tmp_path: Path) -> None:
    out = tmp_path / ("x" if target == "gazebo" else "x.json")
    done = export(aircraft, "--to", target, "-o", out, "--aircraft", "cdfp", *THROWS)
    assert "leave --aircraft cdfp away" in str(done.exception)
    assert not out.exists()


@pytest.mark.parametrize(
    ("term", "line"),
    [("0.3*beta^3", "Cn"), ("0.1*alpha*delta_a", "Cl"), ("0.001*V", "CY"), ("0.2*alpha^4", "CD"),
     ("0.2*alpha^2", "Cm")],
)  # fmt: skip
def test_a_model_that_is_not_linear_is_refused(term: str, line: str, aircraft: Path, tmp_path: Path) -> None:
    path = model_file("six-dof", aircraft, tmp_path, lambda m: m.plus(terms={line: term}))
    for target, out in (("ardupilot", "x.json"), ("gazebo", "g")):
        done = export(path, "--to", target, "-o", tmp_path / out, "--aircraft", aircraft)
        assert f"{line} is not linear" in str(done.exception), done.output
        assert not (tmp_path / out).exists()


def test_a_model_with_other_names_is_refused(aircraft: Path, tmp_path: Path) -> None:
    def renamed(model: Model) -> Model:
        lines = [line.replace("Cl", "Croll").replace("Cn", "Cyaw").replace("CY", "Cside") for line in model.equations]
        names = [p.name.replace("Cl", "Croll").replace("Cn", "Cyaw").replace("CY", "Cside") for p in model.parameters]
        parameters = [replace(p, name=name) for p, name in zip(model.parameters, names, strict=True)]
        return replace(model, equations=tuple(lines), parameters=tuple(parameters))

    path = model_file("lateral", aircraft, tmp_path, renamed)
    for target in ("ardupilot", "neutral"):
        done = export(path, "--to", target, "-o", tmp_path / "x.json", "--aircraft", aircraft)
        assert "has none of the lines CL, CD, CY, Cl, Cm, Cn" in str(done.exception)


def test_what_is_in_no_coefficient_is_told(aircraft: Path, tmp_path: Path) -> None:
    path = model_file("six-dof", aircraft, tmp_path, lambda m: m.plus(terms={"p_dot": "0.5*q"}))
    done = export(
        path, "--to", "ardupilot", "-o", tmp_path / "x.json", "--aircraft", aircraft, "--json", tmp_path / "p.json"
    )
    left = dict(json.loads((tmp_path / "p.json").read_text())["proof"]["left_out"])
    assert done.return_value == 0
    assert 0.0 < left["p_dot beyond coefficients"] < 1.0


class TestNeutral:
    def test_a_reader_has_the_coefficients_of_the_text(self, aircraft: Path, tmp_path: Path) -> None:
        """Nonlinear as it may be, read by the example of the docs."""
        terms = {
            "Cn": "0.3*beta^3",
            "Cl": "where(alpha < 0.1, 0.2*abs(beta), max(0, alpha - 0.05))",
            "Cm": "-1e-3*(p - 2)*-q",
        }
        path = model_file("six-dof", aircraft, tmp_path, lambda m: m.plus(terms=terms))
        done = export(path, "--to", "neutral", "-o", tmp_path / "n.json", "--json", tmp_path / "p.json")
        assert done.return_value == 0, done.output
        assert max(json.loads((tmp_path / "p.json").read_text())["proof"]["deviation"].values()) < 1e-12
        reader = runpy.run_path(str(EXAMPLES / "read_neutral.py"))
        content = json.loads((tmp_path / "n.json").read_text())
        x = states()
        told = text_simulation(str(path)).oracle.coefficients(x)
        for i in range(len(x)):
            state = {n: float(v[i]) for n, v in x.values.items()} | {"rho": float(x.rho[i])}
            found = reader["coefficients"](content, **state)
            np.testing.assert_allclose([found[c] for c in ("CX", "CY", "CZ", "Cl", "Cm", "Cn")], told[i], rtol=1e-12)

    def test_an_aircraft_file_and_its_model_say_the_same(self, tmp_path: Path) -> None:
        """Every derivative that is stated counts, those beyond the built-in models' own text too; what has no place is told."""
        aircraft = RandomAircraft(8).write(tmp_path, CL_beta=0.12, Cn_beta3=0.4)
        assert export(aircraft, "--to", "neutral", "-o", tmp_path / "n.json").return_value == 0
        content = json.loads((tmp_path / "n.json").read_text())
        reader = runpy.run_path(str(EXAMPLES / "read_neutral.py"))["coefficients"]
        still = reader(content, V=20.0, rho=1.2)
        moved = reader(content, V=20.0, rho=1.2, delta_a=0.1, beta=0.2)
        wanted = RandomAircraft(8)["Cn_da"] * 0.1 + RandomAircraft(8)["Cn_beta"] * 0.2
        assert moved["Cn"] - still["Cn"] == pytest.approx(wanted)
        assert moved["CL"] - still["CL"] == pytest.approx(0.12 * 0.2)
        assert any("Cn_beta3" in note for note in content["notes"])

    def test_every_name_has_unit_or_meaning(self, aircraft: Path, tmp_path: Path) -> None:
        assert export(aircraft, "--to", "neutral", "-o", tmp_path / "n.json").return_value == 0
        content = json.loads((tmp_path / "n.json").read_text())
        assert all(v["unit"] and v["meaning"] for v in content["variables"])
        assert content["body"]["Ixz"]["unit"] == "kg m2"
        assert content["constants"]["Cl_p"] == {"value": RandomAircraft(7)["Cl_p"], "unit": "1/rad"}
        assert content["sources"]["Cl_p"] == "engineering estimate"
        assert content["throws"]["delta_e"][1] == RandomAircraft(7).throws["delta_e"]

    def test_an_fmu_steps_to_the_same(self, aircraft: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """With the four names that it takes of PythonFMU, which is no dependency."""
        assert export(aircraft, "--to", "neutral", "-o", tmp_path / "aircraft.json").return_value == 0
        for name in ("neutral_fmu.py", "read_neutral.py"):
            (tmp_path / name).write_text((EXAMPLES / name).read_text(encoding="utf-8"), encoding="utf-8")
        registered: list[tuple[str, str, str]] = []
        slave = type(
            "Fmi2Slave", (), {"__init__": lambda self: None, "register_variable": lambda self, v: registered.append(v)}
        )
        causality = SimpleNamespace(input="input", output="output")
        stand_in = ModuleType("pythonfmu")
        initial = SimpleNamespace(
            exact="exact"
        )  # without it FMPy asks for a list of unknowns that PythonFMU does not write

        def real(name: str, causality: str, initial: str = "") -> tuple[str, str, str]:
            return name, causality, initial

        vars(stand_in).update(Fmi2Causality=causality, Fmi2Initial=initial, Fmi2Slave=slave, Real=real)
        monkeypatch.setitem(sys.modules, "pythonfmu", stand_in)
        monkeypatch.setitem(sys.modules, "read_neutral", None)
        del sys.modules["read_neutral"]
        monkeypatch.syspath_prepend(str(tmp_path))
        unit = runpy.run_path(str(tmp_path / "neutral_fmu.py"))["Aerodynamics"]()
        unit.V, unit.alpha, unit.delta_a = 20.0, 0.05, 0.1
        assert unit.do_step(0.0, 0.1)
        content = json.loads((tmp_path / "aircraft.json").read_text())
        read = runpy.run_path(str(EXAMPLES / "read_neutral.py"))["coefficients"](
            content, V=20.0, alpha=0.05, delta_a=0.1, rho=1.0
        )
        assert {n: getattr(unit, n) for n in read} == read
        assert ("Cl", "output", "exact") in registered
        assert ("delta_a", "input", "") in registered

    def test_readers_are_short(self) -> None:
        for name, start in (("read_neutral.py", "TWO"), ("read_neutral.m", "m =")):
            lines = (EXAMPLES / name).read_text().split(start, 1)[1].splitlines()
            assert len([line for line in lines if line.strip()]) <= 26


@pytest.mark.parametrize(
    "word", ["delta_e", "delta_x=3", "delta_e=wide", "delta_e=1:2", "delta_e=-1:2:3", "delta_e=400deg", "delta_e=nan"]
)
def test_throws_that_are_none_are_refused(word: str, aircraft: Path, tmp_path: Path) -> None:
    done = export(aircraft, "--to", "ardupilot", "-o", tmp_path / "x.json", "--throw", word)
    assert "--throw" in str(done.exception)
