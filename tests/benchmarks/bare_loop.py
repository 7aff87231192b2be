"""The least that a logger can be: a loop over smbus2 that reads what the logger reads, and writes each scan to MCAP as bytes.

Arguments: recorded answers, seconds, rate [Hz], file to write. Nothing is checked, aligned, synced, sent or watched; of the
converters each input is chosen, waited for and read.
"""

import struct
import sys
import time
from itertools import chain
from pathlib import Path

from mcap.writer import CompressionType, Writer
from smbus2 import SMBus, i2c_msg

from daq.sensors.ubx import UbxParser
from tests.benchmarks.replayed_bus import AnsweringKernel, Question, ReplayedBus, ReplayedReceiver

IMU = (0x68, 0x2D, 14)
"""Asked once a scan."""
CONVERTERS, CONFIG, CONVERSION = (0x48, 0x49, 0x4A), 1, 0
INPUTS = tuple([0xC3 | number << 4, 0xE3] for number in range(4))
"""Configuration words of an ADS1115: one conversion of an input to ground, 4.096 V, 860 a second."""
CONVERSION_S = 1.25e-3


def reads_of_a_scan(bus: ReplayedBus) -> list[Question]:
    """What the logger reads in one scan beside its converters, as often as it does."""
    scans = len(bus.scan_answers[IMU])
    return [
        q
        for q, answers in bus.scan_answers.items()
        if q[0] not in CONVERTERS
        for _ in range(round(len(answers) / scans))
    ]


def convert(bus: SMBus) -> list[int]:
    """Each input of each converter."""
    values: list[int] = []
    for word in INPUTS:
        for address in CONVERTERS:
            bus.write_i2c_block_data(address, CONFIG, word)
        time.sleep(CONVERSION_S)
        for address in CONVERTERS:
            values += bus.read_i2c_block_data(address, CONVERSION, 2)
    return values


def main(answers: Path, seconds: float, rate_hz: float, output: Path) -> None:
    """Scan on absolute deadlines until the time is over; prints how many scans were written."""
    bus, port, parser = ReplayedBus(answers), ReplayedReceiver(answers, seconds + 10.0), UbxParser()
    bus.scans_begin()
    questions, sensors = reads_of_a_scan(bus), AnsweringKernel(bus).open()
    begin, interval, count = time.monotonic(), 1.0 / rate_hz, 0
    with output.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start("", "bare loop")
        channel = writer.register_channel(topic="scan", message_encoding="bytes", schema_id=0)
        while (now := time.monotonic()) < begin + seconds:
            time.sleep(max(begin + count * interval - now, 0.0))
            stamp = time.monotonic_ns()
            values = convert(sensors)
            values += chain.from_iterable(_ask(sensors, *question) for question in questions)
            fixes = [payload for _, payload in parser.feed(port.read(port.in_waiting))]
            data = struct.pack(f"<q{len(values)}B", stamp, *values) + b"".join(fixes)
            writer.add_message(channel, log_time=stamp, publish_time=stamp, sequence=count, data=data)
            count += 1
        writer.finish()
    print(count)


def _ask(bus: SMBus, address: int, register: int, length: int) -> list[int]:
    if register >= 0:
        return bus.read_i2c_block_data(address, register, length)
    message = i2c_msg.read(address, length)
    bus.i2c_rdwr(message)
    return list(message)


if __name__ == "__main__":
    main(Path(sys.argv[1]), float(sys.argv[2]), float(sys.argv[3]), Path(sys.argv[4]))
