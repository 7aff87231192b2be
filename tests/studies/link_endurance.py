"""Two hours of telemetry at any speed: is everything received kept, and does memory stay flat?

Run: python -m tests.studies.link_endurance [HOURS]. The last result is kept in docs/link.md.
"""

import resource
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from daq.contract.reading import join, read_segments
from daq.downlink_config import DownlinkConfig
from groundstation.link_config import LinkConfig
from tests.link_rig import Rig, quiet_scan


def resident_mb() -> float:
    """Memory of this process now [MB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6


def main(hours: float) -> None:
    rng = np.random.default_rng(1)
    pool = [quiet_scan(n, rng, time_ns=0) for n in range(400)]
    loss = np.random.default_rng(2)
    with tempfile.TemporaryDirectory() as folder:
        rig = Rig(
            Path(folder),
            down=lambda data: data[:30] + data[31:] if loss.random() < 0.05 else data,
            aircraft=DownlinkConfig(budget_bytes_per_s=2500),
            ground=LinkConfig(ports=("memory",), backfill="lost"),
        )
        started = time.perf_counter()
        sent = 0
        heard = 0
        for quarter in range(round(hours * 4)):
            for _ in range(18_000):
                n = rig.number
                model = pool[n % len(pool)]
                rig.fly(1, lambda _: type(model)(n, rig.clock.monotonic_ns(), 0, 0, 0, model.groups, model.values))  # noqa: B023
                rig.scans.clear()
            heard += len(rig.received())
            rig.events.clear()
            sent = len(rig.link.downlink.sent)
            print(f"{(quarter + 1) / 4:5.2f} h  sent {sent}  received {heard}  memory {resident_mb():.0f} MB")
        rig.rest(60)
        (books,) = rig.ground.accounting()
        print(f"sent {books.sent} = received {books.received} + lost {books.lost_count}; missing {len(books.missing)}")
        print(f"whole run {time.perf_counter() - started:.0f} s")
        (path,) = rig.ground.write_recordings()
        print(f"recording: {len(join(path, read_segments(path)).numbers)} scans, memory {resident_mb():.0f} MB")
        rig.close()


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 2.0)
