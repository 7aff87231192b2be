"""Report pages: self-contained, complete, and with numbers that come from elsewhere than the page itself."""

import csv
import json
import math
import re
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pytest
from matplotlib.figure import Figure

from estimation.aircraft import load_aircraft
from estimation.compatibility.reconstruction import compatibility
from estimation.engine.simulate import simulate
from estimation.models import load_model
from estimation.report import names, published
from estimation.report.check_page import write_check_report
from estimation.report.estimate_page import write_estimate_report
from estimation.report.front import write_front_page
from estimation.report.modes import modes, modes_with_spread, state_matrix, trim
from estimation.report.tables import ReportTable, number, rounded
from estimation.session import runner
from estimation.session.session import EstimationSession
from groundstation.flight import Flight, Provenance
from groundstation.flight.quality.report import quality_report

CRAFT = load_aircraft("cdfp")
LATERAL = load_model("lateral", CRAFT)


def flight(name: str, seed: int, rudder: float) -> Flight:
    """Twelve seconds of the lateral model's own motion at 17 m/s, aileron and (with `rudder`) rudder doublets."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 12.0, 0.05)
    a = (
        np.where((t > 1) & (t < 1.8), 0.1, 0)
        - np.where((t > 1.8) & (t < 2.6), 0.1, 0)
        + np.where((t > 8) & (t < 8.5), 0.1, 0)
    )
    r = rudder * (np.where((t > 4) & (t < 5), 0.12, 0) - np.where((t > 5) & (t < 6), 0.12, 0))
    flat = np.zeros_like(t)
    columns = {
        "delta_a": a,
        "delta_r": r,
        "V": flat + 17.0,
        "alpha": flat + 0.09,
        "theta": flat + 0.09,
        "q": flat,
        "V_dot": flat,
        "rho": flat + 1.17,
        **{c: 0.01 * np.sin(t) for c in ("beta", "p", "r", "phi", "ay")},
    }
    values = {**LATERAL.starts(), "Cn_beta": 0.026, "Cl_dr": -0.02}
    truth = simulate(LATERAL, Flight.build(name, t, columns), values, x0=np.zeros(4))
    for i, c in enumerate(LATERAL.output_names):
        columns[c] = truth[:, i] + (0.05 if c == "ay" else 0.005) * rng.standard_normal(t.size)
    columns["alpha"] = columns["alpha"] + 0.002 * rng.standard_normal(t.size)
    return Flight.build(name, t, columns)


@pytest.fixture(scope="module")
def session() -> EstimationSession:
    return runner.estimate(
        LATERAL, [flight("cdfp_ld1", 1, 0.0), flight("cdfp_ld4", 2, 1.0)], CRAFT, ("ml",), joint=True
    )


@pytest.fixture(scope="module")
def report(session: EstimationSession, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The written page of the session; of the figures that each flight has, those of the first are drawn."""
    savefig, drawn = Figure.savefig, set()

    def once(self: Figure, file: BinaryIO, **options: Any) -> None:
        kind = (len(self.axes), *self.get_size_inches())
        if kind in drawn:
            file.write(b"<svg/>")
        else:
            savefig(self, file, **options)
        drawn.add(kind)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", once)
        return write_estimate_report(session, tmp_path_factory.mktemp("reports") / "estimate")


def outside_references(page: str) -> list[str]:
    """What a browser would fetch to show the page."""
    return [u for u in re.findall(r'(?:src|href|url)\s*[=(]\s*"?([^"\s)>]+)', page) if not u.startswith(("#", "data:"))]


def test_page_is_one_file_with_every_part(report: Path) -> None:
    text = report.read_text(encoding="utf-8")
    assert set(outside_references(text)) <= {"../index.html"}  # the way back, once there is a front page beside it
    assert "<script" not in text
    for part in (
        "scatter",
        "joint",
        "mean",
        "flights",
        "untold",
        "histories",
        "residuals",
        "proof",
        "modes",
        "correlation",
        "provenance",
    ):
        assert f'<div id="{part}"' in text
    for piece in (
        "flight_card",
        "residuals_cdfp_ld1",
        "against_cdfp_ld1",
        "ellipses",
        "figure10_match",
        "runs",
    ):
        assert f'id="{piece}"' in text
    assert text.count("<img") >= 2 + 2 + 2 + 1 + 1 + 1 + 1
    assert not list(report.parent.glob("*.part"))


def test_rudder_derivatives_of_the_aileron_flight_are_not_numbers_but_words(
    session: EstimationSession, report: Path
) -> None:
    text = report.read_text(encoding="utf-8")
    with (report.parent / "tables" / "estimates_cdfp_ld1.csv").open(encoding="utf-8") as file:
        rows = {row[0]: row for row in csv.reader(file)}
    assert "cannot tell" in rows["Cn_dr"]
    assert "rudder doublet or 3-2-1-1" in text
    with (report.parent / "tables" / "estimates_joint.csv").open(encoding="utf-8") as file:
        joint = {row[""]: row for row in csv.DictReader(file)}
    assert float(joint["Cn_dr"]["ml estimate"]) == pytest.approx(
        session.joint["ml"].parameters["Cn_dr"].estimate, abs=1e-4
    )


def test_published_columns_are_those_of_the_same_flight(report: Path) -> None:
    with (report.parent / "tables" / "estimates_cdfp_ld4.csv").open(encoding="utf-8") as file:
        rows = {row[0]: row for row in csv.reader(file)}
    assert rows["Cn_beta"][-4:] == ["0.0217", "0.0001", "0.0177", "0.0021"]  # Tables 3 and 4 of the paper, UFP_LD4
    assert published.counterpart("another") is None
    assert published.counterpart("cdfp_ld12") is None


def test_modes_are_eigenvalues_of_an_independent_linearisation(session: EstimationSession) -> None:
    """Straight flight, Ixz kept, built by hand from the stability derivatives."""
    f, result = session.flights[1].flight, session.joint["ml"]
    state, inputs = trim(LATERAL, f)
    A = state_matrix(LATERAL, result.values, state, inputs)
    v, m = result.values, CRAFT.mass
    V, rho, alpha = 17.0, 1.17, float(np.median(f["alpha"]))
    q, S, b = 0.5 * rho * V**2, CRAFT.area, CRAFT.span
    D = CRAFT.Ixx * CRAFT.Izz - CRAFT.Ixz**2
    hand = np.zeros((4, 4))  # beta p r phi
    for column, name, scale in ((0, "beta", 1.0), (1, "p", b / (2 * V)), (2, "r", b / (2 * V))):
        hand[0, column] = q * S / (m * V) * v[f"CY_{name}"] * scale
        Cl, Cn = v[f"Cl_{name}"] * scale, v[f"Cn_{name}"] * scale
        hand[1, column] = q * S * b * (CRAFT.Izz * Cl + CRAFT.Ixz * Cn) / D
        hand[2, column] = q * S * b * (CRAFT.Ixx * Cn + CRAFT.Ixz * Cl) / D
    hand[0, 1] += math.sin(alpha)
    hand[0, 2] -= math.cos(alpha)
    hand[0, 3] = 9.80665 * math.cos(0.09) / V
    hand[3, 1:3] = 1.0, math.tan(0.09)
    assert np.sort_complex(np.linalg.eigvals(A)) == pytest.approx(np.sort_complex(np.linalg.eigvals(hand)), abs=1e-3)
    assert [x.name for x in modes(A, LATERAL.state_names)] == ["Dutch roll", "roll", "spiral"]
    spread = modes_with_spread(result, f, np.random.default_rng(3))
    assert all(0 < s.speed_spread < 0.5 * abs(s.mode.speed) for s in spread[:2])


def test_modes_of_a_known_matrix() -> None:
    A = np.array([[0.0, 1.0, 0.0], [-4.0, -1.2, 0.0], [0.0, 0.0, -3.0]])  # 2 rad/s, damping 0.3; -3 1/s
    pair, single = modes(A, ("a", "b", "c"))
    assert (pair.speed, pair.damping, single.speed) == pytest.approx((2.0, 0.3, 3.0))


def test_check_page_has_table_2_beside_the_published_one(tmp_path: Path) -> None:
    f = kinematic_flight()
    agreed = "level: the instruments agree"
    page = write_check_report([f], [quality_report(f)], [(f.name, compatibility(f))], tmp_path, agreement=[agreed])
    text = page.read_text(encoding="utf-8")
    first = text[: text.index("<details")]  # what is seen at once
    assert all(words in first for words in (agreed, "<table", "<b>Next</b>"))
    assert outside_references(text) == []
    assert "1.1001 (0.0068)" in text  # K_beta of UFP_LD2
    assert "Figure 7" in text


def kinematic_flight() -> Flight:
    """Level flight: gravity alone on the accelerometers, with noise."""
    rng = np.random.default_rng(5)
    t = np.arange(0.0, 10.0, 0.05)

    def noisy(value: float, sigma: float) -> np.ndarray:
        return value + sigma * rng.standard_normal(t.size)

    columns = {"ax": noisy(0, 0.05), "ay": noisy(0, 0.05), "az": noisy(-9.80665, 0.05), "p": noisy(0, 0.005),
               "q": noisy(0, 0.005), "r": noisy(0, 0.005), "V": noisy(17, 0.1), "alpha": noisy(0, 0.004), "beta": noisy(0, 0.004),
               "phi": noisy(0, 0.002), "theta": noisy(0, 0.002), "psi": noisy(0, 0.002)}  # fmt: skip
    return Flight.build("level", t, columns, provenance=Provenance(aircraft="cdfp"))


def test_front_page_links_what_is_there_and_nothing_else(session: EstimationSession, report: Path) -> None:
    folder = report.parent.parent
    (folder / "estimate.json").write_text(json.dumps(session.to_json()), encoding="utf-8")
    text = write_front_page(folder).read_text(encoding="utf-8")
    assert set(outside_references(text)) == {"estimate/index.html", "estimate.json"}
    found = session.joint["ml"].parameters["Cl_p"]
    assert rounded(found.estimate, found.std_coloured)[0] in text
    assert outside_references(report.read_text(encoding="utf-8")) == ["../index.html"]


def test_front_page_of_an_empty_folder_says_so(tmp_path: Path) -> None:
    assert "No results in this folder yet" in write_front_page(tmp_path).read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("Cl_beta", r"C_{l_{\beta}}"),
        ("Cn_dr", r"C_{n_{\delta_r}}"),
        ("K_beta", r"K_{\beta}"),
        ("dax", r"\Delta_{a_x}"),
        ("p", "p"),
        ("two_words", r"\mathrm{two\_words}"),
    ],
)
def test_latex_of_names(name: str, expected: str) -> None:
    assert names.tex(name) == expected


def test_names_from_a_file_cannot_break_the_page() -> None:
    assert "<script>" not in names.html("<script>")


def test_latex_table_escapes_and_aligns() -> None:
    text = ReportTable("t", "50 % & more", ("", "a_b"), (("Cl_p", "±1"),)).latex()
    assert r"50 \% \& more" in text
    assert r"$C_{l_{p}}$ & $\pm$1 \\" in text
    assert text.count(" & ") == 2


def test_numbers() -> None:
    assert number(-0.0) == "0.0000"
    assert number(-0.00034) == "-0.00034"  # four decimals would show nothing of it
    assert number(-0.00001, 3) == "0.000"
    assert number(math.nan) == number(None) == ""
