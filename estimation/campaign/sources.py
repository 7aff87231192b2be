"""The flights of a plan, from paths, patterns, folders, tables, URLs and scenarios; each with a digest of its content."""

import csv
import glob
import hashlib
import io
import stat
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import IO, Any

import numpy as np
from pydantic import ValidationError

from daq.utilities import limits
from daq.utilities.errors import UserError
from daq.utilities.input_files import matching, read_bytes
from daq.utilities.packages import optional
from daq.utilities.plain_words import visible
from estimation.campaign.keys import key_of
from estimation.campaign.plan import (
    FLIGHT_SUFFIXES,
    CampaignPlan,
    FlightEntry,
    RecordConditions,
    SimulateEntry,
    first_mistake,
)
from estimation.campaign.tasks import CampaignError, FlightMaker, FlightSource

CHUNK = 1 << 20  # bytes read at a time: a flight of any size is digested in little memory
REMOTE_ERRORS = (OSError, ValueError, ImportError, RuntimeError, TypeError, AttributeError, LookupError, AssertionError)
"""What fsspec and its back ends raise for an address that cannot be read, a protocol not known or not installed."""


@dataclass(frozen=True)
class CampaignFlight:
    """One flight of the plan. source: None where its bytes cannot be read; `why` has the reason."""

    location: str
    conditions: RecordConditions
    source: FlightSource | None = None
    why: str = ""

    @property
    def name(self) -> str:
        """Name in the results."""
        return self.source.name if self.source is not None else Path(self.location).stem


def entries_of(
    plan: CampaignPlan, folder: Path, simulator: FlightMaker | None = None, *, send: bool = False
) -> list[CampaignFlight]:
    """Every flight of a plan whose relative paths begin at `folder`. send: carry the bytes of local files along.

    Raises CampaignError for a pattern without a match, and for a table or scenario that cannot be used.
    """
    entries = [e for text in plan.flights for e in _flights_at(text, folder, RecordConditions(), send)]
    simulated = sum(scenario.count for scenario in plan.simulate)
    if simulated > limits.FLIGHTS:
        raise CampaignError(
            f"the plan simulates {simulated} flights; at most {limits.FLIGHTS} are made, take several plans"
        )
    for row in (*plan.flight, *(_table(plan.table, folder) if plan.table else ())):
        entries += _flights_at(row.path, folder, RecordConditions(**row.model_dump(exclude={"path"})), send)
    for number, scenario in enumerate(plan.simulate):
        entries += _simulated(scenario, number, folder, simulator)
        if len(entries) > limits.FLIGHTS:
            raise CampaignError(f"the plan names more than {limits.FLIGHTS} flights; take several plans")
    if not entries:
        raise CampaignError("the plan names no flight; give flights, a table, [[flight]] or [[simulate]]")
    return entries


def _table(name: str, folder: Path) -> Iterator[FlightEntry]:
    """Rows of a CSV with a column `path`; unknown columns are ignored."""
    path = folder / name
    text = read_bytes(path, "table", CampaignError, limits.TABLE_BYTES)
    try:
        rows = list(csv.DictReader(io.StringIO(text.decode("utf-8-sig"), newline="")))
    except (UnicodeDecodeError, csv.Error) as error:
        raise CampaignError(f"table {path}: cannot be read as CSV ({error}); correct the key 'table'") from error
    for number, row in enumerate(rows, start=2):
        flight_fields = {k: v for k, v in row.items() if k in FlightEntry.model_fields and v}
        try:
            yield FlightEntry.model_validate(flight_fields)
        except ValidationError as error:
            raise CampaignError(f"table {path}, line {number}: {first_mistake(error)}; correct it there") from error


def _flights_at(text: str, folder: Path, conditions: RecordConditions, send: bool) -> Iterator[CampaignFlight]:
    if "://" in text:
        for url in _urls(text):
            yield _remote(url, conditions)
        return
    path = folder / text
    for file_path in _paths(path, text):
        yield _local(file_path, conditions, send)


def _paths(path: Path, text: str) -> Sequence[Path]:
    """The file itself, all flights of a folder, or those that a pattern matches."""
    if path.is_dir():
        files = sorted(islice(path.iterdir(), limits.LOOKED_AT))
    elif path.exists() or not glob.has_magic(text):
        return [path]
    else:
        files = matching(path, CampaignError)
    flight_files = [p for p in files if p.suffix.lower() in FLIGHT_SUFFIXES]
    if not flight_files:
        raise CampaignError(f"{text}: no flight there; give files ending in {', '.join(FLIGHT_SUFFIXES)}")
    return flight_files


def _local(path: Path, conditions: RecordConditions, send: bool) -> CampaignFlight:
    entry = CampaignFlight(str(path), conditions)
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):  # reading would wait for a pipe, and never end for a device
            return replace(entry, why=f"{path}: not a file that can be read again; copy the flight into one")
        if status.st_size > limits.DATA_BYTES:
            return replace(entry, why=f"{path}: {status.st_size} bytes long; at most {limits.DATA_BYTES} are read")
        digest = hashlib.sha256()
        with path.open("rb") as handle:
            while chunk := handle.read(CHUNK):
                digest.update(chunk)
        data = read_bytes(path, "flight", CampaignError) if send else None
    except FileNotFoundError:
        return replace(entry, why=f"{path}: no such file")
    except OSError as error:
        return replace(entry, why=f"{path}: cannot be read ({error.strerror or error})")
    return replace(
        entry, source=FlightSource(visible(path.stem), path.suffix, digest.hexdigest(), path=str(path), data=data)
    )


def _urls(text: str) -> list[str]:
    if not glob.has_magic(text):
        return [text]
    try:
        files, path = _filesystem(text)
        addresses = [files.unstrip_protocol(p) for p in sorted(files.glob(path))]
    except REMOTE_ERRORS as error:
        raise CampaignError(f"{text}: cannot be listed ({error}); check address and access") from error
    if not addresses:
        raise CampaignError(f"{text}: no flight there")
    return addresses


def _filesystem(url: str) -> tuple[Any, str]:
    url_to_fs = optional("fsspec.core", "a flight by URL").url_to_fs
    protocol = url.partition("://")[0].lower()
    if "::" in url or protocol not in limits.PROTOCOLS:
        protocols = ", ".join(sorted(limits.PROTOCOLS))
        raise CampaignError(
            f"{url[:200]}: flights are read by {protocols}, one at a time; copy it to where one of them leads"
        )
    files, path = url_to_fs(url, **_time_limits(protocol))
    return files, str(path)


def _time_limits(protocol: str) -> dict[str, Any]:
    """Time limits for a web server that does not answer; aiohttp's own is five minutes a request."""
    if protocol not in ("http", "https"):
        return {}
    timeout = optional("aiohttp", "a flight by URL").ClientTimeout(
        total=None, connect=limits.SILENCE_S, sock_read=limits.SILENCE_S
    )
    return {"client_kwargs": {"timeout": timeout}, "block_size": 0}  # 0: a stream, whether or not the size is known


def _remote(url: str, conditions: RecordConditions) -> CampaignFlight:
    name = Path(url.partition("?")[0])
    try:
        digest = hashlib.sha256(fetched(url)).hexdigest()
    except CampaignError as error:
        return CampaignFlight(url, conditions, None, str(error))
    return CampaignFlight(url, conditions, FlightSource(visible(name.stem), name.suffix, digest, url=url))


def fetched(url: str) -> bytes:
    """The bytes at a URL; CampaignError where they cannot be read."""
    try:
        files, path = _filesystem(url)
        size = files.size(path)
        if size is not None and size > limits.DATA_BYTES:
            raise CampaignError(f"{url}: {size} bytes long; at most {limits.DATA_BYTES} are read")
        if "file" in files.protocol:
            return read_bytes(Path(path), "flight", CampaignError)
        with files.open(path, "rb") as stream:
            return b"".join(_chunks(stream, url))
    except REMOTE_ERRORS as error:
        raise CampaignError(f"{url}: cannot be read ({error}); check address and access") from error


def _chunks(stream: IO[bytes], url: str) -> Iterator[bytes]:
    """The content in chunks; CampaignError where it is too long, or arrives too slowly."""
    start_s, received = time.monotonic(), 0
    while chunk := stream.read(CHUNK):
        received += len(chunk)
        if received > limits.DATA_BYTES:
            raise CampaignError(f"{url}: longer than the {limits.DATA_BYTES} bytes that are read")
        seconds = time.monotonic() - start_s
        if seconds > limits.SILENCE_S and received < seconds * limits.SLOWEST_BYTES_PER_S:
            raise CampaignError(f"{url}: {received} bytes in {seconds:.0f} s; copy it to where it can be read faster")
        yield chunk


# ---------------------------------------------------------------------------------------------- simulated


def _simulated(
    entry: SimulateEntry, number: int, folder: Path, simulator: FlightMaker | None
) -> Iterator[CampaignFlight]:
    if simulator is None:
        raise CampaignError("the plan has [[simulate]], but no simulator was handed in; run it with sideslip campaign")
    conditions = RecordConditions(**{k: getattr(entry, k) for k in RecordConditions.model_fields})
    scenario_file = folder / entry.scenario
    scenario = str(scenario_file) if scenario_file.is_file() else entry.scenario
    label = f"{Path(scenario).stem}{number}"
    for end in (0, 1):  # where both ends of all ranges can be flown, so can the values between
        try:
            simulator.describe(scenario, {**entry.set, **{key: ends[end] for key, ends in entry.vary.items()}})
        except UserError as error:
            raise CampaignError(f"plan, simulate.{number}: {error}") from error
    for i in range(entry.count):
        described = simulator.describe(scenario, {**entry.set, **_drawn_values(entry, i)})
        description: Mapping[str, Any] = {"scenario": described, "seed": int(key_of(entry.seed, i)[:8], 16)}
        scenario_aircraft = str(described.get("flight", {}).get("aircraft", ""))
        source = FlightSource(
            f"{label}-{i:05d}", ".csv", key_of(description, simulator.digest), made=description, maker=simulator.fly
        )
        yield CampaignFlight(
            source.location,
            conditions.model_copy(update={"aircraft": conditions.aircraft or scenario_aircraft}),
            source,
        )


def _drawn_values(entry: SimulateEntry, number: int) -> dict[str, float]:
    """Values of the varied keys for one flight, drawn with its number: another count changes no other flight."""
    rng = np.random.default_rng([entry.seed, number])
    return {key: float(rng.uniform(*ends)) for key, ends in sorted(entry.vary.items())}
