"""A manoeuvre that comes up the link in fragments, until the sequencer has taken or refused it.

One at a time is received; fragments of another take its place. It is unpacked and weighed against the aircraft's limits in a
thread, because that takes longer than the scan loop has. What is taken stays until the logger ends: the file on board is
not replaced, so that a restart flies what was checked on the ground.
"""

import zlib
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from typing import Any

from daq.contract.link import manoeuvre_wire as wire
from daq.contract.manoeuvre import Weigh
from daq.telemetry.control import Control
from daq.telemetry.send_queue import Item, item
from daq.telemetry.worker import Worker
from daq.utilities.errors import UserError

_PATIENCE_S = 0.5
_WARNING = 4


_Weighed = tuple[str, Callable[[], str]]
"""Digest of a manoeuvre that may be flown, and what puts it in place (see Weigh)."""


class ManoeuvreInbox:
    """text: severity and words for the ground."""

    def __init__(self, text: Callable[[int, str], None]) -> None:
        self._text = text
        self._checksum: int | None = None
        self._fragment_count = 0
        self._fragments: dict[int, bytes] = {}
        self._result = wire.RECEIVING
        self._checking: Future[_Weighed | str] | None = None
        self._worker = Worker("manoeuvre")

    def receive(self, fields: Mapping[str, Any], control: Control) -> Item | None:
        """Use a MANOEUVRE_DATA; the answer, or None for one that makes no sense."""
        checksum, number, count = fields["checksum"], fields["fragment"], fields["fragments"]
        length = fields["length"]
        last = number == count - 1
        if not 0 <= number < count <= wire.MOST_FRAGMENTS or not 0 < length <= wire.FRAGMENT_BYTES:
            return None
        if not last and length != wire.FRAGMENT_BYTES:
            return None
        is_retry = self._result == wire.REFUSED and number == 0  # sent anew: what spoke against it may be over
        if is_retry or (checksum, count) != (self._checksum, self._fragment_count):
            if self._checking is not None:
                return self._status()  # one at a time; the sender tries again
            self._checksum, self._fragment_count, self._fragments, self._result = checksum, count, {}, wire.RECEIVING
        if self._result == wire.RECEIVING:
            self._fragments.setdefault(number, bytes(fields["data"][:length]))
            if len(self._fragments) == self._fragment_count:
                self._check(b"".join(self._fragments[i] for i in range(self._fragment_count)), control)
        return self._status()

    def service(self, control: Control) -> Item | None:
        """Hand on what has been checked; the word for the ground about it, if it is time for one."""
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
        self._worker.close(_PATIENCE_S)

    def _check(self, data: bytes, control: Control) -> None:
        weigh = control.weigh
        if weigh is None:
            self._refuse("there is no sequencer on board")
        elif zlib.crc32(data) != self._checksum:
            # Signed frames do not come altered: it was cut up wrongly, and the same fragments would be again.
            self._refuse("its fragments do not fit together")
        else:
            self._checking = self._worker.submit(_weighed, weigh, data)
            self._result = wire.CHECKING

    def _refuse(self, why: str) -> None:
        self._result = wire.REFUSED
        self._text(_WARNING, f"manoeuvre from the ground refused: {why}")

    def _status(self) -> Item:
        received_mask = sum(1 << i for i in self._fragments)
        return item("MANOEUVRE_STATUS", held=received_mask, checksum=self._checksum, result=self._result)


def _weighed(weigh: Weigh, data: bytes) -> _Weighed | str:
    try:
        manoeuvre = wire.unpack(data)
        return manoeuvre.digest, weigh(manoeuvre)
    except UserError as error:
        return str(error)
