"""Named streams of random numbers: one seed of the run, one stream for every purpose, the same in any process."""

from enum import IntEnum

import numpy as np

ROUND = 1000  # between the seeds of successive rounds, more than any of them draws apart by
KINEMATIC = 31  # apart from the seed of the run: nulls of the kinematic check


class Stream(IntEnum):
    """What is drawn; the values are large primes, so that no two streams meet."""

    NULLS = 7919
    INPUT_ERRORS = 104729
    HELD_OUT_NULLS = 32452843
    KINEMATIC_INPUT_ERRORS = 49979687
    CLOSURE_NULLS = 86028121
    MEASURED_AGAIN = 122949823
    CLOSED_LOOP = 141650939

    def generator(self, seed: int, *which: int) -> np.random.Generator:
        """The generator of draw `which` (record, number) of this stream."""
        return np.random.default_rng([seed, int(self), *which])
