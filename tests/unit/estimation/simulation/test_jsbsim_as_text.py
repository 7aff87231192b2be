"""A JSBSim aircraft in our own text: its tables, its names, and that it flies as JSBSim flies it."""

from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from click.testing import CliRunner

pytest.importorskip("jsbsim", reason="the package jsbsim is not installed")

from estimation.errors import EstimationError
from estimation.gap.effects import catalogue
from estimation.models import read_model
from estimation.models.expressions import evaluate
from estimation.models.numeric import FUNCTIONS
from estimation.prepare.pipeline import prepare
from estimation.simulation import conversion
from estimation.simulation.attach import simulation_of
from estimation.simulation.conversion import ProvedImport, import_from_jsbsim, imported_exactly, random_states
from estimation.simulation.jsbsim.export import inlined
from estimation.simulation.jsbsim.flying import fly_aircraft
from estimation.simulation.jsbsim.library import aircraft_file
from estimation.simulation.jsbsim.terms import Sum, TableError, constant, factor, looked_up, table_of, text_of
from estimation.simulation.oracle import SimulationError
from estimation.simulation.proof import AS_IT_IS, NOISE, SHARE, step_model
from sideslip.cli import cli
from tests.studies import jsbsim_flights as truth

ROWS = "0.0 1.0 3.0\n -0.2 0.1 0.5 -0.3\n 0.0 0.2 0.25 0.1\n 0.1 0.9 0.2 0.2\n 0.4 0.3 0.3 -0.6"
ONE = "<table><independentVar>x</independentVar><tableData>-0.2 0.1\n 0.0 0.5\n 0.1 -0.3\n 0.4 -0.3</tableData></table>"
TWO = (
    '<table><independentVar lookup="row">x</independentVar><independentVar lookup="column">y</independentVar>'
    f"<tableData>{ROWS}</tableData></table>"
)
THREE = (
    '<table><independentVar lookup="row">x</independentVar><independentVar lookup="column">y</independentVar>'
    f'<independentVar lookup="table">z</independentVar><tableData breakPoint="1">{ROWS}</tableData>'
    '<tableData breakPoint="2">0.0 5.0\n 0.0 1.0 3.0\n 0.3 2.0 -3.0</tableData></table>'
)  # the second has points of its own


def two(x: float, y: float) -> float:
    """Straight along rows, then along columns, flat outside: by numpy."""
    numbers = [[float(w) for w in line.split()] for line in ROWS.splitlines()]
    rows = np.array(numbers[1:])
    return float(np.interp(y, numbers[0], [np.interp(x, rows[:, 0], rows[:, 1 + j]) for j in range(3)]))


def three(x: float, y: float, z: float) -> float:
    other = np.interp(y, [0.0, 5.0], [np.interp(x, [0.0, 0.3], [1.0, 2.0]), np.interp(x, [0.0, 0.3], [3.0, -3.0])])
    return float(np.interp(z, [1.0, 2.0], [two(x, y), other]))


BY_NUMPY: dict[str, Callable[[float, float, float], float]] = {
    ONE: lambda x, y, z: float(np.interp(x, [-0.2, 0.0, 0.1, 0.4], [0.1, 0.5, -0.3, -0.3])),
    TWO: lambda x, y, z: two(x, y),
    THREE: three,
}


@pytest.mark.parametrize("text", BY_NUMPY)
@pytest.mark.parametrize("fixed", ["", "x", "y", "z", "xy"])
def test_a_table_is_exact_inside_and_flat_outside(text: str, fixed: str) -> None:
    rng = np.random.default_rng(3)
    for _ in range(30):
        at = {"x": rng.uniform(-0.4, 0.6), "y": rng.uniform(-1.0, 6.0), "z": rng.uniform(0.5, 2.5)}
        at |= {"x": 0.1, "y": 3.0} if rng.random() < 0.2 else {}
        table, names = table_of(ET.fromstring(text))
        lines: dict[str, str] = {}

        def line(terms: Sum, lines: dict[str, str] = lines) -> Sum:
            lines[f"line{len(lines)}"] = text_of(terms)
            return factor(f"line{len(lines) - 1}")

        asked = [constant(at[n]) if n in fixed else factor(n) for n in names]
        result = text_of(looked_up(table, asked, line))
        symbols = dict(at)
        for name, value in lines.items():
            symbols[name] = evaluate(value, symbols, FUNCTIONS)
        assert evaluate(result, symbols, FUNCTIONS) == pytest.approx(
            BY_NUMPY[text](at["x"], at["y"], at["z"]), abs=1e-13
        )


@pytest.mark.parametrize(
    ("inside", "told"),
    [
        ("<independentVar>x</independentVar><tableData>0 1 2</tableData>", "a number missing"),
        ("<independentVar>x</independentVar><tableData>1 1 0 2</tableData>", "do not rise"),
        ("<independentVar>x</independentVar><tableData>0 a</tableData>", "'a' for a number"),
        ('<independentVar lookup="axis4">x</independentVar><tableData>0 1</tableData>', "not known here"),
    ],
)
def test_a_table_that_is_none_is_refused(inside: str, told: str) -> None:
    with pytest.raises(TableError, match=told):
        table_of(ET.fromstring(f"<table>{inside}</table>"))


@pytest.fixture(scope="module")
def cessna() -> ProvedImport:
    return imported_exactly("jsbsim:c172p")


def test_derivatives_have_the_field_s_names_and_the_file_s_numbers(cessna: ProvedImport) -> None:
    model = cessna.imported.model
    wanted = {"Cl_p": -0.484, "Cm_q": -12.4, "Cm_alphadot": -7.27, "Cl_da": -0.229, "CY_dr": 0.187, "CL_de": 0.43}
    assert {n: model.parameter(n).start for n in wanted} == wanted  # to the last digit
    assert "aero/coefficient/Clp" in model.parameter("Cl_p").reference_source
    assert model.parameter("CDDe").start == 0.06  # by its size: no name of the field's
    assert model.definitions["CYb"].count("max(0, ") == 2
    assert {"fcs/flap-pos-deg", "aero/stall-hyst-norm", "aero/h_b-mac-ft"} <= cessna.imported.held.keys()


# tables of one, two and three variables; Mach number; Reynolds number; the square of lift with lift by the rate of alpha
@pytest.mark.parametrize("name", ["c172p", "f16", "wrightFlyer1903", "737", "pc7", "dr1"])
def test_coefficients_are_jsbsim_s_own(name: str) -> None:
    assert max(imported_exactly(f"jsbsim:{name}").deviation.values()) < 1e-12


def test_the_text_moves_as_jsbsim_flies_the_aircraft(cessna: ProvedImport) -> None:
    """The whole of it: equations of motion, lift that makes the rate of alpha it goes with, mass and inertia."""
    source = aircraft_file("c172p")
    flight = fly_aircraft(source, inlined(source), False, 120.0, {})
    model = cessna.imported.model
    start = np.array([flight[n][0] for n in model.state_names])
    shown = step_model(model, prepare(model, flight, AS_IT_IS), start, ())
    for i, name in enumerate(model.output_names):
        off = np.sqrt(np.mean((shown[:, i] - flight[name]) ** 2))
        assert off < SHARE * NOISE[name], name


def test_as_a_simulation_it_answers_as_the_aircraft_does(tmp_path: Path) -> None:
    import_from_jsbsim("jsbsim:c172p", tmp_path / "own.toml")
    text, own = simulation_of(str(tmp_path / "own.toml")), simulation_of("jsbsim:c172p")
    states = random_states(own, 20)
    np.testing.assert_allclose(text.oracle.coefficients(states), own.oracle.coefficients(states), atol=1e-9)
    assert text.aircraft is not None
    assert own.aircraft is not None
    assert text.aircraft.Ixz == own.aircraft.Ixz
    assert len(catalogue(model=read_model(tmp_path / "own.toml"))) > 40  # effects find the lines they add to


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("f22", r"aero/coefficient/CYbdot reads aero/betadot-rad_sec, .*--simulation jsbsim:f22"),
        ("X15", "position/h-sl-ft"),
        ("Camel", "vc-kts.*; and [0-9]+ more"),
        ("Submarine_Scout", "another Cl than JSBSim"),
    ],
)
def test_what_is_not_exact_is_told_and_not_written(name: str, told: str, tmp_path: Path) -> None:
    with pytest.raises(SimulationError, match=told) as error:
        import_from_jsbsim(f"jsbsim:{name}", tmp_path / "own.toml")
    assert "\n" not in str(error.value)
    assert not (tmp_path / "own.toml").exists()


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("<value>-0.4840</value>", "<value>0.5</value><random/>", "has <random>"),
        ("<value>-0.4840</value>", "<value>many</value>", "cannot load|'many' for a number"),
        ("<value>-0.4840</value>", "<property>attitude/phi-rad</property>", "Clp reads attitude/phi-rad"),
        (
            "<value>0.4300</value>",
            "<pow><property>aero/alphadot-rad_sec</property><value>2</value></pow>",
            "by a factor",
        ),
    ],
)
def test_a_function_without_a_form_is_named(old: str, new: str, told: str, tmp_path: Path) -> None:
    file = truth.changed(tmp_path, "c172p", lambda text: text.replace(old, new))
    assert new in file.read_text(encoding="utf-8")
    with pytest.raises(SimulationError, match=told):
        imported_exactly(f"jsbsim:{file.parent}")


def test_a_text_that_is_another_is_not_written(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A point of a table out of place by a ten-millionth."""
    real = conversion.import_aircraft

    def wrong(source: conversion.AircraftSource) -> conversion.Imported:
        found = real(source)
        shifted = found.model.with_starts(Cl_p=found.model.parameter("Cl_p").start * (1 + 1e-7))
        return conversion.Imported(shifted, found.held, found.standard, found.own, found.tables)

    monkeypatch.setattr(conversion, "import_aircraft", wrong)
    with pytest.raises(SimulationError, match="another Cl than JSBSim"):
        import_from_jsbsim("jsbsim:c172p", tmp_path / "own.toml")


def test_a_surface_that_it_does_not_know_is_told(tmp_path: Path) -> None:
    done = import_from_jsbsim("jsbsim:c172x", tmp_path / "own.toml")  # its ailerons go by a name of their own
    assert "delta_a" in " ".join(done.notes)
    assert "fcs/effective-aileron-pos" in done.imported.held


class TestVerb:
    def test_writes_and_says_what(self, tmp_path: Path) -> None:
        out = tmp_path / "c172p.toml"
        done = CliRunner().invoke(cli, ["export", "jsbsim:c172p", "-o", str(out)], standalone_mode=False)
        assert done.return_value == 0, done.output
        for word in ("Cl_p", "CLwbh", "flap-pos-deg 0", "13 tables", "200 random states"):
            assert word in done.output
        assert read_model(out).name == "c172p"

    @pytest.mark.parametrize(
        ("words", "told"),
        [
            (["jsbsim:c172p"], "-o MODEL.toml"),
            (["jsbsim:c172p", "-o", "x.csv"], "-o MODEL.toml"),
            (["x.toml", "--to", "model", "-o", "x.toml"], "jsbsim:NAME"),
        ],
    )
    def test_nonsense_is_refused(self, words: list[str], told: str) -> None:
        with pytest.raises(EstimationError, match=told):
            CliRunner().invoke(cli, ["export", *words], catch_exceptions=False)


@pytest.mark.study
@pytest.mark.timeout(600)
def test_how_many_of_jsbsim_s_aircraft_can_be_written() -> None:
    asked, written = [], []
    for file in sorted(truth.OWN.glob("*/*.xml")):
        if file.stem != file.parent.name:
            continue
        try:
            simulation_of(f"jsbsim:{file.stem}")
        except EstimationError:
            continue
        asked.append(file.stem)
        try:
            imported_exactly(f"jsbsim:{file.stem}")
        except SimulationError:
            continue
        written.append(file.stem)
    assert (len(asked), len(written)) == (51, 43)
