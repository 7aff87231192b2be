"""Every file that the program writes goes through `daq.utilities.durable`: other calls that open for writing are listed here."""

import ast
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.conftest import ROOT

PACKAGES = ("daq", "groundstation", "estimation", "firmware_sim", "sideslip")

GIVEN = "writes to the hidden file that `whole` gave its caller"
ALLOWED: dict[tuple[str, str], str] = {
    ("daq/actuation/pwm/heartbeat.py", "open:wb"): "a device of the kernel",
    ("daq/utilities/durable.py", "open:a+b"): "the one place",
    ("daq/utilities/durable.py", "open:w"): "the one place",
    ("daq/utilities/durable.py", "open:wb"): "the one place",
    ("daq/utilities/durable.py", "os.open:w"): "the one place",
    ("daq/utilities/durable.py", "write_bytes"): "the one place",
    ("daq/contract/link/dialect/generate.py", "write_text"): "makes source text of this program, run by its developers",
    ("daq/contract/recordings/recovery.py", "open:wb"): GIVEN,
    ("daq/recorder/storage.py", "os.open:w"): "the card: segments that grow, unbuffered",
    ("daq/transport/signing.py", "write_text"): GIVEN,
    ("estimation/campaign/workers/in_process.py", "open:w"): "the null device",
    ("estimation/campaign/workers/subjects.py", "write_bytes"): "a temporary folder, removed at once",
    ("estimation/engine/compiled_library.py", "write_text"): "a temporary folder, removed at once",
    ("estimation/simulation/jsbsim/library.py", "write_text"): "a temporary folder, removed at once",
    ("estimation/report/drawing/figures.py", "savefig"): "a picture in memory, and `save_figure`",
    ("estimation/campaign/publish.py", "write_table"): GIVEN,
    ("estimation/campaign/store.py", "write_table"): GIVEN,
    ("groundstation/export/run.py", "write_table"): GIVEN,
    ("groundstation/export/run.py", "savemat"): GIVEN,
    ("groundstation/flight/writing.py", "open:w"): GIVEN,
    ("groundstation/flight/writing.py", "open:wb"): GIVEN,
    ("groundstation/flight/writing.py", "write_table"): GIVEN,
    ("groundstation/viewer/live.py", "FileSink"): "a picture that grows while it is seen",
    ("groundstation/receiver/storage/recording.py", "open:wb"): GIVEN,
    ("daq/utilities/standard_streams.py", "os.open:w"): "the null device, in place of a standard stream that is closed",
    ("estimation/answers/answer.py", "to_csv"): GIVEN,
    (
        "daq/contract/link/dialect/build.py",
        "NamedTemporaryFile",
    ): "runs by itself when the package is built, whole or not at all",
    ("daq/contract/link/dialect/build.py", "write_bytes"): "a temporary folder, removed at once",
    ("sideslip/verbs/demo.py", "copyfile"): GIVEN,
    ("estimation/simulation/jsbsim/export.py", "copytree"): "a hidden folder that `replacing_folder` gave",
}
WRITERS = {
    "write_text", "write_bytes", "savefig", "savemat", "write_table", "to_csv", "to_parquet", "copyfile",
    "copytree", "copy", "copy2", "move", "NamedTemporaryFile", "mkstemp", "FileSink", "tofile", "savetxt", "save_array", "memmap",
}  # fmt: skip
HARMLESS = {"copy", "move"}  # of arrays and dictionaries, unless it is shutil's
METHODS_OF_MODULES = {"durable", "outputs", "np"}


def _mode(call: ast.Call, position: int) -> str:
    modes = [k.value for k in call.keywords if k.arg == "mode"] + call.args[position : position + 1]
    return next((m.value for m in modes if isinstance(m, ast.Constant) and isinstance(m.value, str)), "r")


def _opened(call: ast.Call) -> str | None:
    """What a call opens for writing, in the words of ALLOWED; None for any other call."""
    f = call.func
    name = f.attr if isinstance(f, ast.Attribute) else f.id if isinstance(f, ast.Name) else ""
    of = f.value.id if isinstance(f, ast.Attribute) and isinstance(f.value, ast.Name) else ""
    if name == "open" and of == "os":
        text = ast.unparse(call)
        return "os.open:w" if any(flag in text for flag in ("O_WRONLY", "O_RDWR", "O_CREAT", "flags")) else None
    if name == "open":
        mode = _mode(call, 0 if isinstance(f, ast.Attribute) and of != "io" else 1)
        return f"open:{mode}" if set(mode) & set("wax+") and len(mode) <= 3 else None
    if isinstance(f, ast.Name) and name in ("write_text", "write_bytes", "write_table", "move"):
        return None  # those of durable and outputs
    if of in METHODS_OF_MODULES or name not in WRITERS or (name in HARMLESS and of != "shutil"):
        return None
    return name


def opened_for_writing(source: str) -> Iterator[tuple[int, str]]:
    """Line and kind of the calls of a module that open for writing."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call) and (kind := _opened(node)) is not None:
            yield node.lineno, kind


def test_no_file_is_opened_for_writing_besides_the_one_way_and_the_listed_places() -> None:
    found, where = Counter[tuple[str, str]](), []
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            name = str(path.relative_to(ROOT))
            for line, kind in opened_for_writing(path.read_text(encoding="utf-8")):
                found[name, kind] += 1
                if (name, kind) not in ALLOWED:
                    where.append(f"{name}:{line} {kind}")
    assert where == [], "write through daq.utilities.durable"
    assert set(ALLOWED) <= set(found), "no longer there: take it off the list"


@pytest.mark.parametrize(
    "line",
    [
        'path.open("w")', 'open(path, "ab")', 'Path(x).write_text("a")', "figure.savefig(path)", 'path.open(mode="x")',
        "os.open(path, os.O_WRONLY | os.O_CREAT)", "shutil.copy(a, b)", 'io.open(p, "r+")', "a.tofile(p)",
    ],
)  # fmt: skip
def test_the_list_sees_each_way_to_write(line: str) -> None:
    assert [kind for _, kind in opened_for_writing(line)] != []


@pytest.mark.parametrize("line", ["path.open()", 'path.open("rb")', "table.copy()", "os.open(path, os.O_RDONLY)"])
def test_the_list_leaves_reading_alone(line: str) -> None:
    assert list(opened_for_writing(line)) == []


def test_the_root_is_this_tree() -> None:
    assert isinstance(ROOT, Path)
    assert (ROOT / "daq/utilities/durable.py").is_file()
