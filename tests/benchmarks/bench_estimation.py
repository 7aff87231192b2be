"""Speed and memory of the estimation engine, on the project's own code: make bench.

Prints first and warm fit with and without a compiler against scipy least_squares over a Runge-Kutta loop on the same
flight, then cost against samples, parameters and flights. Times are processor seconds of one thread on this machine, now:
they are what a wall clock shows where nothing else runs, and do not grow where something does.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares

from estimation.engine.simulate import Compile, simulate_with_sensitivities
from estimation.estimators.output_error import OutputErrorOptions, build_problem, find_optimum, output_error
from estimation.models import load_model
from estimation.prepare.flight_data import FlightData
from estimation.prepare.pipeline import prepare
from groundstation.flight import write_flight
from tests.benchmarks.conftest import Against
from tests.unit.estimation.truth import NOISE, STRONG, Case, fly

MODEL = load_model("lateral-simple", "cdfp")


def timed(work: Callable[[], object], repeats: int = 3) -> float:
    """Least processor time of some runs [s]."""
    best = np.inf
    for _ in range(repeats):
        begin = time.process_time()
        work()
        best = min(best, time.process_time() - begin)
    return best


def command_time(flight: Path, **environment: str) -> float:
    """Processor time [s] of `sideslip estimate` of one flight from the shell, imports included."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "sideslip", "estimate", str(flight), "--aircraft", "cdfp"]
    subprocess.run(command, env={**os.environ, **environment}, stdout=subprocess.DEVNULL, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def fit(data: list[FlightData], compile_: Compile) -> object:
    options = OutputErrorOptions(compile_=compile_, improve_start=False)
    return output_error(MODEL.with_local("CY_0", "Cl_0", "Cn_0"), data, options=options)


def search(data: list[FlightData], options: OutputErrorOptions) -> object:
    """What scipy does: the optimum from the model's own start values."""
    problem = build_problem(MODEL, data, options)
    return find_optimum(problem, problem.pack(MODEL.starts()), options)


def scipy_fit(data: FlightData) -> tuple[dict[str, float], float]:
    """What one writes first: least_squares with finite differences over a Runge-Kutta loop in numpy."""
    segment = data.segments[0]
    u, z, t = segment.u, segment.z, segment.time
    c, names = MODEL.constants, MODEL.parameter_names
    b, S, m, g = c["b"], c["S"], c["m"], c["g"]
    inertia = c["Ixx"] * c["Izz"] - c["Ixz"] ** 2
    noise = np.array([NOISE[n] for n in MODEL.output_names])

    def rates(x: np.ndarray, w: np.ndarray, v: list[float]) -> tuple[np.ndarray, float]:
        (Y0, Yb, Yp, Yr, Ydr, L0, Lb, Lp, Lr, Lda, Ldr, N0, Nb, Np, Nr, Ndr) = v
        (da, dr, V, rho), (beta, p, r, phi) = w, x
        q, ph, rh = 0.5 * rho * V * V, p * b / (2 * V), r * b / (2 * V)
        CY = Y0 + Yb * beta + Yp * ph + Yr * rh + Ydr * dr
        Cl = L0 + Lb * beta + Lp * ph + Lr * rh + Lda * da + Ldr * dr
        Cn = N0 + Nb * beta + Np * ph + Nr * rh + Ndr * dr
        k = q * S * b / inertia
        x_dot = (
            -r + g / V * np.sin(phi) + rho * V * S / (2 * m) * CY,
            k * (c["Izz"] * Cl + c["Ixz"] * Cn),
            k * (c["Ixx"] * Cn + c["Ixz"] * Cl),
            p,
        )
        return np.array(x_dot), q * S / m * CY

    def misfit(theta: np.ndarray) -> np.ndarray:
        v, x = theta[:16].tolist(), theta[16:]
        y = np.empty_like(z)
        for k in range(len(t)):
            y[k, :4], y[k, 4] = x, rates(x, u[k], v)[1]
            if k + 1 == len(t):
                break
            h = (t[k + 1] - t[k]) / 2
            for j in range(2):
                ua, ub = (u[k] + f * (u[k + 1] - u[k]) for f in (j / 2, (j + 1) / 2))
                um = 0.5 * (ua + ub)
                k1 = rates(x, ua, v)[0]
                k2 = rates(x + h / 2 * k1, um, v)[0]
                k3 = rates(x + h / 2 * k2, um, v)[0]
                k4 = rates(x + h * k3, ub, v)[0]
                x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return ((z - y) / noise).ravel()

    start = np.concatenate([[MODEL.starts()[n] for n in names], segment.x0])
    begin = time.process_time()
    found = least_squares(misfit, start, x_scale=np.maximum(np.abs(start), 1e-3))
    return dict(zip(names, found.x.tolist(), strict=False)), time.process_time() - begin


def peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> dict[str, float]:
    """Print the tables; what the limits are of."""
    rng = np.random.default_rng(1)
    flight = fly(Case(noise=NOISE, servo=None), rng)[0][0]
    sigma = {n: NOISE[n] for n in MODEL.output_names}

    begin = time.process_time()
    output_error(MODEL, flight, options=OutputErrorOptions(compile_="never"))
    first = time.process_time() - begin
    data = prepare(MODEL, flight)
    prepare_time = timed(lambda: prepare(MODEL, flight))
    options = OutputErrorOptions(sigma=sigma, compile_="never", improve_start=False, hold="linear", paths=False)
    own = output_error(MODEL, data, options=options)
    slow, seconds = scipy_fit(data)
    usual = timed(lambda: output_error(MODEL, data, options=OutputErrorOptions(compile_="never")))
    off = max(abs(own.values[n] - slow[n]) / own.std[n] for n in STRONG)
    virtual = timed(lambda: output_error(MODEL, data, options=options))
    alone = timed(lambda: search([data], options))
    quick = timed(lambda: search([data], replace(options, compile_="auto")))
    fast = timed(lambda: output_error(MODEL, data, options=replace(options, compile_="auto")))
    print(f"preparing one 601-sample flight (de-noising)   {prepare_time:8.3f} s")
    print(f"first fit of the process, no compiler          {first:8.3f} s")
    print(f"warm fit with both bounds, no compiler         {usual:8.3f} s")
    print(f"the same with given noise, no compiler         {virtual:8.3f} s")
    print(f"the same with given noise, compiled            {fast:8.3f} s")
    print(f"the optimum alone, without bounds, no compiler {alone:8.3f} s")
    print(f"the optimum alone, without bounds, compiled    {quick:8.3f} s")
    print(f"scipy least_squares + Runge-Kutta loop         {seconds:8.3f} s, which also finds the optimum alone:")
    print(f"  {seconds / alone:.0f} times as long as no compiler, {seconds / quick:.0f} times as long as compiled")
    print(
        f"  (with both bounds {seconds / virtual:.0f} and {seconds / fast:.0f}); answers differ by {off:.3f} of a bound at most"
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "made.mcap"
        write_flight(flight, path)
        without = command_time(path, XDG_CACHE_HOME=folder, SIDESLIP_COMPILER="none")
    print(f"sideslip estimate of it from the shell         {without:8.3f} s without a compiler")
    for label, kind in (("no compiler", "never"), ("compiled", "auto")):
        ms = 1e3 * timed(lambda kind=kind: simulate_with_sensitivities(MODEL, data, compile_=kind))  # type: ignore[misc]
        print(f"one cost + Jacobian, 601 samples, {label:12} {ms:8.2f} ms")
    print("\nsamples, compiled fit")
    for copies in (1, 4, 16):
        long = replace(data, segments=tuple(replace(s) for s in data.segments * copies), samples=601 * copies)
        print(f"{601 * copies:8d} {timed(lambda long=long: fit([long], 'auto'), 1):8.3f} s")  # type: ignore[misc]
    print("\nfree parameters, one cost + Jacobian, compiled")
    for count in (4, 8, 16):
        names = MODEL.parameter_names[:count]
        ms = 1e3 * timed(lambda n=names: simulate_with_sensitivities(MODEL, data, free=n))  # type: ignore[misc]
        print(f"{count:8d} {ms:8.2f} ms")
    print("\nflights together (own trims and initial states each)")
    flights = [prepare(MODEL, f) for f in fly(Case(noise=NOISE, servo=None), rng, 100)[0]]
    for count in (4, 25, 100):
        print(f"{count:8d} {timed(lambda n=count: fit(flights[:n], 'auto'), 1):8.3f} s compiled")  # type: ignore[misc]
    print(f"{100:8d} {timed(lambda: fit(flights, 'never'), 1):8.3f} s without a compiler")
    print(f"peak memory {peak_mb():.0f} MB")
    return {"off": off, "scipy": seconds, "no compiler": alone, "compiled": quick, "with bounds": fast}


@pytest.mark.benchmark
@pytest.mark.timeout(600)
def test_estimation_speed(tmp_path: Path, compared: Against) -> None:
    """In a process whose linear algebra uses one thread, as that of `sideslip estimate` does."""
    one = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    answer = tmp_path / "found.json"
    command = [sys.executable, "-m", "tests.benchmarks.bench_estimation", str(answer)]
    subprocess.run(command, env={**os.environ, **one}, check=True)
    found = json.loads(answer.read_text())
    compared("own optimum off scipy's [bounds]", found["off"], 0.01)
    for how, most in (("no compiler", 1 / 50), ("compiled", 1 / 250), ("with bounds", 1 / 30)):
        compared(f"a fit, {how} / scipy's least_squares", found[how] / found["scipy"], most)


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(json.dumps(main()))
