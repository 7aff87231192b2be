"""`analyse`: from an autopilot's log to one page in one command, by mode, in words that are right; stages are kept."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import sideslip as ss
from estimation.aircraft import load_aircraft
from estimation.aircraft.library import BUILT_IN_FOLDER
from firmware_sim.physics.aerodynamics import LATERAL, true_derivatives
from firmware_sim.world.scenario import load_scenario
from firmware_sim.world.world import simulate_many
from sideslip.verbs.analyse import analyse
from tests.chain.autopilot_logs import BOOT, dataflash
from tests.cli.docs.blocks import files_of

pytestmark = [pytest.mark.timeout(300), pytest.mark.usefixtures("unwritten_figures")]


def described(kind: int, size: int, name: str, layout: str, labels: str) -> bytes:
    return struct.pack("<BBBBB4s16s64s", 0xA3, 0x95, 128, kind, size, name.encode(), layout.encode(), labels.encode())


def modes(changes: list[tuple[float, int]], messages: list[tuple[float, str]]) -> bytes:
    """MODE and MSG of ArduPilot, as a log's first messages: each has its own time."""
    out = described(140, 3 + 8 + 3, "MODE", "QMBB", "TimeUS,Mode,ModeNum,Rsn")
    out += described(141, 3 + 8 + 64, "MSG", "QZ", "TimeUS,Message")
    for time, number in changes:
        out += struct.pack("<BBBQBBB", 0xA3, 0x95, 140, round(1e6 * time), number, number, 2)
    for time, text in messages:
        out += struct.pack("<BBBQ64s", 0xA3, 0x95, 141, round(1e6 * time), text.encode())
    return out


@pytest.fixture(scope="module")
def folder(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("analyse")
    scenario = load_scenario("rich").altered(wind={"gust_deg": 0.1, "speed_m_s": 4.0, "from_deg": 205.0})
    truth = simulate_many([scenario], [7], 50.0)[0]
    end = BOOT + float(truth["time"][-1])
    said = modes([(BOOT, 0), (end - 3.0, 5)], [(BOOT, "ArduPlane V4.5.1"), (BOOT + 1, "EKF3 IMU0 is using GPS")])
    (made / "log.bin").write_bytes(dataflash(truth, np.random.default_rng(5)) + said)
    (made / "surfaces.toml").write_text(files_of(root / "docs" / "import.md")["surfaces.toml"])
    return made


def run(folder: Path, *words: str) -> tuple[int, dict, str]:
    done = CliRunner().invoke(analyse, [str(folder / "log.bin"), *words], standalone_mode=False)
    if done.exception is not None:
        raise done.exception
    out = Path(words[words.index("-o") + 1])
    return int(done.return_value or 0), json.loads((out / "answer.json").read_text()), done.output


def test_a_log_ends_in_its_derivatives_by_mode_and_a_rerun_does_nothing_again(folder: Path) -> None:
    words = ("--map", str(folder / "surfaces.toml"), "--aircraft", "cdfp", "-o", str(folder / "out"))
    code, answer, said = run(folder, *words)
    assert code == 0, answer["verdict"]
    assert {s["by"] for s in answer["stretches"]} == {"mode:MANUAL"}
    assert answer["stretches"][-1]["to"] < answer["modes"][-1]["from"] + 0.1
    method = answer["estimate"]["flights"][0]["recommended"]["method"]
    found = answer["estimate"]["flights"][0]["methods"][method]["parameters"]
    truth = true_derivatives(load_aircraft("cdfp"), {})
    off = {
        n: (found[n]["estimate"] - truth[n]) / found[n]["std_coloured"]
        for n in LATERAL
        if n in found and not n.endswith("_0")
    }
    assert len(off) >= 11  # constants take up the offsets of sensors, and have no truth
    assert max(abs(v) for v in off.values()) < 3.5, off
    assert answer["verdict"].startswith("Derivatives of cdfp by ml (lateral over 1 stretch by mode:MANUAL): CY_beta ")
    page = (folder / "out" / "index.html").read_text()
    assert page.index("Derivatives of cdfp by ml") < page.index("Flight modes of the log")
    assert "done in this run: import, air, estimate" in said
    again = run(folder, *words)
    assert again[1] == answer
    assert "nothing had changed" in again[2]


def test_without_an_aircraft_file_wind_and_motion_are_told(folder: Path) -> None:
    code, answer, _ = run(folder, "--map", str(folder / "surfaces.toml"), "-o", str(folder / "bare"))
    assert code == 1
    assert answer["estimate"] is None
    (wind,) = answer["without_aircraft"]["wind"]
    assert abs(wind["speed"] - 4.0) < 0.6
    assert abs((wind["from_deg"] - 205.0 + 180) % 360 - 180) < 12.0
    assert {m["mode"] for m in answer["without_aircraft"]["modes"]} >= {"roll", "Dutch roll"}
    assert "span, wing area, mean chord, mass" in answer["next"][0]


def test_without_surfaces_the_way_to_a_map_is_told(folder: Path) -> None:
    found = ss.analyse(folder / "log.bin", aircraft="cdfp", output=folder / "none")
    assert not found.passed
    assert found.to_json()["verdict"].startswith(
        "No derivatives: the log is not enough for any model; nearest is longitudinal: it lacks delta_e"
    )
    assert any("--draft-map" in n for n in found.to_json()["next"])


def test_a_rerun_does_again_what_has_changed_and_no_more(folder: Path) -> None:
    log, out = folder / "log.bin", folder / "again"
    other = folder / "other.bin"
    other.write_bytes(log.read_bytes())
    assert ss.analyse(log, aircraft="cdfp", output=out).repeated == ("import", "air", "estimate")
    assert ss.analyse(log, aircraft="cdfp", holdout=[other], output=out).repeated == ("import", "air")
    written = (folder / "again" / "stages" / "import_0.mcap").stat().st_mtime_ns
    aircraft = folder / "heavier.toml"
    aircraft.write_text((BUILT_IN_FOLDER / "cdfp.toml").read_text().replace("mass = 3.5", "mass = 3.6"))
    found = ss.analyse(log, aircraft=aircraft, output=out)
    assert found.repeated == ("air", "estimate")
    assert (folder / "again" / "stages" / "import_0.mcap").stat().st_mtime_ns == written
