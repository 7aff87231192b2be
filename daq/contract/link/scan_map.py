"""Compact sets of scan numbers, bounded in size against forged numbers."""

from collections.abc import Iterator

BLOCK = 512
"""Scans of one SENT_MAP message; blocks begin at multiples of it."""
BLOCK_BYTES = BLOCK // 8
_FULL = (1 << BLOCK) - 1
MAX_BLOCKS = 65536
"""Most blocks of a set: 19 days at 20 Hz; numbers that would need more are refused."""


class ScanMap:
    """A set of scan numbers, one bit each in blocks of BLOCK."""

    def __init__(self) -> None:
        self._blocks: dict[int, int] = {}
        self._count = 0

    def add(self, number: int) -> bool:
        """Add a number; False when it is a member already, or would need a block beyond MAX_BLOCKS."""
        block, bit = number // BLOCK, 1 << number % BLOCK
        word = self._blocks.get(block, 0)
        if word & bit or (not word and len(self._blocks) >= MAX_BLOCKS):
            return False
        self._blocks[block] = word | bit
        self._count += 1
        return True

    def __contains__(self, number: int) -> bool:
        return bool(self._blocks.get(number // BLOCK, 0) >> number % BLOCK & 1)

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[int]:
        for first, last in self.ranges():
            yield from range(first, last + 1)

    def count_within(self, first: int, last: int) -> int:
        """Number of members from `first` to `last`, both included; takes time by the number of blocks."""
        count = 0
        for block, word in self._blocks.items():
            low, high = max(0, first - block * BLOCK), min(BLOCK - 1, last - block * BLOCK)
            if low <= high:
                count += (word >> low & (1 << high - low + 1) - 1).bit_count()
        return count

    def blocks(self) -> list[int]:
        """Indices of the blocks with members, ascending."""
        return sorted(self._blocks)

    def word(self, block: int) -> int:
        """The members of a block as a bit mask."""
        return self._blocks.get(block, 0)

    def set_word(self, block: int, word: int) -> None:
        """Replace the members of a block; an unknown block beyond the limit is ignored."""
        if block not in self._blocks and len(self._blocks) >= MAX_BLOCKS:
            return
        word &= _FULL
        self._count += word.bit_count() - self._blocks.get(block, 0).bit_count()
        if word:
            self._blocks[block] = word
        else:
            self._blocks.pop(block, None)

    def to_bytes(self, block: int) -> bytes:
        """The members of a block as SENT_MAP carries them."""
        return self.word(block).to_bytes(BLOCK_BYTES, "little")

    def minus(self, other: "ScanMap") -> "ScanMap":
        """Members that are not in `other`."""
        difference = ScanMap()
        for block, word in self._blocks.items():
            difference.set_word(block, word & ~other.word(block))
        return difference

    def both(self, other: "ScanMap") -> "ScanMap":
        """Members that are in `other` too."""
        intersection = ScanMap()
        for block, word in self._blocks.items():
            intersection.set_word(block, word & other.word(block))
        return intersection

    def ranges(self) -> list[tuple[int, int]]:
        """Members as inclusive (first, last) ranges, ascending."""
        runs: list[tuple[int, int]] = []
        for block in self.blocks():
            word, number = self._blocks[block], block * BLOCK
            while word:
                skip = (word & -word).bit_length() - 1
                word >>= skip
                run = (~word & (word + 1)).bit_length() - 1
                word >>= run
                first = number + skip
                number = first + run
                if runs and runs[-1][1] == first - 1:
                    runs[-1] = (runs[-1][0], number - 1)
                else:
                    runs.append((first, number - 1))
        return runs
