"""The description of a recording as it comes over the link, checked for type and range before it is used.

The papers (identity and events as compressed JSON) and the archive (attachments) come over the link, where another sender can
answer in the aircraft's place. The limits are several times what a logger sends: it stores 200 events, and its configuration
and calibration files are some tens of kilobytes.
"""

import re
import zlib
from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, field_validator

from daq.contract.link.papers_dictionary import PAPERS_DICTIONARY
from daq.contract.recordings.messages import EventMessage
from daq.contract.recordings.recording import CALIBRATION_PREFIX, CONFIG_ATTACHMENT, RecordingInfo
from groundstation.receiver.continuity import FASTEST_HZ

MAX_PAPERS_BYTES = 1 << 20  # of the papers decompressed; compressed they fit 255 fragments of 190 bytes
MAX_ARCHIVE_BYTES = 1 << 20  # of the archive compressed: one record of the journal
MAX_ATTACHMENTS_BYTES = 1 << 24  # of the archive decompressed
MAX_ATTACHMENTS = 256
MAX_TEXT_BYTES, MAX_LINE_BYTES = 1 << 18, 4096
"""Of configuration and calibration files together, and of one line: tens of times the usual. The time of a parser may grow with
the square of the length of a line."""
MAX_EVENTS = 1000
MAX_TIME_NS = 2**63 - 1  # of a signed 64-bit time in a file: 292 years from 1970

_Time = Annotated[int, Field(ge=0, le=MAX_TIME_NS)]
_Number = Annotated[int, Field(ge=0, le=2**32 - 1)]
_Name = Annotated[str, Field(max_length=128)]
_Text = Annotated[str, Field(max_length=4096)]
_Row = tuple[_Time, _Time, _Number, _Name, _Text]


class Papers(BaseModel):
    """Identity of a recording: session, source, rate [Hz], start [ns UTC], details; its events; size and hash of the archive."""

    model_config = ConfigDict(frozen=True, strict=True, allow_inf_nan=False)

    session: Annotated[str, Field(min_length=1, max_length=128)]
    source: _Name
    aircraft: _Name
    scan_rate_hz: Annotated[float, Field(gt=0.0, le=FASTEST_HZ)]
    started_utc_ns: _Time
    software: _Name
    details: Annotated[dict[_Name, _Text], Field(max_length=1024)]
    events: Annotated[tuple[_Row, ...], Field(max_length=MAX_EVENTS)] = ()
    archive_bytes: Annotated[int, Field(ge=0, le=MAX_ARCHIVE_BYTES)] = 0
    archive_sha256: Annotated[str, Field(max_length=64)] = ""

    @field_validator("session")
    @classmethod
    def _no_folder(cls, session: str) -> str:
        if "/" in session or not session.isprintable():
            raise ValueError("a session's name is part of file names")
        return session

    def info(self, attachments: Mapping[str, bytes]) -> RecordingInfo:
        """Identity of the received recording, with these attachments by name."""
        identity = self.model_dump(exclude={"events", "archive_bytes", "archive_sha256"})
        return RecordingInfo(**identity, role="received", attachments=attachments)

    def marks(self) -> list[EventMessage]:
        """The recording's events."""
        return [EventMessage(*row) for row in self.events]


def inflate(data: bytes, limit: int) -> bytes | None:
    """`data` decompressed; None for bytes that are not compressed, are incomplete, or hold more than `limit` bytes."""
    unpacker = zlib.decompressobj(zdict=PAPERS_DICTIONARY)  # used only if the bytes were compressed with it
    try:
        unpacked = unpacker.decompress(data, limit + 1)
    except zlib.error:
        return None
    return unpacked if unpacker.eof and len(unpacked) <= limit else None


def parse_papers(packed: bytes) -> Papers | None:
    """Papers from their bytes; None for invalid bytes."""
    text = inflate(packed, MAX_PAPERS_BYTES)
    if text is None:
        return None
    try:
        return Papers.model_validate_json(text)
    except ValidationError:
        return None


_CALIBRATION_FILE = re.compile(re.escape(CALIBRATION_PREFIX) + r".*\.toml", re.DOTALL)
_ATTACHMENTS: TypeAdapter[Any] = TypeAdapter(
    Annotated[dict[Annotated[str, Field(min_length=1, max_length=255)], str], Field(max_length=MAX_ATTACHMENTS)],
    config=ConfigDict(strict=True),
)


def parse_archive(packed: bytes) -> dict[str, bytes] | None:
    """Attachment by name from the bytes of an archive; None for invalid bytes.

    Configuration and calibration files are checked to be text, which readers of the recording rely on.
    """
    text = inflate(packed, MAX_ATTACHMENTS_BYTES) if len(packed) <= MAX_ARCHIVE_BYTES else None
    if text is None:
        return None
    try:
        attachments = {str(name): bytes.fromhex(digits) for name, digits in _ATTACHMENTS.validate_json(text).items()}
        texts = [
            data for name, data in attachments.items() if name == CONFIG_ATTACHMENT or _CALIBRATION_FILE.fullmatch(name)
        ]
        lines = [line for data in texts for line in data.decode("utf-8").split("\n")]
    except ValueError:
        return None
    within_limits = sum(map(len, texts)) <= MAX_TEXT_BYTES and max(map(len, lines), default=0) <= MAX_LINE_BYTES
    return attachments if within_limits else None
