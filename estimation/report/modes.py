"""Natural modes of the identified aircraft, with the spread that the bounds of the derivatives give them.

The model is linearised about straight flight at the medians of the measured columns (rates, sideslip, bank and lateral inputs at
zero). The modes are the eigenvalues of df/dx; their spread comes from draws from the estimates' covariance.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq.utilities.constants import SEA_LEVEL_DENSITY
from estimation.engine.trace import trace
from estimation.estimators.result import Result
from estimation.models.base import Model
from estimation.prepare.columns import with_derived
from estimation.report.tables import ReportTable, rounded, significant
from groundstation.flight import Array, Flight

DRAWS = 300  # that give percentiles to a tenth of the spread
REAL = 1e-9  # imaginary part up to which an eigenvalue counts as real
AT_REST = ("beta", "p", "q", "r", "phi", "delta_a", "delta_r", "V_dot", "alpha_dot", "beta_dot", "ay")


@dataclass(frozen=True, slots=True)
class EigenMode:
    """damping: NaN for an aperiodic mode; speed: natural frequency [rad/s], or -eigenvalue [1/s] of an aperiodic one."""

    name: str
    speed: float
    damping: float


def state_matrix(model: Model, values: Mapping[str, float], state: Array, inputs: Array) -> Array:
    """(nx, nx) Jacobian df/dx at one point. values: every parameter; state (nx,), inputs (nu,)."""
    traced = trace(model.structure)
    p = [
        *(values[n] for n in model.parameter_names),
        *(model.constants[n] for n in model.structure.remaining_constants),
    ]
    entries = np.asarray(traced.rates_jacobian(state, inputs, p)[1]).ravel()
    rows, columns = traced.patterns["f_x"]
    A = np.zeros((len(model.states), len(model.states)))
    A[list(rows), list(columns)] = entries
    return A


def trim(model: Model, flight: Flight) -> tuple[Array, Array]:
    """State (nx,) and inputs (nu,) of straight flight: medians of the measured columns, density from air data or height."""
    flight = with_derived(flight, ("rho",))

    def usual(name: str, source: str) -> float:
        return 0.0 if name in AT_REST or not flight.measured(source) else float(np.nanmedian(flight[source]))

    rho = {"rho": SEA_LEVEL_DENSITY}
    state = np.array([usual(s.name, s.source) for s in model.states])
    inputs = np.array([usual(s.name, s.source) or rho.get(s.name, 0.0) for s in model.inputs])
    return state, inputs


def modes(A: Array, states: tuple[str, ...]) -> list[EigenMode]:
    """Modes of a state matrix by their usual names for the lateral and the longitudinal set of states."""
    roots = np.linalg.eigvals(A)
    pairs = sorted((z for z in roots if z.imag > REAL), key=lambda z: -abs(z))
    real = sorted((float(z.real) for z in roots if abs(z.imag) <= REAL), key=lambda x: -abs(x))
    pair_names, real_names = _names(states, len(pairs), len(real))
    oscillations = [
        EigenMode(n, float(abs(z)), float(-z.real / abs(z))) for n, z in zip(pair_names, pairs, strict=True)
    ]
    return oscillations + [EigenMode(n, -x, math.nan) for n, x in zip(real_names, real, strict=True)]


def _names(states: tuple[str, ...], pairs: int, real: int) -> tuple[list[str], list[str]]:
    if set(states) == {"beta", "p", "r", "phi"} and (pairs, real) == (1, 2):
        return ["Dutch roll"], ["roll", "spiral"]
    if {"alpha", "q", "theta"} <= set(states) <= {"V", "alpha", "q", "theta"} and (pairs, real) == (2, 0):
        return ["short period", "phugoid"], []
    return [f"oscillation {i + 1}" for i in range(pairs)], [f"aperiodic {i + 1}" for i in range(real)]


@dataclass(frozen=True, slots=True)
class SpreadMode:
    """A mode with half the width of the middle 68 % of draws, and the share of draws that are unstable."""

    mode: EigenMode
    speed_spread: float
    damping_spread: float
    unstable: float


def modes_with_spread(result: Result, flight: Flight, rng: np.random.Generator) -> list[SpreadMode]:
    """Modes at the estimates and over draws from their corrected covariance; undetermined parameters are not varied."""
    model = result.model
    state, inputs = trim(model, flight)
    nominal_modes = modes(state_matrix(model, result.values, state, inputs), model.state_names)
    draws: dict[str, list[EigenMode]] = {m.name: [] for m in nominal_modes}
    bound = np.array([result.parameters[n].std_coloured for n in result.names])
    root = _square_root(result.covariance_coloured, np.isfinite(bound))
    for _ in range(DRAWS):
        perturbation = root @ rng.standard_normal(len(bound))
        values = {
            **result.values,
            **{n: result.values[n] + float(d) for n, d in zip(result.names, perturbation, strict=True)},
        }
        for m in modes(state_matrix(model, values, state, inputs), model.state_names):
            draws.setdefault(m.name, []).append(m)
    return [
        SpreadMode(
            m,
            _half_width([d.speed for d in draws[m.name]]),
            _half_width([d.damping for d in draws[m.name]]),
            _unstable(draws[m.name]),
        )
        for m in nominal_modes
    ]


def _unstable(draws: list[EigenMode]) -> float:
    """Share of draws that diverge."""
    unstable_count = sum((d.speed if math.isnan(d.damping) else d.damping) < 0 for d in draws)
    return unstable_count / len(draws) if draws else math.nan


def _square_root(covariance: Array, identifiable: NDArray[np.bool_]) -> Array:
    """A root of the covariance, with zeros for parameters that are not identifiable."""
    finite = np.where(identifiable[:, None] & identifiable[None, :] & np.isfinite(covariance), covariance, 0.0)
    values, vectors = np.linalg.eigh(0.5 * (finite + finite.T))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def _half_width(values: list[float]) -> float:
    """Half the width of the middle 68 %; NaN where half of the draws have no such mode."""
    if len(values) < DRAWS // 2 or not np.all(np.isfinite(values)):
        return math.nan
    low, high = np.percentile(values, [15.87, 84.13])
    return float(high - low) / 2


def mode_table(entries: list[tuple[str, str, list[SpreadMode]]]) -> ReportTable:
    """The table of modes. entries: (source of the estimates, method, modes)."""
    rows = []
    for source, method, spread_modes in entries:
        for m in spread_modes:
            speed, damping = m.mode.speed, m.mode.damping
            if math.isnan(damping):
                cells = ["", "", "", _pm(-speed, m.speed_spread)]
            else:
                period = "" if damping >= 1 else significant(2 * math.pi / (speed * math.sqrt(1 - damping**2)))
                cells = [_pm(speed, m.speed_spread), _pm(damping, m.damping_spread), period, ""]
            unstable = "" if math.isnan(m.unstable) else f"{100 * m.unstable:.0f} %"
            rows.append((source, method, m.mode.name, *cells, unstable))
    return ReportTable(
        "modes", "Natural modes at the flights' median speed and incidence",
        ("estimates of", "method", "mode", "natural frequency [rad/s]", "damping ratio", "period [s]", "eigenvalue [1/s]",
         "draws unstable"), tuple(rows), symbols=False,
        note=f"± is half the middle 68 % over {DRAWS} draws from the corrected covariance of the derivatives. Measured inputs "
        "are held: a model that is driven by dynamic pressure or sideslip shows its own modes, not all those of the aircraft.",
    )  # fmt: skip


def _pm(value: float, spread: float) -> str:
    return " ± ".join(rounded(value, spread)) if math.isfinite(spread) and spread > 0.0 else f"{value:.3g}"
