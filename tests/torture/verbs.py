"""The verbs that write, each in a short form, and what they read."""

import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from tests.support.paths import ROOT

FLIGHT, RAW = ROOT / "recordings/cdfp_ld2.mcap", ROOT / "recordings/cdfp_ld2_raw.mcap"
SHORT_SCENARIO = 'title = "short"\n[flight]\nduration_s = 3.0\nmanoeuvres = "rich"\n'
ROWS = 241  # of the flight's table, its header with them: 12 s

VERBS: Mapping[str, str] = {
    **{f"export {e}": f"export FLIGHT -o out.{e}" for e in ("csv", "parquet", "mat", "mcap", "rrd", "kml", "gpx")},
    "export model": "export MODEL -o out.tex",
    "export neutral": "export cdfp --to neutral -o out.json",
    "export gazebo": "export cdfp --to gazebo -o folder",
    "import": "import TABLE --aircraft cdfp -o out.mcap --json out.json",
    "draft map": "import TABLE --draft-map -o out.toml",
    "calibrate": "calibrate RAW -o out.mcap",
    "recover": "recover RAW -o out.mcap",
    "info": "info RAW --json out.json",
    "view": "view SHORT --view none --rrd out.rrd",
    "check": "check FLIGHT --report report --json out.json",
    "reconstruct": "reconstruct SHORT -o out.mcap --json out.json",
    "aircraft new": "aircraft new glider -o out.toml",
    "estimate": "estimate SHORT --method ls --json out.json --save-model out.toml --figure out.png",
    "match": "match MODEL SHORT --json out.json --figure out.png --histories folder",
    "performance": "performance SHORT --json out.json --figure out.png --report report",
    "frequency": "frequency SHORT --input delta_a --output p --json out.json -o out.png --report report",
    "design": "design --model lateral --aircraft cdfp --kind doublet --time 4 -o out.toml --json out.json",
    "watch": "watch FLIGHT --hours 1 --json out.json --report report",
    "campaign": "campaign SHORT --method ls --serial --out data --json out.json",
    "gap": "gap SHORT --nulls 20 --json out.json",
    "analyse": "analyse TABLE -o folder --json out.json",
    "fly": "fly SCENARIO --out flown --json out.json",
    "ground --replay": "ground --replay TLOG --speed max --out session --json out.json",
}
NEW_ONLY = ("recover", "aircraft new")  # refuse a name that is there
OWN_ONLY = ("export neutral",)  # replaces what it wrote itself, and no file of another's
CUT_AT_AN_END = (
    "truth.csv",
)  # of a simulated flight that Ctrl-C or SIGTERM ends early: all its lines, and they are whole
GROWING = (".journal", ".tlog", ".log", ".lock")
"""Endings of what is read while it grows: kept whole as far as it goes, not whole or not at all."""


@dataclass(frozen=True)
class Inputs:
    """Where the words in capitals of VERBS lead."""

    files: Mapping[str, Path]

    def words(self, verb: str) -> list[str]:
        """The command line of a verb."""
        return [str(self.files.get(w, w)) for w in VERBS[verb].split()]


def made_inputs(folder: Path) -> Inputs:
    """Make what the verbs read; once."""
    from estimation.models.load import load_model, write_model

    folder.mkdir(parents=True)
    files = {w: folder / n for w, n in {"TABLE": "short.csv", "SHORT": "short.mcap", "MODEL": "model.toml"}.items()}
    files |= {
        "SCENARIO": folder / "short.toml",
        "FLIGHT": FLIGHT,
        "RAW": RAW,
        "TLOG": folder / "f/ground/telemetry.tlog",
    }
    write_model(load_model("lateral", "cdfp"), files["MODEL"])
    files["SCENARIO"].write_text(SHORT_SCENARIO)
    _run("export", FLIGHT, "-o", folder / "long.csv")
    rows = (folder / "long.csv").read_text().splitlines(keepends=True)
    files["TABLE"].write_text("".join(rows[:ROWS]))
    _run("import", files["TABLE"], "--aircraft", "cdfp", "-o", files["SHORT"])
    _run("fly", files["SCENARIO"], "--out", folder / "f")
    return Inputs(files)


def _run(*words: object) -> None:
    subprocess.run([sys.executable, "-m", "sideslip", "--quiet", *map(str, words)], check=True, capture_output=True)
