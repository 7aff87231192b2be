"""A fixed piece of work, timed on this machine beside what is measured: a benchmark's limit is a ratio to it."""

import struct
import time

import numpy as np

ROUNDS = 4000


def reference_s(repeats: int = 5) -> float:
    """Least processor time [s] of some runs of what our programs do most: packed records, dictionaries, small arrays."""
    best = float("inf")
    for _ in range(repeats):
        begin = time.process_time()
        _work()
        best = min(best, time.process_time() - begin)
    return best


def _work() -> float:
    layout = struct.Struct("<QIhhhhff")
    matrix, total = np.eye(8) + 0.01, 0.0
    for i in range(ROUNDS):
        record = layout.pack(i, i, 1, -2, 3, -4, 0.5, 1.5)
        fields = dict(zip("abcdefgh", layout.unpack(record), strict=True))
        total += sum(fields.values()) + float((matrix @ matrix[i % 8])[0])
    return total
