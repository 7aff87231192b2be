"""Make the operating system leave the scan loop alone: scheduling class, locked memory, garbage collection.

All of it is optional. On an ordinary kernel the loop keeps its deadlines within milliseconds without.
"""

import ctypes
import gc
import os

from daq.config import ConfigError, ScanConfig

_MCL_CURRENT, _MCL_FUTURE = 1, 2
_FULL_COLLECTION_EVERY = 60


def prepare_process(config: ScanConfig) -> None:
    """Apply what `[scan]` asks for. Raises ConfigError naming the key and the missing right."""
    if config.realtime_priority:
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(config.realtime_priority))
        except PermissionError as error:
            raise ConfigError(
                f"scan.realtime_priority {config.realtime_priority}: not permitted; "
                "run as the systemd service (it grants CAP_SYS_NICE) or set it to 0"
            ) from error
    if config.lock_memory:
        _lock_memory()


def _lock_memory() -> None:
    library = ctypes.CDLL(None, use_errno=True)
    if library.mlockall(_MCL_CURRENT | _MCL_FUTURE) != 0:
        reason = os.strerror(ctypes.get_errno())
        raise ConfigError(
            f"scan.lock_memory: not permitted ({reason}); run as the systemd service (it sets LimitMEMLOCK) or set it to false"
        )


class GarbageDiscipline:
    """Collects garbage in the slack after a scan instead of whenever Python feels like it.

    Everything alive at the first collection is frozen: later ones look only at what came after it.
    """

    def __init__(self, *, enabled: bool) -> None:
        self._enabled = enabled
        self._turn = 0

    def __enter__(self) -> "GarbageDiscipline":
        if self._enabled:
            gc.disable()
        return self

    def __exit__(self, *_: object) -> None:
        if self._enabled:
            gc.enable()
            gc.unfreeze()

    def collect(self) -> None:
        """Once a second: the young objects; once a minute all. The first call freezes what the start has built."""
        if not self._enabled:
            return
        if self._turn == 0:
            gc.collect()
            gc.freeze()
        self._turn += 1
        gc.collect(2 if self._turn % _FULL_COLLECTION_EVERY == 0 else 1)
