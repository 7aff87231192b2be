"""The report pages in headless Chromium: nothing overflows, nothing is asked from outside, in light, dark and print."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from estimation.compatibility.reconstruction import compatibility
from estimation.gap.answer.result import DisagreementView, GapResult, Migration, Rejected, Tie
from estimation.gap.pages.report import write_gap_report
from estimation.report.check_page import write_check_report
from estimation.report.estimate_page import write_estimate_report
from estimation.report.front import write_front_page
from estimation.session import runner
from groundstation.flight.quality.report import quality_report
from tests.unit.estimation.gap.test_rerun_report import an_answer
from tests.unit.estimation.test_report import CRAFT, LATERAL, flight, kinematic_flight
from tests.web.fits import OVERFLOW

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytestmark = [
    pytest.mark.browser,
    pytest.mark.timeout(240),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
]

PAGES = ("", "check", "estimate", "gap")
WIDTHS = (400, 1280, 1920)
A4_ACROSS = 1031  # CSS pixels of a sheet 297 mm long within margins of 12 mm
A4_UPRIGHT = 703
MOST_SHEETS = 8  # of a printed report
HIDDEN_BY_SCROLLING = """() => [...document.querySelectorAll('.scroll, .frame, pre')]
  .filter(e => e.scrollWidth > e.clientWidth + 1).map(e => (e.innerText || '').slice(0, 60))"""


def wide_answer() -> GapResult:
    """The hand-made answer with every part of the page filled."""
    answered = an_answer(np.random.default_rng(4))
    names = answered.outputs
    regime = {n: [{"from": 0.0, "to": 1.0, "gap": 1.0 + 0.1 * k} for k in range(6)] for n in names}
    times = tuple((f, 2.0 * k, 2.0 * k + 2, 1.5) for f in ("f0", "f1") for k in range(4))
    missing = tuple({n: np.sin(np.arange(20) / 3) * 1e-3 for n in ("CY", "Cl", "Cn")} for _ in range(2))
    views = tuple(
        DisagreementView(
            stage, 2.0, dict.fromkeys(names, 1.5), times, regime, {"CY": 0.01, "Cl": 0.002, "Cn": 0.003}, missing
        )
        for stage in ("prior parameters frozen", "after the refit", "with the named effects")
    )
    step = replace(
        answered.steps[0],
        migrated={"Cn_p": Migration(0.031, 0.022, 6.1, 0.02)},
        absorbed=0.9,
        equation="C_n = … + C_nδa δa",
    )
    return replace(
        answered,
        steps=(step,),
        views=views,
        minimum_detectable={"Cn_da": 0.0012, "x_vane": 0.3},
        rejected=tuple(
            Rejected("aileron_backlash", f"fits {k}% of its usual size: too small to matter") for k in (4, 5)
        ),
        ties=(Tie("lateral_cg", "motor_torque", 0.999),),
        notes=tuple(f"{f}: theta not measured at 60 samples: those left out" for f in ("f0", "f1")),
        details={
            "kinematic_gate": {"origin": "physics", "best": ""},
            "nulls": 20,
            "seed": 1,
            "repeatability": [{"flight": "f0", "chi2": 60.8, "usual": 18.4, "limit": 55.0, "odd": True}],
            "cannot_tell": [{"effect": e, "separate_by": "rudder doublets"} for e in ("Cn_dr3", "rudder_lag")],
        },
    )


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of pages as the demo leaves it, made of small flights; four methods wide by giving one four names."""
    folder, answer = tmp_path_factory.mktemp("report"), wide_answer()
    level = kinematic_flight()
    write_check_report([level], [quality_report(level)], [(level.name, compatibility(level))], folder / "check")
    one = runner.estimate(LATERAL, [flight("cdfp_ld1", 1, 0.0)], CRAFT, ("ml",))
    names = ("ml", "fem", "ngn-improved", "ls")
    each = replace(one.flights[0], results={m: one.flights[0].results["ml"].with_method(m) for m in names})
    joint = {m: each.results[m] for m in names[:2]}
    session = replace(one, methods=names, flights=(each,), joint=joint, truth={"Cl_p": -0.45, "Cn_beta": 0.026})
    write_estimate_report(session, folder / "estimate")
    write_gap_report(answer, folder / "gap")
    fit = {c: {"r2": 0.99, "theil": 0.031} for c in LATERAL.output_names} | {"ay": {"r2": 0.4, "theil": 0.41}}
    match = {"model": "lateral", "limit": 0.3, "flights": [{"name": "cdfp_ld1", "fit": fit}]}
    truth = {"derivatives": dict(session.truth), "hidden": {"name": "Cn_da", "parameters": {"Cn_da": [-0.01, "1/rad"]}}}
    found: dict[str, Any] = {
        "estimate": session.to_json(),
        "gap": answer.to_json(),
        "match": match,
        "truth": truth,
    }
    for name, content in found.items():
        (folder / f"{name}.json").write_text(json.dumps(content), encoding="utf-8")
    write_front_page(folder)
    return folder


def test_pages_fit_every_window_and_the_sheet_and_ask_nobody(report: Path, browser: "Browser") -> None:
    asked: list[str] = []
    page = browser.new_page()
    page.on("request", lambda request: asked.append(request.url))
    for name in PAGES:
        path = report / name / "index.html"
        page.goto(path.as_uri())
        for width in WIDTHS:
            page.set_viewport_size({"width": width, "height": 900})
            for scheme in ("light", "dark") if width == WIDTHS[0] else ("light",):
                page.emulate_media(color_scheme=scheme)  # type: ignore[arg-type]
                assert page.evaluate(OVERFLOW) == [], (name, width, scheme)
                assert page.evaluate(HIDDEN_BY_SCROLLING) == [], (name, width, scheme)
                assert _dark(page) is (scheme == "dark")
        _prints(page, name)
        page.emulate_media(media="screen", color_scheme="light")
    assert [url for url in asked if not url.startswith(("file://", "data:"))] == []
    assert len([url for url in asked if url.startswith("file://")]) == len(PAGES)


def _dark(page: "Page") -> bool:
    """Whether the page is darker than its letters."""
    ground, letters = page.evaluate(
        "() => ['backgroundColor', 'color'].map(k => getComputedStyle(document.body)[k].match(/[0-9]+/g).slice(0, 3).map(Number))"
    )
    return bool(sum(ground) < sum(letters))


def _prints(page: "Page", name: str) -> None:
    """On paper no column is cut, no head stands alone, and light ink is not printed on white."""
    across = page.evaluate("document.body.classList.contains('landscape')")
    page.set_viewport_size({"width": A4_ACROSS if across else A4_UPRIGHT, "height": 900})
    page.emulate_media(media="print", color_scheme="dark")
    assert page.evaluate(OVERFLOW) == [], (name, "print")
    assert not _dark(page)
    kept = page.evaluate("() => [...document.querySelectorAll('h2, caption')].map(e => getComputedStyle(e).breakAfter)")
    assert set(kept) == {"avoid"}
    assert page.evaluate("getComputedStyle(document.querySelector('.sign')).display") == "flex"
    boxes = re.findall(rb"/MediaBox\s*\[\s*0 0 ([0-9.]+) ([0-9.]+)", page.pdf(prefer_css_page_size=True))
    assert boxes
    assert len(boxes) <= MOST_SHEETS
    assert all((float(width) > float(height)) is across for width, height in boxes), (name, "landscape where wide")


def test_every_page_leads_back_and_a_figure_can_be_enlarged(report: Path, browser: "Browser") -> None:
    page = browser.new_page(viewport={"width": 900, "height": 700})
    page.goto((report / "index.html").as_uri())
    page.click("nav >> text=Gap workflow")
    page.click("nav >> text=Where")  # opens what is folded
    small = page.locator("#residual_maps img").bounding_box()
    page.click("#residual_maps label")
    large = page.locator("#residual_maps img").bounding_box()
    assert small is not None
    assert large is not None
    assert large["width"] > 1.3 * small["width"]
    assert page.evaluate("document.documentElement.scrollWidth") <= 900
    page.click("text=Flight-test report")
    assert page.title() == "Flight-test report"


def test_failed_limits_are_red_with_their_limit(report: Path, browser: "Browser") -> None:
    page = browser.new_page()
    page.emulate_media(color_scheme="light")
    page.goto((report / "index.html").as_uri())
    assert page.locator("#match td.fail").all_inner_texts() == ["0.410", "FAIL"]
    red, green, blue = page.locator("#match td.fail").first.evaluate(
        "e => getComputedStyle(e).color.match(/[0-9]+/g).slice(0, 3).map(Number)"
    )
    assert red > 2 * max(green, blue)
    assert "at most 0.3" in page.inner_text("main")
    assert page.locator("#hidden tbody td").all_inner_texts()[:4] == ["Cn_da", "Cn_da", "-0.0100", "-0.00840"]
    page.goto((report / "gap" / "index.html").as_uri())
    assert page.locator("#repeatability td.fail").count() == 2
    assert page.locator("#notes tbody tr").count() == 1
    assert page.locator("#rejected tbody tr").count() == 1
    heads = page.evaluate(
        "() => [...document.querySelectorAll('table')].map(t => t.querySelectorAll('thead th').length)"
    )
    assert min(heads) >= 2
