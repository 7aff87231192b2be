"""The page on published problems: what of it needs nobody's data is followed on simulated records of the same form."""

import csv
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.cli.docs.blocks import commands_of
from tests.cli.docs.follow import follow
from tests.unit.estimation.campaign.running import ROOT

PAGE = ROOT / "docs" / "validation" / "published.md"
TRUTH = {"Z_w": -1.4249, "Z_de": -6.2632, "M_w": 0.2163, "M_q": -3.7067, "M_de": -12.784}
SPEED, Z_Q, FEEDBACK = 44.5695, -1.4768, 0.025
STEP, EVERY = 0.001, 50  # s, steps between samples
PILOT = ((1.0, 2.0, 2.0), (2.0, 3.0, -2.0), (8.0, 8.9, 2.0), (8.9, 9.5, -2.0), (9.5, 9.8, 2.0), (9.8, 10.1, -2.0),
         (14.0, 15.5, 1.4))  # s, s, deg  # fmt: skip
SIGMA = {"W": 0.05, "Q": 0.001, "AZ": 0.05}


def unstable(rng: np.random.Generator) -> list[dict[str, str]]:
    """20 s of the unstable short period under a pilot and feedback, integrated by itself at 1 kHz; columns as in the book."""
    w = q = stick = 0.0
    rows = []
    for k in range(20_000):
        t = k * STEP
        wanted = np.radians(sum(size for begin, end, size in PILOT if begin < t < end))
        stick += STEP * (wanted - stick) / 0.15
        de = stick + FEEDBACK * w
        az = TRUTH["Z_w"] * w + Z_Q * q + TRUTH["Z_de"] * de
        if k % EVERY == 0:
            seen = {n: v + SIGMA[n] * rng.standard_normal() for n, v in (("W", w), ("Q", q), ("AZ", az))}
            row = {"T": t, "DPlt": stick, "W": seen["W"], "Q": seen["Q"], "DE": de, "AZ": seen["AZ"]}
            rows.append({n: f"{v:.6f}" for n, v in row.items()})
        q_dot = TRUTH["M_w"] * w + TRUTH["M_q"] * q + TRUTH["M_de"] * de
        w, q = w + STEP * (az + SPEED * q), q + STEP * q_dot
    return rows


def test_the_unstable_aircraft_of_the_page(tmp_path: Path, rng: np.random.Generator) -> None:
    rows = unstable(rng)
    with (tmp_path / "unstable.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    shutil.copytree(PAGE.parent / "published", tmp_path / "docs" / "validation" / "published")
    commands = commands_of(PAGE)
    book = [c for c in commands if "unstable" in c]
    assert [c.split()[1] for c in book] == ["import", "estimate"]
    printed = [follow(command, tmp_path, ROOT) for command in book][1]
    assert "the motion is unstable, so the flight was cut" in printed
    methods = json.loads((tmp_path / "unstable.json").read_text())["flights"][0]["methods"]
    for method in ("ml", "ls"):
        for name, truth in TRUTH.items():
            told = methods[method]["parameters"][name]
            assert abs(told["estimate"] - truth) < 4 * told["std_coloured"], (method, name)
            assert told["std_coloured"] < 0.08 * abs(truth), (method, name)


def test_the_truth_that_the_page_states() -> None:
    """The eigenvalues in words are those of the true derivatives in the table, and these are what the test flies."""
    text = PAGE.read_text(encoding="utf-8")
    row = re.search(r"^\| true \| (\S+) \| (\S+) \| (\S+) \|$", text, flags=re.M)
    assert row is not None
    assert [float(v) for v in row.groups()] == pytest.approx([TRUTH[n] for n in ("Z_w", "M_w", "M_q")], rel=1e-3)
    words = re.search(r"eigenvalues \+(\S+) and (-\S+) 1/s", text)
    assert words is not None
    slow, fast = map(float, words.groups())
    matrix = np.array([[TRUTH["Z_w"], SPEED + Z_Q], [TRUTH["M_w"], TRUTH["M_q"]]])
    assert sorted([fast, slow]) == pytest.approx(sorted(np.linalg.eigvals(matrix).real), abs=0.01)
