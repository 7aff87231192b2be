"""Notes of a flight: facts are found by their kind, and kinds go through files."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from estimation.models import Signal, load_model
from estimation.prepare.pipeline import prepare
from groundstation.flight import Flight, read_flight, write_flight
from groundstation.flight.findings import (
    Finding,
    FindingKind,
    finding_texts,
    from_meta,
    to_meta,
    unknown_columns,
    without_repeats,
)
from groundstation.flight.quality.report import time_order
from tests.support.paths import ROOT


def flight(*notes: Finding | str, **columns: np.ndarray) -> Flight:
    time = np.arange(40) / 20
    return Flight.build("f", time, {"p": np.sin(time), **columns}, notes=notes)


def test_the_check_of_time_order_goes_by_kind_and_not_by_words() -> None:
    assert time_order(flight("the pilot said that time runs backwards up there")).severity == "ok"
    told = time_order(flight(Finding(FindingKind.TIME_ORDER, "3 rows put where they belong")))
    assert (told.severity, told.text) == ("warn", "3 rows put where they belong")


@pytest.mark.parametrize("suffix", [".mcap"])
def test_kinds_go_through_a_file(tmp_path: Path, suffix: str) -> None:
    shuffled = np.array([*range(30), *range(35, 29, -1), *range(36, 60)]) / 20 + np.repeat([0.0, 9.0], 30)
    before = Flight.build("f", shuffled, {"p": np.ones(60), "odd": np.ones(60)}, notes=["plain"])
    write_flight(before, tmp_path / f"f{suffix}")
    after = read_flight(tmp_path / f"f{suffix}")
    assert [n.kind for n in before.notes] == [FindingKind.OTHER, FindingKind.TIME_ORDER, FindingKind.GAP]
    assert after.notes[:3] == before.notes[:1] + before.notes[1:]  # the gap is found again, and said once
    assert after.notes[3] == unknown_columns({"odd": "odd"})
    assert time_order(after) == time_order(before)


def test_a_file_without_kinds_is_read_and_a_gap_in_it_said_once(tmp_path: Path) -> None:
    old = from_meta({"notes": ["gap of 9 s", "7"]})
    assert old == [Finding(FindingKind.OTHER, "gap of 9 s"), Finding(FindingKind.OTHER, "7")]
    assert without_repeats([*old, Finding(FindingKind.GAP, "gap of 9 s")]) == (
        Finding(FindingKind.GAP, "gap of 9 s"),
        old[1],
    )
    newer = {"notes": ["x"], "facts": [{"note": 0, "kind": "from the future", "columns": []}]}
    assert from_meta(newer) == [Finding(FindingKind.OTHER, "x")]
    notes = [Finding(FindingKind.OTHER, "a"), unknown_columns({"hohe": "Höhe", "odd": "odd"})]
    assert from_meta(to_meta(notes)) == notes
    assert "facts" not in to_meta(notes[:1])


def test_columns_that_the_model_knows_are_not_called_unknown(clean: Flight) -> None:
    lateral = load_model("lateral", "cdfp")
    model = replace(lateral, inputs=(*lateral.inputs, Signal("weight", "kg")))
    added = clean.with_columns(weight=np.full(len(clean), 8.5), odd=np.ones(len(clean)))
    both = added.with_notes(unknown_columns({"weight": "Gewicht, kg: as is", "odd": "odd, too"}))
    assert finding_texts(prepare(lateral, both).notes)[0].endswith("Gewicht, kg: as is as weight, odd, too as odd")
    assert (
        finding_texts(prepare(model, both).notes)[0]
        == "columns not known to Sideslip, kept as they are: odd, too as odd"
    )
    none_left = added.with_notes(unknown_columns({"weight": "weight"}))
    assert all(n.kind is not FindingKind.UNKNOWN_COLUMNS for n in prepare(model, none_left).notes)


@pytest.fixture(scope="module")
def clean() -> Flight:
    """A recorded flight."""
    return replace(read_flight(ROOT / "recordings" / "cdfp_ld1.mcap"), notes=())
