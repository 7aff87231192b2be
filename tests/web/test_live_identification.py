"""The page of live identification, opened in headless Chromium and looked at."""

from pathlib import Path

import pytest

from groundstation.viewer.live import free_port
from groundstation.viewer.window import WebPage
from tests.web.live_identification import recorded
from tests.web.screenshot import pixels, take

pytestmark = [
    pytest.mark.browser,
    pytest.mark.timeout(300),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
]


def curves(png: Path) -> int:
    """Pixels of the rarer colour of two curves and their bands."""
    part = pixels(png)[150:500, 180:520]
    yellow = (part[..., 0] > 180) & (part[..., 1] > 170) & (part[..., 2] < 120)
    blue = (part[..., 2] - part[..., 0] > 60) & (part[..., 2] > 120)
    return int(min(yellow.sum(), blue.sum()))


def letters(png: Path) -> int:
    """Bright pixels where the table is."""
    return int((pixels(png)[130:500, 530:].min(axis=2) > 150).sum())


def drawn(png: Path) -> bool:
    return curves(png) > 100 and letters(png) > 1500


def test_curves_and_table_are_drawn(tmp_path: Path) -> None:
    rrd = tmp_path / "live.rrd"
    recorded(rrd)
    page = WebPage(rrd, free_port())
    try:
        (shown,) = take(page.url, tmp_path / "page.png", at=0.79, drawn=drawn)
    finally:
        page.close()
    assert curves(shown) > 100
    assert letters(shown) > 1500, "the table has no letters"
