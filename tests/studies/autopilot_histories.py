"""Thousands of random histories of the sequencer through an ArduPlane.

`python -m tests.studies.autopilot_histories [--histories 3000] [--seed 1]`

The strategies and properties are those of tests/unit/daq/autopilot_histories.py. The last result is kept in docs/sequencer.md.
"""

import argparse
from collections import Counter

from hypothesis import HealthCheck, Phase, given, seed, settings

from daq.contract.sequencing import Reason, State
from tests.unit.daq.autopilot_histories import MS, AutopilotHistory, Worst, histories, played


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--histories", type=int, default=3000)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    reasons: Counter[str] = Counter()
    totals: Counter[str] = Counter()
    worst = Worst()

    @seed(options.seed)
    @settings(
        max_examples=options.histories,
        deadline=None,
        database=None,
        phases=[Phase.generate, Phase.shrink],
        suppress_health_check=list(HealthCheck),
    )
    @given(histories)
    def holds(history: AutopilotHistory) -> None:
        run = played(history)
        assert run.faults == [], run.faults
        totals["histories"] += 1
        totals["reached running"] += run.running > 0
        totals["frames"] += len(run.rig.book.frames)
        worst.lapse, worst.switch = max(worst.lapse, run.worst.lapse), max(worst.switch, run.worst.switch)
        frames = run.rig.book.frames
        pairs = zip(frames, frames[1:], strict=False)
        reasons.update(
            Reason(b.reason).words for a, b in pairs if a.state == State.RUNNING and b.state != State.RUNNING
        )

    holds()
    print(", ".join(f"{name} {count}" for name, count in totals.items()))
    print(f"pilot's servos at most {worst.lapse / MS:.0f} ms after the last override was taken,")
    print(f"at most {worst.switch / MS:.0f} ms after his switch left go, and as much more as overrides came late")
    for name, count in sorted(reasons.items()):
        print(f"{name:<40}{count}")


if __name__ == "__main__":
    main()
