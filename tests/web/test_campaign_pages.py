"""A campaign's page and its flights' pages in headless Chromium: nothing overflows, every link leads somewhere and back."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pytest

from estimation.campaign.aerodynamics.differences import difference_rows, step_rows
from estimation.campaign.aerodynamics.tables import database_rows, envelopes, flight_rows, starts_in
from estimation.campaign.groups import group_rows
from estimation.campaign.pages.page import write_campaign_page
from estimation.campaign.plan import CampaignPlan
from estimation.campaign.run import CampaignOutcome
from estimation.campaign.schema import RESULTS, arrow_schema
from tests.unit.estimation.campaign.aerodynamics.test_envelope_curves import SLOPES, STD, estimates, table
from tests.web.fits import OVERFLOW

if TYPE_CHECKING:
    from playwright.sync_api import Browser

pytestmark = [
    pytest.mark.browser,
    pytest.mark.timeout(240),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
]

FLIGHTS = 44
WIDTHS = (400, 1280)


def results() -> pa.Table:
    """Two configurations in turn; a step, a difference and a bad flight; one flight that failed."""
    at, values, std, _ = estimates(np.random.default_rng(3), FLIGHTS, SLOPES)
    values[22:, 2] += 5.0 * STD["Cn_beta"]
    values[1::2, 1] *= 1.1
    values[7] += 12.0 * std[7]
    rows: list[dict[str, Any]] = table(at, values, std).to_pylist()
    for row in rows:
        number = int(row["flight"][1:])
        row |= {
            "configuration": "new rudder" if number % 2 else "old rudder",
            "reference": 1.1 * values[0, row["place"]],
        }
        row |= {"source": f"/flights/of/the/spring/{row['flight']}.csv", "sha256": f"{number:064x}", "duration": 20.0}
        row |= {"V_min": row["V"] - 1.0, "V_max": row["V"] + 1.0, "alpha_min": row["alpha"], "alpha_max": row["alpha"]}
    runs = [{**r, "kind": "run", "parameter": None, "estimate": None, "why": ""} for r in rows if r["place"] == 0]
    fits = [{**r, "kind": "fit", "parameter": "ay", "r2": 0.9, "rms": 0.05} for r in runs]
    failed = {**runs[0], "flight": "broken", "key": "x", "source": "/flights/broken.csv", "status": "failed", "V": None}
    return pa.Table.from_pylist(
        [*rows, *runs, *fits, {**failed, "alpha": None, "why": "no header"}], arrow_schema(RESULTS)
    )


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found, keys = results(), ("configuration",)
    curves = envelopes(found, keys, 0)
    groups = [
        *group_rows(found, keys, starts_in(curves)),
        *flight_rows(curves),
        *step_rows(curves),
        *difference_rows(curves, keys),
    ]
    outcome = CampaignOutcome(
        FLIGHTS + 1,
        FLIGHTS,
        {"/flights/broken.csv": "no header"},
        0,
        31,
        [],
        1,
        found,
        groups,
        database_rows(curves, 0),
    )
    plan = CampaignPlan(groups=keys, methods=("ml",))
    return write_campaign_page(outcome, plan, tmp_path_factory.mktemp("campaign") / "report").parent


def test_pages_fit_and_ask_nobody_and_flights_are_a_click_away(report: Path, browser: "Browser") -> None:
    asked: list[str] = []
    page = browser.new_page()
    page.on("request", lambda request: asked.append(request.url))
    page.goto((report / "index.html").as_uri())
    for width in WIDTHS:
        page.set_viewport_size({"width": width, "height": 900})
        assert page.evaluate(OVERFLOW) == [], width
    words = page.inner_text("main")
    assert "Cn_beta (ml) of configuration=" in words
    assert "they differ" in words
    assert "f007: its estimates together" in words
    assert page.locator("#failed tbody td").all_inner_texts() == ["/flights/broken.csv", "no header"]
    drawn = {page.locator("figure").nth(i).get_attribute("id") for i in range(page.locator("figure").count())}
    assert drawn == {
        "flights_ml",
        "bounds_ml",
        "envelope",
        *(f"trend_{c}_ml" for c in ("alpha", "V", "beta_max", "delta_e")),
    }
    links = page.locator("main a").evaluate_all("list => list.map(a => a.getAttribute('href'))")
    assert len(links) == FLIGHTS + 1
    assert all((report / link).is_file() for link in links)
    page.click("main >> text=f007")
    for width in WIDTHS:
        page.set_viewport_size({"width": width, "height": 900})
        assert page.evaluate(OVERFLOW) == [], width
    assert "its estimates together" in page.inner_text("main")
    page.click("text=Campaign")
    assert page.title() == "Campaign"
    assert [url for url in asked if not url.startswith(("file://", "data:"))] == []
