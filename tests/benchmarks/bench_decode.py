"""Frames decoded per second, side by side with stock pymavlink, and frames lost to dropped bytes."""

import time

import numpy as np
import pytest

from daq.contract.link.dialect import sideslip_dialect
from daq.contract.link.wire import SCAN_FAST_ID, layouts, pack_scan, unpack_scan
from daq.transport.mavlink_codec import FrameDecoder, FrameEncoder, frames_of, padded
from daq.transport.ports import memory_pair
from groundstation.receiver.ports import LinkConfig
from groundstation.receiver.receive import Receiver
from groundstation.receiver.timeline import SystemClock
from tests.benchmarks.conftest import Against
from tests.support.link_rig import random_scan

COUNT = 20_000
READ = 280


def stream() -> list[bytes]:
    rng = np.random.default_rng(1)
    encoder, layout = FrameEncoder(1, 1), layouts()[SCAN_FAST_ID]
    return [encoder.frame(SCAN_FAST_ID, pack_scan(layout, random_scan(n, rng), 9)) for n in range(COUNT)]


def ours(data: bytes) -> int:
    decoder, layout, count = FrameDecoder(), layouts()[SCAN_FAST_ID], 0
    for at in range(0, len(data), READ):
        for frame in frames_of(decoder.feed(data[at : at + READ])):
            unpack_scan(layout, padded(frame.payload, layout.size))
            count += 1
    return count


def stock(data: bytes) -> int:
    parser = sideslip_dialect.MAVLink(None)
    parser.robust_parsing = True
    count = 0
    for at in range(0, len(data), READ):
        count += sum(m.get_type() != "BAD_DATA" for m in parser.parse_buffer(data[at : at + READ]) or [])
    return count


def receiver(data: bytes) -> int:
    port, feed = memory_pair()
    made = Receiver(LinkConfig(ports=("m",), transmit=False), {"m": port}, SystemClock())
    for at in range(0, len(data), 4096):
        feed.write(data[at : at + 4096])
        made.poll()
    count = made.summary()["scans_received"]
    made.close()
    return int(count)


@pytest.mark.benchmark
def test_decoding_speed(compared: Against) -> None:
    frames = stream()
    data = b"".join(frames)
    print()
    runs = {"decoder, to values": ours, "whole receiver": receiver, "stock pymavlink": stock}
    measured: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(7):  # in turns, so that what else the machine does meets all of them
        for name, run in runs.items():
            started = time.process_time()
            count = run(data)
            measured[name].append(count / (time.process_time() - started))
            assert count == COUNT
    rates = {name: float(np.median(m)) for name, m in measured.items()}
    for name, rate in rates.items():
        print(f"{name:22s} {rate:9,.0f} frames/s")
    # the whole receiver, checks included, is no slower than the stock parser alone; two runs differ by 5 %
    for name, most in (("whole receiver", 1.05), ("decoder, to values", 0.7)):
        ratio = float(np.median(np.divide(measured["stock pymavlink"], measured[name])))
        compared(f"time of the {name} / of the stock parser alone", ratio, most)
    rng = np.random.default_rng(2)
    hit = rng.random(COUNT) < 0.01
    on_air = b"".join(f[:40] + f[41:] if h else f for f, h in zip(frames, hit, strict=True))
    lost = {"ours": COUNT - ours(on_air), "stock": COUNT - stock(on_air)}
    print(f"{hit.sum()} frames short of one byte: lost {lost['ours']} (ours), {lost['stock']} (stock)")
    assert lost["ours"] == hit.sum()
