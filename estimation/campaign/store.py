"""Results on disk: parts, each written whole or not at all, joined into one file at the end.

One client alone writes a part: under another name, forced to the disk, then renamed. So a kill at any instant leaves whole
parts; work whose rows were in none yet is done again. A part holds all rows of every key in it.
"""

import hashlib
from collections.abc import Callable, Iterable
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self

from daq.utilities.durable import clear_leftovers, lock_file, make_directories, open_log, whole_file
from estimation.campaign.schema import RESULTS, VERSION, VERSION_KEY, arrow_schema, table_of
from estimation.campaign.tasks import CampaignError, Row

if TYPE_CHECKING:
    import pyarrow as pa

EVERY_S = 10.0  # longest time between parts: the work that a kill can cost
FIRST_S = 1.0  # until the first part, doubled for each next one: a person sees soon that the campaign works
EVERY_ROWS = 20_000  # about 500 flights: a part of 1 MB
RESULTS_FOLDER, SUPERSEDED_FOLDER, DAMAGED_FOLDER = "results", "superseded", "damaged"


class Store:
    """The result parts in `folder`, locked against other campaigns while open. clock: monotonic seconds."""

    def __init__(self, folder: Path, clock: Callable[[], float]) -> None:
        self.folder, self._clock = folder, clock
        self._rows: list[Row] = []
        self._oldest_s, self._wait_s = 0.0, FIRST_S  # time of the oldest unwritten row; longest time it stays unwritten
        self.damaged: list[Path] = []

    def __enter__(self) -> Self:
        try:
            (self.folder / RESULTS_FOLDER).mkdir(parents=True, exist_ok=True)
            self._lock = open_log(self.folder / ".lock")
        except OSError as error:
            raise CampaignError(
                f"--out {self.folder}: cannot be written ({error.strerror}); choose another folder"
            ) from error
        try:
            lock_file(self._lock)  # the kernel releases it however the process ends
        except OSError as error:
            self._lock.close()
            raise CampaignError(f"--out {self.folder}: another campaign writes there; wait, or take another") from error
        for folder in (self.folder, *(f for f in self.folder.iterdir() if f.is_dir())):
            clear_leftovers(folder)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.flush()
        finally:
            self._lock.close()

    def load(self) -> "pa.Table":
        """All rows, each key from one part only. Parts that cannot be read are set aside, so that their work is done again."""
        import pyarrow as pa

        tables = [arrow_schema(RESULTS).empty_table()]
        loaded_keys: set[str] = set()
        for name in (RESULTS_FOLDER, SUPERSEDED_FOLDER):
            for path in sorted((self.folder / name).glob("*.parquet")):
                table = self._read(path)
                if table is None:
                    continue
                keys = table["key"].to_pylist()
                fresh = [k not in loaded_keys for k in keys]
                loaded_keys.update(keys)
                tables.append(table if all(fresh) else table.filter(pa.array(fresh, pa.bool_())))
        return pa.concat_tables(tables)

    def _read(self, path: Path) -> "pa.Table | None":
        import pyarrow as pa
        import pyarrow.parquet as pq

        try:
            with path.open("rb") as file:
                table = pq.ParquetFile(file).read()
            version = int((table.schema.metadata or {}).get(VERSION_KEY.encode(), b"0"))
            if version > VERSION:
                raise CampaignError(
                    f"{path}: written by a later Sideslip (tables of version {version}, here {VERSION}); install that one"
                )
            return conformed(table)
        except (pa.ArrowException, OSError, ValueError):
            damaged_path = self.folder / DAMAGED_FOLDER / path.name
            damaged_path.parent.mkdir(exist_ok=True)
            path.replace(damaged_path)
            self.damaged.append(damaged_path)
            return None

    def add(self, rows: Iterable[Row]) -> None:
        """Take rows. They are on disk within EVERY_S, provided that `tick` is called meanwhile."""
        if not self._rows:
            self._oldest_s = self._clock()
        self._rows += rows
        self.tick()

    def tick(self) -> None:
        """Write a part when one is due."""
        if self._rows and (len(self._rows) >= EVERY_ROWS or self._clock() - self._oldest_s >= self._wait_s):
            self.flush()
            self._wait_s = min(EVERY_S, 2.0 * self._wait_s)

    def flush(self) -> None:
        """Write all rows that are not on disk yet."""
        if not self._rows:
            return
        table = table_of(self._rows, RESULTS)
        write_part(table, self.folder / RESULTS_FOLDER, "part", set(table["key"].to_pylist()))
        self._rows = []

    def replace_all(self, results: "pa.Table", superseded: "pa.Table") -> None:
        """Replace all parts by one file of results and one of superseded results; both are written before a part is deleted."""
        old_parts = {p for n in (RESULTS_FOLDER, SUPERSEDED_FOLDER) for p in (self.folder / n).glob("*.parquet")}
        for table, name in ((superseded, SUPERSEDED_FOLDER), (results, RESULTS_FOLDER)):
            if table.num_rows:
                old_parts.discard(write_part(table, self.folder / name, "all", set(table["key"].to_pylist())))
        for path in sorted(old_parts):
            path.unlink()


def conformed(table: "pa.Table") -> "pa.Table":
    """An older table with today's columns, new ones filled with null. pa.ArrowException where a column has another type."""
    import pyarrow as pa

    schema = arrow_schema(RESULTS)
    columns = [
        table[field.name].cast(field.type) if field.name in table.column_names else pa.nulls(len(table), field.type)
        for field in schema
    ]
    return pa.table(columns, schema=schema)


def write_part(table: "pa.Table", folder: Path, stem: str, content: Iterable[str]) -> Path:
    """Write `folder`/`stem`-<digest of content>.parquet, whole or not at all even in a power cut; returns its path."""
    import pyarrow.parquet as pq

    digest = hashlib.sha256("\n".join(sorted(content)).encode()).hexdigest()[:16]
    path = folder / f"{stem}-{digest}.parquet"
    try:
        make_directories(folder)
        with whole_file(path) as new:
            pq.write_table(table, new, compression="zstd")
    except OSError as error:
        raise CampaignError(f"{path}: cannot be written ({error.strerror or error}); make room there") from error
    return path
