"""The page of a campaign: what was found, every flight, trends, envelope, residuals, failures, and a page of each flight."""

from pathlib import Path
from typing import Any

from estimation.campaign.claims import told
from estimation.campaign.pages.figures import bounds_figure, envelope_figure, scatter_figure, trend_figures
from estimation.campaign.pages.flights import write_flight_pages
from estimation.campaign.pages.points import points_of
from estimation.campaign.pages.tables import failed_table, pooled_table, power_table, step_table, worst_table
from estimation.campaign.plan import CampaignPlan
from estimation.campaign.run import CampaignOutcome
from estimation.report.markup.html import write_page
from estimation.report.tables import write_all

SHOWN = 60  # sentences: the tables hold all


def write_campaign_page(outcome: CampaignOutcome, plan: CampaignPlan, folder: Path) -> Path:
    """Write folder/index.html with everything inside, its tables as CSV and LaTeX in folder/tables, and folder/flights."""
    said = [r["text"] for r in told(outcome.groups)]
    pooled = [t for method in plan.methods if (t := pooled_table(outcome.groups, method)) is not None]
    power, steps = power_table(outcome.groups), step_table(outcome.groups)
    worst, failures = worst_table(outcome.results), failed_table(outcome.failed)
    write_all([*pooled, worst, failures, *(t for t in (power, steps) if t is not None)], folder / "tables")
    flights = write_flight_pages(outcome.results, outcome.groups, plan.groups, folder)
    points = {method: points_of(outcome.results, method, plan.groups) for method in plan.methods}
    bounds = [f for method in plan.methods if (f := bounds_figure(method, outcome.groups)) is not None]
    context: dict[str, Any] = {
        "list": flights,
        "flights": outcome.flights,
        "done": outcome.done,
        "failed": outcome.failed,
        "failures": failures,
        "said": said[:SHOWN],
        "more": max(0, len(said) - SHOWN),
        "power": power,
        "steps": steps,
        "pooled": pooled,
        "worst": worst,
        "bounds": bounds,
        "scatter": [scatter_figure(method, p, outcome.groups) for method, p in points.items() if p],
        "trends": [f for method, p in points.items() if p for f in trend_figures(method, p, outcome.database)],
        "envelope": envelope_figure(outcome.results, plan.groups),
    }
    lead = f"Model {plan.model}; methods: {', '.join(plan.methods)}; groups by {', '.join(plan.groups) or 'nothing'}."
    return write_page(folder / "index.html", "campaign.html.j2", title="Campaign", lead=lead, **context)
