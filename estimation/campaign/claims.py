"""What of the table of groups is said to a person, in the terminal and on the page."""

from collections.abc import Sequence

from estimation.campaign.pooling import LEVEL
from estimation.campaign.tasks import Row

FIRST = ("difference", "step", "envelope", "outlying flight", "outlier")
"""Kinds that say something, those about the aircraft before those about single flights."""


def told(groups: Sequence[Row]) -> list[Row]:
    """Rows that say something that a person must read, the most important first. A flight that is off as a whole is told once,
    not for each of its parameters again."""
    whole = {(r["group"], r["method"], r["flight"]) for r in groups if r["kind"] == "outlying flight"}
    claims = [
        r
        for r in groups
        if r["kind"] in FIRST
        and (r["kind"] != "difference" or r["probability"] <= LEVEL)
        and (r["kind"] != "outlier" or (r["group"], r["method"], r["flight"]) not in whole)
    ]
    return sorted(claims, key=lambda r: FIRST.index(r["kind"]))
