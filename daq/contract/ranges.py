"""Sets of scan numbers as inclusive ranges (first, last)."""

from collections.abc import Iterable, Sequence

Range = tuple[int, int]


def ranges(numbers: Iterable[int]) -> tuple[Range, ...]:
    """Numbers, in any order, as inclusive ranges."""
    out: list[Range] = []
    for n in sorted(set(numbers)):
        if out and n == out[-1][1] + 1:
            out[-1] = (out[-1][0], n)
        else:
            out.append((n, n))
    return tuple(out)


def subtract(these: Iterable[Range], those: Iterable[Range]) -> tuple[Range, ...]:
    """The numbers in `these` that are not in `those`."""
    taken = {n for a, b in those for n in range(a, b + 1)}
    return ranges(n for a, b in these for n in range(a, b + 1) if n not in taken)


def count(these: Iterable[Range]) -> int:
    """How many numbers the ranges hold."""
    return sum(b - a + 1 for a, b in these)


def shown(these: Sequence[Range], limit: int = 5) -> str:
    """Ranges for a sentence."""
    words = ", ".join(f"{a}-{b}" if b > a else str(a) for a, b in these[:limit])
    return words + (f" and {len(these) - limit} more ranges" if len(these) > limit else "")
