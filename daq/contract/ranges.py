"""Sets of scan numbers as inclusive ranges (first, last).

Work and memory go with the number of ranges, never with the numbers in them: a range may span all of 32 bits.
"""

from collections.abc import Iterable, Sequence

Range = tuple[int, int]


def ranges(numbers: Iterable[int]) -> tuple[Range, ...]:
    """Numbers, in any order, as inclusive ranges."""
    return union((n, n) for n in numbers)


def union(these: Iterable[Range]) -> tuple[Range, ...]:
    """Ranges in any order, overlapping or empty (last below first), as ascending ranges that do not touch."""
    out: list[Range] = []
    for first, last in sorted(these):
        if last < first:
            continue
        if out and first <= out[-1][1] + 1:
            out[-1] = (out[-1][0], max(out[-1][1], last))
        else:
            out.append((first, last))
    return tuple(out)


def subtract(these: Iterable[Range], those: Iterable[Range]) -> tuple[Range, ...]:
    """The numbers in `these` that are not in `those`."""
    taken = union(those)
    out: list[Range] = []
    at = 0
    for first, last in union(these):
        while at < len(taken) and taken[at][1] < first:
            at += 1
        begin, i = first, at
        while i < len(taken) and taken[i][0] <= last:
            if begin < taken[i][0]:
                out.append((begin, taken[i][0] - 1))
            begin = taken[i][1] + 1
            i += 1
        if begin <= last:
            out.append((begin, last))
        at = max(at, i - 1)
    return tuple(out)


def count(these: Iterable[Range]) -> int:
    return sum(b - a + 1 for a, b in these)


def shown(these: Sequence[Range], limit: int = 5) -> str:
    """Ranges for a sentence."""
    words = ", ".join(f"{a}-{b}" if b > a else str(a) for a, b in these[:limit])
    return words + (f" and {len(these) - limit} more ranges" if len(these) > limit else "")
