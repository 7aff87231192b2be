"""Builds the MAVLink dialect from its XML as part of the package; everything else stands in pyproject.toml."""

import runpy
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

DIALECT = Path("daq/contract/link/dialect")


class BuildWithDialect(build_py):
    """Modules as always, and the dialect's: in the build folder for a wheel, in the source tree for an editable install."""

    def run(self) -> None:
        """Copy modules, then make the one that is not in git."""
        super().run()
        build = runpy.run_path(str(Path(__file__).parent / DIALECT / "build.py"))
        root = Path(__file__).parent if self.editable_mode else Path(self.build_lib)
        build["write_module"](root / DIALECT)


setup(cmdclass={"build_py": BuildWithDialect})
