"""rerun's web page without its calls home: served on loopback, with nothing in it that asks anybody but this computer.

The page as rerun ships it loads a font from Google, asks GitHub for newer versions and reports its use to rerun.io; neither
can be switched off in it. Here its links to other hosts are taken out, its requests to other hosts fail before the browser
sees them, and a Content-Security-Policy makes the browser refuse whatever were left. That takes the map's tiles away too.
"""

import contextlib
import re
import socket
import threading
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Sequence
from http.server import BaseHTTPRequestHandler
from typing import ClassVar

from groundstation.viewer import gate
from groundstation.viewer.gate import COOKIE, LOOPBACK, LOOPBACK_NAMES, BoundedServer, pump, refusal

TOKEN = "token"
"""Of the page's address."""
DATA = "/rerun."
"""Paths of the services that the page asks for data."""
LARGEST_REQUEST = 1 << 16  # bytes: the page asks, it does not send
_OWN_HEADERS = frozenset({"host", "connection", "cookie", "upgrade", "origin", "keep-alive"})
FILES = ("/re_viewer.js", "/re_viewer_bg.wasm", "/favicon.ico", "/apple-touch-icon.png")
"""What the page is made of, besides itself; rerun's program has no other files that it needs."""

DIRECT = urllib.request.build_opener(urllib.request.ProxyHandler({}))
"""Opens addresses on this computer whatever proxy the environment names."""

_BLOCK_BYTES = 1 << 18
_ASK_S = 10.0  # the files come from this computer's own memory; a client that takes longer over a block has gone
_PASSED_ON = ("Content-Type", "rerun-final-length")
_FOREIGN_LINK = re.compile(r"<link\b[^>]*\bhref=\"(?:https?:)?//[^>]*>", re.IGNORECASE)
_KEEP_TO_THIS_COMPUTER = """<script>
      {
        const ask = window.fetch.bind(window);
        const here = (address) => {
          const url = new URL(address, location.href);
          return (
            ["blob:", "data:"].includes(url.protocol) ||
            ["127.0.0.1", "localhost", "[::1]", location.hostname].includes(url.hostname)
          );
        };
        window.fetch = (what, how) =>
          here(what instanceof Request ? what.url : what)
            ? ask(what, how)
            : Promise.reject(new TypeError("this page asks nobody but this computer"));
        navigator.sendBeacon = () => false;
      }
    </script>"""


def confined_page(page: str) -> str:
    """rerun's page with its links to other hosts taken out, and its requests to them made to fail."""
    return _FOREIGN_LINK.sub("", page).replace("<head>", f"<head>\n    {_KEEP_TO_THIS_COMPUTER}", 1)


def policy(data: Sequence[str]) -> str:
    """The Content-Security-Policy of the page; data: origins of the gRPC servers that it shows."""
    return "; ".join(
        (
            "default-src 'none'",
            "script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'",
            "style-src 'unsafe-inline'",
            "img-src 'self' blob: data:",
            "font-src 'self' data:",
            f"connect-src 'self' blob: data: {' '.join(data)}",
            "base-uri 'none'",
            "form-action 'none'",
            "frame-ancestors 'none'",
        )
    )


class PageServer(BoundedServer):
    """Serves the page, from the files of a rerun program that serves them at `files` (http://...), and its data from `behind`.

    data: other origins the page may take its data from. host: where to listen. key: token that every request has to show; beyond
    loopback there must be one. Raises OSError when the port is taken.
    """

    def __init__(
        self, port: int, files: str, data: Sequence[str], behind: tuple[str, int], host: str = LOOPBACK, key: str = ""
    ) -> None:
        class Handler(_Handler):
            source = files
            backend = behind
            token = key
            names = LOOPBACK_NAMES if host == LOOPBACK else LOOPBACK_NAMES | {host.lower()}
            headers_of_page: ClassVar = {
                "Content-Security-Policy": policy(data),
                "Referrer-Policy": "no-referrer",
                "X-Content-Type-Options": "nosniff",
                "X-DNS-Prefetch-Control": "off",
            }

        super().__init__((host, port), Handler, "viewer-page")


class _Handler(BaseHTTPRequestHandler):
    """Answers for the page and its files, and for nothing else."""

    source = ""
    backend = ("", 0)
    token = ""
    names: ClassVar[frozenset[str]] = LOOPBACK_NAMES
    headers_of_page: ClassVar[dict[str, str]] = {}
    timeout = _ASK_S
    server_version = "sideslip"

    def setup(self) -> None:
        super().setup()
        self._head_late = threading.Timer(gate.HEAD_S, self._hang_up)
        self._head_late.start()

    def finish(self) -> None:
        self._head_late.cancel()
        super().finish()

    def parse_request(self) -> bool:
        """The head has come."""
        parsed = super().parse_request()
        self._head_late.cancel()
        return parsed

    def _hang_up(self) -> None:
        with contextlib.suppress(OSError):
            self.connection.shutdown(socket.SHUT_RDWR)

    def do_GET(self) -> None:
        path, _, query = self.path.partition("?")
        tokens = tuple(urllib.parse.parse_qs(query).get(TOKEN, ()))
        if not self._welcome(tokens):
            return
        if self.token and tokens and path == "/":
            self._remember(query)
            return
        if path != "/" and path not in FILES:
            self.send_error(404)
            return
        try:
            with DIRECT.open(self.source + path, timeout=_ASK_S) as answer:
                head = {name: answer.headers[name] for name in _PASSED_ON if answer.headers[name]}
                if path == "/":
                    page = confined_page(answer.read().decode("utf-8")).encode()
                    self._send(head | {"Content-Length": str(len(page)), "rerun-final-length": str(len(page))})
                    self.wfile.write(page)
                    return
                self._send(head)
                while block := answer.read(_BLOCK_BYTES):
                    self.wfile.write(block)
        except urllib.error.URLError:
            self.send_error(503, "the viewer's program is being started anew; load the page again")
        except (ConnectionError, TimeoutError):
            self.close_connection = True  # the browser has gone

    def do_POST(self) -> None:
        self._pass_on()

    def do_OPTIONS(self) -> None:
        self._pass_on()

    def _pass_on(self) -> None:
        """A request for the flight's data, to the server that has it; of a connection the last."""
        self.close_connection = True
        if not self._welcome() or not self.path.startswith(DATA):
            return
        length = self.headers.get("Content-Length", "0")
        if not length.isdigit() or int(length) > LARGEST_REQUEST or "Transfer-Encoding" in self.headers:
            self.send_error(413)
            return
        body = self.rfile.read(int(length))
        headers = [f"{n}: {v}" for n, v in self.headers.items() if n.lower() not in _OWN_HEADERS]
        host = f"Host: {self.backend[0]}:{self.backend[1]}"
        head = "\r\n".join([f"{self.command} {self.path} HTTP/1.1", host, *headers, "Connection: close"]) + "\r\n\r\n"
        with contextlib.suppress(OSError), socket.create_connection(self.backend, _ASK_S) as server:
            server.sendall(head.encode("latin-1") + body)
            pump(self.connection, server)

    def _welcome(self, shown: tuple[str, ...] = ()) -> bool:
        """Whether to answer; says why not."""
        headers = {name.lower(): value for name, value in self.headers.items()}
        if len(self.headers.get_all("Host", [])) > 1:
            headers["host"] = ","
        status = refusal(headers, self.names, self.token, tokens=shown)
        if status is not None:
            self.close_connection = True
            self.send_error(status.value)
        return status is None

    def _remember(self, query: str) -> None:
        """The token out of the address into a cookie, which goes with every request of this page and no other site's."""
        rest = [(n, v) for n, v in urllib.parse.parse_qsl(query) if n != TOKEN]
        self.send_response(303)
        self.send_header("Location", "/?" + urllib.parse.urlencode(rest))
        self.send_header("Set-Cookie", f"{COOKIE}={self.token}; HttpOnly; SameSite=Strict; Path=/")
        self.send_header("Content-Length", "0")
        self.end_headers()

    def _send(self, head: dict[str, str]) -> None:
        self.send_response(200)
        for name, value in (head | self.headers_of_page).items():
            self.send_header(name, value)
        self.end_headers()

    def log_message(self, format: str, *args: object) -> None:
        """Requests of one's own browser are no news."""
