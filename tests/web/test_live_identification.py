"""The page of live identification, opened in headless Chromium and looked at."""

from pathlib import Path

import pytest

from groundstation.viewer.live import free_port
from groundstation.viewer.window import WebPage
from tests.web.live_identification import recorded
from tests.web.screenshot import pixels, take

pytestmark = [
    pytest.mark.long,
    pytest.mark.browser,
    pytest.mark.timeout(300),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
]


def test_curves_and_table_are_drawn(tmp_path: Path) -> None:
    rrd = tmp_path / "live.rrd"
    recorded(rrd)
    page = WebPage(rrd, free_port())
    try:
        (shown,) = take(page.url, tmp_path / "page.png", at=0.79, apart_s=10.0)
    finally:
        page.close()
    rgb = pixels(shown)
    curves, table = rgb[150:500, 180:520], rgb[130:500, 530:]
    yellow = (curves[..., 0] > 180) & (curves[..., 1] > 170) & (curves[..., 2] < 120)
    blue = (curves[..., 2] - curves[..., 0] > 60) & (curves[..., 2] > 120)
    assert min(yellow.sum(), blue.sum()) > 100
    assert (table.min(axis=2) > 150).sum() > 1500, "the table has no letters"
