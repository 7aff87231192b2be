"""What a layout becomes for one flight: read-outs on top, and no pane that has nothing to show."""

import inspect
from collections.abc import Collection, Sequence

import rerun.blueprint as rrb

from groundstation.viewer import entities as e

TOP = 0.10  # of the height: a line of read-outs from 720 lines of screen on
CONTAINERS = (rrb.Vertical, rrb.Horizontal, rrb.Tabs, rrb.Grid)


def fitted(page: rrb.Blueprint, *, live: bool, filled: Collection[str] | None = None) -> rrb.Blueprint:
    """The layout with read-outs and, live, the alarms above it.

    filled: entities with something to show, all of them where None is given; a pane without any is taken out, and so is a
    container that has no pane left.
    """
    body = page.root_container if filled is None else _kept(page.root_container, filled)
    top = _top(live=live) if filled is None or e.READOUTS in filled else None
    there = [(part, share) for part, share in ((top, TOP), (body, 1.0 - TOP)) if part is not None]
    if there:
        page.root_container = rrb.Vertical(*(p for p, _ in there), row_shares=[s for _, s in there])
    return page


def _top(*, live: bool) -> rrb.Container:
    """Read-outs; live with the alarms in words, and a lamp in the colour of the highest."""
    readouts = _bare(rrb.TextDocumentView(origin=e.READOUTS, name="Read-outs"))
    if not live:
        return rrb.Horizontal(readouts)
    words = _bare(rrb.TextDocumentView(origin=e.ALARM_WORDS, name="Alarms"))
    lamp = _bare(rrb.StateTimelineView(origin=e.ALARM, name="Alarm"))
    return rrb.Horizontal(readouts, words, lamp, column_shares=[3.4, 1.1, 0.5])


def _bare(view: rrb.View) -> rrb.View:
    """The view without its title bar: its height is that of a line of read-outs."""
    view.titlebar = False
    return view


def _kept(pane: rrb.Container | rrb.View, filled: Collection[str]) -> rrb.Container | rrb.View | None:
    """The pane with what has something to show; None where nothing of it has."""
    if not isinstance(pane, CONTAINERS):
        return pane if _shows(pane, filled) else None
    at = [(i, kept) for i, part in enumerate(pane.contents) if (kept := _kept(part, filled)) is not None]
    if not at:
        return None
    rows, columns = (_shares(s, [i for i, _ in at]) for s in (pane.row_shares, pane.column_shares))
    given = {"row_shares": rows, "column_shares": columns, "grid_columns": pane.grid_columns, "name": pane.name}
    kind = next(k for k in CONTAINERS if isinstance(pane, k))
    taken = inspect.signature(kind.__init__).parameters
    return kind(*(kept for _, kept in at), **{k: v for k, v in given.items() if k in taken and v is not None})


def _shares(shares: Sequence[float] | None, kept: Sequence[int]) -> list[float] | None:
    return None if shares is None else [shares[i] for i in kept]


def _shows(view: rrb.View, filled: Collection[str]) -> bool:
    """Whether any of the entities that a view asks for is filled."""
    asked = [view.contents] if isinstance(view.contents, str) else list(view.contents)
    for text in asked:
        entity = str(text).replace("$origin", str(view.origin)).lstrip("+ ")
        root = entity.removesuffix("/**")
        if any(f == root or (root != entity and f.startswith(f"{root}/")) for f in filled):
            return True
    return False
