"""The front page of a folder of reports: key numbers and figures, hidden effects of simulated flights, links to each page."""

import json
import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from markupsafe import Markup

from estimation.report import published
from estimation.report.drawing.figures import Picture, file_picture
from estimation.report.estimate_tables import ColumnGroup, grouped_table, match_table, published_cells
from estimation.report.page import MARK, Page, Section, box, bullets, link_back, paragraph
from estimation.report.tables import CANNOT_TELL, ReportTable, number, rounded, value_and_bound
from estimation.signals.goodness_of_fit import THEIL_LIMIT

PAGES = (
    ("check", "Data compatibility", "do accelerations, rates, attitude and air data tell the same story?"),
    (
        "estimate",
        "Aerodynamic derivatives",
        "estimates with bounds, histories, residuals, modes, what is not identifiable",
    ),
    ("gap", "Gap workflow", "what the model was missing, how it was found and what adding it changed"),
    ("campaign", "Campaign", "many flights together"),
)
WORDS = {
    "no_gap": "no gap",
    "gap_closed": "gap closed",
    "gap_reduced": "gap reduced",
    "unknown_effect": "unknown effect",
    "cannot_tell": "cannot tell",
}


MOST_STEPS = 2  # effects of the gap workflow among the key numbers
HEAD = ("before [σ]", "after [σ]", "floor [σ]")
ERROR = (
    "Error: estimate of {} less truth, in its corrected bounds; constants take up the sensors' offsets and have none."
)


def write_front_page(folder: Path) -> Path:
    """Write folder/index.html from the folder's content: check/, estimate/, gap/, campaign/ (each with index.html), match.svg or
    match.png, and check.json, estimate.json, match.json, gap.json, truth.json. Missing ones are left out. The pages get a link
    back to it. Returns its path.

    truth.json, of simulated flights: {"derivatives": {name: value},
    "hidden": {"name": effect, "parameters": {name: [value, unit]}}}.
    """
    contents = {name: _read_json(folder / f"{name}.json") for name in ("check", "estimate", "match", "gap", "truth")}
    links = [(n, title, description) for n, title, description in PAGES if (folder / n / "index.html").is_file()]
    files = [f"{name}.json" for name, data in contents.items() if data is not None]
    sections = [
        Section("", "", [_key_numbers(contents), _contents(links)]),
        *_gap_section(contents["gap"], (contents["truth"] or {}).get("hidden")),
    ]
    derivatives = _derivatives(contents["estimate"], (contents["truth"] or {}).get("derivatives", {}))
    if derivatives is not None:
        sections.append(Section("aerodynamic", "Aerodynamic derivatives", [derivatives]))
    match = _match(contents["match"])
    if match is not None:
        sections.append(Section("proof", "Proof of match", [match, _match_figure(folder)]))
    if files:
        sections.append(Section("files", "Files", [_file_links(files)]))
    lead = _lead(contents["estimate"], contents["check"])
    navigation = [(f"{name}/index.html", title) for name, title, _ in links]
    page = Page("Flight-test report", lead, sections, navigation, back="", mark=MARK)
    page_path = page.write(folder / "index.html")
    for name, *_ in links:
        link_back(folder / name / "index.html")
    return page_path


def _key_numbers(contents: dict[str, dict[str, Any] | None]) -> Markup | None:
    """Key numbers in large letters, red where they are beyond their limit."""
    keys = [
        Markup('<div class="key"><b{}>{}</b><span>{}</span></div>').format(
            Markup(' class="fail"') if failed else "", value, label
        )
        for value, label, failed in _keys(contents)
    ]
    return Markup('<div class="figures">{}</div>').format(Markup().join(keys)) if keys else None


def _contents(links: Sequence[tuple[str, str, str]]) -> Markup | None:
    entry = Markup('<a href="{}/index.html"><b>{}</b></a>: {}')
    return bullets(entry.format(*link) for link in links) if links else None


def _gap_section(gap: dict[str, Any] | None, hidden: dict[str, Any] | None) -> list[Section]:
    """The answer of the gap workflow, and the hidden effect where it is known."""
    if not gap:
        return []
    text = box([paragraph(gap["text"])]) if gap["text"] else None
    title = f"Gap: {WORDS.get(gap.get('verdict', ''), '')}"
    return [Section("gap_answer", title, [text, _hidden(gap, hidden), _gap_table(gap)])]


def _file_links(files: Sequence[str]) -> Markup:
    links = Markup(", ").join(Markup('<a href="{}">{}</a>').format(file, file) for file in files)
    return paragraph(Markup("The same results for a program: {}.").format(links))


def _read_json(path: Path) -> dict[str, Any] | None:
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else None


def _lead(estimate: dict[str, Any] | None, check: dict[str, Any] | None) -> str:
    source = estimate or check
    if source is None:
        return "No results in this folder yet."
    names = ", ".join(f["name"] for f in source["flights"])
    aircraft_text = f"Aircraft {estimate['aircraft']}, model {estimate['model']}. " if estimate else ""
    return f"{aircraft_text}Flights: {names}."


def _limit(match: dict[str, Any]) -> float:
    """Limit of Theil's coefficient in a proof of match."""
    return float(match.get("limit", THEIL_LIMIT))


def _channel_limit(match: dict[str, Any], channel: dict[str, Any]) -> float:
    """Largest Theil's coefficient of a channel that matches: the limit, in excess of what its noise alone causes."""
    return math.hypot(_limit(match), channel.get("noise") or 0.0)


def _keys(contents: dict[str, dict[str, Any] | None]) -> list[tuple[str, str, bool]]:
    """(value, description, whether it is beyond its limit)."""
    keys = []
    if (check := contents["check"]) is not None:
        verdicts = [q["verdict"] for f in check["flights"] for q in f["quality"]]
        failed_counts = f"{verdicts.count('fail')} failed, {verdicts.count('warn')} warned"
        keys.append(
            (
                f"{verdicts.count('ok')} of {len(verdicts)}",
                f"data quality checks passed ({failed_counts})",
                "fail" in verdicts,
            )
        )
    if (match := contents["match"]) is not None:
        channels = [c for f in match["flights"] for c in f["fit"].values() if c["theil"] is not None]
        if channels:
            worst = max(channels, key=lambda c: c["theil"] / _channel_limit(match, c))
            limit = _channel_limit(match, worst)
            words = f"Theil's coefficient of the worst channel in the proof of match (limit {limit:.2g} with its noise)"
            keys.append((f"{worst['theil']:.2f}", words, worst["theil"] > limit))
    if (gap := contents["gap"]) is not None:
        keys.append((WORDS.get(gap["verdict"], gap["verdict"]), "answer of the gap workflow", False))
        for step in gap["steps"][:MOST_STEPS]:
            closed = (step["holdout"] or step["gap"])["closed"]
            flights_text = "on the held-out flight" if step["holdout"] else "on the training flights"
            if closed is not None:
                keys.append((f"{closed:.0%}", f"of the gap closed by {step['effect']} {flights_text}", False))
    return keys


def _derivatives(data: dict[str, Any] | None, truth: dict[str, float]) -> ReportTable | None:
    """The joint estimates, or the means over flights, beside the truth of simulated flights, the wind tunnel and the published
    means."""
    if not data:
        return None
    joint = data["joint"] or {}
    tables = {m: fit["parameters"] for m, fit in joint.items()} or data["mean"]
    methods = list(tables)
    recommended = data.get("recommended", {}).get("method") if joint else None
    groups: list[ColumnGroup] = []
    for method, entries in tables.items():
        label = f"{method} (recommended)" if method == recommended else method
        cells = partial(_estimate_cells, entries)
        groups.append((label, ("estimate", "corrected" if joint else "scatter"), cells))
    if truth:
        groups.append(("simulated", ("truth", "error [bounds]"), partial(_truth_cells, joint, methods, truth)))
    ours = published.is_of(data["aircraft"])
    if ours:
        groups.append(("wind tunnel", ("value",), lambda name: [number(published.wind_tunnel(name))]))
        groups.append(("published, ml", ("mean", "scatter"), published_cells(partial(published.mean, "ml"))))
    notes = [ERROR.format(methods[0])] if truth and methods else []
    notes += [published.COMPARISON] if ours else []
    caption = "Means over the flights"
    if joint:
        caption = "Joint estimates over all flights, bounds corrected for coloured residuals"
    parameters = list(next(iter(tables.values()), ()))
    return grouped_table("derivatives", f"{caption} [1/rad]", parameters, groups, " ".join(notes))


def _truth_cells(joint: dict[str, Any], methods: list[str], truth: dict[str, float], name: str) -> list[str]:
    """The true value, and the error of the first method's joint estimate in its bounds."""
    entry = joint[methods[0]]["parameters"].get(name) if joint else None
    true = truth.get(name)
    if true is None or entry is None or name.endswith("_0") or not entry["identifiable"] or not entry["std_coloured"]:
        return [number(true), ""]
    return [number(true), f"{(entry['estimate'] - true) / entry['std_coloured']:+.1f}"]


def _estimate_cells(entries: dict[str, Any], name: str) -> list[str]:
    """An estimate and its bound, or a mean and its scatter."""
    entry = entries.get(name)
    if entry is None:
        return ["", ""]
    if "mean" in entry:
        return value_and_bound(entry["mean"], entry["std"])
    cells = value_and_bound(entry["estimate"], entry["std_coloured"])
    return cells if entry["identifiable"] else [cells[0], CANNOT_TELL]


def _match(data: dict[str, Any] | None) -> ReportTable | None:
    if not data or not data["flights"]:
        return None
    channels = list(data["flights"][0]["fit"])
    fits = [[flight["fit"].get(channel, {}) for channel in channels] for flight in data["flights"]]
    pairs = [[(fit.get("r2"), fit.get("theil"), _channel_limit(data, fit)) for fit in flight] for flight in fits]
    proofs = zip([(flight["name"],) for flight in data["flights"]], pairs, strict=True)
    caption = "Proof of match: flights predicted with parameters frozen"
    return match_table("match", caption, ("flight",), channels, proofs, _limit(data))


def _gap_table(data: dict[str, Any] | None) -> ReportTable | None:
    """Each effect with its gap before and after, on the training flights and on those held out."""
    if not data or not data["steps"]:
        return None
    rows = []
    for step in data["steps"]:
        holdout_gap = step["holdout"] or {}
        cells = [number(step["gap"][k], 2) for k in ("before", "after", "floor")]
        cells += [number(holdout_gap.get(k), 2) for k in ("before", "after")]
        size = "; ".join(_size(name, e) for name, e in step["parameters"].items())
        rows.append((step["effect"], step["title"], size, number(step["confidence"], 2), *cells))
    return ReportTable(
        "gap",
        "Effects, with the disagreement in units of the measurement noise σ",
        ("effect", "what it is", "estimate", "weight", *HEAD, *HEAD[:2]),
        tuple(rows),
        (("", 4), ("training flights", 3), ("held-out flights", 2)),
        symbols=False,
        texts=(1, 2),
    )


def _size(name: str, entry: dict[str, Any]) -> str:
    """`Cn_da = -0.0102 ± 0.0006 1/rad`."""
    value = " ± ".join(text for text in rounded(entry["estimate"], entry["std"]) if text)
    unit = str(entry.get("unit", ""))
    return f"{name} = {value} {'' if unit == '1' else unit}".strip()


def _hidden(gap: dict[str, Any] | None, hidden: dict[str, Any] | None) -> ReportTable | None:
    """The effect hidden in the simulated aircraft beside the workflow's answer; None where it is not known."""
    if not gap or not hidden:
        return None
    step = next((s for s in gap["steps"] if hidden["name"] in (s["effect"], *(m["effect"] for m in s["set"]))), None)
    parameters = {} if step is None else step["parameters"]
    if step is None:
        verdict = "not found"
    else:
        verdict = "named" if step["effect"] == hidden["name"] else f"among those that {step['effect']} stands for"
    rows = []
    for name, (value, unit) in hidden["parameters"].items():
        estimate, bound = value_and_bound(
            *((parameters[name]["estimate"], parameters[name]["std"]) if name in parameters else (None, None))
        )
        rows.append((hidden["name"], name, number(value), estimate, bound, unit or "1", verdict))
    return ReportTable(
        "hidden",
        "The hidden effect",
        ("effect", "parameter", "truth", "estimate", "bound", "unit", "answer"),
        tuple(rows),
        symbols=False,
        texts=(6,),
        failed=frozenset({(i, 6) for i in range(len(rows))} if step is None else set()),
    )


def _match_figure(folder: Path) -> Picture | None:
    paths = [folder / "match.svg", folder / "match.png"]
    path = next((p for p in paths if p.is_file()), None)
    return (
        None
        if path is None
        else file_picture(path, "match_figure", "Measured and predicted motion, parameters frozen.")
    )
