"""The least that a logger can be: a loop that asks the bus what the logger asks, and writes each scan to MCAP as packed bytes.

Arguments: recorded answers, seconds, rate [Hz], file to write. Nothing is checked, aligned, synced, sent or watched.
"""

import struct
import sys
import time
from itertools import chain
from pathlib import Path

from mcap.writer import CompressionType, Writer
from smbus2 import i2c_msg

from daq.sensors.ubx import UbxParser
from tests.benchmarks.replayed_bus import Question, ReplayedBus, ReplayedReceiver

IMU = (0x68, 0x2D, 14)
"""Asked once a scan."""


def reads_of_a_scan(bus: ReplayedBus) -> list[Question]:
    """What the logger reads in one scan, as often as it does."""
    scans = len(bus.scan_answers[IMU])
    return [q for q, answers in bus.scan_answers.items() for _ in range(round(len(answers) / scans))]


def main(answers: Path, seconds: float, rate_hz: float, output: Path) -> None:
    """Scan on absolute deadlines until the time is over; prints how many scans were written."""
    bus, port, parser = ReplayedBus(answers), ReplayedReceiver(answers, seconds + 10.0), UbxParser()
    bus.scans_begin()
    questions = reads_of_a_scan(bus)
    begin, interval, count = time.monotonic(), 1.0 / rate_hz, 0
    with output.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start("", "bare loop")
        channel = writer.register_channel(topic="scan", message_encoding="bytes", schema_id=0)
        while (now := time.monotonic()) < begin + seconds:
            time.sleep(max(begin + count * interval - now, 0.0))
            stamp = time.monotonic_ns()
            values = list(chain.from_iterable(_ask(bus, *question) for question in questions))
            fixes = [payload for _, payload in parser.feed(port.read(port.in_waiting))]
            data = struct.pack(f"<q{len(values)}B", stamp, *values) + b"".join(fixes)
            writer.add_message(channel, log_time=stamp, publish_time=stamp, sequence=count, data=data)
            count += 1
        writer.finish()
    print(count)


def _ask(bus: ReplayedBus, address: int, register: int, length: int) -> list[int]:
    if register >= 0:
        return bus.read_i2c_block_data(address, register, length)
    message = i2c_msg.read(address, length)
    bus.i2c_rdwr(message)
    return list(message)


if __name__ == "__main__":
    main(Path(sys.argv[1]), float(sys.argv[2]), float(sys.argv[3]), Path(sys.argv[4]))
