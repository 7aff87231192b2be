"""The front page of a folder of reports: key numbers and figures, what was hidden where that is known, links to each page."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from markupsafe import Markup

from estimation.report import published
from estimation.report.drawing.figures import Picture, file_picture
from estimation.report.estimate_tables import match_table
from estimation.report.page import MARK, Page, Section, box, bullets, link_back, paragraph
from estimation.report.tables import CANNOT_TELL, ReportTable, number, rounded, significant, value_and_bound
from estimation.signals.goodness_of_fit import THEIL_LIMIT

PAGES = (
    ("check", "Data compatibility", "do accelerations, rates, attitude and air data tell the same story?"),
    (
        "estimate",
        "Aerodynamic derivatives",
        "estimates with bounds, histories, residuals, modes, what could not be told",
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


HEAD = ("before [σ]", "after [σ]", "floor [σ]")
ERROR = (
    "Error: estimate of {} less truth, in its corrected bounds; constants take up the sensors' offsets and have none."
)


def write_front_page(folder: Path) -> Path:
    """Write folder/index.html from what lies in it: check/, estimate/, gap/, campaign/ (each with index.html), match.svg or
    match.png, and the JSON files check.json, estimate.json, match.json, gap.json, truth.json beside them. Missing ones are left
    out. The pages get a link back to it.

    truth.json, of simulated flights: {"derivatives": {name: value},
    "hidden": {"name": effect, "parameters": {name: [value, unit]}}}.
    """
    contents = {name: _read(folder / f"{name}.json") for name in ("check", "estimate", "match", "gap", "truth")}
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


def _key_numbers(found: dict[str, dict[str, Any] | None]) -> Markup | None:
    """Numbers in large letters, red where they are beyond their limit."""
    keys = [
        Markup('<div class="key"><b{}>{}</b><span>{}</span></div>').format(
            Markup(' class="fail"') if failed else "", value, label
        )
        for value, label, failed in _keys(found)
    ]
    return Markup('<div class="figures">{}</div>').format(Markup().join(keys)) if keys else None


def _contents(links: Sequence[tuple[str, str, str]]) -> Markup | None:
    entry = Markup('<a href="{}/index.html"><b>{}</b></a>: {}')
    return bullets(entry.format(*link) for link in links) if links else None


def _gap_section(gap: dict[str, Any] | None, hidden: dict[str, Any] | None) -> list[Section]:
    """The answer of the gap workflow, and what was hidden where that is known."""
    if not gap:
        return []
    text = box([paragraph(gap["text"])]) if gap["text"] else None
    title = f"Gap: {WORDS.get(gap.get('verdict', ''), '')}"
    return [Section("gap_answer", title, [text, _hidden(gap, hidden), _gap_table(gap)])]


def _file_links(files: Sequence[str]) -> Markup:
    links = Markup(", ").join(Markup('<a href="{}">{}</a>').format(file, file) for file in files)
    return paragraph(Markup("The same results for a program: {}.").format(links))


def _read(path: Path) -> dict[str, Any] | None:
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else None


def _lead(estimate: dict[str, Any] | None, check: dict[str, Any] | None) -> str:
    source = estimate or check
    if source is None:
        return "No results in this folder yet."
    names = ", ".join(f["name"] for f in source["flights"])
    craft = f"Aircraft {estimate['aircraft']}, model {estimate['model']}. " if estimate else ""
    return f"{craft}Flights: {names}."


def _limit(match: dict[str, Any]) -> float:
    """Limit of Theil's coefficient that a proof of match was judged by."""
    return float(match.get("limit", THEIL_LIMIT))


def _keys(found: dict[str, dict[str, Any] | None]) -> list[tuple[str, str, bool]]:
    """(value, what it is, whether it is beyond its limit)."""
    keys = []
    if (check := found["check"]) is not None:
        verdicts = [q["verdict"] for f in check["flights"] for q in f["quality"]]
        failed_counts = f"{verdicts.count('fail')} failed, {verdicts.count('warn')} warned"
        keys.append(
            (
                f"{verdicts.count('ok')} of {len(verdicts)}",
                f"data quality checks passed ({failed_counts})",
                "fail" in verdicts,
            )
        )
    if (match := found["match"]) is not None:
        theil = [c["theil"] for f in match["flights"] for c in f["fit"].values() if c["theil"] is not None]
        if theil:
            keys.append(
                (
                    f"{max(theil):.2f}",
                    f"worst Theil coefficient of the proof of match (limit {_limit(match):g})",
                    max(theil) > _limit(match),
                )
            )
    if (gap := found["gap"]) is not None:
        keys.append((WORDS.get(gap["verdict"], gap["verdict"]), "answer of the gap workflow", False))
        for step in gap["steps"][:2]:
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
        if truth:
            row += [number(truth.get(name)), _error_in_bounds(source, methods, name, truth.get(name))]
        if ours:
            published_mean = published.mean("ml", name)
            row += [
                number(published.wind_tunnel(name)),
                number(published_mean[0] if published_mean else None),
                significant(published_mean[1] if published_mean else None, 2),
            ]
        rows.append(tuple(row))
    spread = "bound" if source else "scatter"
    recommended = data.get("recommended", {}).get("method") if source else None
    truth_heads = ("truth", "error [bounds]") if truth else ()
    head = [
        "",
        *(h for _ in methods for h in ("estimate", spread)),
        *truth_heads,
        *(("value", "mean", "scatter") if ours else ()),
    ]
    titles = [f"{m} (recommended)" if m == recommended else m for m in methods]
    groups = [
        ("", 1),
        *((t, 2) for t in titles),
        *((("simulated", 2),) if truth else ()),
        *((("wind tunnel", 1), ("published, ml", 2)) if ours else ()),
    ]
    notes = [ERROR.format(methods[0])] if truth and methods else []
    notes += [published.COMPARISON] if ours else []
    caption = (
        "Joint estimates over all flights, bounds corrected for coloured residuals"
        if source
        else "Means over the flights"
    )
    return ReportTable(
        "derivatives", f"{caption} [1/rad]", tuple(head), tuple(rows), tuple(groups), note=" ".join(notes)
    )


def _error_in_bounds(source: dict[str, Any], methods: list[str], name: str, true: float | None) -> str:
    """How far the first method's joint estimate is from the truth, in its bounds."""
    entry = source[methods[0]]["parameters"].get(name) if source else None
    if true is None or entry is None or name.endswith("_0") or not entry["identifiable"] or not entry["std_coloured"]:
        return ""
    return f"{(entry['estimate'] - true) / entry['std_coloured']:+.1f}"


def _pair(entry: dict[str, Any] | None) -> list[str]:
    if entry is None:
        return ["", ""]
    if not entry["identifiable"]:
        return [value_and_bound(entry["estimate"], entry["std_coloured"])[0], CANNOT_TELL]
    return value_and_bound(entry["estimate"], entry["std_coloured"])


def _mean_pair(entry: dict[str, Any] | None) -> list[str]:
    return ["", ""] if entry is None else value_and_bound(entry["mean"], entry["std"])


def _match(data: dict[str, Any] | None) -> ReportTable | None:
    if not data or not data["flights"]:
        return None
    channels = list(data["flights"][0]["fit"])
    fits = [[flight["fit"].get(channel, {}) for channel in channels] for flight in data["flights"]]
    pairs = [[(fit.get("r2"), fit.get("theil")) for fit in flight] for flight in fits]
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
    """What was hidden in the simulated aircraft beside what the workflow says of it; None where it is not known."""
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
