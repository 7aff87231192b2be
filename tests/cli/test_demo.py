"""The demo, whole: it ends well, leaves what it promises, and finds what was hidden."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from sideslip.verbs.demo import DEMO_HIDDEN
from tests.support.paths import ROOT


def pasted_in_the_readme() -> list[str]:
    """The lines of the demo's output that README.md shows; it leaves lines out, and dots stand for what follows."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"^```\n(1  Four flights.*?)^```$", text, flags=re.M | re.S)
    lines = [_plain(re.sub(r"(\.\.\.|Report: .*)$", "", line)) for line in block.splitlines()]
    return [line for line in lines if line]


def _plain(text: str) -> str:
    """With every number as one sign, so that another processor's last digit or a busy machine's seconds do not count."""
    return " ".join(re.sub(r"[-+]?\d[\d.]*(e[-+]?\d+)?", "#", text).split())


@pytest.mark.timeout(900)
def test_demo(tmp_path: Path) -> None:
    out = tmp_path / "demo"
    command = [sys.executable, "-m", "sideslip", "demo", "--out", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=850, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    page = out / "report" / "index.html"
    assert page.is_file()
    assert str(page) in done.stdout
    assert done.stdout.count("air and ground agree") == 4
    estimate = json.loads((out / "report" / "estimate.json").read_text())
    truth = {"Cl_p": -0.4951, "Cl_da": -0.0948, "Cn_beta": 0.0263, "CY_dr": 0.4174}
    for name, value in truth.items():
        found = estimate["joint"]["ml"]["parameters"][name]
        assert abs(found["estimate"] - value) < 4 * found["std_coloured"], name
    # the rudder hardly moves in three of the four flights: the fourth was taken for another aircraft
    assert (estimate["recommended"]["method"], estimate["odd"]) == ("ml", [])
    gap = json.loads((out / "report" / "gap.json").read_text())
    members = [m["effect"] for m in gap["steps"][0]["set"]]
    assert DEMO_HIDDEN[0] in members
    assert gap["steps"][0]["gap"]["closed"] > 0.7
    told = json.loads((out / "report" / "truth.json").read_text())
    assert told["hidden"]["name"] == DEMO_HIDDEN[0]
    assert {name: round(told["derivatives"][name], 4) for name in truth} == truth
    assert f"hidden: {DEMO_HIDDEN[0]} (adverse yaw from aileron) of -0.01 1/rad" in done.stdout
    front = page.read_text(encoding="utf-8")
    assert 'id="hidden"' in front
    assert "error [bounds]" in front
    for piece in pasted_in_the_readme():
        assert piece in _plain(done.stdout), piece
    for name in ("check", "estimate", "gap"):
        assert 'href="../index.html"' in (out / "report" / name / "index.html").read_text(encoding="utf-8")
