"""A recording as its bytes."""

import pytest

from tests.unit.daq.synthetic import write_recording


def _written(folder: pytest.TempPathFactory, *, compress: bool) -> bytes:
    path = folder.mktemp("recording") / "s1_000.mcap"
    write_recording(path, compress=compress)
    return path.read_bytes()


@pytest.fixture(scope="session", params=[False, True], ids=["plain", "zstd"])
def original(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Compressed and not."""
    return _written(tmp_path_factory, compress=request.param)


@pytest.fixture(scope="session")
def plain(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Not compressed."""
    return _written(tmp_path_factory, compress=False)
