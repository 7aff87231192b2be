"""Named streams of random numbers: from the seed of a run one stream for every purpose, the same in any process."""

from enum import IntEnum

import numpy as np

ROUND = 1000  # added to the seed for every round: more than any offset used within a round
KINEMATIC = 31  # added to the seed of the run for the nulls of the kinematic check


class Stream(IntEnum):
    """What is drawn. The values are distinct large primes, so that no two streams start alike."""

    NULLS = 7919
    INPUT_ERRORS = 104729
    HELD_OUT_NULLS = 32452843
    KINEMATIC_INPUT_ERRORS = 49979687
    CLOSURE_NULLS = 86028121
    MEASURED_AGAIN = 122949823

    def generator(self, seed: int, *which: int) -> np.random.Generator:
        """The generator of one draw of this stream. which: indices of the draw, such as record and number."""
        return np.random.default_rng([seed, int(self), *which])
