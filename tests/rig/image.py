"""The computer's root file system: a small Debian, and on it what docs/install-companion.md says, command by command.

Built once into `build/rig` and kept; `.key` files say from what. The page is followed with the reader's own files at hand:
the checkout, the wheels that `pip wheel` made of it, calibration files. What is not from the page is the rig's own: the disk's
line in fstab, an initramfs with that disk's modules only, an agent that carries out commands, and the keys of the
configuration in which this aircraft differs.
"""

import hashlib
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.cli.docs.blocks import files_of, write_files
from tests.rig.machine import Image, RigError, adapter
from tests.rig.page import HOME, PAGE, installing
from tests.support.paths import ROOT

MIRROR = "http://deb.debian.org/debian"
PACKAGES = (
    "systemd systemd-sysv udev dbus sudo kmod python3 python3-venv e2fsprogs procps util-linux linux-image-amd64"
    " initramfs-tools lz4"
)
_NOT_NEEDED = (  # of a server's start; each takes seconds under emulation
    "e2scrub_reap.service",
    "proc-sys-fs-binfmt_misc.automount",
    "systemd-binfmt.service",
    "systemd-pstore.service",
    "apt-daily.timer",
    "apt-daily-upgrade.timer",
    "e2scrub_all.timer",
    "dpkg-db-backup.timer",
    "fstrim.timer",
)
_AGENT = """\
#!/bin/bash
while [ ! -e /dev/virtio-ports/rig ]; do sleep 0.2; done
exec 3<>/dev/virtio-ports/rig
echo hello >&3
while IFS= read -r -u 3 line; do
  bash -c "$(base64 -d <<<"$line")" >/run/rig.out 2>&1 </dev/null
  echo "$? $(base64 -w0 /run/rig.out)" >&3
done
"""
_AGENT_UNIT = """\
[Unit]
DefaultDependencies=no
After=systemd-udevd.service
[Service]
ExecStart=/usr/local/sbin/rig-agent
[Install]
WantedBy=sysinit.target
"""
_OWN_FILES = {
    "usr/local/sbin/rig-agent": _AGENT,
    "etc/systemd/system/rig-agent.service": _AGENT_UNIT,
    "etc/hostname": "companion\n",
    "etc/hosts": "127.0.0.1 localhost companion\n",
    "etc/fstab": "/dev/vda / ext4 ro,noatime 0 1\n",
    "etc/apt/apt.conf.d/90rig": 'APT::Get::Assume-Yes "true";\nAPT::Install-Recommends "false";\n',
    "etc/initramfs-tools/conf.d/rig": "MODULES=list\nCOMPRESS=lz4\n",
    "etc/initramfs-tools/modules": "virtio_pci\nvirtio_blk\next4\noverlay\ncrc32c_generic\ncrc32c-intel\n",
}
_THIS_AIRCRAFT = {
    'device = "/dev/i2c-1"': 'device = "/dev/i2c-sensors"',
    'device = "/dev/serial0"': f'device = "{adapter("gps")}"',
    'port = "serial:/dev/ttyUSB0:57600"': f'port = "serial:{adapter("radio")}:57600"',
    "rate_hz = 20.0 ": "rate_hz = 2.0 ",  # what an emulated processor does: a message on the bus takes it 4 ms
    "scans = 80 ": "scans = 16 ",
}
"""In which the aircraft's configuration differs from the one that the page copies."""
_CONFIG = "etc/sideslip/aircraft.toml"
_ROOM_MB = 200


def debian(folder: Path) -> Path:
    """A bare Debian 12 below `folder`, made by debootstrap if it is not there."""
    root, key = folder / "debian", folder / "debian.key"
    wanted = f"{MIRROR} {PACKAGES}"
    if key.exists() and key.read_text() == wanted:
        return root
    key.unlink(missing_ok=True)
    shutil.rmtree(root, ignore_errors=True)
    words = ["debootstrap", "--variant=minbase", "--include", PACKAGES.replace(" ", ","), "bookworm", str(root), MIRROR]
    _do(words, folder / "debootstrap.log")
    key.write_text(wanted)
    return root


def wheels(folder: Path) -> Path:
    """What the page has its reader carry: the wheels of this checkout and of all that it needs on board."""
    out = folder / "wheels"
    shutil.rmtree(out, ignore_errors=True)
    _do([sys.executable, "-m", "pip", "wheel", "-q", str(ROOT), "-w", str(out)], folder / "wheels.log")
    return out


def build(folder: Path) -> Image:
    """The image, built anew when the page, the code on board or the rig's own files have changed."""
    folder.mkdir(parents=True, exist_ok=True)
    image = Image(folder / "vmlinuz", folder / "initrd.img", folder / "root.img")
    key = folder / "image.key"
    wanted = _fingerprint()
    if key.exists() and key.read_text() == wanted:
        return image
    key.unlink(missing_ok=True)
    root = folder / "root"
    shutil.rmtree(root, ignore_errors=True)
    _do(["cp", "-a", str(debian(folder)), str(root)], folder / "copy.log")
    _write_own(root)
    _pack_bag(root / HOME.lstrip("/"), wheels(folder))
    with _entered(root):
        for command in installing(PAGE):
            _inside(root, command, folder / "install.log")
        _inside(
            root, "systemctl -q enable rig-agent && systemctl -q mask " + " ".join(_NOT_NEEDED), folder / "install.log"
        )
        _inside(root, "update-initramfs -u", folder / "install.log")
    _edit(root / _CONFIG)
    for name, out in (("vmlinuz", image.kernel), ("initrd.img", image.initrd)):
        (newest,) = (root / "boot").glob(f"{name}-*")
        shutil.copyfile(newest, out)
    size_mb = int(subprocess.check_output(["du", "-sm", str(root)]).split()[0])
    image.root.unlink(missing_ok=True)
    _do(
        ["mke2fs", "-q", "-t", "ext4", "-d", str(root), str(image.root), f"{size_mb * 11 // 10 + _ROOM_MB}M"],
        folder / "mke2fs.log",
    )
    shutil.rmtree(root)
    key.write_text(wanted)
    return image


def _fingerprint() -> str:
    """Of all that the image is made from."""
    digest = hashlib.sha256()
    sources = [
        PAGE,
        *(ROOT / "daq").rglob("*"),
        Path(__file__),
        Path(installing.__code__.co_filename),
        ROOT / "pyproject.toml",
    ]
    for path in sorted(p for p in sources if p.is_file() and p.suffix != ".pyc"):
        digest.update(str(path.relative_to(ROOT)).encode() + path.read_bytes())
    return digest.hexdigest()


def _write_own(root: Path) -> None:
    for name, text in _OWN_FILES.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    (root / "usr/local/sbin/rig-agent").chmod(0o755)
    shutil.copyfile("/etc/resolv.conf", root / "etc/resolv.conf")
    write_files({name.lstrip("/"): text for name, text in files_of(PAGE).items()}, root)


def _pack_bag(bag: Path, made: Path) -> None:
    """What the reader has with him: the checkout's configuration and unit, the wheels, the aircraft's calibration."""
    for name in ("daq/configs", "daq/service"):
        shutil.copytree(ROOT / name, bag / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(made, bag / "wheels")
    shutil.copytree(ROOT / "groundstation/calibration/files/cdfp", bag / "calibration")


def _edit(config: Path) -> None:
    text = config.read_text()
    for was, becomes in _THIS_AIRCRAFT.items():
        if was not in text:
            raise RigError(f"{config} has no line {was}")
        text = text.replace(was, becomes)
    config.write_text(text)


@contextmanager
def _entered(root: Path) -> Iterator[None]:
    """With /proc and /dev, which installers look at."""
    for name in ("proc", "dev"):
        subprocess.run(["mount", "--bind", f"/{name}", str(root / name)], check=True)
    try:
        yield
    finally:
        for name in ("dev", "proc"):
            subprocess.run(["umount", str(root / name)], check=True)


def _inside(root: Path, command: str, log: Path) -> None:
    clean = [
        "env",
        "-i",
        f"HOME={HOME}",
        "PATH=/usr/sbin:/usr/bin:/sbin:/bin",
        "DEBIAN_FRONTEND=noninteractive",
        "LC_ALL=C.UTF-8",
    ]
    _do(["chroot", str(root), *clean, "bash", "-ec", f"cd {HOME}; {command}"], log, told=command)


def _do(words: list[str], log: Path, told: str = "") -> None:
    """Run a program, its words into a log; raises RigError with the end of it where it fails."""
    with log.open("ab") as out:
        out.write(f"$ {told or ' '.join(words)}\n".encode())
        out.flush()
        done = subprocess.run(
            ["nice", "-n", "5", *words], stdin=subprocess.DEVNULL, stdout=out, stderr=out, check=False
        )
    if done.returncode != 0:
        last = re.sub(r"\r", "\n", log.read_text(errors="replace"))[-1500:]
        raise RigError(f"{told or ' '.join(words)} ended with {done.returncode}; {log} ends:\n{last}")
