"""Bench recordings: known stimuli instead of a flight, through the same instruments, chips and logger.

Each bench sets an angle, a speed, a force or an orientation for some seconds at a time and records the reading of the reference
instrument, which has an error of its stated size, as on a real bench. `record_bench` writes a raw recording and beside it the
plan from which calibration files are fitted."""

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from daq.utilities.constants import GAS_CONSTANT, GRAVITY
from daq.utilities.durable import write_text
from firmware_sim.hardware.sensing.sensor_models import SensorModels
from firmware_sim.hardware.sensing.units import individual
from firmware_sim.physics.atmosphere import Site, air_at
from firmware_sim.physics.effects.base import Sensed
from firmware_sim.runs.flight import FlightFiles, prepare_flight
from firmware_sim.tables import ScenarioError, toml_text
from firmware_sim.world.ground import direction_cosines
from firmware_sim.world.scenario import scenario_from
from firmware_sim.world.truth import Truth

DWELL_S, MOVE_S, LEAD_S = 3.0, 1.0, 1.5
MARGIN_S = 0.5  # of a dwell left out at either end: filters and vanes settle

Reference = float | tuple[float, float, float] | None


@dataclass(frozen=True, slots=True)
class Pose:
    """What the bench sets for one dwell. Angles [rad], rates [rad/s], speed [m/s], load [N], pressure [Pa].

    vane_alpha, vane_beta are the vanes' own angles.
    """

    vane_alpha: float = 0.0
    vane_beta: float = 0.0
    left: float = 0.0
    right: float = 0.0
    rudder: float = 0.0
    attitude: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rates: tuple[float, float, float] = (0.0, 0.0, 0.0)
    speed: float = 0.0
    load: float = 0.0
    pressure: float = 0.0  # 0: that of the day
    warmer_k: float = 0.0


@dataclass(frozen=True, slots=True)
class InstrumentReading:
    """What one instrument is compared with: its name in the calibration set and the reference of each dwell."""

    instrument: str
    procedure: str
    references: tuple[Reference, ...]
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class SimulatedBench:
    """A bench: poses one after another, and what they tell about which instruments."""

    title: str
    poses: tuple[Pose, ...]
    readings: tuple[InstrumentReading, ...]
    dwell_s: float = DWELL_S
    tumbling: bool = False  # turns from pose to pose without standing still

    @property
    def duration_s(self) -> float:
        """Length of the recording [s]."""
        return LEAD_S + len(self.poses) * (self.dwell_s + MOVE_S)

    def window(self, i: int) -> tuple[float, float]:
        """Start and end of dwell `i` [s], settled."""
        start = LEAD_S + i * (self.dwell_s + MOVE_S) + MOVE_S
        return start + MARGIN_S, start + self.dwell_s - MARGIN_S


@dataclass(frozen=True, slots=True)
class BenchFiles:
    """What a bench recording has left."""

    flight: FlightFiles
    plan: Path


class BenchRig:
    """A truth source that shows the poses of a bench, moving from one to the next within MOVE_S."""

    def __init__(self, bench: SimulatedBench, models: SensorModels) -> None:
        self._bench = bench
        self._models = models

    def advance(self, to_time: float) -> Truth:
        """The truth at `to_time` [s]."""
        bench = self._bench
        i, elapsed = divmod(max(to_time - LEAD_S, 0.0), bench.dwell_s + MOVE_S)
        last = len(bench.poses) - 1
        target = bench.poses[min(int(i), last)]
        start = bench.poses[max(min(int(i), last + 1) - 1, 0)]
        span = bench.dwell_s + MOVE_S if bench.tumbling else MOVE_S
        in_motion = to_time >= LEAD_S and i <= last and elapsed < span
        pose = _between(start, target, elapsed / span if in_motion else 1.0)
        if in_motion and target.attitude != start.attitude:
            turning = [(new - old) / span for old, new in zip(start.attitude, target.attitude, strict=True)]
            pose = replace(pose, rates=_body_rates(pose.attitude, turning))
        return bench_truth(to_time, pose, self._models)


def _between(a: Pose, b: Pose, share: float) -> Pose:
    def mix(x: Any, y: Any) -> Any:
        if isinstance(x, tuple):
            return tuple(mix(p, q) for p, q in zip(x, y, strict=True))
        return x + share * (y - x)

    return Pose(**{name: mix(getattr(a, name), getattr(b, name)) for name in Pose.__dataclass_fields__})


def _body_rates(attitude: tuple[float, float, float], turning: Sequence[float]) -> tuple[float, float, float]:
    phi, theta, _ = attitude
    phi_dot, theta_dot, psi_dot = turning
    return (
        phi_dot - psi_dot * math.sin(theta),
        theta_dot * math.cos(phi) + psi_dot * math.sin(phi) * math.cos(theta),
        -theta_dot * math.sin(phi) + psi_dot * math.cos(phi) * math.cos(theta),
    )


def bench_truth(time: float, pose: Pose, models: SensorModels, site: Site | None = None) -> Truth:
    """The truth of an aircraft held by the bench."""
    site = site or Site()
    air = air_at(site.elevation_m, site.temperature_offset_k)
    pressure = pose.pressure or float(air.pressure)
    temperature = float(air.temperature) + pose.warmer_k
    density = pressure / (GAS_CONSTANT * temperature)
    turn = direction_cosines(*pose.attitude)
    force = turn @ np.array([0.0, 0.0, -GRAVITY])
    # The free stream that turns each vane to its angle: wash undone, and beta from the flank angle.
    alpha = (pose.vane_alpha - models.alpha_vane.wash_offset) / models.alpha_vane.wash_factor
    flank = (pose.vane_beta - models.beta_vane.wash_offset) / models.beta_vane.wash_factor
    beta = math.atan(math.tan(flank) * math.cos(alpha))
    ax, ay, az = (float(f) for f in force)
    mx, my, mz = (float(b) for b in turn @ np.array(site.magnetic_ned_t))
    p, q, r = pose.rates
    phi, theta, psi = pose.attitude
    left, right, rudder = pose.left, pose.right, pose.rudder
    sensed = Sensed(ax, ay, az, p, q, r, phi, theta, psi, alpha, beta, pose.speed, left, right, rudder)
    return Truth(
        time=time,
        specific_force=(ax, ay, az),
        rates=pose.rates,
        rate_derivatives=(0.0, 0.0, 0.0),
        phi=phi,
        theta=theta,
        psi=psi,
        alpha=alpha,
        beta=beta,
        V=pose.speed,
        wind_ned=(0.0, 0.0, 0.0),
        velocity_ned=(0.0, 0.0, 0.0),
        position_ned=(0.0, 0.0, 0.0),
        latitude=site.latitude_deg,
        longitude=site.longitude_deg,
        altitude=site.elevation_m,
        left_elevon=left,
        right_elevon=right,
        rudder=rudder,
        surface_e=0.5 * (left + right),
        surface_a=0.5 * (right - left),
        surface_r=rudder,
        cmd_left=left,
        cmd_right=right,
        cmd_rudder=rudder,
        throttle=0.0,
        thrust=pose.load,
        p_static=pressure,
        p_dynamic=0.5 * density * pose.speed**2,
        temperature=temperature,
        rho=density,
        magnetic=(mx, my, mz),
        digital=(0.0, 1.0, 0.0, 0.0, 0.0),
        supply_voltage=12.0,
        sensed=sensed,
    )


# ------------------------------------------------------------------------------------------------------- the benches

PROTRACTOR, STEPS, MANOMETER_M_S, WEIGHTS_N, TABLE_RAD_S, LEVEL, BAROMETER_PA = (
    0.0015,
    13,
    0.05,
    0.02,
    0.0005,
    0.003,
    10.0,
)
"""One sigma of the references: protractor [rad], tunnel speed, weights, turntable, gravity by a level [m/s2], barometer."""


def _angles(rng: np.random.Generator) -> SimulatedBench:
    """Vanes and surfaces at known angles, all moved together."""
    names = ("alpha_vane", "beta_vane", "elevon_left", "elevon_right", "rudder")
    nominal = np.linspace(-0.42, 0.42, STEPS)
    true = nominal + PROTRACTOR * rng.standard_normal((5, STEPS))
    poses = tuple(Pose(a, b, left, right, rudder) for a, b, left, right, rudder in true.T.tolist())
    references = tuple(float(a) for a in nominal)
    options = {"method": "protractor, 13 positions", "reference_uncertainty": PROTRACTOR, "degree": 3}
    return SimulatedBench(
        "vanes and surfaces at known angles",
        poses,
        tuple(InstrumentReading(n, "static_points", references, options) for n in names),
    )


def _tunnel(rng: np.random.Generator) -> SimulatedBench:
    """Wind-tunnel speeds up and down."""
    speeds = np.array([0.0, 8.0, 10.0, 12.0, 14.0, 16.0, 18.0, 20.0, 22.0, 24.0, 26.0, 28.0])
    true = np.abs(speeds + MANOMETER_M_S * rng.standard_normal(speeds.size) * (speeds > 0.0))
    options = {
        "method": "wind tunnel, 12 speeds",
        "reference_unit": "m/s",
        "reference_uncertainty": 0.8,  # Pa: the tunnel's 0.05 m/s at 14 m/s
    }
    reading = InstrumentReading("pitot", "speed_sweep", tuple(float(v) for v in speeds), options)
    return SimulatedBench("speed sweep in the tunnel", tuple(Pose(speed=float(v)) for v in true), (reading,))


def _load(rng: np.random.Generator) -> SimulatedBench:
    """Weights on the thrust stand."""
    weights = np.linspace(0.0, 16.0, 9)
    true = weights + WEIGHTS_N * rng.standard_normal(9) * (weights > 0.0)
    options = {"method": "weights over a pulley", "reference_uncertainty": WEIGHTS_N}
    reading = InstrumentReading("thrust", "static_points", tuple(float(w) for w in weights), options)
    return SimulatedBench("weights on the thrust stand", tuple(Pose(load=float(w)) for w in true), (reading,))


def _chamber(rng: np.random.Generator) -> SimulatedBench:
    """Static pressures against a barometer."""
    pressures = np.linspace(95_000.0, 103_000.0, 7)
    true = pressures + BAROMETER_PA * rng.standard_normal(7)
    options = {"method": "pressure chamber and barometer", "reference_uncertainty": BAROMETER_PA}
    reading = InstrumentReading("static", "static_points", tuple(float(p) for p in pressures), options)
    return SimulatedBench(
        "static pressure against a barometer", tuple(Pose(pressure=float(p)) for p in true), (reading,)
    )


_HALF_TURN, _QUARTER = math.pi, 0.5 * math.pi
_FACES = (
    (0.0, 0.0), (_HALF_TURN, 0.0), (_QUARTER, 0.0), (-_QUARTER, 0.0), (0.0, _QUARTER - 1e-3), (0.0, 1e-3 - _QUARTER),
    (0.25 * math.pi, 0.5), (-0.25 * math.pi, 0.5), (0.25 * math.pi, -0.5), (-0.25 * math.pi, -0.5),
    (0.75 * math.pi, 0.5), (-0.75 * math.pi, -0.5),
)  # fmt: skip


def _faces(rng: np.random.Generator) -> SimulatedBench:
    """The six faces and six corners down, the accelerometer seeing gravity from all sides, cold and warm."""
    poses, references = [], []
    for warmer in (0.0, 20.0):
        for phi, theta in _FACES:
            tilt = LEVEL / GRAVITY * rng.standard_normal(2)
            poses.append(Pose(attitude=(phi + tilt[0], theta + tilt[1], 0.0), warmer_k=warmer))
            x, y, z = direction_cosines(phi, theta, 0.0) @ np.array([0.0, 0.0, -GRAVITY])
            references.append((float(x), float(y), float(z)))
    options = {
        "method": "six faces and six corners, two temperatures",
        "reference_uncertainty": LEVEL,
        "fit_temperature": True,
    }
    return SimulatedBench(
        "six-face tumble", tuple(poses), (InstrumentReading("accelerometer", "vectors", tuple(references), options),)
    )


def _turntable(rng: np.random.Generator) -> SimulatedBench:
    """Rates about each axis both ways, and standing still, cold and warm."""
    poses, references = [], []
    rates = (0.0, 0.0, 0.0), *(tuple(s * (a == i) for a in range(3)) for i in range(3) for s in (-4.0, -1.5, 1.5, 4.0))
    for warmer, rate in itertools.product((0.0, 20.0), rates):
        table_error = TABLE_RAD_S * rng.standard_normal(3) * (np.array(rate) != 0.0)
        p, q, r = (float(v) for v in np.array(rate) + table_error)
        poses.append(Pose(rates=(p, q, r), warmer_k=warmer))
        references.append((float(rate[0]), float(rate[1]), float(rate[2])))
    options = {
        "method": "turntable, three axes, two temperatures",
        "reference_uncertainty": TABLE_RAD_S,
        "fit_temperature": True,
    }
    return SimulatedBench(
        "turntable", tuple(poses), (InstrumentReading("gyro", "vectors", tuple(references), options),)
    )


def _swing(rng: np.random.Generator) -> SimulatedBench:
    """Turned slowly through all orientations in the earth's field, away from iron."""
    site = Site()
    angles = np.stack(
        [rng.uniform(-math.pi, math.pi, 30), rng.uniform(-1.4, 1.4, 30), rng.uniform(-math.pi, math.pi, 30)]
    )
    poses = tuple(Pose(attitude=(float(a), float(b), float(c))) for a, b, c in angles.T)
    strength = float(np.linalg.norm(site.magnetic_ned_t))
    options = {"method": "turned by hand in all directions", "field": strength, "reference_uncertainty": 0.4e-6}
    reading = InstrumentReading("magnetometer", "sphere", (None,) * len(poses), options)
    return SimulatedBench("magnetometer tumble", poses, (reading,), dwell_s=2.0, tumbling=True)


_BENCHES: Mapping[str, Callable[[np.random.Generator], SimulatedBench]] = {
    "bench_angles": _angles,
    "bench_tunnel": _tunnel,
    "bench_load": _load,
    "bench_chamber": _chamber,
    "bench_faces": _faces,
    "bench_turntable": _turntable,
    "bench_swing": _swing,
}


def bench_titles() -> dict[str, str]:
    """Names of the benches and what they do."""
    return {name: make(np.random.default_rng(0)).title for name, make in _BENCHES.items()}


def record_bench(
    name: str,
    folder: Path,
    *,
    seed: int = 1,
    sensors: Mapping[str, Any] | None = None,
    calibration: Path | None = None,
    speed: float | None = None,
) -> BenchFiles:
    """Run a bench through chips and logger: `folder/onboard/*.mcap` and `folder/plan.toml`.

    sensors: the table `[sensors]` of a scenario, the individual unit among it. calibration: set embedded in the recording.
    seed: of the sensors' noise and the references' errors. Raises ScenarioError for an unknown bench.
    """
    if name not in _BENCHES:
        raise ScenarioError(f"bench {name!r}: known are {', '.join(_BENCHES)}")
    bench = _BENCHES[name](np.random.default_rng([seed, 0xBE2C]))
    scenario = scenario_from(
        {
            "name": name,
            "title": bench.title,
            "flight": {"seed": seed, "duration_s": bench.duration_s},
            "sensors": dict(sensors or {}),
            "logger": {"downlink": None},
        },
        name,
    )
    models = individual(SensorModels().altered(**dict(sensors or {})))
    flight = prepare_flight(scenario, folder, source=BenchRig(bench, models), calibration=calibration, speed=speed)
    with flight:
        files = flight.run()
    plan = folder / "plan.toml"
    write_text(plan, _plan_text(bench, flight.scan_times[0]))
    return BenchFiles(files, plan)


def _plan_text(bench: SimulatedBench, first_scan_s: float) -> str:
    """The bench plan as the fitting reads it: times after the first scan."""
    fits = []
    for reading in bench.readings:
        dwells = list(_dwells(bench, reading.references, first_scan_s))
        fits.append(
            {"instrument": reading.instrument, "procedure": reading.procedure, **reading.options, "dwell": dwells}
        )
    return toml_text({"format": 1, "fit": fits})


def _dwells(bench: SimulatedBench, references: Sequence[Reference], first_scan_s: float) -> Iterable[dict[str, Any]]:
    if bench.tumbling:
        yield {"start": bench.window(0)[0] - first_scan_s, "stop": bench.window(len(bench.poses) - 1)[1] - first_scan_s}
        return
    for i, reference in enumerate(references):
        start, stop = (round(t - first_scan_s, 3) for t in bench.window(i))
        reading = list(reference) if isinstance(reference, tuple) else reference
        yield {"start": start, "stop": stop, "reference": reading}
