"""Every message on the page of troubleshooting is one that the code says, word for word; some are provoked."""

import ast
import re
from functools import lru_cache
from pathlib import Path

import pytest

import sideslip
from tests.support.paths import ROOT

PAGE = ROOT / "docs" / "troubleshooting.md"
ROOMS = ("daq", "groundstation", "estimation", "sideslip")
FIXED = 5  # letters from which a piece between two values tells anything
NOT_A_MESSAGE = (
    "the browser lags, the picture is late",
    "verdict: ",
    "recommended: none",
    "no telemetry: active",
    "refused …",
)


@lru_cache(maxsize=1)
def said() -> str:
    """All text of the code, a line a string; values within are dots."""
    found = []
    for room in ROOMS:
        for path in sorted((ROOT / room).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.JoinedStr):
                    found.append("".join(v.value if isinstance(v, ast.Constant) else "…" for v in node.values))  # type: ignore[misc]
                elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                    found.append(node.value)
    return "\n".join(found)


def messages() -> list[str]:
    """The first column of the page's tables."""
    rows = re.findall(r"^\| (.*?) \| .* \|$", PAGE.read_text(encoding="utf-8"), flags=re.M)
    return [row for row in rows if row not in ("message", "it says")]


def test_messages_of_the_page_are_those_of_the_code() -> None:
    told = messages()
    assert len(told) > 30
    lost = [
        (message, part)
        for message in told
        if not message.startswith(NOT_A_MESSAGE)
        for part in message.split("…")
        if len(part.strip()) >= FIXED and part.strip() not in said()
    ]
    assert not lost


def wrong_inputs(folder: Path) -> dict[str, list[str]]:
    """Command lines, by the words of the page that they bring about."""
    (folder / "log.ulg").write_bytes(b"ULog")
    (folder / "numbers.csv").write_text("0.0,1.0\n0.1,1.0\n")
    (folder / "few.csv").write_text("time,p,q,r\n" + "".join(f"{0.05 * i},0,0,0\n" for i in range(50)))
    raw = str(ROOT / "recordings" / "cdfp_ld1_raw.mcap")
    nameless = str(ROOT / "recordings" / "foreign" / "ordinary_0.csv")
    return {
        "not a flight file": ["check", str(folder / "log.ulg")],
        "a raw recording must pass": ["check", raw],
        "the first line is not a header": ["check", str(folder / "numbers.csv")],
        "names no aircraft": ["estimate", nameless],
        "missing, needed for": ["estimate", str(folder / "few.csv"), "--aircraft", "cdfp"],
    }


def test_what_the_page_promises_is_what_one_reads(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = " ".join(messages()).replace("…", " ")
    for words, arguments in wrong_inputs(tmp_path).items():
        with pytest.raises(SystemExit) as ended:
            sideslip.main(arguments)
        text = capsys.readouterr().err
        assert ended.value.code == 2
        assert words in text
        assert words.split(",")[0] in page
        assert len(text.splitlines()) == 1
