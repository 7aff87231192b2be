"""Names, texts and numbers of a stranger on the live page, looked at in headless Chromium: they are shown and do nothing."""

import threading
import zlib
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from daq.transport.mavlink_codec import FrameEncoder
from groundstation.viewer.live import LiveView, ViewOptions, free_port
from groundstation.viewer.window import WebPage
from tests.support.bad_values import bad_frames
from tests.unit.groundstation.test_hostile_papers import Impostor, altered
from tests.unit.groundstation.test_quarantine import Sky
from tests.web.screenshot import ARGUMENTS, COLOURFUL, chromium, saturated

pytestmark = [
    pytest.mark.browser,
    pytest.mark.timeout(240),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
]

WORDS = (
    "<img src=http://203.0.113.7/x onerror=alert(1)>", "![x](http://203.0.113.7/y.png)", "<script>alert(2)</script>",
    "[press](javascript:alert(3))", "\u202egnp.evil", "\x1b[2J", "nan", "$\\frac{$",
)  # fmt: skip


def _talk(sky: Sky, stop: threading.Event) -> None:
    """An aircraft, and a stranger in its place who says everything that he can."""
    encoder = FrameEncoder(1, 1)
    names = {f"imu.{word}"[:100]: word for word in WORDS}
    papers = altered(
        session=WORDS[1].replace("/", ":"), aircraft=WORDS[0], details=names, events=[[5, 6, 1, WORDS[1], WORDS[0]]]
    )
    impostor = Impostor(sky.station.folder, zlib.compress(papers, 9), sky.rig)
    bad = [frame.data for frame in bad_frames(encoder, {})]
    turn = 0
    while not stop.wait(0.05):
        sky.theirs.write(encoder.message("STATUSTEXT", severity=turn % 8, text=WORDS[turn % len(WORDS)]))
        fields = {
            "boot": 7,
            "time_monotonic_ns": 10**9,
            "number": 3,
            "origin": WORDS[1][:15],
            "text": WORDS[turn % len(WORDS)],
        }
        sky.theirs.write(encoder.message("SCAN_EVENT", **fields))
        sky.theirs.write(b"".join(bad[20 * turn % len(bad) :][:20]))
        sky.fly(1, impostor)
        turn += 1


def test_a_stranger_s_words_are_shown_and_reach_for_nothing(tmp_path: Path) -> None:
    from playwright.sync_api import sync_playwright

    port = free_port()
    view = LiveView("live", ViewOptions(layout="full", port=port))
    page_at = WebPage(view.url, free_port())
    sky = Sky(tmp_path / "s", make_view=lambda _: view)
    stop, asked, spoken = threading.Event(), list[str](), list[str]()
    feeder = threading.Thread(target=_talk, args=(sky, stop))
    feeder.start()
    try:
        with sync_playwright() as tools:
            browser = tools.chromium.launch(executable_path=chromium(), headless=True, args=list(ARGUMENTS))
            page = browser.new_page(viewport={"width": 960, "height": 540}, color_scheme="dark")
            page.on("request", lambda request: asked.append(request.url))
            page.on("dialog", lambda dialog: spoken.append(dialog.message))
            page.on("pageerror", lambda error: spoken.append(str(error)))
            page.on("console", lambda message: spoken.append(message.text) if "panicked" in message.text else None)
            page.goto(page_at.url, wait_until="commit")
            for _ in range(40):
                page.wait_for_timeout(1500)
                page.screenshot(path=str(tmp_path / "shown.png"))
                if saturated(tmp_path / "shown.png") > COLOURFUL and len(sky.lines) > 100:
                    break
            strangers = page.locator("img, script:not([src]):has-text('alert'), iframe, a[href^=javascript]").count()
            browser.close()
    finally:
        stop.set()
        feeder.join()
        page_at.close()
        sky.land()
        view.close()
    assert saturated(tmp_path / "shown.png") > COLOURFUL
    assert (spoken, strangers) == ([], 0)
    assert {urlsplit(url).hostname for url in asked if url.startswith(("http", "ws"))} == {"127.0.0.1"}
    assert any("onerror=alert(1)" in line for line in sky.lines)  # it was said, and is there as words
    assert all(line.isprintable() for line in sky.lines)
