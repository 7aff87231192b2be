"""Stepwise regression and sparse regression (STLSQ, the method of PySINDy) on the flights of the gap benchmark.

Run: python -m tests.studies.gap_comparison [--kind effects|nulls] [--start N] [--count N] [--size S] [--nulls N]

Both see the same flights and a library with one term for each effect, in five equations by equation error: force and
moment coefficients and the kinematics of sideslip and bank. Each answers twice: by its own rule (partial F at 1 %; STLSQ
with the threshold that scores best over the whole study, which no user could know), and with the statistic of every
term standardised on the same simulated nulls that the gap workflow uses, with a family-wise 95 % threshold.
"""

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter
from scipy.stats import f as f_law

from estimation.aircraft import load_aircraft
from estimation.gap.baseline import Baseline, bank_error, channel_noise, filtered_attitudes, fit_baseline
from estimation.gap.bench import build_bench
from estimation.gap.dormant import with_dormant
from estimation.gap.effects import catalogue
from estimation.gap.nuisance import with_nuisance
from estimation.gap.nulls import NullFlyer, fly_nulls, input_errors
from estimation.gap.whitening import force_states
from estimation.models.load import load_model
from groundstation.flight import Flight
from tests.studies import second_truth as truth
from tests.studies.gap_benchmark import cases, flights, requests, same_class, wilson

Array = NDArray[np.float64]
Signals = Mapping[str, Array]

G = 9.80665
ALPHA = 0.01  # of the partial F test
THRESHOLDS = (0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.5)  # of STLSQ, in standard deviations of the equation's left side
OUTPUTS = ("beta", "p", "r", "phi", "ay")

BASE: Mapping[str, tuple[str, ...]] = {
    "CY": ("1", "beta", "p_hat", "r_hat", "delta_r"),
    "Cl": ("1", "beta", "p_hat", "r_hat", "delta_a", "delta_r"),
    "Cn": ("1", "beta", "p_hat", "r_hat", "delta_a*0", "delta_r"),
    "beta_dot": ("1",),
    "phi_dot": ("1",),
}
LIBRARY: tuple[tuple[str, str, str], ...] = (  # effect, equation, term
    ("CY_da", "CY", "delta_a"), ("CY_beta3", "CY", "beta**3"), ("imu_lever_arm", "CY", "p_dot"),
    ("imu_lever_arm", "CY", "r_dot"), ("Cl_alpha_beta", "Cl", "alpha*beta"), ("Cl_da_de", "Cl", "delta_a*delta_e"),
    ("Cl_beta3", "Cl", "beta**3"), ("Cl_da3", "Cl", "delta_a**3"), ("Cl_p_abs_p", "Cl", "p_hat*abs(p_hat)"),
    ("Cl_betadot", "Cl", "bd_hat"), ("aileron_delay", "Cl", "da_dot"), ("aileron_backlash", "Cl", "sign(da_dot)"),
    ("aileron_deadzone", "Cl", "clip(delta_a,-.014,.014)"), ("motor_torque", "Cl", "thrust/q"),
    ("lateral_cg", "Cl", "az/q"), ("surface_compliance", "Cl", "q*delta_a"), ("indicial_lag", "Cl", "bd_hat"),
    ("Cn_da", "Cn", "delta_a"), ("Cn_alpha_beta", "Cn", "alpha*beta"), ("Cn_beta3", "Cn", "beta**3"),
    ("Cn_dr3", "Cn", "delta_r**3"), ("Cn_betadot", "Cn", "bd_hat"), ("Ixz_error", "Cn", "p_dot/q"),
    ("prop_gyroscopic", "Cn", "qq/q"), ("p_factor", "Cn", "thrust*alpha/q"), ("rudder_delay", "Cn", "dr_dot"),
    ("rudder_backlash", "Cn", "sign(dr_dot)"), ("slipstream_rudder", "Cn", "thrust*delta_r/q"),
    ("beta_scale", "beta_dot", "b_dot"), ("beta_lag", "beta_dot", "b_ddot"), ("vane_position", "beta_dot", "r_dot/V"),
    ("airspeed_scale", "beta_dot", "(ay + g*cos(theta)*sin(phi))/V"), ("wind_shear", "beta_dot", "cos(psi)*sin(theta-alpha)"),
    ("gyro_scale", "phi_dot", "p"), ("gyro_misalignment", "phi_dot", "r"), ("attitude_lag", "phi_dot", "p_dot"),
    ("time_skew", "beta_dot", "p_dot*sin(alpha)-r_dot"),
)  # fmt: skip


def signals(flight: Flight, outputs: Mapping[str, Array] | None = None) -> dict[str, Array]:
    """Measured signals with smoothed derivatives. outputs: others than the flight's own (a null's)."""
    made = {n: np.asarray(v) for n, v in flight.columns.items()} | dict(outputs or {})
    step = float(np.median(np.diff(flight.time)))
    rate = lambda v, order=1: savgol_filter(v, 7, 3, deriv=order, delta=step)  # noqa: E731
    q = 0.5 * made["rho"] * made["V"] ** 2
    b = truth.SPAN
    return made | {
        "1": np.ones_like(q), "q_rate": made["q"], "qq": made["q"], "q": q, "g": np.full_like(q, G),
        "p_hat": made["p"] * b / (2 * made["V"]), "r_hat": made["r"] * b / (2 * made["V"]),
        "p_dot": rate(made["p"]), "r_dot": rate(made["r"]), "phi_rate": rate(made["phi"]), "b_dot": rate(made["beta"]),
        "b_ddot": rate(made["beta"], 2), "bd_hat": rate(made["beta"]) * b / (2 * made["V"]),
        "da_dot": rate(made["delta_a"]), "dr_dot": rate(made["delta_r"]),
    }  # fmt: skip


def left_sides(s: Signals, k: Mapping[str, float]) -> dict[str, Array]:
    """What the five equations are to explain. k: mass, inertia and size of the aircraft file."""
    q, S, b = s["q"], k["S"], k["b"]
    roll = (
        k["Ixx"] * s["p_dot"]
        - k["Ixz"] * s["r_dot"]
        + (k["Izz"] - k["Iyy"]) * s["qq"] * s["r"]
        - k["Ixz"] * s["p"] * s["qq"]
    )
    yaw = (
        k["Izz"] * s["r_dot"]
        - k["Ixz"] * s["p_dot"]
        + (k["Iyy"] - k["Ixx"]) * s["p"] * s["qq"]
        + k["Ixz"] * s["qq"] * s["r"]
    )
    kinematic = s["p"] * np.sin(s["alpha"]) - s["r"] * np.cos(s["alpha"])
    kinematic = kinematic + (s["ay"] + G * np.cos(s["theta"]) * np.sin(s["phi"])) / s["V"]
    turn = s["p"] + np.tan(s["theta"]) * (s["qq"] * np.sin(s["phi"]) + s["r"] * np.cos(s["phi"]))
    return {"CY": k["m"] * s["ay"] / (q * S), "Cl": roll / (q * S * b), "Cn": yaw / (q * S * b),
            "beta_dot": s["b_dot"] - kinematic, "phi_dot": s["phi_rate"] - turn}  # fmt: skip


def term(text: str, s: Signals) -> Array:
    """A library term over time."""
    if text == "1":
        return s["1"]
    known = {"sign": np.sign, "abs": np.abs, "clip": np.clip, "sin": np.sin, "cos": np.cos, **s}
    return np.asarray(eval(text, {"__builtins__": {}}, known))  # noqa: S307 (the library above, nothing else)


def statistics(sets: Sequence[Signals], k: Mapping[str, float]) -> tuple[Array, Array]:
    """(terms,) partial F of each term added to its equation's base, and its coefficient in standard deviations."""
    F, size = np.zeros(len(LIBRARY)), np.zeros(len(LIBRARY))
    sides = [left_sides(s, k) for s in sets]
    for equation, base in BASE.items():
        y = np.concatenate([side[equation] for side in sides])
        X = np.column_stack([np.concatenate([term(t, s) for s in sets]) for t in base if not t.endswith("*0")])
        Q, _ = np.linalg.qr(X)
        e = y - Q @ (Q.T @ y)
        for j, (_, where, text) in enumerate(LIBRARY):
            if where != equation:
                continue
            x = np.concatenate([term(text, s) for s in sets])
            d = x - Q @ (Q.T @ x)
            if d @ d < 1e-10 * (x @ x):
                continue
            gain = (d @ e) ** 2 / (d @ d)
            F[j] = gain / ((e @ e - gain) / (y.size - X.shape[1] - 1))
            size[j] = abs(d @ e / (d @ d)) * float(np.std(x)) / float(np.std(y))
    return F, size


def stlsq(sets: Sequence[Signals], k: Mapping[str, float], threshold: float, rounds: int = 10) -> str:
    """Effect of the largest library term that survives sequentially thresholded least squares (base terms are kept)."""
    sides = [left_sides(s, k) for s in sets]
    best, name = 0.0, ""
    for equation, base in BASE.items():
        y = np.concatenate([side[equation] for side in sides])
        y = (y - y.mean()) / float(np.std(y))
        kept = [t for t in base if not t.endswith("*0")]
        extra = [(n, t) for n, where, t in LIBRARY if where == equation]
        columns = [np.concatenate([term(t, s) for s in sets]) for t in [*kept, *(t for _, t in extra)]]
        X = np.column_stack([c / (float(np.std(c)) or 1.0) for c in columns])
        alive = np.ones(X.shape[1], bool)
        for _ in range(rounds):
            w = np.zeros(X.shape[1])
            w[alive] = np.linalg.lstsq(X[:, alive], y, rcond=None)[0]
            fresh = np.abs(w) >= threshold
            fresh[: len(kept)] = True
            if (fresh == alive).all():
                break
            alive = fresh
        for j, (effect, _) in enumerate(extra):
            if alive[len(kept) + j] and abs(w[len(kept) + j]) > best:
                best, name = abs(float(w[len(kept) + j])), effect
    return name


def null_statistics(training: Sequence[Flight], k: Mapping[str, float], nulls: int) -> Array:
    """(nulls, terms) sqrt of the partial F on simulated nulls of the fitted baseline."""
    model, effects = load_model("lateral"), catalogue()
    bench = build_bench(model, effects, training, ())
    white = channel_noise(bench.records)
    scatter = bank_error(bench.records, model.output_names, white)
    filtered = filtered_attitudes(bench.records, model.output_names, white)
    clean = with_nuisance(model, dict(zip(model.output_names, scatter, strict=True)), 0.05, filtered)
    working = with_dormant(clean, effects, bench.available, force_states(model))
    errors = [input_errors(r, clean, np.random.default_rng([1, 104729, i])) for i, r in enumerate(bench.records)]
    baseline = fit_baseline(working, clean, bench, scatter)
    flown = fly_nulls(NullFlyer.build(baseline.problem, baseline.fit, baseline.noise, errors), nulls, 1)
    return np.array([np.sqrt(statistics(_null_signals(training, baseline, null), k)[0]) for null in flown])


def _null_signals(training: Sequence[Flight], baseline: Baseline, null: Sequence[Array]) -> list[dict[str, Array]]:
    made = []
    names = baseline.model.output_names
    for flight, coarse, left, residual in zip(
        training, baseline.problem.coarse, baseline.fit.residuals, null, strict=True
    ):
        shown = coarse.z - left + residual
        made.append(signals(flight, {n: shown[:, names.index(n)] for n in OUTPUTS}))
    return made


def answers(training: Sequence[Flight], nulls: int) -> dict[str, Any]:
    """What every method names: effect or empty."""
    k = load_model("lateral", load_aircraft("cdfp")).constants
    sets = [signals(f) for f in training]
    F, _ = statistics(sets, k)
    samples = sum(f.time.size for f in training)
    own = LIBRARY[int(np.argmax(F))][0] if F.max() > f_law.isf(ALPHA, 1, samples) else ""
    found: dict[str, Any] = {"stepwise": own}
    found |= {f"stlsq {t:g}": stlsq(sets, k, t) for t in THRESHOLDS}
    if nulls:
        calm = null_statistics(training, k, nulls)
        spread = np.sqrt(np.mean(calm**2, axis=0))
        spread[spread == 0.0] = np.inf
        z, limit = np.sqrt(F) / spread, float(np.quantile((calm / spread).max(axis=1), 0.95))
        found["stepwise on nulls"] = LIBRARY[int(np.argmax(z))][0] if z.max() > limit else ""
    return found


def run(kind: str, size: float, start: int, count: int, gust: float, nulls: int, out: Path) -> None:
    out.parent.mkdir(parents=True, exist_ok=True)
    chosen = cases(kind, size, start, count)
    flown = truth.fly([r for _, effects, seed in chosen for r in requests(effects, seed, gust, "rich")])
    for i, (label, effects, seed) in enumerate(chosen):
        four = flights(flown[4 * i : 4 * i + 4])
        row = {"kind": kind, "label": label, "truth": list(effects), "seed": seed, "size": size, "gust": gust}
        row |= {"named": answers(four[:3], nulls)}
        with out.open("a", encoding="utf-8") as handle:
            handle.write(json.dumps(row) + "\n")
        print(label, row["named"], flush=True)


def summary(path: Path) -> str:
    """Exact and class scores on flights with one effect, false alarms on flights with none, by method, as Markdown."""
    rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    lines = ["| method | exact | in class | false alarms |", "|---|---|---|---|"]
    methods = list(dict.fromkeys(m for r in rows for m in r["named"]))
    for method in methods:
        hidden = [r for r in rows if r["truth"] and method in r["named"]]
        calm = [r for r in rows if not r["truth"] and method in r["named"]]
        exact = sum(r["named"][method] == r["truth"][0] for r in hidden)
        close = sum(bool(r["named"][method]) and same_class(r["named"][method], r["truth"][0]) for r in hidden)
        alarms = sum(bool(r["named"][method]) for r in calm)
        lines.append(
            f"| {method} | {wilson(exact, len(hidden))} | {wilson(close, len(hidden))} | {wilson(alarms, len(calm))} |"
        )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--kind", default="effects")
    parser.add_argument("--size", type=float, default=1.0)
    parser.add_argument("--start", type=int, default=0)
    parser.add_argument("--count", type=int, default=1)
    parser.add_argument("--gust", type=float, default=0.15)
    parser.add_argument("--nulls", type=int, default=100)
    parser.add_argument("--out", type=Path, default=Path("build/gap_comparison.jsonl"))
    parser.add_argument("--summary", action="store_true")
    a = parser.parse_args()
    if not a.summary:
        run(a.kind, a.size, a.start, a.count, a.gust, a.nulls, a.out)
    print(summary(a.out))


if __name__ == "__main__":
    main()
