"""One table of all ratios at the end, whatever machine it is; pytest's exit status is that of the whole."""

from collections.abc import Callable

import pytest

from tests.benchmarks.reference import reference_s

Against = Callable[[str, float, float], None]
ROWS = pytest.StashKey[list[tuple[str, float, float]]]()


@pytest.fixture
def compared(request: pytest.FixtureRequest) -> Against:
    """Notes a ratio for the table, and fails where it is above its limit: `compared(what, ratio, most)`."""
    rows = request.config.stash.setdefault(ROWS, [])

    def compare(what: str, ratio: float, most: float) -> None:
        rows.append((what, ratio, most))
        assert ratio <= most, f"{what}: {ratio:.3g}, at most {most:g}"

    return compare


@pytest.fixture
def against_reference(compared: Against) -> Against:
    """The same for processor seconds, which are divided by those of the reference work, run here and now."""
    before = reference_s()

    def compare(what: str, seconds: float, most: float) -> None:
        compared(f"{what} / reference", seconds / min(before, reference_s()), most)

    return compare


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """The table."""
    rows = config.stash.get(ROWS, [])
    if rows:
        terminalreporter.section("ratios")
        for what, ratio, most in rows:
            terminalreporter.line(f"{what:<62}{ratio:>9.3f}  at most {most:g}{'' if ratio <= most else '  ABOVE'}")
