"""The process that shows a `ForgettingFiles` as a mounted file system (FUSE), and does as it is told from outside.

Run as `python -m tests.chain.card.server MOUNTPOINT DESCRIPTOR`: the descriptor is a socket for `tests.chain.card.mounted`.
A process of its own, because a program that waits in a system call on a file system that it serves itself waits for ever.
"""

import errno
import os
import stat
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import asdict
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import mfusepy

from tests.chain.card.forgetting import CUTS, PAGE, ForgettingFiles, Inode
from tests.chain.card.troubles import Troubles


class Card(mfusepy.Operations):  # type: ignore[misc]
    """The operations libfuse asks for; several threads at once."""

    use_ns = True

    def __init__(self) -> None:
        self.files = ForgettingFiles()
        self.troubles = Troubles()
        self._lock = threading.RLock()
        self._open: dict[int, Inode] = {}
        self._next = 1
        self._times: dict[int, int] = {}
        self._let_through = threading.Event()
        self._let_through.set()
        self.syncing = 0  # syncs that wait at the closed gate
        self._operations = 0  # that changed something, since it was last asked
        self._left: int | None = None  # of them until everything fails

    # ------------------------------------------------------------------------------------------ orders from outside

    def cut(self, kind: int, seed: int) -> None:
        """The power goes and comes back: what programs have open is dead, what was not synced is as the cut says."""
        with self._lock:
            self.files = self.files.survivors(CUTS[kind], seed)
            self._open.clear()

    def survivors(self, kind: int, seed: int, into: str) -> None:
        """Lay what a cut now would leave into a directory outside; here everything goes on."""
        with self._lock:
            found = self.files.survivors(CUTS[kind], seed).files()
        for path, data in found.items():
            place = Path(into + path)
            (place if path.endswith("/") else place.parent).mkdir(parents=True, exist_ok=True)
            if not path.endswith("/"):
                place.write_bytes(data)

    def trouble(self, troubles: Troubles) -> None:
        """From now on the card is like this."""
        self.troubles = troubles

    def room(self, size: int | None) -> None:
        """Bytes the card takes in all."""
        self.files.room = size

    def gate(self, is_open: bool) -> None:
        """While closed, no sync comes to an end."""
        (self._let_through.set if is_open else self._let_through.clear)()

    def trip(self, operations: int | None) -> int:
        """After so many more changes everything fails, as if the power were gone; None: never. Changes since the last call."""
        with self._lock:
            done, self._operations, self._left = self._operations, 0, operations
            return done

    def secure(self) -> None:
        """Everything written so far goes to the medium."""
        with self._lock:
            self.files.sync_all()

    def waiting(self) -> int:
        """Syncs that stand at the closed gate."""
        return self.syncing

    def traffic(self) -> dict[str, int]:
        """What has gone to the medium."""
        return asdict(self.files.traffic)

    # ------------------------------------------------------------------------------------------ the file system

    def _handle(self, inode: Inode) -> int:
        self._next += 1
        self._open[self._next] = inode
        return self._next

    def _opened(self, handle: int) -> Inode:
        if handle not in self._open:
            raise OSError(errno.EIO, "the power was cut")
        return self._open[handle]

    def _may(self, operation: str) -> None:
        """Before every change; OSError when it is not to be."""
        if self._left == 0:
            raise OSError(errno.EIO, "the power is going")
        self._operations += 1
        self._left = None if self._left is None else self._left - 1
        number = (self.troubles.fails or {}).get(operation)
        if number is not None:
            raise OSError(number, os.strerror(number))

    def getattr(self, path: str, fh: int | None = None) -> dict[str, int]:
        with self._lock:
            inode = self.files.find(path) if fh is None else self._opened(fh)
            at = self._times.get(inode.number, 0)
            return {
                "st_mode": inode.mode,
                "st_ino": inode.number,
                "st_nlink": 1,
                "st_size": len(inode.data),
                "st_blocks": -(-len(inode.data) // 512),
                "st_uid": os.getuid(),
                "st_gid": os.getgid(),
                "st_mtime": at,
                "st_ctime": at,
                "st_atime": at,
            }

    def readdir(self, path: str, fh: int) -> list[tuple[str, dict[str, int], int]]:
        with self._lock:
            here = self.files.find(path)
            rows = [(".", here), *((name, self.files.child(number)) for name, number in here.entries.items())]
            return [(name, {"st_mode": i.mode, "st_ino": i.number}, 0) for name, i in rows]

    def opendir(self, path: str) -> int:
        with self._lock:
            return self._handle(self.files.find(path))

    def releasedir(self, path: str, fh: int) -> None:
        self._open.pop(fh, None)

    def mkdir(self, path: str, mode: int) -> None:
        with self._lock:
            self._may("create")
            self.files.make(path, stat.S_IFDIR | mode)

    def create(self, path: str, mode: int, flags: int) -> int:
        with self._lock:
            self._may("create")
            inode = self.files.make(path, stat.S_IFREG | stat.S_IMODE(mode))
            self._times[inode.number] = time.time_ns()
            return self._handle(inode)

    def open(self, path: str, flags: int) -> int:
        with self._lock:
            inode = self.files.find(path)
            if flags & os.O_TRUNC:
                self._may("change")
                self.files.truncate(inode, 0)
            return self._handle(inode)

    def release(self, path: str, fh: int) -> None:
        self._open.pop(fh, None)

    def read(self, path: str, size: int, offset: int, fh: int) -> bytes:
        with self._lock:
            return bytes(self._opened(fh).data[offset : offset + size])

    def write(self, path: str, data: bytes, offset: int, fh: int) -> int:
        with self._lock:
            self._may("write")
            inode = self._opened(fh)
            self._times[inode.number] = time.time_ns()
            return self.files.write(inode, data, offset)

    def truncate(self, path: str, length: int, fh: int | None = None) -> None:
        with self._lock:
            self._may("change")
            self.files.truncate(self.files.find(path) if fh is None else self._opened(fh), length)

    def unlink(self, path: str) -> None:
        with self._lock:
            self._may("change")
            self.files.remove(path)

    rmdir = unlink

    def rename(self, old: str, new: str) -> None:
        with self._lock:
            self._may("change")
            self.files.rename(old, new)

    def chmod(self, path: str, mode: int) -> None:
        with self._lock:
            self._may("change")
            inode = self.files.find(path)
            inode.mode = stat.S_IFMT(inode.mode) | stat.S_IMODE(mode)

    def fsync(self, path: str, datasync: int, fh: int) -> None:
        self._wait_for_the_card(len(self._opened(fh).dirty) * PAGE)
        with self._lock:
            inode = self._opened(fh)
            try:
                self._may("sync")
            except OSError:
                self.files.sync_fails(inode)
                raise
            self.files.sync_file(inode)

    def fsyncdir(self, path: str, datasync: int, fh: int) -> None:
        self._wait_for_the_card(PAGE)
        with self._lock:
            self._may("sync")
            self.files.sync_directory(self._opened(fh))

    def statfs(self, path: str) -> dict[str, int]:
        with self._lock:
            room = 1 << 30 if self.files.room is None else self.files.room
            free = max(0, room - self.files.used()) // PAGE
        return {"f_bsize": PAGE, "f_frsize": PAGE, "f_blocks": room // PAGE, "f_bfree": free, "f_bavail": free}

    def _wait_for_the_card(self, size: int) -> None:
        troubles = self.troubles
        time.sleep(troubles.sync_s + (size / troubles.bytes_per_s if troubles.bytes_per_s else 0.0))
        self.syncing += 1
        self._let_through.wait()
        self.syncing -= 1


def obey(card: Card, orders: Connection) -> None:
    """Carry out what comes over the socket, until it is closed."""
    doing: dict[str, Callable[..., Any]] = {
        name: getattr(card, name)
        for name in ("cut", "survivors", "trouble", "room", "gate", "trip", "secure", "waiting", "traffic")
    }
    while True:
        try:
            name, arguments = orders.recv()
        except EOFError:
            return
        try:
            orders.send((True, doing[name](*arguments)))
        except OSError as error:
            orders.send((False, error))


def main(mountpoint: str, descriptor: int) -> None:
    """Serve until unmounted."""
    card = Card()

    def serve() -> None:
        obey(card, Connection(descriptor))
        # Whoever mounted it is gone, killed perhaps: leave no mount behind.
        subprocess.run(["fusermount3", "-u", "-z", mountpoint], check=False, capture_output=True)

    threading.Thread(target=serve, daemon=True).start()
    nothing_cached = {"entry_timeout": 0, "attr_timeout": 0, "negative_timeout": 0, "direct_io": True}
    mfusepy.FUSE(
        card, mountpoint, foreground=True, fsname="forgetting", use_ino=True, hard_remove=True, **nothing_cached
    )


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
