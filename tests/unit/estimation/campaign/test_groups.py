"""What was planted in a table of estimates is told, and nothing else is."""

from typing import Any

import numpy as np
import pyarrow as pa

from estimation.campaign.aerodynamics.differences import difference_rows, step_rows
from estimation.campaign.aerodynamics.joint_tables import joint_model_rows
from estimation.campaign.aerodynamics.jsbsim import aerodynamics_files
from estimation.campaign.aerodynamics.tables import database_rows, envelopes, flight_rows, starts_in
from estimation.campaign.aerodynamics.terms import ConditionTerm, with_terms
from estimation.campaign.groups import claims_of as told_to_a_person
from estimation.campaign.groups import group_rows
from estimation.campaign.schema import RESULTS, arrow_schema
from estimation.models import load_model
from estimation.models.load import model_text

PARAMETERS = {"Cl_p": (-0.5, 0.01), "Cn_dr": (-0.045, 0.0008), "Cn_beta": (0.02, 0.0005)}


def results(seed: int, change: Any = None, flights: int = 40) -> pa.Table:
    """Two configurations flown in turn, a flight a day; `change(i, name, value)` plants something."""
    rng = np.random.default_rng(seed)
    rows = []
    for i in range(flights):
        for name, (true, std) in PARAMETERS.items():
            bound = std * rng.uniform(0.8, 1.3)
            value = true + float(rng.standard_normal()) * bound
            rows.append(
                {
                    "kind": "estimate",
                    "flight": f"f{i:03d}",
                    "key": f"k{i:03d}",
                    "method": "ml",
                    "parameter": name,
                    "estimate": change(i, name, value) if change else value,
                    "std_coloured": bound,
                    "identifiable": True,
                    "status": "ok",
                    "aircraft": "cdfp",
                    "configuration": "new" if i % 2 else "old",
                    "date": f"2026-{3 + i // 28:02d}-{1 + i % 28:02d}",
                }
            )
    return pa.Table.from_pylist(rows, arrow_schema(RESULTS))


def every_row(table: pa.Table, keys: tuple[str, ...]) -> list[dict[str, Any]]:
    """As a campaign puts the table of groups together."""
    curves = envelopes(table, keys, 0)
    return [
        *group_rows(table, keys, starts_in(curves)),
        *flight_rows(curves),
        *step_rows(curves),
        *difference_rows(curves, keys),
    ]


def told(table: pa.Table, keys: tuple[str, ...]) -> list[dict[str, Any]]:
    """Rows that claim something."""
    rows = every_row(table, keys)
    return [
        r for r in rows if r["kind"] in ("outlier", "step") or (r["kind"] == "difference" and r["probability"] < 0.05)
    ]


def test_a_change_of_five_percent_in_one_derivative_is_found_with_its_power() -> None:
    table = results(1, lambda i, name, value: value * 1.05 if name == "Cn_dr" and i % 2 else value)
    claims = told(table, ("aircraft", "configuration"))
    assert [(r["kind"], r["parameter"]) for r in claims] == [("difference", "Cn_dr")]
    row = claims[0]
    assert abs(abs(row["estimate"]) - 0.05 * 0.045) < 3 * row["std"]
    assert row["power"] > 0.99
    assert "they differ" in row["text"]
    quiet = [r for r in every_row(table, ("configuration",)) if r["kind"] == "difference" and r["parameter"] == "Cl_p"]
    assert "no difference found; a change of 5% would be found with probability" in quiet[0]["text"]


def test_a_step_half_way_is_found_with_its_date_and_makes_no_outliers() -> None:
    table = results(2, lambda i, name, value: value + 0.003 if name == "Cn_beta" and i >= 22 else value)
    claims = told(table, ("aircraft",))
    assert [(r["kind"], r["parameter"]) for r in claims] == [("step", "Cn_beta")]
    assert abs(claims[0]["estimate"] - 0.003) < 4 * claims[0]["std"]
    assert claims[0]["at"] == "2026-03-23"


def test_a_step_leaves_a_value_and_a_curve_on_either_side_of_what_it_moved_and_one_of_the_rest() -> None:
    table = results(2, lambda i, name, value: value + 0.003 if name == "Cn_beta" and i >= 22 else value)
    curves = envelopes(table, ("aircraft",), 0)
    database = database_rows(curves, 0)
    pooled = [r for r in every_row(table, ("aircraft",)) if r["kind"] == "pooled"]
    flown = [r for r in database if r["flown"]]
    for name, sides in (
        ("Cn_beta", [("2026-03-01", "2026-03-22"), ("2026-03-23", "2026-04-12")]),
        ("Cl_p", [(None, None)]),
    ):
        values = [r for r in pooled if r["parameter"] == name]
        assert [(r["since"], r["until"]) for r in values] == sides
        assert sorted({(r["since"], r["until"]) for r in database if r["parameter"] == name}) == sides
        for r in values:
            curve = [f for f in flown if (f["parameter"], f["since"]) == (name, r["since"])]
            assert {f["flights"] for f in curve} == {r["flights"]}
            assert abs(np.mean([f["estimate"] for f in curve]) - r["estimate"]) < 3.0 * r["std"]
    before, after = (r for r in pooled if r["parameter"] == "Cn_beta")
    assert (before["flights"], after["flights"]) == (22, 18)
    assert abs(after["estimate"] - before["estimate"] - 0.003) < 3.0 * np.hypot(before["std"], after["std"])
    assert max(before["ratio"], after["ratio"]) < 1.5  # of all flights together the scatter is three times the bounds
    newest = next(r for r in database if (r["parameter"], r["since"]) == ("Cn_beta", "2026-03-23"))
    (text,) = aerodynamics_files(database).values()
    assert f'<function name="aero/sideslip/Cn_beta">\n    <value>{newest["estimate"]:.8g}</value>' in text


def test_what_moved_after_a_step_is_said_of_a_model_over_both_sides() -> None:
    model = with_terms(load_model("lateral", "cdfp"), [ConditionTerm("Cn_beta", "beta", 2)], {})
    run = {"kind": "run", "key": "k", "group": "aircraft=cdfp", "method": "ml", "why": "terms", "flights": 40}
    table = pa.Table.from_pylist([{**run, "model_text": model_text(model)}], arrow_schema(RESULTS))
    starts = {("aircraft=cdfp", "ls", name): [("2026-03-23", "f022")] for name in ("Cn_beta", "Cn_0")}
    (row,) = joint_model_rows(table, starts)
    assert "on both sides of a step in time that moved Cn_beta (2026-03-23), and it mixes them" in row["text"]
    assert "Cn_0" not in row["text"]  # each flight has its own
    (row,) = joint_model_rows(table)
    assert "step" not in row["text"]


def test_three_bad_flights_are_outliers_and_left_out() -> None:
    bad = {7, 20, 33}
    table = results(3, lambda i, name, value: value + 0.02 * (1 + i % 3) if name == "Cn_dr" and i in bad else value)
    rows = every_row(table, ("aircraft",))
    outliers = [r["flight"] for r in rows if r["kind"] == "outlier" and r["parameter"] == "Cn_dr"]
    assert outliers == ["f007", "f020", "f033"]
    pooled = next(r for r in rows if r["kind"] == "pooled" and r["parameter"] == "Cn_dr")
    assert pooled["flights"] == 37
    assert abs(pooled["estimate"] + 0.045) < 3 * pooled["std"]


def test_a_flight_that_is_off_as_a_whole_is_told_once() -> None:
    rows = every_row(results(3, lambda i, name, value: 1.2 * value if i == 7 else value), ("aircraft",))
    assert sum(r["kind"] == "outlier" and r["flight"] == "f007" for r in rows) == 3
    claims = [r["kind"] for r in told_to_a_person(rows) if r["flight"] == "f007"]
    assert claims == ["outlying flight"]


def test_where_nothing_was_planted_hardly_anything_is_claimed() -> None:
    """Each of 20 campaigns tests differences and steps at 5 % each, and outliers of 3 parameters and 2 groups at 5 %."""
    claims = [len(told(results(100 + k), ("configuration",))) for k in range(20)]
    assert sum(claims) < 20 * 0.4 * 1.5


def test_the_order_of_rows_changes_no_bit() -> None:
    table = results(4)
    shuffled = table.take(np.random.default_rng(0).permutation(table.num_rows))
    assert every_row(table, ("configuration",)) == every_row(shuffled, ("configuration",))
