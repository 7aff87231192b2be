"""The web page of a recorded flight and of a live one, opened in headless Chromium and looked at."""

import threading
from pathlib import Path

import numpy as np
import pytest

from groundstation.flight import read_flight
from groundstation.viewer.live import LiveView, ViewOptions, free_port
from groundstation.viewer.window import WebPage
from tests.web.screenshot import ARGUMENTS, COLOURFUL, chromium, picture, pixels, saturated, take

pytestmark = [
    pytest.mark.browser,
    pytest.mark.timeout(240),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
]


def coloured(png: Path) -> tuple[int, int, int]:
    """Pixels of the curves on the left, of the aircraft's orange fin in the middle, of the green health lanes on the right."""
    rgb = pixels(png)
    left, middle, right = rgb[:, :380], rgb[:, 380:700], rgb[:, 700:]
    blue = (left[..., 2] - left[..., 0] > 60) & (left[..., 2] > 120)
    orange = (middle[..., 0] > 190) & (abs(middle[..., 1] - 94) < 40) & (middle[..., 2] < 60)
    green = (right[..., 1] - right[..., 0] > 50) & (right[..., 1] - right[..., 2] > 25)
    return int(blue.sum()), int(orange.sum()), int(green.sum())


def whole(png: Path) -> bool:
    blue, orange, green = coloured(png)
    return min(blue, orange) > 100 and green > 2000


def test_recorded_flight_is_drawn_on_the_full_page(root: Path, tmp_path: Path) -> None:
    shown = picture(root / "recordings" / "cdfp_ld4_raw.mcap", tmp_path / "page.png", drawn=whole)
    assert saturated(shown) > COLOURFUL
    assert whole(shown), coloured(shown)


def test_live_flight_moves_on_the_light_page(root: Path, tmp_path: Path) -> None:
    flight = read_flight(root / "recordings" / "cdfp_ld4.mcap")
    rows = [{n: float(v[i]) for n, v in flight.columns.items() if np.isfinite(v[i])} for i in range(len(flight))]
    view = LiveView("live", ViewOptions(layout="light", port=free_port()))
    page = WebPage(view.url, free_port())
    stop = threading.Event()

    def feed() -> None:
        i = 0
        while not stop.wait(0.087):
            view.sample(0.087 * i, rows[(2 * i) % len(rows)])
            i += 1

    feeder = threading.Thread(target=feed, name="feeder")
    feeder.start()
    try:
        first, second = take(page.url, tmp_path / "live.png", times=2, apart_s=3.0)
    finally:
        stop.set()
        feeder.join()
        page.close()
        view.close()
    assert saturated(first) > COLOURFUL
    moved = np.abs(pixels(first) - pixels(second)).max(axis=2) > 60
    assert moved.sum() > 500, "the live page stands still"
    assert view.dropped == 0


def test_the_live_page_asks_nobody_but_this_computer(tmp_path: Path) -> None:
    from playwright.sync_api import sync_playwright

    view = LiveView("home", ViewOptions(layout="full", port=free_port()))
    page = WebPage(view.url, free_port())
    asked: list[str] = []
    try:
        for i in range(40):
            view.sample(0.1 * i, {"latitude": 47.4, "longitude": 8.5, "alpha": 0.1})
        with sync_playwright() as tools:
            browser = tools.chromium.launch(executable_path=chromium(), headless=True, args=list(ARGUMENTS))
            shown = browser.new_page(viewport={"width": 960, "height": 540})
            shown.on("request", lambda request: asked.append(request.url))
            shown.route("**/*", lambda r: r.continue_() if "//127.0.0.1" in r.request.url else r.abort())
            shown.goto(page.url, wait_until="commit")
            for _ in range(120):
                if shown.evaluate("window._handle !== undefined"):
                    break
                shown.wait_for_timeout(500)
            shown.wait_for_timeout(6000)  # rerun reports its use a while after it has started
            shown.screenshot(path=str(tmp_path / "home.png"))
            refused = shown.evaluate("fetch('https://tel.rerun.io/api/pog').then(() => '', (e) => e.message)")
            browser.close()
    finally:
        page.close()
        view.close()
    assert [url for url in asked if not url.startswith("http://127.0.0.1:")] == []
    assert any(url.endswith("ReadMessages") for url in asked), "the page has not asked for its data"
    assert refused == "this page asks nobody but this computer"
