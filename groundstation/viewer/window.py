"""Windows onto a live or recorded flight: rerun's native viewer, or its web page served on loopback only.

The web page comes from the rerun binary, because the Python call `serve_web_viewer` listens on every interface.
"""

import contextlib
import subprocess
import sys
import time
import urllib.error
import urllib.parse
import urllib.request
from pathlib import Path
from typing import Literal

from groundstation.viewer.live import LOOPBACK, ViewerError, free_port, port_is_free

Window = Literal["web", "native", "none"]
DEFAULT_WEB_PORT = 9090
START_TIMEOUT_S = 20.0
VIEWER_MEMORY = "2GB"


def rerun_binary() -> str:
    """Path of the real rerun program (the `rerun` on PATH is a Python wrapper around it).

    Raises ViewerError when the package does not carry it.
    """
    import rerun_cli

    name = "rerun.exe" if sys.platform == "win32" else "rerun"
    path = Path(rerun_cli.__file__).with_name(name)
    if not path.is_file():
        raise ViewerError(f"rerun's viewer program is not at {path}; reinstall rerun-sdk")
    return str(path)


class WebPage:
    """The rerun web viewer on loopback, as a child process, showing a live server or a recording."""

    def __init__(self, source: str | Path, port: int = DEFAULT_WEB_PORT) -> None:
        """source: the gRPC address of a live view, or an .rrd file that this page serves itself."""
        if not port_is_free(port):
            raise ViewerError(f"web port {LOOPBACK}:{port} is in use; give another with --web-port")
        own_port = free_port()
        command = [rerun_binary(), "--serve-web", "--bind", LOOPBACK, "--port", str(own_port)]
        command += ["--web-viewer-port", str(port), "--server-memory-limit", "512MB"]
        live = not isinstance(source, Path)
        if not live:
            command.append(str(source))
        self._process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        data = source if live else f"rerun+http://{LOOPBACK}:{own_port}/proxy"
        query = urllib.parse.urlencode({"url": data, "renderer": "webgl", "hide_welcome_screen": "1"})
        self.url = f"http://{LOOPBACK}:{port}/?{query}"
        self._wait(f"http://{LOOPBACK}:{port}/")

    def _wait(self, address: str) -> None:
        deadline = time.monotonic() + START_TIMEOUT_S
        while time.monotonic() < deadline:
            if self._process.poll() is not None:
                raise ViewerError(f"rerun's web server ended at once with status {self._process.returncode}")
            with contextlib.suppress(urllib.error.URLError, OSError), urllib.request.urlopen(address, timeout=1.0):
                return
            time.sleep(0.05)
        self.close()
        raise ViewerError(f"rerun's web server did not answer on {address} within {START_TIMEOUT_S:g} s")

    def wait(self, timeout: float | None = None) -> None:
        """Until the page's process ends or the time is over."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout)

    def close(self) -> None:
        """End the page. rerun has been seen to survive one SIGTERM, so it is killed after a grace time."""
        self._process.terminate()
        try:
            self._process.wait(2.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


class NativeWindow:
    """rerun's own window, attached to a live view or opened on a recording."""

    def __init__(self, source: str | Path) -> None:
        target = [str(source)] if isinstance(source, Path) else ["--connect", source]
        command = [
            rerun_binary(),
            *target,
            "--memory-limit",
            VIEWER_MEMORY,
            "--hide-welcome-screen",
            "--port",
            str(free_port()),
        ]
        self._process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    @property
    def open(self) -> bool:
        """Whether the window is still there."""
        return self._process.poll() is None

    def wait(self, timeout: float | None = None) -> None:
        """Until the person closes the window or the time is over."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout)

    def close(self) -> None:
        """Close the window."""
        if self.open:
            self._process.terminate()
            try:
                self._process.wait(2.0)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
