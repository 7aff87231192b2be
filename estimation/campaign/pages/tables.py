"""Tables of the campaign's page: pooled estimates, differences with their power, steps, worst channels, failures."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from estimation.campaign.tasks import Row
from estimation.report.tables import ReportTable, number, significant

if TYPE_CHECKING:
    import pyarrow as pa

WORST = 20  # channels


def pooled_table(groups: Sequence[Row], method: str) -> ReportTable | None:
    rows = [r for r in groups if r["kind"] == "pooled" and r["method"] == method]
    cells = tuple(
        (
            r["parameter"],
            r["group"] + (f", {r['since'][:10]} to {r['until'][:10]}" if r.get("since") else ""),
            str(r["flights"]),
            number(r["estimate"]),
            significant(r["std"], 2),
            significant(r["between"], 2),
            significant(r["scatter"], 2),
            significant(r["bound"], 2),
            significant(r["ratio"], 2),
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
    return (
        ReportTable(
            f"pooled_{method.replace(':', '_')}",
            f"Pooled over flights, {method}",
            head,
            cells,
            note="std: of the pooled estimate; between flights: standard deviation beyond the flights' own bounds (REML); "
            "scatter: sample standard deviation; bound: rms of the corrected bounds. Sound bounds have a ratio near 1. "
            "What a step in time moved is pooled on each side by itself, from date to date.",
        )
        if cells
        else None
    )


def power_table(groups: Sequence[Row]) -> ReportTable | None:
    rows = [r for r in groups if r["kind"] == "difference"]
    cells = tuple(
        (
            r["parameter"],
            r["method"],
            f"{r['other']} less {r['group']}",
            number(r["estimate"]),
            significant(r["std"], 2),
            significant(r["probability"], 2),
            significant(r["detectable"], 2),
            significant(r["power"], 2),
        )
        for r in sorted(rows, key=lambda r: r["probability"])
    )
    head = ("parameter", "method", "groups", "difference", "std", "probability", "detectable", "power for 5 %")
    note = "Probability heeds the number of parameters compared; detectable: the least difference found four times in five."
    return ReportTable("differences", "Differences between groups", head, cells, note=note) if cells else None


def worst_table(results: "pa.Table") -> ReportTable:
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
            r["parameter"],
            r["method"],
            r["group"],
            r["at"],
            r["flight"],
            number(r["estimate"]),
            significant(r["std"], 2),
            significant(r["probability"], 2),
        )
        for r in sorted(rows, key=lambda r: (r["at"], r["group"], r["parameter"]))
    )
    head = ("parameter", "method", "group", "from", "first flight", "change", "std", "probability")
    note = "Probability: of a step as clear as this by chance, in all parameters together and over all dates."
    return ReportTable("steps", "Steps in time", head, cells, note=note) if cells else None


def failed_table(failed: Mapping[str, str]) -> ReportTable:
    """A sentence on each flight without a usable estimate."""
    title = "Flights without a usable estimate"
    return ReportTable("failed", title, ("flight", "why"), tuple(failed.items()), symbols=False, texts=(0, 1))
