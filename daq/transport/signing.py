"""MAVLink 2 message signing for both ends of the link.

A signature is a link id, a 48-bit timestamp (10 microsecond units since 2015-01-01) and the first six bytes of SHA-256 over key,
frame, link id and timestamp (MAVLink guide, "Message Signing"). The hash is verified, in constant time, before any content of a
frame is used or stored, so that a forged frame can neither advance a stream's timestamp nor lock the true sender out. Timestamps
survive a restart, so that recorded frames cannot be replayed later.
"""

import hashlib
import hmac
import json
import logging
import os
import stat
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any

from daq.utilities.durable import make_directories, replacing
from daq.utilities.errors import UserError
from daq.utilities.input_files import READ_AT_ONCE

KEY_BYTES = 32
SIGNATURE_BYTES = 13
UNITS_PER_S = 100_000
EPOCH_UNIX_S = 1_420_070_400
"""2015-01-01 in Unix time."""
NEW_STREAM_MARGIN = 60 * UNITS_PER_S
"""A new stream may lag the latest received timestamp by this much (MAVLink guide: one minute)."""
RESERVE = 60 * UNITS_PER_S
"""Outgoing timestamps are reserved on disk this far ahead, so that a restart never repeats one."""
MAX_STREAMS = 256  # (system, component, link id) in a state; frames of further ones are refused
CLOCK_KNOWN = 10 * 365 * 86_400 * UNITS_PER_S
"""A clock before 2025 was never set: clocks without a battery begin in 1970, or when their system was built."""

_STAMP_LIMIT = 2**48 - 1
_KEY_FILE_BYTES = 4096
_STATE_FILE_BYTES = 1 << 16
"""MAX_STREAMS rows of at most 30 characters are an eighth of it."""
_LOG = logging.getLogger("sideslip.signing")


class SigningError(UserError):
    """A key or state file that cannot be used."""


class SignatureVerdict(Enum):
    """Result of checking the signature of a frame."""

    GOOD = "good"
    UNSIGNED = "unsigned"
    FORGED = "badly signed"
    REPLAYED = "replayed"

    @property
    def accepted(self) -> bool:
        return self is SignatureVerdict.GOOD


def load_key(path: str | Path) -> bytes:
    """Read a signing key from a file: 32 bytes, or 64 hexadecimal digits.

    Raises SigningError when the file is missing, no regular file, readable by others than its owner, or no key.
    """
    path = Path(path)
    try:
        data, mode = _small_file(path, _KEY_FILE_BYTES)
    except OSError as error:
        raise SigningError(
            f"{path}: signing key cannot be read ({error.strerror}); correct the key key_file"
        ) from error
    if not stat.S_ISREG(mode):
        raise SigningError(f"{path}: not a regular file, so not a signing key; correct the key key_file")
    if stat.S_IMODE(mode) & 0o077:
        raise SigningError(
            f"{path}: signing key has mode {stat.S_IMODE(mode):04o}, others may read it; run 'chmod 600 {path}'"
        )
    text = data.strip()
    if len(data) != KEY_BYTES and len(text) == 2 * KEY_BYTES:
        try:
            data = bytes.fromhex(text.decode("ascii"))
        except (UnicodeDecodeError, ValueError):
            data = b""
    if len(data) != KEY_BYTES:
        raise SigningError(f"{path}: not a signing key; it must hold 32 bytes or 64 hexadecimal digits")
    if len(set(data)) == 1:
        raise SigningError(
            f"{path}: every byte of this signing key is the same, which anybody can guess; make one: 'head -c 32 /dev/urandom'"
        )
    return data


def _small_file(path: Path, limit: int) -> tuple[bytes, int]:
    """Read at most `limit` + 1 bytes of a regular file, none of another kind; returns them and the mode.

    Opens without blocking, even a FIFO without a writer. Raises OSError.
    """
    descriptor = os.open(path, READ_AT_ONCE | getattr(os, "O_NOCTTY", 0))
    mode = os.fstat(descriptor).st_mode
    if not stat.S_ISREG(mode):
        os.close(descriptor)
        return b"", mode
    with os.fdopen(descriptor, "rb") as file:
        return file.read(limit + 1), mode


def stamp_of(utc_ns: int) -> int:
    """The signing timestamp of a UTC time [10 us since 2015]; 0 before 2015."""
    return max(0, utc_ns // 10_000 - EPOCH_UNIX_S * UNITS_PER_S)


def signature_hash(key: bytes, frame: bytes, link_id: int, stamp: int) -> bytes:
    """The six hash bytes of a signature over `frame` (magic to checksum)."""
    tail = bytes([link_id]) + stamp.to_bytes(6, "little")
    return hashlib.sha256(key + frame + tail).digest()[:6]


@dataclass
class SigningState:
    """The state that must survive a restart: the last timestamp sent, or reserved, and the last one received, in all and by
    stream."""

    sent: int = 0
    heard: int = 0
    streams: dict[tuple[int, int, int], int] = field(default_factory=dict)  # (system, component, link id) -> timestamp


def load_state(path: Path | None) -> SigningState:
    """Read the state from `path`; a new one when there is no file.

    Raises SigningError when the file is no signing state, because a new state would make replays possible.
    """
    if path is None:
        return SigningState()
    try:
        data, mode = _small_file(path, _STATE_FILE_BYTES)
        if not stat.S_ISREG(mode):
            raise SigningError(f"{path}: not a regular file, so not a signing state; correct the key signing_state")
        if len(data) > _STATE_FILE_BYTES:
            raise ValueError(f"it has more than {_STATE_FILE_BYTES} bytes")
        return _state_of(json.loads(data))
    except FileNotFoundError:
        return SigningState()
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise SigningError(
            f"{path}: not a signing state ({str(error)[:100]}); remove the file only if the key is new, or replays become"
            " possible"
        ) from error


def _state_of(table: Any) -> SigningState:
    """The state in the JSON of its file. Raises ValueError, KeyError or TypeError for invalid content."""
    rows = table["streams"]
    if not isinstance(rows, list) or len(rows) > MAX_STREAMS:
        raise ValueError(f"streams is not a list of at most {MAX_STREAMS}")
    streams = {}
    for system, component, link, stamp in rows:
        stream = (_bounded_integer(system, 255), _bounded_integer(component, 255), _bounded_integer(link, 255))
        streams[stream] = _bounded_integer(stamp, _STAMP_LIMIT)
    return SigningState(
        _bounded_integer(table["sent"], _STAMP_LIMIT), _bounded_integer(table["heard"], _STAMP_LIMIT), streams
    )


def _bounded_integer(value: object, most: int) -> int:
    if type(value) is not int or not 0 <= value <= most:
        raise ValueError(f"not a whole number from 0 to {most}")
    return value


def save_state(state: SigningState, path: Path) -> None:
    """Write the state atomically and synced, so that a power cut restores no older one. Raises OSError.

    It is written under an unpredictable name into a file that must not exist yet, so that a link planted in a folder that others
    may write to is not followed.
    """
    rows = [[*stream, stamp] for stream, stamp in sorted(state.streams.items())]
    make_directories(path.parent)
    with replacing(path) as new:
        new.chmod(0o600)
        new.write_text(json.dumps({"sent": state.sent, "heard": state.heard, "streams": rows}))


class Signer:
    """Signs sent frames and checks received ones, with one key.

    now: returns UTC [ns]. While the clock is behind the last timestamp (no battery-backed clock), each frame's timestamp is the
    last one plus one unit.

    An invalid state file is renamed, and `notice` says so in a sentence. Timestamps then begin with the clock, so that frames
    recorded more than NEW_STREAM_MARGIN ago are still refused. Raises SigningError where the clock was never set.
    """

    def __init__(self, key: bytes, now: Callable[[], int], *, link_id: int = 0, state_path: Path | None = None) -> None:
        if len(key) != KEY_BYTES:
            raise SigningError(f"signing key has {len(key)} bytes; it must have {KEY_BYTES}")
        self._key = key
        self._now = now
        self._link_id = link_id
        self._path = state_path
        self.notice = ""
        self.state = self._loaded(state_path)
        self._reserved = self.state.sent
        self._last = self.state.sent
        self._saved_heard = self.state.heard

    def _loaded(self, path: Path | None) -> SigningState:
        try:
            return load_state(path)
        except SigningError as error:
            now_stamp = stamp_of(self._now())
            if path is None or not path.is_file():
                raise
            if now_stamp < CLOCK_KNOWN:
                raise SigningError(f"{error}; it is not replaced, because this computer's clock is not set") from error
            unusable = path.with_name(path.name + ".unusable")
            path.replace(unusable)
            self.notice = (
                f"{path}: not a signing state; set aside as {unusable}, timestamps begin with this computer's clock"
            )
            _LOG.warning("%s", self.notice)
            return SigningState(now_stamp, now_stamp)

    def sign(self, frame: bytes) -> bytes:
        """The 13 signature bytes of a frame (magic to checksum, signed flag set)."""
        self._last = min(_STAMP_LIMIT, max(self._last + 1, stamp_of(self._now())))
        link, stamp = self._link_id, self._last
        return bytes([link]) + stamp.to_bytes(6, "little") + signature_hash(self._key, frame, link, stamp)

    def judge(self, frame: bytes, stream: tuple[int, int], signature: bytes | None) -> SignatureVerdict:
        """Check a received frame (magic to checksum) of `stream` (system, component), and note its timestamp if it is good."""
        if signature is None:
            return SignatureVerdict.UNSIGNED
        link, stamp = signature[0], int.from_bytes(signature[1:7], "little")
        if not hmac.compare_digest(signature_hash(self._key, frame, link, stamp), signature[7:13]):
            return SignatureVerdict.FORGED
        key = (*stream, link)
        last_stamp = self.state.streams.get(key)
        floor = self.state.heard - NEW_STREAM_MARGIN if last_stamp is None else last_stamp + 1
        if stamp < floor:
            return SignatureVerdict.REPLAYED
        if last_stamp is None and len(self.state.streams) >= MAX_STREAMS:
            return SignatureVerdict.REPLAYED
        self.state.streams[key] = stamp
        self.state.heard = max(self.state.heard, stamp)
        return SignatureVerdict.GOOD

    def needs_saving(self) -> bool:
        """Whether the state on disk is out of date: a frame was received, or the reserve of timestamps runs out."""
        return self.state.heard != self._saved_heard or self._last + RESERVE // 2 > self._reserved

    def save(self) -> None:
        """Save the state; may block on the file system."""
        reserved = max(self._last, stamp_of(self._now())) + RESERVE
        heard_stamp = self.state.heard
        if self._path is not None:
            save_state(SigningState(reserved, heard_stamp, dict(self.state.streams)), self._path)
        self._reserved, self._saved_heard = reserved, heard_stamp
