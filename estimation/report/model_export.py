"""Derivatives for other programs and for papers: a model or an estimate as JSON, CSV or a LaTeX table."""

import csv
import io
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from daq.utilities.input_files import read_json
from daq.utilities.outputs import write_json, write_text
from estimation.errors import EstimationError
from estimation.models import Model, read_model
from estimation.report.names import tex
from estimation.report.tables import CANNOT_TELL, latex_text, rounded

FORMATS = (".json", ".tex", ".csv")


@dataclass(frozen=True)
class ModelRow:
    """One parameter: value, bound where there is an estimate, and belief. prior: whether the belief entered the fit. The fields
    are the columns of the CSV file."""

    name: str
    value: float
    unit: str = "1"
    std: float | None = None
    reference: float | None = None
    reference_std: float | None = None
    source: str = ""
    identifiable: bool = True
    prior: bool = False


def model_rows(model: Model) -> list[ModelRow]:
    """The parameters of a model with their start values, priors and beliefs."""
    return [
        ModelRow(p.name, p.start, p.unit, p.prior_std, p.reference, p.reference_std, p.reference_source)
        for p in model.parameters
    ]


def estimate_rows(content: dict[str, Any], path: Path) -> tuple[list[ModelRow], tuple[str, ...]]:
    """The parameters of `estimate --json` and notes on them: of the joint estimate where there is one, else of the only flight;
    by the recommended method, or where none is by the first.

    Raises EstimationError for a file with several flights and no joint estimate, or another kind of JSON.
    """
    joint, flights = content.get("joint") or {}, content.get("flights") or []
    if joint:
        methods, recommended = joint, content.get("recommended") or {}
    elif isinstance(flights, list) and len(flights) == 1:
        methods, recommended = flights[0]["methods"], flights[0].get("recommended") or {}
    else:
        raise EstimationError(
            f"{path}: {len(flights)} flights and no joint estimate; estimate with --joint, or one flight alone"
        )
    method = next((m for m in methods if m == recommended.get("method")), next(iter(methods)))
    parameters, priors = methods[method]["parameters"], content.get("priors") or {}
    rows = [
        ModelRow(
            name,
            p["estimate"],
            p.get("unit", "1"),
            p["std_coloured"] or p["std"],
            p.get("reference"),
            priors.get(name, {}).get("std"),
            p.get("reference_source", ""),
            bool(p.get("identifiable", True)),
            name in priors,
        )
        for name, p in parameters.items()
    ]
    return rows, tuple(_notes(content, method, recommended))


def _notes(content: dict[str, Any], method: str, recommended: dict[str, Any]) -> Iterator[str]:
    """Sentences on the source of the estimates, the recommendation, and the conventions of the numbers."""
    names = ", ".join(str(f["name"]) for f in content.get("flights") or [] if "name" in f)
    source = f"Aircraft {content.get('aircraft', 'unknown')}, model {content['model']}, method {method}"
    yield f"{source}; flights {names}." if names else f"{source}."
    if recommended:
        why = recommended.get("why", "")
        yield f"Nothing is recommended: {why}." if recommended.get("method") == "none" else f"Recommended: {why}."
    yield "Bound: one standard deviation, corrected for coloured residuals. Prior: a belief that entered the fit."
    for subject, meaning in (content.get("conventions") or {}).items():
        yield f"{str(subject).capitalize() if subject != 'CG' else subject}: {meaning}."


def read_rows(path: Path) -> tuple[str, list[ModelRow], tuple[str, ...]]:
    """Name, rows and notes of a model TOML or of a file by `estimate --json`. Raises EstimationError for any other file."""
    if path.suffix == ".toml":
        model = read_model(path)
        return model.name, model_rows(model), ()
    try:
        content = read_json(path, "estimate", EstimationError)
        return str(content["model"]), *estimate_rows(content, path)
    except OSError as error:
        raise EstimationError(f"{path}: cannot be read ({error.strerror}); name a model or an estimate") from error
    except (ValueError, KeyError, TypeError, AttributeError, StopIteration, RecursionError) as error:
        raise EstimationError(f"{path}: not what 'sideslip estimate --json' writes; name a model .toml") from error


def export_model(path: Path, out: Path) -> None:
    """Write the parameters of `path` in the format of `out`'s ending. Raises EstimationError."""
    _check_format(out)
    if out.exists() and path.exists() and out.samefile(path):
        raise EstimationError(f"{out}: that is the file to export; give another name")
    _write(*read_rows(path), out)


def export_estimates(content: dict[str, Any], out: Path) -> None:
    """Write the parameters in the content of `estimate --json`, in the format of `out`'s ending. Raises EstimationError."""
    _check_format(out)
    _write(str(content["model"]), *estimate_rows(content, out), out)


def _check_format(out: Path) -> None:
    if out.suffix.lower() not in FORMATS:
        raise EstimationError(f"{out}: a model is written as {', '.join(FORMATS)}; end the name in one of these")


def _write(name: str, rows: Sequence[ModelRow], notes: Sequence[str], out: Path) -> None:
    match out.suffix.lower():
        case ".json":
            write_json({"model": name, "parameters": [asdict(r) for r in rows], "notes": list(notes)}, out)
        case ".csv":
            write_csv(rows, out)
        case _:
            write_text(latex_table(rows, notes), out)


def write_csv(rows: Sequence[ModelRow], out: Path) -> None:
    """One line a parameter; empty cells are unknown."""
    buffer = io.StringIO(newline="")
    writer = csv.writer(buffer)
    writer.writerow(
        ["parameter", "value", "unit", "std", "reference", "reference_std", "source", "identifiable", "prior"]
    )
    for row in rows:
        writer.writerow(["" if v is None else v for v in asdict(row).values()])
    write_text(buffer.getvalue(), out)


def latex_table(rows: Sequence[ModelRow], notes: Sequence[str] = ()) -> str:
    """A booktabs `tabular`: symbol, value and bound rounded to the bound, belief; notes below."""
    lines = [
        r"\begin{tabular}{lrrr}",
        r"\toprule",
        r"parameter & estimate & bound & before \\",
        r"\midrule",
    ]
    for row in rows:
        if row.identifiable:
            cells = [_math(text) for text in rounded(row.value, row.std)]
        else:
            cells = [rf"\multicolumn{{2}}{{c}}{{{CANNOT_TELL}}}"]
        lines.append(rf"${tex(row.name)}$ & {' & '.join([*cells, _belief(row)])} \\")
    lines.append(r"\bottomrule")
    if notes:
        lines.append(rf"\multicolumn{{4}}{{p{{0.9\linewidth}}}}{{\footnotesize {latex_text(' '.join(notes))}}} \\")
    return "\n".join([*lines, r"\end{tabular}", ""])


def _belief(row: ModelRow) -> str:
    """The belief, its standard deviation where it entered the fit, and its source."""
    if row.reference is None:
        return ""
    spread = rf" $\pm$ {_math(f'{row.reference_std:.2g}')}" if row.prior and row.reference_std is not None else ""
    remarks = ", ".join(t for t in (latex_text(row.source), "prior" if row.prior else "") if t)
    return _math(f"{row.reference:.4g}") + spread + (f" ({remarks})" if remarks else "")


def _math(number: str) -> str:
    """A number in LaTeX's maths, with powers of ten; empty for an empty text."""
    mantissa, _, power = number.partition("e")
    return f"${mantissa}" + (rf" \times 10^{{{int(power)}}}$" if power else "$") if number else ""
