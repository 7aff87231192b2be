"""What `recordings/manifest.json` says of the recordings is so."""

import hashlib
import json

from tests.support.paths import ROOT

FOLDER = ROOT / "recordings"


def listed() -> dict[str, str]:
    """File name -> hash, of every recording of the manifest."""
    files: dict[str, str] = {}
    for entry in json.loads((FOLDER / "manifest.json").read_text(encoding="utf-8"))["recordings"]:
        digest = entry["sha256"]
        files |= digest if isinstance(digest, dict) else {entry["flight"]: digest}
    return files


def test_every_recording_is_the_one_of_the_manifest() -> None:
    for name, digest in listed().items():
        assert hashlib.sha256((FOLDER / name).read_bytes()).hexdigest() == digest, name


def test_every_recording_is_in_the_manifest() -> None:
    found = {str(p.relative_to(FOLDER)) for p in FOLDER.rglob("*.mcap")}
    assert found == {n for n in listed() if n.endswith(".mcap")}


def test_recordings_name_no_folder_of_the_machine_they_were_made_on() -> None:
    root = str(FOLDER.parent).encode()
    assert len(root) > 1
    for path in FOLDER.rglob("*_raw.mcap"):
        assert root not in path.read_bytes(), path.name
