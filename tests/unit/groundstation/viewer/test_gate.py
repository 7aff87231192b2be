"""Who may look at the view: asked as a rebound page, another site, a stranger in the network and a crowd would ask."""

import contextlib
import http.client
import socket
import threading
import time
import urllib.parse
from collections.abc import Iterator

import pytest

from groundstation.viewer import gate
from groundstation.viewer.gate import LOOPBACK_NAMES, ViewerGate, host_of, refusal, single_request
from groundstation.viewer.live import LiveView, ViewOptions, free_port
from groundstation.viewer.window import WebPage

READ = "/rerun.sdk_comms.v1alpha1.MessageProxyService/ReadMessages"
GRPC = {"Content-Type": "application/grpc-web+proto", "X-Grpc-Web": "1"}


def asked(port: int, path: str = "/", method: str = "GET", **headers: str) -> tuple[int, bytes, dict[str, str]]:
    """Status, the first bytes of the body, headers. headers: with _ for -."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    given = {name.replace("_", "-"): value for name, value in headers.items()}
    connection.putrequest(method, path, skip_host="Host" in given)
    body = b"\0\0\0\0\0" if method == "POST" else b""
    for name, value in {**given, **(GRPC if method == "POST" else {}), "Content-Length": str(len(body))}.items():
        connection.putheader(name, value)
    connection.endheaders(body)
    answer = connection.getresponse()
    try:
        with contextlib.suppress(TimeoutError):
            connection.sock and connection.sock.settimeout(3)
            return answer.status, answer.read1(1 << 16), dict(answer.headers)
        return answer.status, b"", dict(answer.headers)
    finally:
        connection.close()


@pytest.fixture(scope="module")
def view() -> Iterator[tuple[LiveView, int]]:
    port = free_port()
    made = LiveView("gate", ViewOptions(layout="light", port=port))
    made.event(1.0, "SECRET-WORD-0815")
    try:
        yield made, port
    finally:
        made.close()


@pytest.fixture(scope="module")
def page(view: tuple[LiveView, int]) -> Iterator[int]:
    port = free_port()
    made = WebPage(view[0].url, port)
    try:
        yield port
    finally:
        made.close()


def test_requests_for_other_data_are_answered_with_an_error(page: int) -> None:
    assert asked(page, "/elsewhere", "POST")[0] == 404
    answer = spoken(page, f"POST {READ} HTTP/1.1\r\nHost: localhost\r\n".encode() + b"Content-Length: \xb2\r\n")
    assert answer.startswith(b"HTTP/1.0 413")


STRANGE = [
    "evil.example",
    "evil.example:9876",
    "127.0.0.1.evil.example",
    "localhost.evil.example:80",
    "10.0.0.7",
    "[::2]",
    "",
]


@pytest.mark.parametrize("host", STRANGE)
def test_a_rebound_name_reads_nothing_from_either_port(view: tuple[LiveView, int], page: int, host: str) -> None:
    for port, path, method in ((view[1], READ, "POST"), (page, READ, "POST"), (page, "/", "GET")):
        status, body, _ = asked(port, path, method, Host=host)
        assert status in (403, 421)
        assert b"SECRET" not in body
        assert len(body) < 1000


@pytest.mark.parametrize(
    "origin",
    ["http://evil.example", "https://127.0.0.1.evil.example:9876", "null", "http://evil.example//localhost"],
)
def test_another_site_that_asks_by_the_right_name_reads_nothing(
    view: tuple[LiveView, int], page: int, origin: str
) -> None:
    for port in (view[1], page):
        assert asked(port, READ, "POST", Origin=origin)[0] == 403


@pytest.mark.parametrize("name", ["127.0.0.1", "localhost", "LOCALHOST", "[::1]"])
def test_a_page_of_this_computer_reads_the_flight_through_both_ports(
    view: tuple[LiveView, int], page: int, name: str
) -> None:
    for port in (view[1], page):
        status, body, _ = asked(port, READ, "POST", Host=f"{name}:{port}", Origin=f"http://{name}:{page}")
        assert status == 200
        assert len(body) > 100
    assert asked(page, Host=f"{name}:{page}")[0] == 200


def test_a_second_request_on_the_same_connection_is_not_passed_on(view: tuple[LiveView, int]) -> None:
    head = f"OPTIONS {READ} HTTP/1.1\r\nHost: %s\r\nConnection: keep-alive\r\nContent-Length: 0\r\n\r\n"
    with socket.create_connection(("127.0.0.1", view[1]), 5) as client:
        client.sendall((head % "localhost" + head % "evil.example").encode())
        client.settimeout(5)
        got = b""
        while data := client.recv(65536):
            got += data
    assert got.count(b"HTTP/1.1 ") == 1


def test_native_viewers_attach_as_before(view: tuple[LiveView, int]) -> None:
    with socket.create_connection(("127.0.0.1", view[1]), 5) as client:
        client.sendall(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + b"\0\0\0\4\0\0\0\0\0")
        client.settimeout(5)
        assert client.recv(9)[3] == 4  # the server's SETTINGS frame


def test_a_crowd_of_idle_connections_delays_nobody_and_does_not_stay(
    view: tuple[LiveView, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gate, "HEAD_S", 0.5)
    begun = time.monotonic()
    crowd = [socket.create_connection(("127.0.0.1", view[1]), 5) for _ in range(300)]
    assert time.monotonic() - begun < 10.0
    time.sleep(1.5)
    assert asked(view[1], READ, "POST")[0] == 200
    assert sum(t.name.startswith("Thread") for t in threading.enumerate()) < 20
    for one in crowd:
        one.close()


def test_a_head_that_drips_is_not_waited_for(
    view: tuple[LiveView, int], page: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gate, "HEAD_S", 0.6)
    for port in (view[1], page):
        with socket.create_connection(("127.0.0.1", port), 5) as client:
            client.sendall(b"GET / HTTP/1.1\r\n")
            client.settimeout(0.2)
            with contextlib.suppress(ConnectionError):
                for _ in range(50):
                    client.sendall(b"X: y\r\n")
                    with contextlib.suppress(TimeoutError):
                        if client.recv(1) == b"":
                            break
                else:
                    pytest.fail(f"port {port} waited")
        assert asked(port, Host="evil.example")[0] == 421


def test_one_computer_does_not_keep_the_others_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """127.0.0.2 stands for another computer."""
    monkeypatch.setattr(gate, "MOST_OF_ONE", 3)
    port = free_port()
    server = ViewerGate(port, ("127.0.0.1", 9))
    with contextlib.ExitStack() as opened:
        opened.callback(server.close)

        def connect(source: str) -> bool:
            client = opened.enter_context(socket.create_connection(("127.0.0.1", port), 5, (source, 0)))
            client.settimeout(0.3)
            try:
                return client.recv(1) != b""
            except TimeoutError:
                return True

        assert [connect("127.0.0.2") for _ in range(5)] == [True, True, True, False, False]
        assert all(connect(source) for source in ("127.0.0.3", *["127.0.0.1"] * 5))


def test_with_a_token_only_who_has_the_address_gets_in(view: tuple[LiveView, int]) -> None:
    port = free_port()
    page = WebPage(view[0].url, port, wait=False, token="t0ken-of-this-page")
    try:
        deadline = time.monotonic() + 20.0
        cookie: dict[str, str] = {}
        while time.monotonic() < deadline:
            status, _, head = asked(port, page.url.partition(f":{port}")[2])
            assert status == 303
            cookie = {"Cookie": head["Set-Cookie"].partition(";")[0]}
            assert "token" not in urllib.parse.parse_qs(urllib.parse.urlsplit(head["Location"]).query)
            if asked(port, head["Location"], **cookie)[0] == 200:
                break
            time.sleep(0.1)
        assert asked(port, READ, "POST", **cookie)[0] == 200
        for wrong in ({}, {"Cookie": "sideslip=other"}, {"Cookie": "other=t0ken-of-this-page"}):
            assert asked(port, **wrong)[0] == 403
            assert asked(port, READ, "POST", **wrong)[0] == 403
        assert asked(port, "/?token=wrong")[0] == 403
        assert "SameSite=Strict" in head["Set-Cookie"]
        assert "HttpOnly" in head["Set-Cookie"]
    finally:
        page.close()


def test_beyond_loopback_there_is_no_page_without_a_token() -> None:
    with pytest.raises(Exception, match="needs a token"):
        WebPage("rerun+http://127.0.0.1:9/proxy", free_port(), host="0.0.0.0")


def test_names_are_read_as_browsers_write_them() -> None:
    assert [host_of(h) for h in ("LocalHost:80", "[::1]:9", "http://a.b:1", " 127.0.0.1 ", "")] == [
        "localhost", "::1", "a.b", "127.0.0.1", "",
    ]  # fmt: skip
    assert refusal({"host": "localhost"}, LOOPBACK_NAMES, "") is None
    assert refusal({}, LOOPBACK_NAMES, "") is not None
    assert single_request(b"GET / HTTP/1.1\r\nConnection: keep-alive\r\nHost: a\r\n\r\nx") == (
        b"GET / HTTP/1.1\r\nHost: a\r\nConnection: close\r\n\r\nx"
    )


UPGRADE = b"Upgrade: h2c\r\nHTTP2-Settings: AAMAAABkAAQAAP__\r\n"
FRAMES = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"


def spoken(port: int, head: bytes, body: bytes = b"") -> bytes:
    """All that a connection answers within two seconds."""
    with socket.create_connection(("127.0.0.1", port), 5) as client:
        client.sendall(head + b"\r\n" + body)
        client.settimeout(2.0)
        answer = b""
        with contextlib.suppress(OSError):
            while piece := client.recv(4096):
                answer += piece
        return answer


@pytest.mark.parametrize("host", [b"127.0.0.1", b"evil.example"])
@pytest.mark.parametrize("connection", [b"Connection: Upgrade, HTTP2-Settings\r\n", b"connection: upgrade\r\n", b""])
def test_a_request_does_not_become_http2_on_its_way(view: tuple[LiveView, int], host: bytes, connection: bytes) -> None:
    head = b"GET " + READ.encode() + b" HTTP/1.1\r\nHost: " + host + b"\r\n" + connection + UPGRADE
    answer = spoken(view[1], head, FRAMES)
    assert not answer.startswith(b"HTTP/1.1 101")
    assert answer.startswith(b"HTTP/1.1 421") or host == b"127.0.0.1"
    assert b"SECRET" not in answer


@pytest.mark.parametrize(
    "line",
    [
        b"X: a\nUpgrade: h2c",
        b"X: a\rUpgrade: h2c",
        b"Upgrade : h2c",
        b" Upgrade: h2c",
        b"X: a\x00",
        b"X: a\r\n\tUpgrade: h2c",
    ],
)
def test_lines_that_two_programs_read_differently_are_refused(view: tuple[LiveView, int], line: bytes) -> None:
    head = b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n" + line + b"\r\n"
    assert spoken(view[1], head).startswith(b"HTTP/1.1 400")


def test_headers_of_the_connection_are_not_passed_on() -> None:
    head = b"GET / HTTP/1.1\r\nHost: a\r\nConnection: Upgrade\r\n" + UPGRADE + b"Keep-Alive: timeout=9\r\n\r\n"
    assert single_request(head) == b"GET / HTTP/1.1\r\nHost: a\r\nConnection: close\r\n\r\n"
