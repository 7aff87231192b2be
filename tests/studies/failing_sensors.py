"""Sensors that are pulled and come back in flight, alone and two at a time, at random instants: what does the recording say?

    python -m tests.studies.failing_sensors [FLIGHTS] [SEED]

Each flight has sensors drawn from all drivers, or an autopilot with or without vanes as their source, a scan rate of 20, 50 or
100 Hz, and one or two devices that go and come back once or twice. Of the recording must hold: no slot missed, its counts close;
while a device is away each scan says so and has none of its values; it is there again once it can be; the others go on. The last
result is in docs/logger.md.
"""

import itertools
import re
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from daq.contract.channels import channels_of
from daq.contract.recordings.accounting import verify
from daq.contract.recordings.reading import read_recording
from daq.contract.scan import Scan, SensorState
from firmware_sim.runs.flight import prepare_flight
from firmware_sim.world.scenario import load_scenario
from tests.support.paths import ROOT

SECONDS = 16.0
NOTICED_S = 1.1
"""A receiver is silent for half a second before it counts as gone, an autopilot's sample is stale by then; one scan more."""
RETURN_S = 3.2
"""From its plug to values: the longest pause between two tries, and the set-up of the slowest chip, among others."""
GONE = frozenset({SensorState.ABSENT, SensorState.FAULT, SensorState.STALE, SensorState.OFF})
PITOTS = {"sdp3x": "address = 0x21", "dlvr": 'chip = "l10d"', "ms5525": "address = 0x76", "ms4525do": ""}
CONFIGS = ROOT / "daq" / "configs"

Span = tuple[float, float]


@dataclass(frozen=True)
class Trial:
    """config: text; away: device -> when it is away [s]; groups: device -> what then has no values."""

    config: str
    away: Mapping[str, tuple[Span, ...]]
    groups: Mapping[str, tuple[str, ...]]

    @property
    def words(self) -> str:
        drivers = re.findall(r'^driver = "(\w+)"', self.config, re.M)
        rate = re.search(r"(?m)^rate_hz = ([\d.]+)", self.config)
        spans = "; ".join(f"{d} {', '.join(f'{a:.2f} to {b:.2f}' for a, b in s)}" for d, s in self.away.items())
        return f"{rate[1] if rate else '?'} Hz, {', '.join(sorted(set(drivers))) or 'usual'}: {spans}"


def of_chips(rng: np.random.Generator) -> tuple[str, dict[str, tuple[str, ...]]]:
    """Sensors of their own: configuration, and device -> groups."""
    text = (CONFIGS / "cdfp.toml").read_text()
    imu, pitot, static = (
        rng.choice(["icm20948", "icm42688"]),
        str(rng.choice(list(PITOTS))),
        rng.choice(["bmp390", "bmp581"]),
    )
    devices = {n: (n,) for n in ("imu", "static", "thrust", "capture", "gnss", "analog_a", "analog_b", "analog_c")}
    devices["pitot_sdp3x" if pitot == "sdp3x" else "pitot"] = ("pitot",)
    if imu == "icm42688":
        text = _section(text, "imu", 'driver = "icm42688"\naddress = 0x68')
        text = _section(text, "mag", None)
    else:
        devices |= {"imu": ("imu", "mag"), "mag": ("mag",)}
    if pitot != "ms4525do":
        text = _section(text, "pitot", f'driver = "{pitot}"\n{PITOTS[pitot]}')
    if static == "bmp581":
        text = _section(text, "static", 'driver = "bmp581"\naddress = 0x46')
    if rng.random() < 0.5:
        vanes = "[sensors.vane_alpha]\naddress = 0x36\n\n[sensors.vane_beta]\naddress = 0x37\n"
        text = _section(text, "analog_a", None) + "\n" + vanes
        devices |= {"vane_alpha": ("vane_alpha",), "vane_beta": ("vane_beta",)}
        del devices["analog_a"]
    return text, devices


def of_autopilot(rng: np.random.Generator) -> tuple[str, dict[str, tuple[str, ...]]]:
    """An autopilot as the source, with or without vanes."""
    with_vanes = rng.random() < 0.6
    text = (CONFIGS / ("autopilot_vanes.toml" if with_vanes else "autopilot.toml")).read_text()
    devices = {"autopilot": ("imu", "mag", "attitude", "pitot", "static", "capture", "gnss")}
    return text, devices | ({"vane_alpha": ("vane_alpha",), "vane_beta": ("vane_beta",)} if with_vanes else {})


def _section(text: str, name: str, body: str | None) -> str:
    """The configuration with another section of a sensor, or without it."""
    made = "" if body is None else f"[sensors.{name}]\n{body}\n\n"
    return re.sub(rf"(?ms)^\[sensors\.{name}\].*?(?=^\[)", lambda _: made, text, count=1)


def trial(rng: np.random.Generator) -> Trial:
    """One flight's sensors and what happens to them."""
    text, devices = of_autopilot(rng) if rng.random() < 0.35 else of_chips(rng)
    rate = float(rng.choice([20.0, 50.0, 100.0]))
    text = re.sub(r"(?m)^rate_hz = .*", f"rate_hz = {rate:g}", text, count=1)
    if rate == 100.0:
        text = text.replace("baud = 230400", "baud = 460800")
    failing = rng.choice(sorted(devices), min(len(devices), int(rng.integers(1, 3))), replace=False)
    away = {}
    for device in map(str, failing):
        first, length = float(rng.uniform(2.0, 4.0)), float(rng.uniform(0.4, 2.5))
        spans: list[Span] = [(first, first + length)]
        if rng.random() < 0.4:
            again = first + length + RETURN_S + float(rng.uniform(0.3, 1.5))
            spans.append((again, again + float(rng.uniform(0.4, 2.0))))
        away[device] = tuple(spans)
    return Trial(text, away, devices)


def fly(one: Trial, folder: Path, seed: int) -> list[str]:
    """What is wrong with the recording of one flight."""
    config = folder / "rig.toml"
    config.write_text(one.config)
    faults = [
        {"kind": "absent", "device": device, "start_s": a, "stop_s": b}
        for device, spans in one.away.items()
        for a, b in spans
    ]
    scenario = load_scenario("nominal").altered(flight={"duration_s": SECONDS, "seed": seed}, faults=tuple(faults))
    flight = prepare_flight(scenario, folder / "flight", config_file=config)
    origin_s = flight.clock.monotonic_ns() * 1e-9
    flight.run()
    (directory,) = {p.parent for p in (folder / "flight").rglob("*_000.mcap")}
    recording = read_recording(next(directory.glob("*_000.mcap")))
    scans, books = list(recording.scans()), recording.last_statistics
    books = books() if callable(books) else books
    wrong = [] if verify(directory).ok else ["the recording is not sound"]
    if books is None or books.missed or books.dropped or books.lost or not books.closes:
        wrong.append(f"slots: {books}")
    away = {g: one.away.get(d, ()) for d, groups in one.groups.items() for g in groups}
    for device, spans in one.away.items():
        for group in one.groups[device]:
            away[group] = tuple(sorted({*away[group], *spans}))
    for group, spans in away.items():
        wrong += misreported(scans, group, spans, origin_s)
    return wrong


def misreported(scans: Sequence[Scan], group: str, spans: Sequence[Span], origin_s: float) -> list[str]:
    """What the scans say wrongly of a group that was away in `spans` [s after `origin_s`]."""
    names = {c.name for c in channels_of(group)}
    mute, gone_else, kept = 0, 0, 0
    for scan in scans:
        at_s = scan.time - origin_s
        if group not in scan.groups:
            continue
        gone, valued = scan.groups[group].state in GONE, bool(names & scan.values.keys())
        if gone and valued:
            return [f"{group}: {scan.groups[group].state.words} with values at {at_s:.2f} s"]
        inside = any(a + NOTICED_S <= at_s < b for a, b in spans)
        near = any(a - 0.1 <= at_s < b + RETURN_S for a, b in spans)
        kept += inside and not gone
        gone_else += gone and not near
        mute += not near
    wrong = [f"{group}: {kept} scans while away do not say so"] if kept else []
    if gone_else > max(2, mute // 50):
        wrong.append(f"{group}: gone in {gone_else} of {mute} scans while it was there")
    return wrong


def main(flights: int, seed: int) -> int:
    """All flights; 1 where one was wrong."""
    rng, bad, began = np.random.default_rng([44, 3, seed]), 0, time.monotonic()
    single, pairs = Counter[str](), Counter[str]()
    for number in range(flights):
        one = trial(rng)
        with tempfile.TemporaryDirectory() as name:
            wrong = fly(one, Path(name), 100 * seed + number)
        (single if len(one.away) == 1 else pairs).update(itertools.chain(one.away))
        bad += bool(wrong)
        print(f"{number + 1}: {'; '.join(wrong) or 'right'} | {one.words}", flush=True)
    print(
        f"{flights} flights, {bad} wrong, {time.monotonic() - began:.0f} s; alone {dict(single)}; with another {dict(pairs)}"
    )
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main(*(int(a) for a in sys.argv[1:3] or ("40", "1"))))
