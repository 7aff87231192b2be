"""Pictures of the viewer in headless Chromium. `python -m tests.web.screenshot` makes docs/pictures/view.png and view.webp.

Nothing but loopback is reached. Software rendering: no GPU or display is needed.
"""

import os
import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.support.paths import ROOT

ARGUMENTS = (
    "--no-sandbox",
    "--disable-gpu-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--disable-dev-shm-usage",
)
TIME_LINE_UP = 15  # pixels from the lower edge of the page to the time line
TIME_LINE = (0.24, 0.82)  # where it begins and ends, as shares of the page's width
COLOURFUL = 1500  # saturated pixels that make a page count as drawn


def chromium() -> str:
    """Path of Chromium; a missing one fails in CI and skips elsewhere."""
    found = shutil.which("chromium") or shutil.which("chromium-browser")
    if found is None:
        why = "Chromium is not installed (Debian: apt-get install chromium)"
        if os.environ.get("CI"):
            pytest.fail(why)
        pytest.skip(why)
    return found


def pixels(png: Path) -> NDArray[np.int16]:
    """(rows, columns, 3) of a picture."""
    from PIL import Image

    with Image.open(png) as picture:
        return np.asarray(picture.convert("RGB"), np.int16)


def saturated(png: Path) -> int:
    """Number of pixels with a clear colour: curves, states, the aircraft; not grey text on a dark ground."""
    rgb = pixels(png)
    return int(((rgb.max(axis=2) - rgb.min(axis=2)) > 60).sum())


def colourful(png: Path) -> bool:
    """Whether a picture of the viewer has something drawn."""
    return saturated(png) > COLOURFUL


def take(
    url: str,
    target: Path,
    *,
    drawn: Callable[[Path], bool] = colourful,
    times: int = 1,
    apart_s: float = 5.0,
    wait_s: float = 75.0,
    size: tuple[int, int] = (960, 540),
    at: float | None = None,
) -> list[Path]:
    """Open a page, wait until a picture of it is as `drawn` says, and take `times` pictures `apart_s` apart.

    at: as soon as something is drawn, click on the time line so far to its right (share of the page's width). The layout comes
    behind the first data of a recording, on a busy machine by seconds: what waits for letters says so in `drawn`.
    """
    from playwright.sync_api import sync_playwright

    paths = []
    with sync_playwright() as tools:
        browser = tools.chromium.launch(executable_path=chromium(), headless=True, args=list(ARGUMENTS))
        page = browser.new_page(viewport={"width": size[0], "height": size[1]}, color_scheme="dark")
        page.route("**/*", lambda route: route.continue_() if "//127.0.0.1" in route.request.url else route.abort())
        page.goto(url, wait_until="commit")
        deadline = time.monotonic() + wait_s

        def wait_until(right: Callable[[Path], bool]) -> None:
            while time.monotonic() < deadline:
                page.wait_for_timeout(1500)
                page.screenshot(path=str(target))
                if right(target):
                    break

        if at is not None:
            wait_until(colourful)
            page.mouse.click(at * size[0], size[1] - TIME_LINE_UP)
        wait_until(drawn)
        for number in range(times):
            if number:
                page.wait_for_timeout(1000 * apart_s)
            path = target.with_stem(f"{target.stem}_{number}") if times > 1 else target
            page.screenshot(path=str(path))
            paths.append(path)
        browser.close()
    return paths


def film(
    url: str, target: Path, *, frames: int = 24, size: tuple[int, int] = (1200, 720), wait_s: float = 75.0
) -> Path:
    """A moving picture (animated WebP) of a recorded flight: its time line from left to right, a frame at a time."""
    from PIL import Image
    from playwright.sync_api import sync_playwright

    with sync_playwright() as tools, tempfile.TemporaryDirectory() as scratch:
        browser = tools.chromium.launch(executable_path=chromium(), headless=True, args=list(ARGUMENTS))
        page = browser.new_page(viewport={"width": size[0], "height": size[1]}, color_scheme="dark")
        page.route("**/*", lambda route: route.continue_() if "//127.0.0.1" in route.request.url else route.abort())
        page.goto(url, wait_until="commit")
        shots = [Path(scratch) / f"{i:03d}.png" for i in range(frames)]
        deadline = time.monotonic() + wait_s
        while time.monotonic() < deadline:
            page.wait_for_timeout(1500)
            page.screenshot(path=str(shots[0]))
            if saturated(shots[0]) > COLOURFUL:
                break
        for i, shot in enumerate(shots):
            page.mouse.click(
                (TIME_LINE[0] + i / (frames - 1) * (TIME_LINE[1] - TIME_LINE[0])) * size[0], size[1] - TIME_LINE_UP
            )
            page.wait_for_timeout(2500)
            page.screenshot(path=str(shot))
        browser.close()
        first, *rest = [Image.open(shot).convert("RGB") for shot in shots]
        first.save(target, save_all=True, append_images=rest, duration=350, loop=0, quality=60, method=4)
    return target


def after(seconds: float) -> Callable[[Path], bool]:
    """Something is drawn, and was `seconds` ago: for pictures that people look at."""
    first: list[float] = []

    def settled(png: Path) -> bool:
        if colourful(png) and not first:
            first.append(time.monotonic())
        return bool(first) and time.monotonic() > first[0] + seconds

    return settled


def picture(recording: Path, target: Path, **options: Any) -> Path:
    """The full page of a recorded flight, as `sideslip view` shows it."""
    from groundstation.viewer.live import free_port
    from groundstation.viewer.recorded import as_rrd
    from groundstation.viewer.window import WebPage

    with tempfile.TemporaryDirectory() as scratch:
        page = WebPage(as_rrd(recording, Path(scratch) / "f.rrd"), free_port())
        try:
            return take(page.url, target, **options)[0]
        finally:
            page.close()


def main() -> None:
    """Fly, receive over a lossy radio, and take the pictures of the README."""
    from firmware_sim.world.scenario import load_scenario
    from groundstation.viewer.live import free_port
    from groundstation.viewer.recorded import as_rrd
    from groundstation.viewer.window import WebPage
    from sideslip.chain import fly_scenario
    from sideslip.verbs.demo import DEMO_RADIO

    target = ROOT / "docs" / "pictures" / "view.png"
    with tempfile.TemporaryDirectory() as scratch:
        fly_scenario(load_scenario("cdfp_ld4").altered(radio=DEMO_RADIO), Path(scratch), seed=4)
        (received,) = (Path(scratch) / "ground").glob("aircraft*.mcap")
        picture(received, target, size=(1600, 960), at=0.585, drawn=after(8.0))
        shown = WebPage(as_rrd(received, Path(scratch) / "film.rrd"), free_port())
        try:
            film(shown.url, target.with_suffix(".webp"))
        finally:
            shown.close()
    print(target)


if __name__ == "__main__":
    main()
