"""Forms of transfer functions: names and units of their unknowns, and the polynomials that these make.

Approximations of the classic modes (D. T. McRuer, I. Ashkenas and D. Graham, Aircraft Dynamics and Automatic Control, chapters 5
and 6), each with a delay tau that stands for servos, sampling and faster modes.
"""

from dataclasses import dataclass

import numpy as np

from estimation.errors import EstimationError
from estimation.signals.curves import Complex
from groundstation.flight import Array

HIGHEST = 6  # order of a general form
LONGEST_NAME = 7  # characters of orders M/N: longer numbers are not converted
SURFACE_OF = {"cmd_a": "delta_a", "cmd_e": "delta_e", "cmd_r": "delta_r"}


@dataclass(frozen=True)
class TransferForm:
    """orders: of numerator and denominator. mode: "roll", "dutch-roll" or "short-period" where time constant, or damping and
    frequency, of the denominator are the unknowns; else empty, and the coefficients are."""

    name: str
    orders: tuple[int, int]
    mode: str = ""

    @property
    def _suffix(self) -> str:
        return {"dutch-roll": "d", "short-period": "sp"}.get(self.mode, "")

    @property
    def names(self) -> tuple[str, ...]:
        """Of the unknowns: gain, zeros, poles, delay."""
        m, n = self.orders
        zeros = (
            ("1/T_theta2",) if (self.mode, m) == ("short-period", 1) else tuple(f"b{k}" for k in range(m - 1, -1, -1))
        )
        if self.mode == "roll":
            poles: tuple[str, ...] = ("T_R",)
        elif self._suffix:
            poles = (f"zeta_{self._suffix}", f"omega_{self._suffix}")
        else:
            poles = tuple(f"a{k}" for k in range(n - 1, -1, -1))
        return ("K", *zeros, *poles, "tau")

    @property
    def units(self) -> tuple[str, ...]:
        """Of the unknowns."""
        m, n = self.orders
        zeros = [_per_second(m - k) for k in range(m - 1, -1, -1)]
        if self.mode == "roll":
            poles = ["s"]
        elif self._suffix:
            poles = ["1", "rad/s"]
        else:
            poles = [_per_second(n - k) for k in range(n - 1, -1, -1)]
        return ("output/input " + _per_second(n - m), *zeros, *poles, "s")

    @property
    def equation(self) -> str:
        """The transfer function in symbols."""
        m, n = self.orders
        zeros = self.names[1 : 1 + m]
        top = "K" if not m else f"K ({_polynomial(m, zeros)})"
        if self.mode == "roll":
            bottom = "s + 1/T_R"
        elif self._suffix:
            bottom = f"s^2 + 2 zeta_{self._suffix} omega_{self._suffix} s + omega_{self._suffix}^2"
        else:
            bottom = _polynomial(n, self.names[1 + m : 1 + m + n])
        return f"{top} exp(-tau s) / ({bottom})"

    def polynomials(self, x: Array) -> tuple[Array, Array, float]:
        """(numerator, denominator, delay [s]) of unknowns x in the order of `names`."""
        m, _ = self.orders
        numerator = x[0] * np.concatenate([[1.0], x[1 : 1 + m]])
        poles = x[1 + m : -1]
        if self.mode == "roll":
            denominator = np.array([1.0, 1.0 / poles[0]]) if poles[0] else np.array([1.0, np.inf])
        elif self._suffix:
            denominator = np.array([1.0, 2.0 * poles[0] * poles[1], poles[1] ** 2])
        else:
            denominator = np.concatenate([[1.0], poles])
        return numerator, denominator, float(x[-1])

    def from_polynomials(self, numerator: Array, denominator: Array, delay: float) -> Array:
        """Unknowns (n,) of a numerator and a monic denominator."""
        gain = numerator[0] if numerator[0] else 1e-12
        poles = denominator[1:]
        if self.mode == "roll":
            poles = np.array([1.0 / poles[0] if poles[0] > 0.0 else 1.0])
        elif self._suffix:
            omega = float(np.sqrt(abs(poles[1]))) or 1.0
            poles = np.array([poles[0] / (2.0 * omega), omega])
        return np.concatenate([[gain], numerator[1:] / gain, poles, [delay]])

    def response(self, x: Array, omega: Array) -> Complex:
        """(points,) H at omega [rad/s]."""
        numerator, denominator, delay = self.polynomials(x)
        s = 1j * omega
        with np.errstate(all="ignore"):
            ratio = np.polyval(numerator, s) / np.polyval(denominator, s)
        return np.asarray(np.nan_to_num(ratio * np.exp(-s * delay), nan=1e30, posinf=1e30, neginf=-1e30), np.complex128)


def _per_second(power: int) -> str:
    return "1" if power == 0 else "1/s" if power == 1 else f"1/s^{power}"


def _polynomial(order: int, names: tuple[str, ...]) -> str:
    terms = []
    for power, name in zip(range(order, -1, -1), ("", *names), strict=True):
        s = "" if power == 0 else "s" if power == 1 else f"s^{power}"
        terms.append(" ".join(filter(None, (name, s))))
    return " + ".join(terms)


ROLL = TransferForm("roll", (0, 1), "roll")
SECOND_ORDER = ("dutch-roll", "short-period")


def form_for(control: str, output: str, name: str = "auto") -> TransferForm | None:
    """The form of that name, or of orders M/N; for `auto` the classic one of a control and an output, None where there is none.

    Side and normal acceleration follow a surface at once, and roll rate follows the rudder through sideslip: their numerators are
    of second order. Raises EstimationError for an unknown form.
    """
    if name == "auto":
        name = _classic(SURFACE_OF.get(control, control), output)
        if not name:
            return None
    if name == "roll":
        return ROLL
    if name in SECOND_ORDER:
        return TransferForm(name, (2 if output in ("ay", "az", "p") else 1, 2), name)
    top, slash, bottom = name.partition("/")
    if not (slash and top.isdecimal() and bottom.isdecimal() and len(name) <= LONGEST_NAME):
        raise EstimationError(f"form {name!r}: give roll, dutch-roll, short-period, auto, or orders like 1/2")
    m, n = int(top), int(bottom)
    if not 0 <= m <= n or not 1 <= n <= HIGHEST:
        raise EstimationError(
            f"form {name}: the numerator's order may not be above the denominator's, which is 1 to {HIGHEST}"
        )
    return TransferForm(f"{m}/{n}", (m, n))


def general_forms() -> tuple[TransferForm, ...]:
    """The forms that `auto` tries where there is no classic one."""
    return tuple(TransferForm(f"{m}/{n}", (m, n)) for m, n in ((0, 1), (0, 2), (1, 2), (2, 2), (2, 3)))


def _classic(surface: str, output: str) -> str:
    if (surface, output) == ("delta_a", "p"):
        return "roll"
    if surface == "delta_r" and output in ("r", "beta", "ay", "p"):
        return "dutch-roll"
    if surface == "delta_e" and output in ("q", "alpha", "az"):
        return "short-period"
    return ""
