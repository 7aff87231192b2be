"""`sideslip ground` when something is in the way: one sentence, exit status 2, and nothing that was there is touched."""

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import sideslip
from daq.identification.monitor import threshold
from daq.utilities.errors import UserError
from estimation.aircraft import load_aircraft
from estimation.models import load_model
from estimation.models.load import write_model
from groundstation.cli import live
from groundstation.cli.live import _estimate
from groundstation.cli.services import Services
from groundstation.live.config import GroundConfig
from groundstation.live.handover import hand_over_sessions
from groundstation.live.station import Station
from tests.support.link_rig import Rig, random_scan


def ended(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[object, str]:
    with pytest.raises(SystemExit) as exit_:
        sideslip.main(arguments)
    return exit_.value.code, capsys.readouterr().err.strip()


@pytest.fixture
def config(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "ground.toml"
    path.write_text('[output]\ndirectory = "session"\ndated = false\n')
    return path


def test_a_replay_never_goes_into_the_folder_of_a_session(
    config: Path, root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    session = Path("session")
    session.mkdir()
    log = session / "telemetry.tlog"
    log.write_bytes(b"kept")
    recording = str(root / "recordings" / "cdfp_ld1_raw.mcap")
    code, said = ended(["ground", str(config), "--replay", recording, "--speed", "max"], capsys)
    assert code == 2
    assert "holds a session already (telemetry.tlog)" in said
    assert [p.name for p in session.iterdir()] == ["telemetry.tlog"]
    assert log.read_bytes() == b"kept"


@pytest.mark.parametrize(
    ("ports", "words"),
    [
        ("[]", "there is nothing to listen to"),
        ('["udpin:14899", "udpin:14899"]', "'udpin:14899' is listed twice"),
        ('"serial:/dev/nowhere"', "/dev/nowhere cannot be opened"),
        ('["nonsense"]', "write serial:DEVICE:BAUD"),
    ],
)
def test_ports_that_cannot_be_are_named(
    ports: str, words: str, config: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config.write_text(f"[link]\nports = {ports}\n")
    code, said = ended(["ground", str(config), "--duration", "0.1", "--out", "o"], capsys)
    assert code == 2
    assert words in said
    assert "\n" not in said
    assert not Path("o").exists()


def test_a_model_to_be_held_against_flight_is_looked_for_at_the_start(
    config: Path, root: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for constant, value in (
        ("HOUR_S", 600.0),
        ("AT_ONCE", 24),
        ("FLIGHT_S", 25.0),
    ):  # thresholds from a sixth of the flights
        monkeypatch.setattr(threshold, constant, value)
    recording = str(root / "recordings" / "cdfp_ld1_raw.mcap")
    command = ["ground", str(config), "--replay", recording, "--speed", "max", "--model"]
    code, said = ended([*command, "nowhere.toml"], capsys)
    assert (code, "nowhere.toml: no such file" in said) == (2, True)
    write_model(load_model("longitudinal", load_aircraft("cdfp")), Path("pitch.toml"))
    with pytest.raises(SystemExit, match=r"^0$"):
        sideslip.main([*command, "pitch.toml", "--aircraft", "cdfp"])  # identified, and watched, in pitch
    out = capsys.readouterr().out
    assert "the gap monitor holds flight against pitch.toml" in out
    assert "no gap monitor" not in out


def test_an_estimate_is_made_by_what_the_command_is_given(tmp_path: Path) -> None:
    """In this process, of the manoeuvres where there are some; what is wrong with it costs the session nothing."""
    asked: list[object] = []

    def estimate(flights: Sequence[Path], model: str, methods: str, aircraft: str, report: Path) -> list[str]:
        asked.append((list(flights), model, methods, aircraft, report))
        if model == "none":
            raise UserError("no such model")
        return ["recommended: ml"]

    services = Services(
        lambda *_: pytest.fail("no aircraft is asked for"), lambda _: pytest.fail("no recipe"), estimate
    )
    handed = [
        SimpleNamespace(manoeuvres_path=tmp_path / "m.mcap", path=tmp_path / "f.mcap"),
        SimpleNamespace(manoeuvres_path=None, path=tmp_path / "g.mcap"),
    ]
    told: list[str] = []
    for model in ("lateral", "none"):
        settings = SimpleNamespace(
            handover=SimpleNamespace(model=model, methods="ml"), identification=SimpleNamespace(aircraft="cdfp")
        )
        _estimate(handed, settings, tmp_path, told.append, services, show=False)
    flights = [tmp_path / "m.mcap", tmp_path / "g.mcap"]
    assert asked == [(flights, model, "ml", "cdfp", tmp_path / "report") for model in ("lateral", "none")]
    assert told == ["recommended: ml", "the estimate could not be made: no such model"]


def test_a_picture_that_cannot_be_is_spoken_of(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[str] = []
    for rerun_is in (True, False):
        monkeypatch.setattr(live, "find_spec", lambda name, there=rerun_is: object() if there else None)
        with live._views(GroundConfig(), "none", told.append) as views:
            assert views is None
    assert told == ["no picture: the package 'rerun' is not installed; pip install 'sideslip[ground]', then --view web"]


def test_the_end_of_a_session_says_what_it_does(tmp_path: Path) -> None:
    rig, rng, lines = Rig(tmp_path), np.random.default_rng(83), list[str]()
    station = Station(GroundConfig(), rig.ground, rig.clock, tmp_path, echo=lines.append)
    rig.look = station.step  # type: ignore[method-assign]
    rig.fly(40, lambda n: random_scan(n, rng, time_ns=rig.clock.monotonic_ns()))
    (journal,) = (r.journal for r in rig.ground.session_recorders().values())
    rig.link.close()
    station.close()
    hand_over_sessions(station, tmp_path, lines.append)
    assert f"the session ends: {journal.total} scans are written as recordings" in lines
    begun = next(
        i for i, line in enumerate(lines) if f"a flight is made of {journal.total} scans from telemetry" in line
    )
    assert lines.index(f"the session ends: {journal.total} scans are written as recordings") < begun
