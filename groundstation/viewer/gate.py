"""Access control of the view: every request is checked for its Host, its Origin and, where there is one, the token.

A page of another site whose name resolves to this computer (DNS rebinding) sends that name as Host, and is refused. Native
viewers use HTTP/2 without encryption, which no browser does; they are accepted on loopback, where every user of this computer
could read the data anyway. Connections are limited in number and in idle time."""

import contextlib
import hmac
import re
import secrets
import select
import socket
import socketserver
import sys
import threading
import time
from collections import Counter
from collections.abc import Mapping
from http import HTTPStatus
from typing import Any

from daq.utilities.errors import UserError

LOOPBACK = "127.0.0.1"
LOOPBACK_NAMES = frozenset({"127.0.0.1", "localhost", "::1"})
"""Names in a Host header that mean this computer."""

MOST_CONNECTIONS = 64
MOST_OF_ONE = (
    24  # connections of one other computer, which must not block all others: a browser has six, and its streams
)
HEAD_S = 5.0  # in which the head of a request must be complete
IDLE_S = 600.0  # without a byte in either direction, after which a connection is closed
LONGEST_HEAD = 16384  # bytes
_BLOCK = 1 << 16
_BACKLOG = 128
_HOP_BY_HOP = (b"connection:", b"upgrade:", b"http2-settings:", b"keep-alive:", b"proxy-connection:")
"""Headers that are removed: with them a connection could continue as HTTP/2, or with a second request, without a check."""
_ODD_LINE = re.compile(rb"[\x00\n\r]|^[ \t]|^[^:]*[ \t]:")
"""A bare line end, a continued line or a blank before the colon: programs differ in how they read these."""
_HTTP2 = b"PRI * HTTP/2.0\r\n\r\n"
COOKIE = "sideslip"


class ViewerError(UserError):
    """The viewer cannot be started."""


def port_is_free(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((LOOPBACK, port))
        except OSError:
            return False
    return True


def free_port() -> int:
    """A TCP port on loopback that is free now."""
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.bind((LOOPBACK, 0))
        return int(probe.getsockname()[1])


def hidden_address() -> str:
    """A random loopback address, which a page of another site cannot know; 127.0.0.1 on systems with only that one."""
    if sys.platform != "linux":
        return LOOPBACK
    return f"127.{secrets.randbelow(254) + 1}.{secrets.randbelow(254) + 1}.{secrets.randbelow(253) + 2}"


def host_of(header: str) -> str:
    """The host name in a Host or Origin header, in lower case, without scheme, port and brackets."""
    name = header.strip().lower()
    name = name.partition("//")[2] or name
    if name.startswith("["):
        return name[1:].partition("]")[0]
    return name.partition(":")[0]


def refusal(
    headers: Mapping[str, str], names: frozenset[str], token: str, *, tokens: tuple[str, ...] = ()
) -> HTTPStatus | None:
    """The HTTP status of a refused request; None for an accepted one. headers: by their names in lower case. names: host names of
    this server; not checked with a token, which a page of another site does not have. tokens: of the request, besides its
    cookie."""
    host, origin = headers.get("host", ""), headers.get("origin")
    if not token and host_of(host) not in names:
        return HTTPStatus.MISDIRECTED_REQUEST
    if origin is not None and host_of(origin) not in (names if not token else {host_of(host)}):
        return HTTPStatus.FORBIDDEN
    candidates = [*tokens, *_cookies(headers.get("cookie", ""))]
    if token and not any(hmac.compare_digest(token.encode(), word.encode("utf-8", "replace")) for word in candidates):
        return HTTPStatus.FORBIDDEN
    return None


def _cookies(header: str) -> list[str]:
    pairs = (part.strip().partition("=") for part in header.split(";"))
    return [value for name, _, value in pairs if name == COOKIE]


class BoundedServer(socketserver.ThreadingTCPServer):
    """A server with one thread for each connection, at most MOST_CONNECTIONS; further ones are closed at once."""

    daemon_threads = True
    allow_reuse_address = True
    request_queue_size = _BACKLOG

    def __init__(self, address: tuple[str, int], handler: type[socketserver.BaseRequestHandler], name: str) -> None:
        self._room = threading.BoundedSemaphore(MOST_CONNECTIONS)
        self._served: Counter[str] = Counter()  # connections by the computer that they come from
        self._counting = threading.Lock()
        super().__init__(address, handler)
        self._thread = threading.Thread(target=self.serve_forever, args=(0.1,), name=name, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Accept no more connections."""
        self.shutdown()
        self.server_close()
        self._thread.join()

    def _admitted(self, computer: str) -> bool:
        with self._counting:
            crowded = computer != LOOPBACK and self._served[computer] >= MOST_OF_ONE
            if crowded or not self._room.acquire(blocking=False):
                return False
            self._served[computer] += 1
            return True

    def process_request(self, request: socket.socket | tuple[bytes, socket.socket], client_address: Any) -> None:
        """Serve a connection, or close it where there are too many."""
        if not self._admitted(str(client_address[0])):
            self.shutdown_request(request)
            return
        super().process_request(request, client_address)

    def process_request_thread(self, request: socket.socket | tuple[bytes, socket.socket], client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            with self._counting:
                self._served -= Counter([str(client_address[0])])  # subtraction drops counts of zero
                self._room.release()

    def handle_error(self, request: object, client_address: object) -> None:
        """Print nothing: broken connections are normal."""


def pump(first: socket.socket, second: socket.socket, idle_s: float = IDLE_S) -> None:
    """Forward bytes in both directions until one side ends, or nothing comes for `idle_s`."""
    destination = {first: second, second: first}
    for side in destination:
        side.settimeout(HEAD_S)
    while True:
        ready, _, _ = select.select(list(destination), [], [], idle_s)
        if not ready:
            return
        for side in ready:
            data = side.recv(_BLOCK)
            if not data:
                return
            destination[side].sendall(data)


class ViewerGate(BoundedServer):
    """A proxy with access control before rerun's server of a live view, on loopback. backend: address of that server. Raises
    OSError."""

    def __init__(self, port: int, backend: tuple[str, int]) -> None:
        class GateHandler(_GateConnection):
            backend_address = backend

        super().__init__((LOOPBACK, port), GateHandler, "viewer-gate")


class _GateConnection(socketserver.BaseRequestHandler):
    """One connection, which is accepted or refused by its first request."""

    backend_address = ("", 0)

    def handle(self) -> None:
        client: socket.socket = self.request
        with contextlib.suppress(OSError, TimeoutError):
            head = _head(client)
            if head is None:
                return
            if not head.startswith(_HTTP2):
                status = HTTPStatus.BAD_REQUEST if ambiguous(head) else refusal(_headers(head), LOOPBACK_NAMES, "")
                if status is not None:
                    response = (
                        f"HTTP/1.1 {status.value} {status.phrase}",
                        "Content-Length: 0",
                        "Connection: close",
                        "",
                        "",
                    )
                    client.sendall("\r\n".join(response).encode())
                    return
                head = single_request(head)
            with socket.create_connection(self.backend_address, HEAD_S) as server:
                server.sendall(head)
                pump(client, server)


def ambiguous(head: bytes) -> bool:
    """Whether another program may read the headers of a head differently."""
    lines = head.partition(b"\r\n\r\n")[0].split(b"\r\n")
    return any(_ODD_LINE.search(line) for line in lines[1:]) or bool(re.search(rb"[\x00\n\r]", lines[0]))


def single_request(head: bytes) -> bytes:
    """The head of a request (and the bytes after it), changed so that the connection closes after it: only the first request was
    checked."""
    lines, body = head.partition(b"\r\n\r\n")[::2]
    headers = [line for line in lines.split(b"\r\n") if not line.lower().startswith(_HOP_BY_HOP)]
    return b"\r\n".join([*headers, b"Connection: close"]) + b"\r\n\r\n" + body


def _head(client: socket.socket) -> bytes | None:
    """The bytes of a connection up to the end of the first head, and those received with it; None where the head is not complete
    in HEAD_S, or too long."""
    deadline = time.monotonic() + HEAD_S
    data = b""
    while b"\r\n\r\n" not in data:
        client.settimeout(max(0.001, deadline - time.monotonic()))  # the deadline is for the whole head
        piece = client.recv(4096)
        data += piece
        if not piece or len(data) > LONGEST_HEAD:
            return None
    return data


def _headers(head: bytes) -> dict[str, str]:
    """Headers by their names in lower case; a repeated one has the invalid value ","."""
    headers: dict[str, str] = {}
    for line in head.partition(b"\r\n\r\n")[0].decode("latin-1").split("\r\n")[1:]:
        name, _, value = line.partition(":")
        key = name.strip().lower()
        headers[key] = "," if key in headers else value.strip()
    return headers
