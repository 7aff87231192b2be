"""Notes on flights for a page: each said once, with the flights it is of."""

from collections.abc import Iterable

from estimation.report.tables import ReportTable


def notes_table(notes: Iterable[tuple[str, str]]) -> ReportTable | None:
    """Notes as (flight, sentence) as a table of sentences; None where there are none."""
    by = collected((text, flight) for flight, text in notes)
    if not by:
        return None
    rows = tuple((text, ", ".join(flights)) for text, flights in by.items())
    return ReportTable("notes", "Notes on the flights", ("note", "flights"), rows, symbols=False, texts=(0, 1))


def collected(pairs: Iterable[tuple[str, str]]) -> dict[str, list[str]]:
    """Second members by the first, each once, in their order."""
    by: dict[str, dict[str, None]] = {}
    for key, value in pairs:
        by.setdefault(key, {})[value] = None
    return {key: list(values) for key, values in by.items()}
