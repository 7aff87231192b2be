"""The five equations of lateral-directional motion as linear regressions on measured signals.

Side force, rolling and yawing moment (regressed on the derivatives of the linear model), kinematics of sideslip and of
bank (regressed on a constant). Each reads d/dt momentum + rest = base terms, and becomes regressors in one of these ways,
with a length in samples:
`savgol`: rates by Savitzky-Golay differentiation, everything else as measured;
`weak`: the equation multiplied by a smooth test function that slides over the flight and integrated by parts, so that
nothing is differentiated; the rest by the trapezoidal rule;
`weak cubic`: the same, the rest integrated through cubics.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.signal import savgol_filter

from tests.studies.gap_regression.library import LIBRARY, Array, G, Signals

EQUATIONS = ("CY", "Cl", "Cn", "beta", "phi")
BASE: Mapping[str, tuple[str, ...]] = {
    "CY": ("CY_0", "CY_beta", "CY_p", "CY_r", "CY_dr"),
    "Cl": ("Cl_0", "Cl_beta", "Cl_p", "Cl_r", "Cl_da", "Cl_dr"),
    "Cn": ("Cn_0", "Cn_beta", "Cn_p", "Cn_r", "Cn_dr"),
    "beta": ("constant_beta",),
    "phi": ("constant_phi",),
}
REGRESSOR = {"beta": "beta", "p": "p_hat", "r": "r_hat", "da": "delta_a", "dr": "delta_r"}
SCALE = {"CY": "qS", "Cl": "qSb", "Cn": "qSb"}
CONSTANTS = ("m", "S", "b", "Ixx", "Iyy", "Izz", "Ixz")
COURSES = ("beta", "p", "q", "r", "phi", "theta", "psi", "alpha", "V", "rho", "ax", "ay", "az", "delta_a", "delta_r",
           "delta_e", "thrust")  # fmt: skip
GIVEN = frozenset((*CONSTANTS, *COURSES, "V_dot", "step"))
SMOOTHED = frozenset(COURSES) - {"rho", "delta_a", "delta_r", "delta_e"}
SMOOTH = 7  # samples of the smoothing of the signals that library columns are made of


@dataclass(frozen=True)
class Way:
    """How signals become regressors. kind: savgol | weak | weak cubic; length: samples of the window."""

    kind: str
    length: int

    @property
    def name(self) -> str:
        return f"{self.kind} {self.length}"

    def rate(self, x: Array, step: float) -> Array:
        """(..., N) -> (..., n) rate of a signal, as the left side takes it."""
        if self.kind == "savgol":
            return np.asarray(savgol_filter(x, self.length, 3, deriv=1, delta=step))
        return self._tested(np.diff(x) / step)

    def value(self, g: Array) -> Array:
        """(..., N) -> (..., n) what of a course goes with that rate."""
        if self.kind == "savgol":
            return g
        if self.kind == "weak":
            return self._tested(0.5 * (g[..., 1:] + g[..., :-1]))
        before, after = 3 * (g[..., :1] - g[..., 1:2]) + g[..., 2:3], 3 * (g[..., -1:] - g[..., -2:-1]) + g[..., -3:-2]
        o = np.concatenate([before, g, after], axis=-1)
        return self._tested((13.0 * (o[..., 1:-2] + o[..., 2:-1]) - o[..., :-3] - o[..., 3:]) / 24.0)

    def _tested(self, intervals: Array) -> Array:
        """Weighted means of neighbouring intervals."""
        n = intervals.shape[-1] - self.length + 1
        return np.asarray(sum(w * intervals[..., k : k + n] for k, w in enumerate(self.weights)))

    @cached_property
    def weights(self) -> Array:
        """Area of (1 - t^2)^2 over each of the intervals it spans, of sum 1."""
        edges = np.linspace(-1.0, 1.0, self.length + 1)
        area = edges - 2 * edges**3 / 3 + edges**5 / 5
        return np.asarray(np.diff(area) / (area[-1] - area[0]))


PLAIN = Way("weak cubic", 5)  # for the derivatives that give some library terms their weights


def with_airspeed_rate(s: Signals) -> dict[str, Array | float]:
    """Signals with the rate of the airspeed, which flights do not record."""
    return {**s, "V_dot": savgol_filter(s["V"], 2 * SMOOTH + 1, 2, deriv=1, delta=s["step"])}


def derived(s: Signals) -> dict[str, Array | float]:
    """Signals with what the equations calculate from them."""
    v = dict(s)
    q_dyn = 0.5 * v["rho"] * v["V"] ** 2
    v |= {
        "q_dyn": q_dyn,
        "qS": q_dyn * v["S"],
        "qSb": q_dyn * v["S"] * v["b"],
        "p_hat": v["p"] * v["b"] / (2 * v["V"]),
        "r_hat": v["r"] * v["b"] / (2 * v["V"]),
    }
    v["beta_rate"] = (
        v["p"] * np.sin(v["alpha"])
        - v["r"] * np.cos(v["alpha"])
        + (v["ay"] + G * np.cos(v["theta"]) * np.sin(v["phi"])) / (v["V"] * np.cos(v["beta"]))
        - v["V_dot"] / v["V"] * np.tan(v["beta"])
    )
    v["phi_rate"] = v["p"] + np.tan(v["theta"]) * (v["q"] * np.sin(v["phi"]) + v["r"] * np.cos(v["phi"]))
    return v


def smoothed(s: Signals) -> dict[str, Array | float]:
    """What library columns are made of: measured signals smoothed (surfaces are left sharp) and their rates."""
    v = dict(s)
    v |= {n: savgol_filter(x, SMOOTH, 3) for n, x in s.items() if n in SMOOTHED}
    rates = {f"{n}_rate": savgol_filter(s[n], SMOOTH, 3, deriv=1, delta=s["step"]) for n in ("p", "r")}
    rates["theta_rate"] = v["q"] * np.cos(v["phi"]) - v["r"] * np.sin(v["phi"])
    return derived(v) | rates


def momenta(v: Signals) -> Array:
    """(equations, N) what is differentiated on the left sides."""
    p, r = v["p"], v["r"]
    return np.stack([np.zeros_like(p), v["Ixx"] * p - v["Ixz"] * r, v["Izz"] * r - v["Ixz"] * p, v["beta"], v["phi"]])


def rests(v: Signals) -> Array:
    """(equations, N) the rest of the left sides: force [N], couplings [N m], kinematics [rad/s]."""
    p, q, r = v["p"], v["q"], v["r"]
    roll = (v["Izz"] - v["Iyy"]) * q * r - v["Ixz"] * p * q
    yaw = (v["Iyy"] - v["Ixx"]) * p * q + v["Ixz"] * q * r
    return np.stack([v["m"] * v["ay"], roll, yaw, -v["beta_rate"], -v["phi_rate"]])


def base_terms(v: Signals, equation: str) -> Array:
    """(terms, N) regressors of the linear model in that equation."""
    ones = np.ones_like(v["V"])
    names = [n.partition("_")[2] for n in BASE[equation]]
    return np.stack(
        [v[SCALE[equation]] * v.get(REGRESSOR.get(n, ""), ones) if equation in SCALE else ones for n in names]
    )


def based(v: Signals, derivatives: Mapping[str, float]) -> Array:
    """(equations, N) the base terms with their derivatives, summed."""
    return np.stack([np.array([derivatives[n] for n in BASE[e]]) @ base_terms(v, e) for e in EQUATIONS])


def library_courses(v: Signals, derivatives: Mapping[str, float]) -> tuple[Array, Array]:
    """What each hypothesis at its usual size adds to the left side less the base terms: momenta and rests, both
    (equations, hypotheses, N)."""
    shape = (len(EQUATIONS), len(LIBRARY), v["V"].size)
    rate, rest = np.zeros(shape), np.zeros(shape)
    here = momenta(v), rests(v) - based(v, derivatives)
    given = {n: x for n, x in v.items() if n in GIVEN}
    for j, hypothesis in enumerate(LIBRARY):
        if hypothesis.terms is not None:
            for equation, course in hypothesis.terms(v, derivatives).items():
                rest[EQUATIONS.index(equation), j] = course * v[SCALE[equation]] if equation in SCALE else course
        else:
            assert hypothesis.corrected is not None
            w = derived(given | dict(hypothesis.corrected(v)))
            rate[:, j], rest[:, j] = here[0] - momenta(w), here[1] - rests(w) + based(w, derivatives)
    return rate, rest


def evidence(flights: Sequence[Signals], ways: Sequence[Way]) -> dict[str, Array]:
    """All that a regression of these flights together can use, by the name of the way.

    (equations, hypotheses + 1, hypotheses + 1): products of the library columns and, last, of the left side, the base
    terms projected out of both, each equation divided by the variance of what its base terms leave.
    """
    raw = [derived(s) for s in flights]
    left = [(momenta(v), rests(v), [base_terms(v, e) for e in EQUATIONS]) for v in raw]
    step = float(raw[0]["step"])
    derivatives: dict[str, float] = {}
    for e, y, X in _regressions(left, PLAIN, step):
        derivatives |= dict(zip(BASE[EQUATIONS[e]], np.linalg.lstsq(X, y, rcond=None)[0].tolist(), strict=True))
    courses = [library_courses(smoothed(s), derivatives) for s in flights]
    found = {}
    for way in ways:
        columns = np.concatenate([way.rate(a, step) + way.value(b) for a, b in courses], axis=-1)
        grams = []
        for e, y, X in _regressions(left, way, step):
            M = np.column_stack([columns[e].T, y])
            Q, _ = np.linalg.qr(X)
            M -= Q @ (Q.T @ M)
            grams.append(M.T @ M * (y.size / (M[:, -1] @ M[:, -1])))
        found[way.name] = np.stack(grams)
    return found


def _regressions(
    left: Sequence[tuple[Array, Array, Sequence[Array]]], way: Way, step: float
) -> list[tuple[int, Array, Array]]:
    """Per equation: its index, left side (n,) and base regressors (n, terms) of all flights."""
    made = []
    for e in range(len(EQUATIONS)):
        y = np.concatenate([way.rate(m[e], step) + way.value(r[e]) for m, r, _ in left])
        X = np.concatenate([way.value(b[e]).T for _, _, b in left])
        made.append((e, y, X))
    return made
