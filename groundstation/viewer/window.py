"""Windows onto a live or recorded flight: rerun's native viewer, or its web page served on loopback only.

The web page comes from the rerun binary, because the Python call `serve_web_viewer` listens on every interface, and goes
through `groundstation.viewer.page`, which confines it to this computer. The binary itself asks for newer versions and reports
its use by HTTPS. It uses proxies, so it is given one that does not exist.
"""

import contextlib
import ctypes
import os
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.parse
from pathlib import Path
from typing import Literal

from groundstation.viewer.gate import LOOPBACK, ViewerError, free_port, hidden_address, port_is_free
from groundstation.viewer.page import DIRECT, TOKEN, PageServer

Window = Literal["web", "native", "none"]
DEFAULT_WEB_PORT = 9090
START_TIMEOUT_S = 20.0
_GRACE_S = 2.0  # for rerun to end by itself
VIEWER_MEMORY = "2GB"  # of rerun's window
SERVER_MEMORY = "512MB"  # of the server behind a page: a recorded flight


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


_NOWHERE = f"http://{LOOPBACK}:9"  # the discard port, on which usually nothing listens
_PROXIES = {
    name: _NOWHERE for scheme in ("all", "http", "https") for name in (f"{scheme}_proxy", f"{scheme}_proxy".upper())
}

_PR_SET_PDEATHSIG = 1
_libc = ctypes.CDLL(None) if sys.platform == "linux" else None


def _start(command: list[str]) -> "subprocess.Popen[bytes]":
    """Start rerun as a child that ends with this process, even if that is killed: else it would hold its port."""

    def end_with_parent() -> None:
        if _libc is not None:
            _libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)

    # safe in a process with threads: the function takes no lock
    quiet = subprocess.DEVNULL
    return subprocess.Popen(command, stdout=quiet, stderr=quiet, env=os.environ | _PROXIES, preexec_fn=end_with_parent)  # noqa: PLW1509


class RerunProcess:
    """A rerun program as a child process."""

    def __init__(self, command: list[str]) -> None:
        self._command = [rerun_binary(), *command]
        self._process = _start(self._command)

    @property
    def open(self) -> bool:
        """Whether the process runs."""
        return self._process.poll() is None

    @property
    def pid(self) -> int:
        return self._process.pid

    def restart(self) -> None:
        self._process = _start(self._command)

    def wait(self, timeout: float | None = None) -> None:
        """Wait until the process ends, as when a person closes its window, or for `timeout` [s]."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout)

    def close(self) -> None:
        """End the process; rerun sometimes survives a SIGTERM, so it is killed after a grace time."""
        self._process.terminate()
        try:
            self._process.wait(_GRACE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


class WebPage(RerunProcess):
    """The rerun web viewer on loopback, as a child process, showing a live server or a recording.

    source: the gRPC address of a live view, or an .rrd file that this page serves itself. wait: until it answers.
    """

    def __init__(
        self,
        source: str | Path,
        port: int = DEFAULT_WEB_PORT,
        *,
        wait: bool = True,
        host: str = LOOPBACK,
        token: str = "",
    ) -> None:
        if host != LOOPBACK and not token:
            raise ViewerError(f"the page on {host} can be reached from elsewhere: it needs a token")
        if not port_is_free(port):
            raise ViewerError(f"web port {LOOPBACK}:{port} is in use; give another with --web-port")
        data_port, hidden, files_port = free_port(), hidden_address(), free_port()
        command = ["--serve-web", "--bind", hidden, "--port", str(data_port)]
        command += ["--web-viewer-port", str(files_port), "--server-memory-limit", SERVER_MEMORY]
        live = not isinstance(source, Path)
        backend = urllib.parse.urlsplit(str(source)).netloc if live else f"{hidden}:{data_port}"
        public_host = socket.gethostname() if host not in (LOOPBACK, "localhost") and host.startswith("0.") else host
        parameters = {
            "url": f"rerun+http://{public_host}:{port}/proxy",
            "renderer": "webgl",
            "hide_welcome_screen": "1",
        }
        query = urllib.parse.urlencode({TOKEN: token, **parameters} if token else parameters)
        self.address = f"http://{public_host}:{port}/"
        self.url = f"{self.address}?{query}"
        name, _, number = backend.rpartition(":")
        super().__init__(command if live else [*command, str(source)])
        try:
            files = f"http://{hidden}:{files_port}"
            self._server = PageServer(port, files, (f"http://{public_host}:{port}",), (name, int(number)), host, token)
        except OSError as error:
            super().close()
            raise ViewerError(f"web port {LOOPBACK}:{port} cannot be used ({error.strerror})") from error
        if wait:
            self._wait_for_answer(self.address)

    def _wait_for_answer(self, address: str) -> None:
        deadline = time.monotonic() + START_TIMEOUT_S
        while time.monotonic() < deadline:
            if self._process.poll() is not None:
                raise ViewerError(f"rerun's web server ended at once with status {self._process.returncode}")
            with contextlib.suppress(urllib.error.URLError, OSError), DIRECT.open(address, timeout=1.0):
                return
            time.sleep(0.05)
        self.close()
        raise ViewerError(f"rerun's web server did not answer on {address} within {START_TIMEOUT_S:g} s")

    def close(self) -> None:
        self._server.close()
        super().close()


class NativeWindow(RerunProcess):
    """rerun's own window, attached to a live view or opened on a recording.

    headless: draw without a display, for tests. The viewer's control port is on loopback too; rerun's default is not.
    """

    def __init__(self, source: str | Path, *, headless: bool = False) -> None:
        target = [str(source)] if isinstance(source, Path) else ["--connect", source]
        port = free_port()
        self.control = f"rerun+http://{LOOPBACK}:{port}/proxy"
        command = [*target, "--memory-limit", VIEWER_MEMORY, "--hide-welcome-screen", "--bind", LOOPBACK]
        super().__init__([*command, "--port", str(port), *(["--headless"] if headless else [])])

    def close(self) -> None:
        if self.open:
            super().close()
