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
    merged: list[Range] = []
    for first, last in sorted(these):
        if last < first:
            continue
        if merged and first <= merged[-1][1] + 1:
            merged[-1] = (merged[-1][0], max(merged[-1][1], last))
        else:
            merged.append((first, last))
    return tuple(merged)


def subtract(these: Iterable[Range], those: Iterable[Range]) -> tuple[Range, ...]:
    """The numbers in `these` that are not in `those`."""
    removed = union(those)
    remaining: list[Range] = []
    index = 0
    for first, last in union(these):
        while index < len(removed) and removed[index][1] < first:
            index += 1
        begin, i = first, index
        while i < len(removed) and removed[i][0] <= last:
            if begin < removed[i][0]:
                remaining.append((begin, removed[i][0] - 1))
            begin = removed[i][1] + 1
            i += 1
        if begin <= last:
            remaining.append((begin, last))
        index = max(index, i - 1)
    return tuple(remaining)


def count(these: Iterable[Range]) -> int:
    return sum(b - a + 1 for a, b in these)


def shown(these: Sequence[Range], limit: int = 5) -> str:
    """Ranges for a sentence."""
    words = ", ".join(f"{a}-{b}" if b > a else str(a) for a, b in these[:limit])
    return words + (f" and {len(these) - limit} more ranges" if len(these) > limit else "")
