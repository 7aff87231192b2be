"""The memory card of the simulated aircraft: a real directory behind the recorder's file interface, with faults.

Stalls last simulated time. A full card takes part of a write and then fails, which leaves an incomplete chunk in the file as on a
real one. A card that is gone fails every operation with EIO, also on open files.
"""

import errno
import os
from pathlib import Path

from daq.clock import Clock
from daq.recorder.storage import RealStorage, Storage, StorageFile
from firmware_sim.hardware.faults import FILE_KINDS, Fault, FaultSet


class SimulatedCard:
    """A `daq.recorder.storage.Storage` that fails at the times of the scenario's faults."""

    def __init__(self, faults: FaultSet, clock: Clock, origin_ns: int = 0, inner: Storage | None = None) -> None:
        self._faults = tuple(f for f in faults.faults if f.kind in FILE_KINDS)
        self._clock = clock
        self._origin_ns = origin_ns
        self._inner = inner or RealStorage()

    def create(self, path: Path) -> StorageFile:
        self.touch()
        return _CardFile(self._inner.create(path), self)

    def free_bytes(self, directory: Path) -> int:
        return 0 if self._active("disk_full") else self._inner.free_bytes(directory)

    def recordings(self, directory: Path) -> list[Path]:
        self.touch()
        return self._inner.recordings(directory)

    def remove(self, path: Path) -> None:
        self.touch()
        self._inner.remove(path)

    def full(self) -> bool:
        """Whether the card is full now."""
        return self._active("disk_full") is not None

    def touch(self) -> None:
        """Delay an operation, or make it fail, as the active faults require. Raises OSError (EIO)."""
        for fault in self._faults:
            if not fault.active(self._seconds()):
                continue
            if fault.kind == "card_gone":
                raise OSError(errno.EIO, os.strerror(errno.EIO))
            if fault.kind == "sd_slow":
                self._clock.sleep_until(self._clock.monotonic_ns() + round((fault.size or 0.0) * 1e9))
            elif fault.kind == "sd_stall":
                self._clock.sleep_until(self._origin_ns + round(fault.stop_s * 1e9))

    def _seconds(self) -> float:
        return (self._clock.monotonic_ns() - self._origin_ns) * 1e-9

    def _active(self, kind: str) -> Fault | None:
        return next((f for f in self._faults if f.kind == kind and f.active(self._seconds())), None)


class _CardFile:
    def __init__(self, inner: StorageFile, card: SimulatedCard) -> None:
        self._inner = inner
        self._card = card

    def write(self, data: bytes) -> int:
        self._card.touch()
        if self._card.full():
            self._inner.write(data[: len(data) // 2])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return self._inner.write(data)

    def tell(self) -> int:
        return self._inner.tell()

    def flush(self) -> None:
        self._inner.flush()

    def sync(self) -> None:
        self._card.touch()
        self._inner.sync()

    def close(self) -> None:
        self._inner.close()
