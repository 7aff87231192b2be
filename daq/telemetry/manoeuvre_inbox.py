"""Receives a manoeuvre by radio in fragments and passes it to the sequencer, which takes or refuses it.

One is received at a time; a fragment of another discards it. A thread unpacks it and checks it against the aircraft's limits,
because that takes longer than the scan loop allows. The manoeuvre is used until the logger ends: the file on board is not
replaced, so that a restart flies the one that was checked on the ground.
"""

import zlib
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from typing import Any

from daq.contract.link import manoeuvre_wire as wire
from daq.contract.manoeuvre import ManoeuvreCheck
from daq.telemetry.control import Control
from daq.telemetry.send_queue import Item, item
from daq.telemetry.worker import Worker
from daq.utilities.errors import UserError

_CLOSE_TIMEOUT_S = 0.5  # for a check that is running when the link is closed
_WARNING = 4  # severity of STATUSTEXT, as syslog has it


_CheckedManoeuvre = tuple[str, Callable[[], str]]
"""Digest of a manoeuvre within the limits, and the function that loads it (see ManoeuvreCheck)."""


class ManoeuvreInbox:
    """text: sends a severity and a text to the ground."""

    def __init__(self, text: Callable[[int, str], None]) -> None:
        self._text = text
        self._checksum: int | None = None
        self._fragment_count = 0
        self._fragments: dict[int, bytes] = {}
        self._result = wire.RECEIVING
        self._checking: Future[_CheckedManoeuvre | str] | None = None
        self._worker = Worker("manoeuvre")

    def receive(self, fields: Mapping[str, Any], control: Control) -> Item | None:
        """Take a MANOEUVRE_DATA; returns the MANOEUVRE_STATUS to send, None for an invalid message."""
        checksum, number, count = fields["checksum"], fields["fragment"], fields["fragments"]
        length = fields["length"]
        last = number == count - 1
        if not 0 <= number < count <= wire.MOST_FRAGMENTS or not 0 < length <= wire.FRAGMENT_BYTES:
            return None
        if not last and length != wire.FRAGMENT_BYTES:
            return None
        is_retry = self._result == wire.REFUSED and number == 0  # the reason of the refusal may no longer apply
        if is_retry or (checksum, count) != (self._checksum, self._fragment_count):
            if self._checking is not None:
                return self._status()  # a check is running; the sender repeats its fragments
            self._checksum, self._fragment_count, self._fragments, self._result = checksum, count, {}, wire.RECEIVING
        if self._result == wire.RECEIVING:
            self._fragments.setdefault(number, bytes(fields["data"][:length]))
            if len(self._fragments) == self._fragment_count:
                self._check(b"".join(self._fragments[i] for i in range(self._fragment_count)), control)
        return self._status()

    def service(self, control: Control) -> Item | None:
        """Load a manoeuvre whose check has ended; returns the MANOEUVRE_STATUS to send, None without one."""
        if self._checking is None or not self._checking.done():
            return None
        result, self._checking = self._checking.result(), None
        digest, refusal = ("", result) if isinstance(result, str) else (result[0], result[1]())
        if refusal:
            self._refuse(refusal)
        else:
            self._result = wire.TAKEN
            control.mark_event(f"manoeuvre {digest[:6]} taken from the ground", "ground")
        return self._status()

    def close(self) -> None:
        self._worker.close(_CLOSE_TIMEOUT_S)

    def _check(self, data: bytes, control: Control) -> None:
        check_manoeuvre = control.check_manoeuvre
        if check_manoeuvre is None:
            self._refuse("there is no sequencer on board")
        elif zlib.crc32(data) != self._checksum:
            # signed frames arrive unaltered: the sender has cut it wrongly, and would again
            self._refuse("its fragments do not fit together")
        else:
            self._checking = self._worker.submit(_check, check_manoeuvre, data)
            self._result = wire.CHECKING

    def _refuse(self, reason: str) -> None:
        self._result = wire.REFUSED
        self._text(_WARNING, f"manoeuvre from the ground refused: {reason}")

    def _status(self) -> Item:
        received_mask = sum(1 << i for i in self._fragments)
        return item("MANOEUVRE_STATUS", held=received_mask, checksum=self._checksum, result=self._result)


def _check(check_manoeuvre: ManoeuvreCheck, data: bytes) -> _CheckedManoeuvre | str:
    try:
        manoeuvre = wire.unpack(data)
        return manoeuvre.digest, check_manoeuvre(manoeuvre)
    except UserError as error:
        return str(error)
