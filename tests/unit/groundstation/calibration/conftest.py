"""Scans made by inverting the nominal data-sheet transfer functions, written down here a second time on purpose."""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest

from daq.contract.channels import GROUP_NAMES
from daq.contract.scan import GroupStatus, RawValue, Scan, SensorState
from groundstation.calibration.calibration_set import CalibrationSet, load_calibration

VOLT = 4.096 / 32768
PERIOD_NS = 50_000_000

Motion = Callable[[float], Mapping[str, float]]


def raw_values(motion: Mapping[str, float]) -> dict[str, RawValue]:
    """Counts of nominal instruments for p q r ax ay az alpha beta (at the vanes) left right rudder q_c [SI]."""
    m = {"az": -9.80665, "q_c": 130.0, **motion}
    get = lambda name: m.get(name, 0.0)  # noqa: E731
    values: dict[str, RawValue] = {}
    for axis, name in zip("xyz", ("ax", "ay", "az"), strict=True):
        values[f"accel_{axis}"] = round(get(name) / 9.80665 * 4096)
    for axis, name in zip("xyz", "pqr", strict=True):
        values[f"gyro_{axis}"] = round(math.degrees(get(name)) * 65.5)
    values["imu_temperature"] = round((get("die_c") - 21) * 333.87)
    half = {a: get(a) / 2 for a in ("phi", "theta", "psi")}
    c, s = {k: math.cos(v) for k, v in half.items()}, {k: math.sin(v) for k, v in half.items()}
    quaternion = (
        c["phi"] * c["theta"] * c["psi"] + s["phi"] * s["theta"] * s["psi"],
        s["phi"] * c["theta"] * c["psi"] - c["phi"] * s["theta"] * s["psi"],
        c["phi"] * s["theta"] * c["psi"] + s["phi"] * c["theta"] * s["psi"],
        c["phi"] * c["theta"] * s["psi"] - s["phi"] * s["theta"] * c["psi"],
    )
    values.update({f"quaternion_{a}": round(32767 * v) for a, v in zip("wxyz", quaternion, strict=True)})
    values["alpha_vane"] = round((2.5 + 1.25 * get("alpha")) / VOLT)
    values["beta_vane"] = round((2.5 + 1.25 * get("beta")) / VOLT)
    values["elevon_left_pot"] = round((2.5 + 1.6 * get("left")) / VOLT)
    values["elevon_right_pot"] = round((2.5 + 1.6 * get("right")) / VOLT)
    values["rudder_pot"] = round((2.5 + 1.6 * get("rudder")) / VOLT)
    values["sensor_supply"] = round(2.5 / VOLT)
    values["supply"] = round(12.0 / 5 / VOLT)
    values["pitot_pressure"] = round(8191.5 + m["q_c"] / (2 * 6894.757 / (0.8 * 16383)))
    values["static_pressure"], values["static_temperature"] = 6_946_816, 8_398_608
    values["thrust_load"] = round(40_000 * get("thrust"))
    for i, name in ((1, "left"), (2, "right"), (3, "rudder")):
        values[f"pwm_{i}"] = round(15_000 + 5_000 / math.radians(25) * get(name))
    values["pwm_4"] = 15_000
    return values


@pytest.fixture
def make_scans() -> Callable[..., list[Scan]]:
    """make_scans(count, motion(t) -> {...}, offsets_us={group: us}): groups are sampled at their own instants."""

    def make(
        count: int, motion: Motion = lambda t: {}, offsets_us: Mapping[str, int] | None = None, **fixed: Any
    ) -> list[Scan]:
        from daq.contract.channels import CHANNELS

        offsets = {g: (offsets_us or {}).get(g, 0) for g in GROUP_NAMES}
        group_of = {c.name: c.group for c in CHANNELS}
        scans = []
        for i in range(count):
            time_ns = 10_000_000_000 + i * PERIOD_NS
            by_offset = {o: raw_values({**fixed, **motion(time_ns * 1e-9 + o * 1e-6)}) for o in set(offsets.values())}
            names = next(iter(by_offset.values()))
            values = {n: by_offset[offsets[group_of[n]]][n] for n in names}
            groups = {g: GroupStatus(SensorState.OK, offsets[g]) for g in GROUP_NAMES}
            scans.append(Scan(i, time_ns, groups=groups, values=values))
        return scans

    return make


@pytest.fixture
def nominal() -> CalibrationSet:
    """The nominal set of the CDFP without facts: no filter delays, but the chip's coefficients."""
    full = load_calibration("cdfp")
    facts = f'"static.nvm" = "{full.facts["static.nvm"]}"'
    head = 'format = 1\ninstrument = "logger"\nkind = "logger"\ndate = 2026-01-01\nmethod = "test"\n[logger.facts]\n'
    still = {n: t.replace("delay = 0.00796", "delay = 0.0") for n, t in full.texts.items()}
    return full.with_texts({**still, "logger.toml": head + facts + "\n"})


@pytest.fixture
def white(rng: np.random.Generator) -> Callable[[int], np.ndarray]:
    """Unit white noise."""
    return lambda n: rng.standard_normal(n)
