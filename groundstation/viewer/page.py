"""rerun's web page, served on loopback and changed so that it makes requests to this computer only.

The page as rerun ships it loads a font from Google, asks GitHub for newer versions and reports its use to rerun.io, and none of
these can be switched off in it. Here its links to other hosts are removed, its requests to other hosts fail before the browser
sees them, and a Content-Security-Policy makes the browser refuse the rest. Map tiles are not loaded either.
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

TOKEN = "token"  # parameter of the page's address
DATA = "/rerun."  # beginning of the paths from which the page requests data
LARGEST_REQUEST = 1 << 16  # bytes: requests for data are small
_REPLACED_HEADERS = frozenset({"host", "connection", "cookie", "upgrade", "origin", "keep-alive"})
FILES = ("/re_viewer.js", "/re_viewer_bg.wasm", "/favicon.ico", "/apple-touch-icon.png")
"""All files that the page needs from rerun's program."""

DIRECT = urllib.request.build_opener(urllib.request.ProxyHandler({}))
"""Opens addresses on this computer, without the proxies that the environment may name."""

_BLOCK_BYTES = 1 << 18
_TIMEOUT_S = 10.0  # for a block of a file, which comes from this computer's memory
_FORWARDED_HEADERS = ("Content-Type", "rerun-final-length")
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
    """rerun's page without its links to other hosts, and with a script that makes requests to them fail."""
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
    """Serves the page with the files of a rerun program that serves them at `files` (http://...), and data from the
    server `data_server`.

    data: other origins from which the page may load data. host: address on which to listen. key: token required of every request;
    needed beyond loopback. Raises OSError when the port is in use.
    """

    def __init__(
        self,
        port: int,
        files: str,
        data: Sequence[str],
        data_server: tuple[str, int],
        host: str = LOOPBACK,
        key: str = "",
    ) -> None:
        class Handler(_Handler):
            source = files
            backend = data_server
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
    """Answers requests for the page, its files and its data, and no others."""

    source = ""
    backend = ("", 0)
    token = ""
    names: ClassVar[frozenset[str]] = LOOPBACK_NAMES
    headers_of_page: ClassVar[dict[str, str]] = {}
    timeout = _TIMEOUT_S
    server_version = "sideslip"

    def setup(self) -> None:
        super().setup()
        self._head_timer = threading.Timer(gate.HEAD_S, self._hang_up)
        self._head_timer.start()

    def finish(self) -> None:
        self._head_timer.cancel()
        super().finish()

    def parse_request(self) -> bool:
        """Read the head of a request, and stop the timer that waits for it."""
        parsed = super().parse_request()
        self._head_timer.cancel()
        return parsed

    def _hang_up(self) -> None:
        with contextlib.suppress(OSError):
            self.connection.shutdown(socket.SHUT_RDWR)

    def do_GET(self) -> None:
        path, _, query = self.path.partition("?")
        tokens = tuple(urllib.parse.parse_qs(query).get(TOKEN, ()))
        if not self._accepted(tokens):
            return
        if self.token and tokens and path == "/":
            self._move_token_to_cookie(query)
            return
        if path != "/" and path not in FILES:
            self.send_error(404)
            return
        try:
            with DIRECT.open(self.source + path, timeout=_TIMEOUT_S) as answer:
                head = {name: answer.headers[name] for name in _FORWARDED_HEADERS if answer.headers[name]}
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
            self.close_connection = True  # the browser has closed its end

    def do_POST(self) -> None:
        self._forward()

    def do_OPTIONS(self) -> None:
        self._forward()

    def _forward(self) -> None:
        """Forward a request for the flight's data to the server that has it; the last request of its connection."""
        self.close_connection = True
        if not self._accepted():
            return
        if not self.path.startswith(DATA):
            self.send_error(404)
            return
        length = self.headers.get("Content-Length", "0")
        if not length.isdecimal() or int(length) > LARGEST_REQUEST or "Transfer-Encoding" in self.headers:
            self.send_error(413)
            return
        body = self.rfile.read(int(length))
        headers = [f"{n}: {v}" for n, v in self.headers.items() if n.lower() not in _REPLACED_HEADERS]
        host = f"Host: {self.backend[0]}:{self.backend[1]}"
        head = "\r\n".join([f"{self.command} {self.path} HTTP/1.1", host, *headers, "Connection: close"]) + "\r\n\r\n"
        with contextlib.suppress(OSError), socket.create_connection(self.backend, _TIMEOUT_S) as server:
            server.sendall(head.encode("latin-1") + body)
            pump(self.connection, server)

    def _accepted(self, tokens: tuple[str, ...] = ()) -> bool:
        """Whether to answer a request; sends the error where not. tokens: those in its address."""
        headers = {name.lower(): value for name, value in self.headers.items()}
        if len(self.headers.get_all("Host", [])) > 1:
            headers["host"] = ","
        status = refusal(headers, self.names, self.token, tokens=tokens)
        if status is not None:
            self.close_connection = True
            self.send_error(status.value)
        return status is None

    def _move_token_to_cookie(self, query: str) -> None:
        """Redirect to the address without its token, and set a cookie, which only requests of this page carry."""
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
        """Print nothing."""
