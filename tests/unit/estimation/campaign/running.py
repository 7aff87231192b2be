"""Starting the command, and looking at what it left."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from estimation.campaign.schema import UNREPEATABLE
from tests.support.paths import ROOT

HOSTILE = "tests.unit.estimation.campaign.hostile:HOSTILE"


def command(*words: str) -> list[str]:
    """The command line, as a process of its own: an engine leaves threads until its process ends."""
    return [sys.executable, "-m", "sideslip", "campaign", *words]


def environment(**more: str) -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", **more}


def start(*words: str, **more: str) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        command(*words), cwd=ROOT, env=environment(**more), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def children(pid: int) -> set[int]:
    """All processes below one."""
    try:
        own = {int(c) for t in Path(f"/proc/{pid}/task").glob("*/children") for c in t.read_text().split()}
    except OSError:
        return set()
    return own | {below for child in own for below in children(child)}


def workers_of(pid: int) -> set[int]:
    """Processes started by multiprocessing's spawn: the engine's workers."""
    return {c for c in children(pid) if b"spawn_main" in Path(f"/proc/{c}/cmdline").read_bytes()}


def altered(source: Path, target: Path, change: float) -> Path:
    """The flight with another altitude, which no estimate here looks at: other bytes, the same numbers."""
    head, *lines = source.read_text(encoding="utf-8").splitlines()
    place = head.split(",").index("altitude")
    rows = [line.split(",") for line in lines]
    for row in rows:
        row[place] = repr(float(row[place]) + change)
    target.write_text("\n".join([head, *(",".join(r) for r in rows)]) + "\n", encoding="utf-8")
    return target


def results_of(out: Path) -> pa.Table:
    return pq.read_table(out / "results")


def repeatable(table: pa.Table) -> list[dict[str, Any]]:
    """Rows without what tells of the run, in one order."""
    rows = table.drop_columns([*UNREPEATABLE, "source"]).to_pylist()
    return sorted(rows, key=lambda r: (r["key"], r["kind"], r["parameter"] or ""))
