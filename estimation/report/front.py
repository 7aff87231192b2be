"""The front page of a folder of reports: the key numbers and figures, and links to each page."""

import json
from pathlib import Path
from typing import Any

from estimation.report import published
from estimation.report.figures import Picture, file_picture
from estimation.report.html import write_page
from estimation.report.tables import CANNOT_TELL, Table, number, significant

PAGES = (
    ("check", "Data compatibility", "do accelerations, rates, attitude and air data tell the same story?"),
    (
        "estimate",
        "Aerodynamic derivatives",
        "estimates with bounds, histories, residuals, modes, what could not be told",
    ),
    ("gap", "Gap workflow", "what the model was missing, how it was found and what adding it changed"),
)
WORDS = {
    "no_gap": "no gap", "gap_closed": "gap closed", "gap_reduced": "gap reduced", "unknown_effect": "unknown effect",
    "cannot_tell": "cannot tell",
}  # fmt: skip


def write_front_page(folder: Path) -> Path:
    """Write folder/index.html from what lies in it: check/, estimate/, gap/ (each with index.html), match.png, and the
    JSON files check.json, estimate.json, match.json, gap.json beside them. Missing ones are left out."""
    found = {name: _read(folder / f"{name}.json") for name in ("check", "estimate", "match", "gap")}
    links = [(f"{n}/index.html", title, about) for n, title, about in PAGES if (folder / n / "index.html").is_file()]
    return write_page(
        folder / "index.html", "front.html.j2",
        title="Flight-test report", lead=_lead(found["estimate"], found["check"]), links=links,
        keys=_keys(found), tables=[t for t in (_derivatives(found["estimate"]), _match(found["match"])) if t is not None],
        match_figure=_match_figure(folder), gap=found["gap"], verdict=WORDS.get((found["gap"] or {}).get("verdict", ""), ""),
        files=[f"{n}.json" for n, data in found.items() if data is not None],
    )  # fmt: skip


def _read(path: Path) -> dict[str, Any] | None:
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else None


def _lead(estimate: dict[str, Any] | None, check: dict[str, Any] | None) -> str:
    some = estimate or check
    if some is None:
        return "No results in this folder yet."
    names = ", ".join(f["name"] for f in some["flights"])
    craft = f"Aircraft {estimate['aircraft']}, model {estimate['model']}. " if estimate else ""
    return f"{craft}Flights: {names}."


def _keys(found: dict[str, dict[str, Any] | None]) -> list[tuple[str, str]]:
    keys = []
    if (check := found["check"]) is not None:
        verdicts = [q["verdict"] for f in check["flights"] for q in f["quality"]]
        bad = f"{verdicts.count('fail')} failed, {verdicts.count('warn')} warned"
        keys.append((f"{verdicts.count('ok')} of {len(verdicts)}", f"data quality checks passed ({bad})"))
    if (match := found["match"]) is not None:
        theil = [c["theil"] for f in match["flights"] for c in f["fit"].values() if c["theil"] is not None]
        if theil:
            keys.append((f"{max(theil):.2f}", "worst Theil coefficient of the proof of match (0 perfect, 1 hopeless)"))
    if (gap := found["gap"]) is not None:
        keys.append((WORDS.get(gap["verdict"], gap["verdict"]), "answer of the gap workflow"))
        for step in gap["steps"][:2]:
            closed = (step["holdout"] or step["gap"])["closed"]
            where = "on the held-out flight" if step["holdout"] else "on the training flights"
            if closed is not None:
                keys.append((f"{closed:.0%}", f"of the gap closed by {step['effect']} {where}"))
    return keys


def _derivatives(data: dict[str, Any] | None) -> Table | None:
    """The joint estimates, or the means over flights, beside the wind tunnel and the published means."""
    if not data:
        return None
    source = data["joint"] or {}
    methods = list(source or data["mean"])
    names = (
        list(next(iter((source[m]["parameters"] if source else data["mean"][m]) for m in methods))) if methods else []
    )
    ours = published.is_of(data["aircraft"])
    rows = []
    for name in names:
        row = [name]
        for method in methods:
            row += (
                _pair(source[method]["parameters"].get(name)) if source else _mean_pair(data["mean"][method].get(name))
            )
        if ours:
            said = published.mean("ml", name)
            row += [
                number(published.wind_tunnel(name)),
                number(said[0] if said else None),
                significant(said[1] if said else None, 2),
            ]
        rows.append(tuple(row))
    spread = "bound" if source else "scatter"
    head = ["", *(h for _ in methods for h in ("estimate", spread)), *(("value", "mean", "scatter") if ours else ())]
    best = data.get("recommended", {}).get("method") if source else None
    titles = [f"{m} (recommended)" if m == best else m for m in methods]
    groups = [("", 1), *((t, 2) for t in titles), *((("wind tunnel", 1), ("published, ml", 2)) if ours else ())]
    what = (
        "Joint estimates over all flights, bounds corrected for coloured residuals"
        if source
        else "Means over the flights"
    )
    return Table("derivatives", f"{what} [1/rad]", tuple(head), tuple(rows), tuple(groups),
                 note=published.COMPARISON if ours else "")  # fmt: skip


def _pair(entry: dict[str, Any] | None) -> list[str]:
    if entry is None:
        return ["", ""]
    if not entry["identifiable"]:
        return [number(entry["estimate"]), CANNOT_TELL]
    return [number(entry["estimate"]), significant(entry["std_coloured"], 2)]


def _mean_pair(entry: dict[str, Any] | None) -> list[str]:
    return ["", ""] if entry is None else [number(entry["mean"]), significant(entry["std"], 2)]


def _match(data: dict[str, Any] | None) -> Table | None:
    if not data or not data["flights"]:
        return None
    channels = list(data["flights"][0]["fit"])
    rows = []
    for flight in data["flights"]:
        row = [flight["name"]]
        for channel in channels:
            fit = flight["fit"].get(channel, {})
            row += [number(fit.get("r2"), 3), number(fit.get("theil"), 3)]
        rows.append(tuple(row))
    return Table("match", "Proof of match: flights predicted with parameters frozen",
                 ("flight", *(h for _ in channels for h in ("r²", "Theil"))), tuple(rows),
                 (("", 1), *((c, 2) for c in channels)), symbols=False)  # fmt: skip


def _match_figure(folder: Path) -> Picture | None:
    path = folder / "match.png"
    return (
        file_picture(path, "match_figure", "Measured and predicted motion, parameters frozen.")
        if path.is_file()
        else None
    )
