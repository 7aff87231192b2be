"""The Python API: five lines give a table and a figure, with the numbers of the verbs."""

import ast
import inspect
import json
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import sideslip as ss
from daq.utilities.errors import UserError
from sideslip import api
from sideslip.api import Estimates
from tests.support.paths import RECORDINGS

LD4 = RECORDINGS / "cdfp_ld4.mcap"
RECORDS = ("bench", "calibrate", "info", "recover", "verify")


@pytest.fixture(scope="module")
def result() -> Estimates:
    return ss.estimate(ss.open(LD4), "lateral", method="ml,ls")


def test_importing_it_is_light() -> None:
    code = (
        "import sys, sideslip; print([m for m in ('numpy', 'scipy', 'casadi', 'torch', 'click') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
    assert set(dir(ss)) >= {"open", "import_log", "check", "estimate", "match", "gap", "design", "simulate"}


def test_a_mistyped_function_or_argument_is_answered_with_the_one_meant() -> None:
    with pytest.raises(AttributeError, match="did you mean estimate"):
        _ = ss.estimat
    with pytest.raises(TypeError, match=r"estimate\(\) has no argument 'metod'; did you mean method"):
        ss.estimate([], metod="ml")  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="it takes path"):
        ss.open("a.mcap", zzz=1)  # type: ignore[call-arg]


@pytest.mark.parametrize("name", [n for n in ss.__all__ if n in {*api.__all__, *RECORDS}])
def test_help_of_a_function_has_each_argument_and_an_example(name: str) -> None:
    function = getattr(ss, name)
    text = inspect.getdoc(function) or ""
    for argument in inspect.signature(function).parameters:
        assert f"\n    {argument}: " in text, argument
    example = textwrap.dedent(text.split("Example::\n")[1])
    ast.parse(example)
    assert f"ss.{name}(" in example


def test_raw_recordings_are_calibrated_when_opened() -> None:
    raw, flight = ss.open(RECORDINGS / "cdfp_ld4_raw.mcap"), ss.open(LD4)
    np.testing.assert_allclose(raw["p"], flight["p"], rtol=1e-12)


class TestEstimate:
    def test_numbers_are_those_of_the_verb(self, result: Estimates, tmp_path: Path) -> None:
        with pytest.raises(SystemExit):
            ss.main(["estimate", str(LD4), "--method", "ml,ls", "--brief", "--json", str(tmp_path / "verb.json")])
        verb = json.loads((tmp_path / "verb.json").read_text())["flights"][0]["methods"]
        table = result.to_pandas().set_index(["method", "parameter"])
        for method in ("ml", "ls"):
            for name, entry in verb[method]["parameters"].items():
                assert table.loc[(method, name), "estimate"] == pytest.approx(entry["estimate"], rel=1e-9)

    def test_short_text_and_escaped_html(self, result: Estimates) -> None:
        assert len(repr(result)) < 400
        assert repr(result).startswith("<Estimates of lateral by ml, ls")
        page = result._repr_html_()
        assert page.count("<tr>") == 1 + len(result.best.parameters)
        assert "Cl_p" in result.summary()

    def test_plot_gives_axes_and_takes_them(self, result: Estimates) -> None:
        import matplotlib as mpl

        mpl.use("Agg")
        from matplotlib import pyplot as plt

        axes = result.plot()
        assert "$C_{l_{p}}$" in [t.get_text() for t in axes.get_yticklabels()]
        assert result.plot(ax=axes) is axes
        plt.close("all")

    def test_saved_in_each_format(self, result: Estimates, tmp_path: Path) -> None:
        for ending in ("toml", "json", "csv", "tex"):
            assert result.save(tmp_path / f"e.{ending}").stat().st_size > 200
        with pytest.raises(UserError, match=r"e\.xls"):
            result.save(tmp_path / "e.xls")

    def test_the_fitted_model_predicts_and_simulates(self, result: Estimates) -> None:
        proof = ss.match(result.model, RECORDINGS / "cdfp_ld2.mcap", free=("CY_0", "Cl_0", "Cn_0"))
        assert proof.to_pandas().set_index("channel").loc["p", "r2"] > 0.9
        shown = ss.simulate(result.model, LD4)
        both = np.isfinite(shown["p"]) & np.isfinite(shown["p_model"])
        assert np.corrcoef(shown["p"][both], shown["p_model"][both])[0, 1] > 0.95


def test_a_flight_without_aircraft_is_refused_with_the_way_out() -> None:
    with pytest.raises(UserError, match="aircraft"):
        ss.estimate(RECORDINGS / "foreign" / "ordinary_0.csv")
    one = ss.estimate(RECORDINGS / "foreign" / "ordinary_0.csv", aircraft="cdfp", method="ls")
    assert one["Cl_p"].estimate < 0


def test_check_and_its_correction() -> None:
    whole = ss.open(LD4)
    found = ss.check(whole.part(whole.time < whole.time[0] + 8.0))
    assert set(found.to_pandas()["factor"]) >= {"dax", "K_beta"}
    assert repr(found).startswith("<Check of cdfp_ld4: ")
    (flight,) = found.corrected()
    assert flight.name == "cdfp_ld4"
    assert "K_beta" in found.summary()
    assert "<table>" in found._repr_html_()


@pytest.fixture
def drawing() -> Iterator[None]:
    """Figures without a display, closed afterwards."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    yield
    plt.close("all")


@pytest.mark.usefixtures("drawing")
def test_checks_and_matches_draw_measured_beside_computed(result: Estimates, tmp_path: Path) -> None:
    whole = ss.open(LD4)
    found = ss.check(whole.part(whole.time < whole.time[0] + 8.0))
    axes = found.plot()
    assert [a.get_ylabel() for a in axes[:2]] == ["V [m/s]", "alpha [deg]"]
    reconstructed = found.results["cdfp_ld4"].flights[0].reconstructed
    np.testing.assert_allclose(axes[1].lines[1].get_ydata(), np.degrees(reconstructed[:, 1]))
    proof = ss.match(result.model, LD4)
    assert "match" in proof.summary().splitlines()[2]
    assert len(proof.plot()) == len(result.model.outputs)
    with pytest.raises(UserError, match="1 axes for 5 panels"):
        proof.plot(ax=axes[0])
    for kept in (found, proof):
        assert kept.save(tmp_path / "t.csv").read_text().startswith("flight,")
        with pytest.raises(UserError, match=r"t\.xls"):
            kept.save(tmp_path / "t.xls")


def test_figures_are_those_of_the_page(result: Estimates, tmp_path: Path) -> None:
    figures = result.figures()
    assert set(figures) == {
        "forest",
        "strips",
        "figure8",
        "figure9_cdfp_ld4",
        "residuals_cdfp_ld4",
        "against_cdfp_ld4",
        "correlations",
        "ellipses",
    }
    one = figures["ellipses"]
    assert one is figures["ellipses"]  # drawn once
    shown = one._repr_html_()
    assert "data:image/svg+xml" in shown
    page = result.report(tmp_path / "page").read_text()
    assert one.uri in page
    assert one.save(tmp_path / "e.svg").read_text().lstrip().startswith("<?xml")
    with pytest.raises(UserError, match=r"in \.svg"):
        one.save(tmp_path / "e.png")


def test_an_imported_log_carries_its_aircraft(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text('name = "mine"\n[geometry]\nspan = 1.5\n')
    flight = ss.import_log(RECORDINGS / "foreign" / "ordinary_0.csv", aircraft=file)
    assert flight.provenance.aircraft == "mine"
    assert ss.import_log(RECORDINGS / "foreign" / "ordinary_0.csv", aircraft="cdfp").provenance.aircraft == "cdfp"


def test_design_and_import(tmp_path: Path) -> None:
    plan = ss.design("longitudinal", 10.0, "cdfp", kind="doublet")
    assert plan.relative["Cm_de"] < 0.2
    flight = ss.open(LD4)
    flight.save(tmp_path / "log.csv")
    again = ss.import_log(tmp_path / "log.csv")
    np.testing.assert_allclose(again["p"], flight["p"], rtol=1e-9)


def test_the_lines_of_the_page_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import re

    import matplotlib as mpl

    mpl.use("Agg")
    monkeypatch.chdir(RECORDINGS.parent)
    page = (RECORDINGS.parent / "docs" / "api.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```$", page, flags=re.M | re.S)
    names: dict[str, object] = {}
    for block in blocks:
        exec(block, names)  # noqa: S102
    assert len(blocks) == 2
    assert {"table", "axes", "model"} <= set(names)


def test_the_first_line_says_whether_the_instruments_agree() -> None:
    """Perfect instruments of another simulator agree; with a vane that shows a seventh too much its scale is named."""
    flight = ss.open(RECORDINGS / "foreign" / "ordinary_1.csv")
    sound = ss.check(flight, aircraft="cdfp")
    assert next(iter(sound.lines())) == f"{flight.name}: the instruments agree"
    wrong = ss.check(flight.with_columns(beta=flight["beta"] * 1.15), aircraft="cdfp")
    assert next(iter(wrong.lines())) == f"{flight.name}: the instruments agree once K_beta is corrected"
    assert wrong.to_json()["flights"][0]["agreement"] == wrong.agreement(flight.name)
