"""The views of a session: one for each aircraft, with its page or window. None of them can end or delay the session."""

import secrets
import time
from collections.abc import Callable

from daq.identification.regression import REGRESSIONS
from groundstation.live.config import ViewConfig
from groundstation.viewer.gate import LOOPBACK, ViewerError, port_is_free
from groundstation.viewer.live import LiveView, ViewOptions
from groundstation.viewer.window import NativeWindow, WebPage, Window

_RESTART_S = 5.0  # between two looks for pages whose process has ended
_PORTS_TRIED = 100


class SessionViews:
    """Makes views on the configured ports, and on the next ones for further aircraft. say: prints addresses and troubles. model:
    of live identification, whose derivatives are drawn.

    Raises ViewerError when made, if a configured port is in use; later that only costs the view.
    """

    def __init__(self, config: ViewConfig, window: Window, say: Callable[[str], None], model: str = "") -> None:
        regressions = REGRESSIONS.get(model, REGRESSIONS["lateral"])
        self._coefficients = tuple(e.coefficient for r in regressions for e in r.equations)
        self._config, self._window, self._say = config, window, say
        self._token = secrets.token_urlsafe(16) if config.token or config.host != LOOPBACK else ""
        self._views: list[LiveView] = []
        self._windows: list[WebPage | NativeWindow] = []
        self._pages: dict[int, str] = {}  # index of a page: the aircraft's name
        self._next_check_s = 0.0
        for key, port in (("port", config.port), ("web_port", config.web_port)):
            if not port_is_free(port) and (key == "port" or window == "web"):
                raise ViewerError(f"[view] {key}: {LOOPBACK}:{port} is in use; close the other viewer or give another")
        if window == "web":
            self._say(f"the page opens with the first aircraft heard, at http://{config.host}:{config.web_port}/")

    def make(self, system: int) -> LiveView | None:
        """The view of an aircraft; None, and a line that says why, when there can be none."""
        name = f"aircraft {system}"
        try:
            port = _free_from(self._config.port + len(self._views))
            options = ViewOptions(
                self._config.layout,
                port,
                self._config.memory_limit,
                open_port=not self._token or self._window != "web",
                coefficients=self._coefficients,
            )
            view = LiveView(f"aircraft{system}", options)
            self._views.append(view)
            if self._window == "web":
                web_port = _free_from(self._config.web_port + len(self._pages))
                page = WebPage(view.url, web_port, wait=False, host=self._config.host, token=self._token)
                self._pages[len(self._windows)] = name
                self._windows.append(page)
                self._say(f"{name}: {page.url}")
                if self._config.layout == "full" and len(self._pages) == 1:
                    self._say(
                        "if the browser lags: --layout light, on a phone: --layout phone (or layout under [view])"
                    )
            else:
                self._windows.append(NativeWindow(view.url))
        except (ViewerError, OSError) as error:
            self._say(f"{name}: no picture ({error}); reception goes on")
            return None
        return view

    def tend(self) -> None:
        """Restart a page whose process has ended. A person may close a window, which stays closed. Call it often."""
        now_s = time.monotonic()
        if now_s < self._next_check_s:
            return
        self._next_check_s = now_s + _RESTART_S
        for index, name in self._pages.items():
            page = self._windows[index]
            if isinstance(page, WebPage) and not page.open:
                self._say(f"{name}: the page's server has ended; it is started anew on {page.address}")
                page.restart()

    def close(self) -> None:
        for view in self._views:
            view.close()
        for window in self._windows:
            window.close()


def _free_from(port: int) -> int:
    """The first free port from `port` on. Raises ViewerError when _PORTS_TRIED are in use."""
    for candidate in range(port, min(port + _PORTS_TRIED, 65536)):
        if port_is_free(candidate):
            return candidate
    raise ViewerError(f"no free port from {port} on")
