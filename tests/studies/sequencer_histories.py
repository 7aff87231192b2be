"""Thousands of random histories of the onboard sequencer.

`python -m tests.studies.sequencer_histories [--histories 3000] [--seed 1]`

The strategies and properties are those of tests/unit/daq/sequencer_histories.py. The last result is kept in docs/sequencer.md.
"""

import argparse
from collections import Counter

from hypothesis import HealthCheck, Phase, given, seed, settings

from daq.contract.sequencing import Reason, State
from tests.unit.daq.sequencer_histories import History, histories, played


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--histories", type=int, default=3000)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    reasons: Counter[str] = Counter()
    totals: Counter[str] = Counter()

    @seed(options.seed)
    @settings(
        max_examples=options.histories,
        deadline=None,
        database=None,
        phases=[Phase.generate, Phase.shrink],
        suppress_health_check=list(HealthCheck),
    )
    @given(histories)
    def holds(history: History) -> None:
        run = played(history)
        assert run.faults() == [], run.faults()
        totals["histories"] += 1
        totals["reached running"] += any(f.state == State.RUNNING for f in run.rig.book.frames)
        totals["frames"] += len(run.rig.book.frames)
        reasons.update(_ends(run.rig.book.frames))
        if totals["histories"] % 250 == 0:
            print(f"{totals['histories']} histories hold", flush=True)

    holds()
    print(", ".join(f"{name} {count}" for name, count in totals.items()))
    for name, count in sorted(reasons.items()):
        print(f"{name:<40}{count}")


def _ends(frames: list) -> list[str]:  # type: ignore[type-arg]
    """How manoeuvres that ran were ended."""
    pairs = zip(frames, frames[1:], strict=False)
    return [Reason(b.reason).words for a, b in pairs if a.state == State.RUNNING and b.state != State.RUNNING]


if __name__ == "__main__":
    main()
