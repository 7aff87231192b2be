"""The booted computer: QEMU without KVM, its root file system read-only, its card an image that stays, its plug in our hand."""

import base64
import json
import socket
import subprocess
import time
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

BOOT_LIMIT_S = 600.0
MEMORY_MB = 768
_PATIENCE_S = 0.5
SERIAL_ADAPTERS = ("gps", "radio")
"""Serial lines, each behind a USB adapter of its own serial number."""
_LEFT_OUT = (
    "dbus.service dbus.socket systemd-logind.service getty.target systemd-user-sessions.service systemd-journal-flush.service"
    " modprobe@dm_mod.service modprobe@fuse.service modprobe@loop.service modprobe@efi_pstore.service modprobe@configfs.service"
    " modprobe@drm.service kmod-static-nodes.service dev-hugepages.mount dev-mqueue.mount sys-kernel-debug.mount"
    " sys-kernel-tracing.mount sys-kernel-config.mount sys-fs-fuse-connections.mount systemd-sysusers.service"
    " systemd-random-seed.service systemd-update-utmp.service systemd-fsck-root.service systemd-remount-fs.service"
    " systemd-sysctl.service systemd-machine-id-commit.service"
).split()
"""Of a lean start, units that the logger knows nothing of: half of the time of an emulated processor."""


def adapter(line: str) -> str:
    """The name that udev gives a serial adapter in the machine."""
    return f"/dev/serial/by-id/usb-QEMU_QEMU_USB_SERIAL_{line}-if00-port0"


class RigError(Exception):
    """The rig itself cannot go on, in a sentence."""


@dataclass(frozen=True, slots=True)
class Image:
    """What is booted."""

    kernel: Path
    initrd: Path
    root: Path


@dataclass(frozen=True, slots=True)
class Answer:
    """What a command in the machine said."""

    status: int
    text: str


class Machine:
    """One power-up of the computer. folder: has the bench's sockets; console and agent are put beside them.

    card: the image it records on; None for a computer whose card was left at home. read_only: the card's lock is on. lean: start
    without what the logger knows nothing of, for many starts in a row. absent: serial adapters that are not plugged in.
    Leaving the context pulls the plug.
    """

    def __init__(
        self,
        image: Image,
        folder: Path,
        card: Path | None,
        *,
        read_only: bool = False,
        lean: bool = False,
        absent: Collection[str] = (),
    ) -> None:
        self._folder, self._plugs = folder, folder / "plugs"
        self._plugs.unlink(missing_ok=True)
        self.console = folder / "console.log"
        agent = folder / "agent"
        agent.unlink(missing_ok=True)
        self._listener = socket.socket(socket.AF_UNIX)
        self._listener.bind(str(agent))
        self._listener.listen(1)
        self._listener.settimeout(BOOT_LIMIT_S)
        self._connection: socket.socket | None = None
        self._buffer = b""
        self._process = subprocess.Popen(
            _command(image, folder, card, read_only, lean, absent),
            stdin=subprocess.DEVNULL,
            stderr=(folder / "qemu.log").open("wb"),
        )
        self.started = time.monotonic()

    def wait_for_agent(self) -> float:
        """Wait until the machine takes commands; returns the seconds since it was switched on. Raises RigError."""
        try:
            if self._connection is None:  # it is the emulator's, and lives through a restart of what is emulated
                self._connection, _ = self._listener.accept()
                self._connection.settimeout(BOOT_LIMIT_S)
            self._line()
        except OSError as error:
            last = self.console.read_text(errors="replace")[-400:] if self.console.exists() else ""
            raise RigError(
                f"the machine did not boot within {BOOT_LIMIT_S:.0f} s ({error}); its console ends:\n{last}"
            ) from error
        return time.monotonic() - self.started

    def run(self, command: str, *, check: bool = True) -> Answer:
        """Run a command of bash in the machine, as root. Raises RigError where it fails and `check` holds."""
        assert self._connection is not None
        self._connection.sendall(base64.b64encode(command.encode()) + b"\n")
        status, _, text = self._line().partition(b" ")
        answer = Answer(int(status), base64.b64decode(text).decode(errors="replace"))
        if check and answer.status != 0:
            raise RigError(f"in the machine: {command}\nended with {answer.status}:\n{answer.text}")
        return answer

    def wait_until(self, command: str, limit_s: float) -> str:
        """Repeat a command until it ends with 0; what it printed then. Raises RigError after `limit_s`."""
        deadline = time.monotonic() + limit_s
        while True:
            answer = self.run(command, check=False)
            if answer.status == 0:
                return answer.text.strip()
            if time.monotonic() > deadline:
                raise RigError(f"in the machine, after {limit_s:.0f} s still not: {command}\n{answer.text}")
            time.sleep(_PATIENCE_S)

    def plug(self, line: str, there: bool) -> None:
        """Plug a serial adapter in, or pull it. Raises RigError."""
        device, data = f"usb_{line}", {"path": str(self._folder / line)}
        backend = {"type": "socket", "data": {"addr": {"type": "unix", "data": data}, "server": False}}
        if there:
            self._plugs_do("chardev-add", id=line, backend=backend)
            self._plugs_do("device_add", driver="usb-serial", chardev=line, id=device, serial=line)
        else:
            self._plugs_do("device_del", until="DEVICE_DELETED", id=device)
            self._plugs_do("chardev-remove", id=line)

    def _plugs_do(self, command: str, until: str = "", **arguments: object) -> None:
        """One command of QEMU's machine protocol; until: the event that shows that it is done."""
        with socket.socket(socket.AF_UNIX) as connection, connection.makefile("rw") as plugs:
            connection.connect(str(self._plugs))
            connection.settimeout(BOOT_LIMIT_S)
            plugs.readline()  # greeting
            events = set()
            for execute, words in (("qmp_capabilities", {}), (command, arguments)):
                plugs.write(json.dumps({"execute": execute, "arguments": words}) + "\n")
                plugs.flush()
                while "event" in (answer := json.loads(plugs.readline())):
                    events.add(answer["event"])
                if "error" in answer:
                    raise RigError(f"QEMU refuses {execute} {words}: {answer['error'].get('desc')}")
            while until and until not in events:
                events.add(json.loads(plugs.readline()).get("event"))

    def crash(self) -> None:
        """Kill the kernel, as itself would at a fault; the agent is gone until `wait_for_agent` finds it again."""
        assert self._connection is not None
        word = base64.b64encode(b"echo 0 >/proc/sys/kernel/panic; echo c >/proc/sysrq-trigger")
        self._connection.sendall(word + b"\n")
        self.started = time.monotonic()

    def cut(self) -> None:
        """Pull the plug: nothing that is not on the card is there afterwards."""
        self._process.kill()
        self._process.wait()
        if self._connection is not None:
            self._connection.close()
            self._connection = None
        self._listener.close()

    def __enter__(self) -> "Machine":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.cut()

    def _line(self) -> bytes:
        assert self._connection is not None
        while b"\n" not in self._buffer:
            data = self._connection.recv(1 << 16)
            if not data:
                raise RigError("the machine has ended by itself")
            self._buffer += data
        line, _, self._buffer = self._buffer.partition(b"\n")
        return line


def _command(
    image: Image, folder: Path, card: Path | None, read_only: bool, lean: bool, absent: Collection[str]
) -> list[str]:
    def unix(name: str) -> list[str]:
        return ["-chardev", f"socket,id={name},path={folder / name}"]

    words = ["nice", "-n", "5", "qemu-system-x86_64", "-nodefaults", "-vga", "none"]
    words += ["-accel", "tcg,thread=multi,tb-size=512", "-cpu", "Nehalem", "-smp", "1"]
    words += ["-m", str(MEMORY_MB), "-display", "none", "-monitor", "none", "-rtc", "base=utc"]
    words += ["-kernel", str(image.kernel), "-initrd", str(image.initrd)]
    masks = [f"systemd.mask={unit}" for unit in _LEFT_OUT] if lean else []
    words += ["-append", " ".join(["root=/dev/vda ro console=ttyS0 quiet mitigations=off nowatchdog", *masks])]
    words += ["-drive", f"file={image.root},if=virtio,format=raw,readonly=on"]
    if card is not None:
        words += ["-drive", f"file={card},if=virtio,format=raw,readonly={'on' if read_only else 'off'}"]
    words += ["-device", "i6300esb", "-action", "watchdog=reset"]
    words += ["-serial", f"file:{folder / 'console.log'}"]
    words += ["-qmp", f"unix:{folder / 'plugs'},server=on,wait=off", "-device", "qemu-xhci"]
    for line in SERIAL_ADAPTERS:
        if line not in absent:
            words += [*unix(line), "-device", f"usb-serial,chardev={line},id=usb_{line},serial={line}"]
    for device in ("sensors", "spare"):
        words += [*unix(device), "-device", f"usb-redir,chardev={device},id=usb_{device}"]
    words += ["-device", "virtio-serial-pci", *unix("agent"), "-device", "virtserialport,chardev=agent,name=rig"]
    return words
