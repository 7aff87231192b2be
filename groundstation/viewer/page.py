"""rerun's web page without its calls home: served on loopback, with nothing in it that asks anybody but this computer.

The page as rerun ships it loads a font from Google, asks GitHub for newer versions and reports its use to rerun.io; neither
can be switched off in it. Here its links to other hosts are taken out, its requests to other hosts fail before the browser
sees them, and a Content-Security-Policy makes the browser refuse whatever were left. That takes the map's tiles away too.
"""

import re
import threading
import urllib.error
import urllib.request
from collections.abc import Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import ClassVar

LOOPBACK = "127.0.0.1"
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
          return ["blob:", "data:"].includes(url.protocol) || ["127.0.0.1", "localhost", "[::1]"].includes(url.hostname);
        };
        window.fetch = (what, how) =>
          here(what instanceof Request ? what.url : what)
            ? ask(what, how)
            : Promise.reject(new TypeError("this page asks nobody but this computer"));
        navigator.sendBeacon = () => false;
      }
    </script>"""


def kept_home(page: str) -> str:
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


class PageServer:
    """Serves the page on a loopback port, from the files of a rerun program that serves them at `files` (http://...).

    data: origins the page may take its data from. Raises OSError when the port is taken.
    """

    def __init__(self, port: int, files: str, data: Sequence[str]) -> None:
        class Handler(_Handler):
            source = files
            headers_of_page: ClassVar = {
                "Content-Security-Policy": policy(data),
                "Referrer-Policy": "no-referrer",
                "X-Content-Type-Options": "nosniff",
                "X-DNS-Prefetch-Control": "off",
            }

        self._server = ThreadingHTTPServer((LOOPBACK, port), Handler)
        self._server.daemon_threads = True
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.1,), name="viewer-page", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Serve no more."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class _Handler(BaseHTTPRequestHandler):
    """Answers for the page and its files, and for nothing else."""

    source = ""
    headers_of_page: ClassVar[dict[str, str]] = {}
    timeout = _ASK_S
    server_version = "sideslip"

    def do_GET(self) -> None:
        path = self.path.partition("?")[0]
        if path != "/" and path not in FILES:
            self.send_error(404)
            return
        try:
            with DIRECT.open(self.source + path, timeout=_ASK_S) as answer:
                head = {name: answer.headers[name] for name in _PASSED_ON if answer.headers[name]}
                if path == "/":
                    page = kept_home(answer.read().decode("utf-8")).encode()
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

    def _send(self, head: dict[str, str]) -> None:
        self.send_response(200)
        for name, value in (head | self.headers_of_page).items():
            self.send_header(name, value)
        self.end_headers()

    def log_message(self, format: str, *args: object) -> None:
        """Requests of one's own browser are no news."""
