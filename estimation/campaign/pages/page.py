"""The page of a campaign: claims, every flight, trends, envelope, residuals and failures; and a page for each flight."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from markupsafe import Markup

from estimation.campaign.groups import claims_of
from estimation.campaign.pages.figures import bounds_figure, envelope_figure, scatter_figure, trend_figures
from estimation.campaign.pages.flights import write_flight_pages
from estimation.campaign.pages.points import method_stem, points_of
from estimation.campaign.plan import CampaignPlan
from estimation.campaign.run import CampaignOutcome
from estimation.campaign.tasks import Row
from estimation.report.page import Page, Part, Section, box, breakable, bullets, coloured, paragraph
from estimation.report.tables import ReportTable, number, significant

if TYPE_CHECKING:
    import pyarrow as pa

SHOWN = 60  # sentences; groups.parquet has all
WORST = 20  # channels in the table of the worst residuals


def write_campaign_page(outcome: CampaignOutcome, plan: CampaignPlan, folder: Path) -> Path:
    """Write folder/index.html, its tables as CSV and LaTeX in folder/tables, and the pages in folder/flights."""
    claims = [r["text"] for r in claims_of(outcome.groups)]
    failures = failed_table(outcome.failed)
    flights = write_flight_pages(outcome.results, outcome.groups, plan.groups, folder)
    points = {
        m: estimate_points for m in plan.methods if (estimate_points := points_of(outcome.results, m, plan.groups))
    }
    envelope = envelope_figure(outcome.results, plan.groups)
    pooled = [pooled_table(outcome.groups, method) for method in plan.methods]
    bounds = [bounds_figure(method, outcome.groups) for method in plan.methods]
    trends = [
        f
        for method, estimate_points in points.items()
        for f in trend_figures(method, estimate_points, outcome.database)
    ]
    scatter = [scatter_figure(method, estimate_points, outcome.groups) for method, estimate_points in points.items()]
    sections = [
        Section("", "", [_status_box(outcome)]),
        Section("found", "Found", _found_parts(claims, outcome.groups), "Found"),
        Section("pooled", "Pooled estimates", [*pooled, *bounds], "Pooled"),
        Section("scatter", "Every flight", scatter, "Scatter"),
        Section("trends", "Trends over conditions", trends, "Trends"),
        Section(
            "envelope",
            "Envelope flown",
            [envelope or paragraph("Angle of attack or airspeed was not measured.")],
            "Envelope",
        ),
        Section("worst", "Worst residuals", [worst_table(outcome.results)], "Residuals"),
        Section(
            "failed",
            "Flights without a usable estimate",
            [failures if outcome.failed else paragraph("None.")],
            "Failed",
        ),
        Section("flights", "Flights", [flights], "Flights"),
    ]
    lead = f"Model {plan.model}; methods: {', '.join(plan.methods)}; groups by {', '.join(plan.groups) or 'nothing'}."
    return Page("Campaign", lead, sections, beside=[failures]).write(folder / "index.html", folder / "tables")


def _status_box(outcome: CampaignOutcome) -> Markup:
    missing = ", " + coloured(f"{len(outcome.failed)} not", "fail") if outcome.failed else Markup()
    counts = Markup("{} flights: {}{}.").format(outcome.flights, coloured(f"{outcome.done} estimated", "ok"), missing)
    return box([paragraph(counts)], warn=bool(outcome.failed))


def _found_parts(claims: Sequence[str], groups: Sequence[Row]) -> list[Part]:
    """The claims that a person must read first, steps in time, and the power of the comparisons."""
    parts: list[Part] = [paragraph("No outlier, no step in time and no difference between groups was found.")]
    if claims:
        parts = [bullets(breakable(text) for text in claims[:SHOWN])]
    if len(claims) > SHOWN:
        parts.append(paragraph(f"{len(claims) - SHOWN} more in groups/groups.parquet.", "note"))
    power = power_table(groups)
    return [*parts, step_table(groups), paragraph("What could have been found:") if power else None, power]


def pooled_table(groups: Sequence[Row], method: str) -> ReportTable | None:
    """The pooled estimates of all groups by a method."""
    rows = [r for r in groups if r["kind"] == "pooled" and r["method"] == method]
    cells = tuple(
        (
            r["parameter"],
            r["group"] + (f", {r['since'][:10]} to {r['until'][:10]}" if r.get("since") else ""),
            str(r["flights"]),
            number(r["estimate"]),
            *(significant(r[name], 2) for name in ("std", "between", "scatter", "bound", "ratio")),
        )
        for r in sorted(rows, key=lambda r: (r["parameter"], r["group"], r.get("since") or ""))
    )
    head = (
        "parameter",
        "group",
        "flights",
        "estimate",
        "std",
        "between flights",
        "scatter",
        "bound",
        "scatter / bound",
    )
    note = (
        "std: of the pooled estimate; between flights: standard deviation beyond the flights' own bounds (REML); "
        "scatter: sample standard deviation; bound: rms of the corrected bounds. Sound bounds have a ratio near 1. "
        "What a step in time moved is pooled on each side by itself, from date to date."
    )
    name, caption = f"pooled_{method_stem(method)}", f"Pooled over flights, {method}"
    return ReportTable(name, caption, head, cells, note=note) if cells else None


def power_table(groups: Sequence[Row]) -> ReportTable | None:
    """Differences between groups, with those that could have been found."""
    rows = [r for r in groups if r["kind"] == "difference"]
    cells = tuple(
        (
            r["parameter"],
            r["method"],
            f"{r['other']} less {r['group']}",
            number(r["estimate"]),
            *(significant(r[name], 2) for name in ("std", "probability", "detectable", "power")),
        )
        for r in sorted(rows, key=lambda r: r["probability"])
    )
    head = ("parameter", "method", "groups", "difference", "std", "probability", "detectable", "power for 5 %")
    note = "Probability allows for the number of parameters compared; detectable: the least difference found four times in five."
    return ReportTable("differences", "Differences between groups", head, cells, note=note) if cells else None


def worst_table(results: "pa.Table") -> ReportTable:
    """The channels of least R2, of all flights and methods."""
    import pyarrow.compute as pc

    fits = results.filter(pc.and_(pc.equal(results["kind"], "fit"), pc.is_valid(results["r2"])))
    rows = fits.sort_by([("r2", "ascending"), ("flight", "ascending"), ("parameter", "ascending")]).slice(0, WORST)
    cells = tuple(
        (str(r["flight"]), r["method"], r["parameter"], number(r["r2"], 3), significant(r["rms"]), r["status"])
        for r in rows.to_pylist()
    )
    head = ("flight", "method", "channel", "r²", "rms [SI]", "status")
    return ReportTable("worst", f"The {WORST} channels that the model explains least", head, cells, symbols=False)


def step_table(groups: Sequence[Row]) -> ReportTable | None:
    """Every parameter that a step in time moved."""
    rows = [r for r in groups if r["kind"] == "step" and r.get("parameter")]
    cells = tuple(
        (
            *(r[name] for name in ("parameter", "method", "group", "at", "flight")),
            number(r["estimate"]),
            *(significant(r[name], 2) for name in ("std", "probability")),
        )
        for r in sorted(rows, key=lambda r: (r["at"], r["group"], r["parameter"]))
    )
    head = ("parameter", "method", "group", "from", "first flight", "change", "std", "probability")
    note = "Probability: of a step as clear as this by chance, in all parameters together and over all dates."
    return ReportTable("steps", "Steps in time", head, cells, note=note) if cells else None


def failed_table(failed: Mapping[str, str]) -> ReportTable:
    """Each flight without a usable estimate, with the reason."""
    title = "Flights without a usable estimate"
    return ReportTable("failed", title, ("flight", "why"), tuple(failed.items()), symbols=False, texts=(0, 1))
