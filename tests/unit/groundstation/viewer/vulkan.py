"""Whether rerun's own viewer can draw here."""

import os
import shutil
import subprocess

import pytest


def need_vulkan() -> None:
    """Skip where there is no Vulkan driver, software's included; a missing one fails in CI."""
    listed = subprocess.run(
        [shutil.which("ldconfig") or "/sbin/ldconfig", "-p"], capture_output=True, text=True, check=False
    )
    if "libvulkan" not in listed.stdout:
        why = "no Vulkan driver (Debian: apt-get install mesa-vulkan-drivers libvulkan1)"
        if os.environ.get("CI"):
            pytest.fail(why)
        pytest.skip(why)
