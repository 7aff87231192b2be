"""Models and estimates as JSON, CSV and LaTeX."""

import csv
import json
from pathlib import Path
from typing import Any

import pytest

from estimation.errors import EstimationError
from estimation.models import load_model, write_model
from estimation.report.model_export import export_model
from estimation.report.tables import rounded


@pytest.fixture
def model(tmp_path: Path) -> Path:
    write_model(load_model("lateral", "cdfp"), tmp_path / "model.toml")
    return tmp_path / "model.toml"


def test_csv_and_json_hold_every_parameter_with_unit_and_source(model: Path, tmp_path: Path) -> None:
    export_model(model, tmp_path / "m.csv")
    export_model(model, tmp_path / "m.json")
    rows = list(csv.DictReader((tmp_path / "m.csv").read_text().splitlines()))
    parameters = load_model("lateral", "cdfp").parameters
    assert [r["parameter"] for r in rows] == [p.name for p in parameters]
    assert {r["parameter"]: r["unit"] for r in rows}["Cl_p"] == "1/rad"
    assert {r["identifiable"] for r in rows} == {"True"}
    assert all(None not in r for r in rows)  # no cell beyond the header
    content = json.loads((tmp_path / "m.json").read_text())
    assert [p["value"] for p in content["parameters"]] == [p.start for p in parameters]


def test_latex_compiles_in_the_eye_of_matplotlib(model: Path, tmp_path: Path) -> None:
    from matplotlib.mathtext import MathTextParser

    export_model(model, tmp_path / "m.tex")
    text = (tmp_path / "m.tex").read_text()
    cells = [c for line in text.splitlines() for c in line.split("&") if "$" in c]
    assert len(cells) >= 2 * len(load_model("lateral", "cdfp").parameters)
    for cell in cells:
        MathTextParser("agg").parse(cell.replace(r"\\", "").strip())


def test_estimate_of_one_flight_brings_its_corrected_bounds(tmp_path: Path) -> None:
    one = {"estimate": -0.49561, "std": 0.002, "std_coloured": 0.0123}
    content = {"model": "lateral", "flights": [{"methods": {"ml": {"parameters": {"Cl_p": one}}}}]}
    (tmp_path / "e.json").write_text(json.dumps(content))
    export_model(tmp_path / "e.json", tmp_path / "e.tex")
    assert "$-0.496$ & $0.012$" in (tmp_path / "e.tex").read_text()


@pytest.mark.parametrize("text", ["[]", "{}", '{"model": 1, "flights": [{}]}', "[" * 100_000, "nonsense"])
def test_other_files_are_refused_in_one_sentence(tmp_path: Path, text: str) -> None:
    (tmp_path / "e.json").write_text(text)
    with pytest.raises(EstimationError):
        export_model(tmp_path / "e.json", tmp_path / "e.csv")


def test_never_onto_itself(model: Path) -> None:
    copy = model.rename(model.with_suffix(".json"))
    with pytest.raises(EstimationError, match="another name"):
        export_model(copy, copy)


@pytest.mark.parametrize(
    ("value", "bound", "texts"),
    [
        (-0.49561, 0.0123, ("-0.496", "0.012")),
        (123.456, 21.0, ("123", "21")),
        (0.5, None, ("0.5", "")),
        (0.5, float("nan"), ("0.5", "")),
        (-2.2e-6, 8.6e-6, ("-0.0000022", "0.0000086")),
    ],
)
def test_rounding_to_the_bound(value: float, bound: float | None, texts: tuple[str, str]) -> None:
    assert rounded(value, bound) == texts


def recommended_estimate(method: str) -> dict[str, Any]:
    numbers = {"ml": -0.41, "ls": -0.37}
    methods = {
        m: {
            "parameters": {
                "Cl_p": {
                    "estimate": v,
                    "std": 0.01,
                    "std_coloured": 0.01,
                    "reference": -0.5,
                    "reference_source": "flight",
                }
            }
        }
        for m, v in numbers.items()
    }
    verdict = {"method": method, "why": "rough_air & 3 % of it"}
    return {
        "aircraft": "a_1",
        "model": "lateral",
        "flights": [{"name": "f_1", "methods": dict(reversed(methods.items())), "recommended": verdict}],
        "conventions": {"units": "derivatives per rad"},
        "priors": {"Cl_p": {"mean": -0.5, "std": 0.06}},
    }


def exported(content: dict[str, Any], folder: Path) -> str:
    (folder / "e.json").write_text(json.dumps(content))
    export_model(folder / "e.json", folder / "e.tex")
    return (folder / "e.tex").read_text()


def test_the_table_is_of_the_recommended_method_with_priors_and_conventions(tmp_path: Path) -> None:
    text = exported(recommended_estimate("ml"), tmp_path)
    assert "$-0.410$" in text
    assert "-0.370" not in text
    assert r"$-0.5$ $\pm$ $0.06$ (flight, prior)" in text
    for words in (r"Aircraft a\_1", "method ml", r"f\_1", r"rough\_air \& 3 \% of it", "derivatives per rad"):
        assert words in text
    assert "Nothing is recommended" in exported(recommended_estimate("none"), tmp_path)
