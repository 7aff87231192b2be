"""Makes everything under recordings/: `python -m tests.support.make_recordings`. The same code and seeds give the same flights.

Two kinds. `cdfp_ld1..4`: raw and calibrated flights in the manner of the published UFP_LD1..4, with the instrument
factors that were put in. `gap/<letter>_0..3.mcap`: sets of three flights to learn from and one to hold out, of an
aircraft that may hide something; what, stands in `gap/key.json`, which only this and scoring read.
"""

import hashlib
import json
import shutil
import tempfile
from pathlib import Path
from typing import Any

import sideslip
from firmware_sim.runs.campaign import CampaignFlights
from firmware_sim.world.scenario import Scenario, load_scenario
from firmware_sim.world.simulation import derivatives_of
from tests.support.paths import ROOT

FOLDER = ROOT / "recordings"
PAPER_FLIGHTS = ("cdfp_ld1", "cdfp_ld2", "cdfp_ld3", "cdfp_ld4")
KEY = FOLDER / "gap" / "key.json"


def digest(path: Path) -> str:
    """SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def planted(scenario: Scenario) -> dict[str, Any]:
    """The instrument factors of a scenario, as its file has them."""
    return scenario.model_dump(exclude_defaults=True, mode="json").get("sensors", {})


def paper_flights(scratch: Path, made: Path) -> list[dict[str, Any]]:
    """Fly the four and copy raw and calibrated recordings to `made`."""
    rows = []
    for name in PAPER_FLIGHTS:
        scenario = load_scenario(name)
        flown = sideslip.fly_scenario(scenario, scratch / name, backfill=False)
        raw = sorted((scratch / name / "onboard").glob("*.mcap"))
        assert len(raw) == 1, raw
        shutil.copyfile(raw[0], made / f"{name}_raw.mcap")
        shutil.copyfile(flown.onboard, made / f"{name}.mcap")
        rows.append(
            {
                "name": name,
                "raw": f"{name}_raw.mcap",
                "flight": f"{name}.mcap",
                "sha256": {f: digest(made / f) for f in (f"{name}_raw.mcap", f"{name}.mcap")},
                "source": "simulated",
                "made_by": f"sideslip fly {name}",
                "seed": scenario.flight.seed,
                "derivatives": derivatives_of(scenario, scenario.flight.seed),
                "planted": planted(scenario),
            }
        )
    return rows


def gap_sets(scratch: Path, made: Path, key: dict[str, Any]) -> list[dict[str, Any]]:
    """Fly the sets of the key to `made`, and put the true derivatives into it; the manifest does not tell what the key tells."""
    rows = []
    for letter, entry in key.items():
        plan = CampaignFlights(
            hidden=tuple((name, size) for name, size in entry["hidden"]), seed=entry["seed"]
        ).scenarios()
        for number, (scenario, seed) in enumerate(plan):
            flown = sideslip.fly_scenario(scenario, scratch / f"{letter}{number}", seed=seed, backfill=False)
            target = made / "gap" / f"{letter}_{number}.mcap"
            shutil.copyfile(flown.onboard, target)
            rows.append(
                {
                    "name": f"gap/{letter}_{number}",
                    "flight": f"gap/{target.name}",
                    "sha256": digest(target),
                    "source": "simulated",
                    "seed": seed,
                }
            )
        first, seed = plan[0]
        entry["derivatives"] = derivatives_of(first, seed)
    return rows


def main() -> None:
    """Make everything anew, and only then put it in the place of what is there."""
    key = json.loads(KEY.read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory() as folder:
        scratch, made = Path(folder), Path(folder) / "made"
        (made / "gap").mkdir(parents=True)
        rows = paper_flights(scratch, made)
        more = gap_sets(scratch, made, key)
        for old in FOLDER.rglob("*.mcap"):
            old.unlink()
        for new in made.rglob("*.mcap"):
            shutil.copyfile(new, FOLDER / new.relative_to(made))
    manifest = {
        "about": "Simulated flights through the simulated sensor bus, the real logger and calibration.",
        "made_by": "python -m tests.support.make_recordings",
        "recordings": rows + more,
    }
    (FOLDER / "manifest.json").write_text(json.dumps(manifest, indent=1) + "\n", encoding="utf-8")
    KEY.write_text(json.dumps(key, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
