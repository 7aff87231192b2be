"""Can the logger be installed on ARM? Each onboard dependency is looked up. Run: python -m tests.studies.onboard_install

For every package that `pip install .` brings (the base dependencies and theirs), on aarch64 and armv7l, under the Python of
Debian 12 and 13: a wheel that fits, else Debian's own package in a version that will do, else the source. Then `pip install .`
itself, here: what it takes of memory and disk. Needs the network and, for Debian's packages, apt.
"""

import argparse
import json
import re
import resource
import subprocess
import sys
import tempfile
import tomllib
import venv
from dataclasses import dataclass
from pathlib import Path

from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name
from packaging.version import InvalidVersion, Version

from tests.support.paths import ROOT

_PIP = (sys.executable, "-m", "pip", "--disable-pip-version-check")


@dataclass(frozen=True, slots=True)
class Target:
    """A computer to install on. glibc: of its Debian, the newest wheel tag that runs there."""

    machine: str
    debian: str
    python: str
    glibc: int

    @property
    def architecture(self) -> str:
        """Debian's name for the machine."""
        return {"aarch64": "arm64", "armv7l": "armhf"}[self.machine]

    @property
    def tags(self) -> list[str]:
        """The options by which pip looks for wheels for it."""
        platforms = [f"manylinux_2_{minor}_{self.machine}" for minor in range(self.glibc, 16, -1)]
        abis = [f"cp{self.python.replace('.', '')}", "abi3", "none"]
        named = [("--platform", p) for p in [*platforms, f"manylinux2014_{self.machine}"]]
        return [word for pair in [*named, *(("--abi", a) for a in abis)] for word in pair]


TARGETS = tuple(
    Target(machine, debian, python, glibc)
    for machine in ("aarch64", "armv7l")
    for debian, python, glibc in (("bookworm", "3.11", 36), ("trixie", "3.13", 41))
)
_DEBIAN_NAMES = {"protobuf": "python3-protobuf", "pyserial": "python3-serial"}


def onboard_packages() -> dict[str, SpecifierSet]:
    """Name of every package that an onboard installation brings, and the versions that are wanted of it."""
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["dependencies"]
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        subprocess.run(
            [*_PIP, "install", "--quiet", "--dry-run", "--ignore-installed", "--report", str(report), *declared],
            check=True,
        )
        found = [item["metadata"] for item in json.loads(report.read_text())["install"]]
    wanted = {canonicalize_name(m["name"]): SpecifierSet() for m in found}
    asked = declared + [line for m in found for line in m.get("requires_dist", [])]
    for requirement in map(Requirement, asked):
        name = canonicalize_name(requirement.name)
        if name in wanted and (requirement.marker is None or requirement.marker.evaluate({"extra": ""})):
            wanted[name] &= requirement.specifier
    return wanted


def wheel(name: str, wanted: SpecifierSet, target: Target) -> str | None:
    """The wheel pip would take for a target, by file name; None when the index has none that fits."""
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        look = ["install", "--quiet", "--dry-run", "--no-deps", "--ignore-installed", "--only-binary=:all:"]
        there = ["--python-version", target.python, "--implementation", "cp", *target.tags]
        command = [*_PIP, *look, "--target", folder, "--report", str(report), *there, f"{name}{wanted}"]
        done = subprocess.run(command, check=False, capture_output=True)
        if done.returncode:
            return None
        (item,) = json.loads(report.read_text())["install"]
        return str(item["download_info"]["url"]).rsplit("/", 1)[-1]


class Debian:
    """Debian's package lists for one target, kept apart from this machine's."""

    def __init__(self, folder: Path, target: Target, mirror: str) -> None:
        for part in ("lists/partial", "cache/archives/partial", "etc/sources.list.d"):
            (folder / part).mkdir(parents=True)
        (folder / "status").touch()
        (folder / "etc/sources.list").write_text(f"deb [trusted=yes] {mirror} {target.debian} main\n")
        self._options = [
            f"-oDir::State::lists={folder / 'lists'}",
            f"-oDir::State::status={folder / 'status'}",
            f"-oDir::Cache={folder / 'cache'}",
            f"-oDir::Etc::sourcelist={folder / 'etc/sources.list'}",
            f"-oDir::Etc::sourceparts={folder / 'etc/sources.list.d'}",
            f"-oAPT::Architecture={target.architecture}",
            f"-oAPT::Architectures={target.architecture}",
        ]
        subprocess.run(["apt-get", *self._options, "-q", "update"], check=True, capture_output=True)

    def version(self, package: str) -> Version | None:
        """The upstream version of a package; None when there is none."""
        said = subprocess.run(
            ["apt-cache", *self._options, "show", "--no-all-versions", package],
            check=False,
            capture_output=True,
            text=True,
        ).stdout
        found = re.search(r"^Version: (?:\d+:)?([^-+~\s]+)", said, re.MULTILINE)
        try:
            return Version(found[1]) if found else None
        except InvalidVersion:
            return None


def debian_mirror() -> str:
    """Where this machine takes Debian's packages from."""
    said = subprocess.run(
        ["apt-get", "indextargets", "--format", "$(REPO_URI)"], check=True, capture_output=True, text=True
    )
    return said.stdout.split()[0]


def path_for(name: str, wanted: SpecifierSet, target: Target, debian: Debian) -> str:
    """How a package comes onto a target, in words."""
    found = wheel(name, wanted, target)
    if found is not None:
        return "any" if found.endswith("-any.whl") else f"wheel {found.split('-')[1]}"
    packaged = debian.version(_DEBIAN_NAMES.get(name, f"python3-{name}"))
    if packaged is not None and wanted.contains(packaged, prereleases=True):
        return f"Debian {packaged}"
    return "source" + (f" (Debian has {packaged})" if packaged else "")


def table(packages: dict[str, SpecifierSet]) -> bool:
    """Print a row for each package; whether all have a way without a compiler."""
    mirror, complete = debian_mirror(), True
    print(
        "| package | wanted | "
        + " | ".join(f"{t.machine}, Debian {t.debian}, Python {t.python}" for t in TARGETS)
        + " |"
    )
    print("|---" * (2 + len(TARGETS)) + "|")
    with tempfile.TemporaryDirectory() as name:
        lists = [Debian(Path(name) / str(i), target, mirror) for i, target in enumerate(TARGETS)]
        for package, wanted in sorted(packages.items()):
            ways = [path_for(package, wanted, t, d) for t, d in zip(TARGETS, lists, strict=True)]
            complete &= not any(w.startswith("source") for w in ways)
            print(f"| {package} | {wanted or 'any'} | " + " | ".join(ways) + " |", flush=True)
    return complete


def footprint() -> None:
    """Install into a fresh environment here and print what that takes."""
    with tempfile.TemporaryDirectory() as name:
        environment = Path(name) / "venv"
        venv.create(environment, with_pip=True)
        empty = _size(environment)
        subprocess.run([environment / "bin/pip", "install", "-q", "--no-cache-dir", str(ROOT)], check=True)
        peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
        everything = _size(environment)
        disk = f"{everything - empty:.0f} MB of disk, {everything:.0f} MB with the empty environment"
        print(f"pip install .: {peak:.0f} MB of memory at most, {disk}")


def _size(folder: Path) -> float:
    """Size of all files [MB]."""
    return sum(p.lstat().st_size for p in folder.rglob("*") if not p.is_dir()) / 1e6


def main() -> int:
    """0 when every package has a wheel or a Debian package everywhere, 1 when some must be compiled."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--no-install", action="store_true", help="Only look packages up.")
    arguments = parser.parse_args()
    complete = table(onboard_packages())
    if not arguments.no_install:
        footprint()
    return 0 if complete else 1


if __name__ == "__main__":
    sys.exit(main())
