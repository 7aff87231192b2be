"""The pressure chip's own compensation, of single readings on board and of whole recordings on the ground."""

from dataclasses import dataclass
from struct import Struct
from typing import Any, Self, TypeVar

from daq.utilities.constants import ZERO_CELSIUS

Number = TypeVar("Number", bound=Any)
"""A number, or an array of them."""

NVM_BYTES = 21
_NVM = Struct("<HHbhhbbHHbbhbb")  # T1 to T3, P1 to P11
_PRESSURE_POWERS = (20, 29, 32, 37, -3, 6, 8, 15, 48, 48, 65)  # of two, that P1 to P11 are divided by


@dataclass(frozen=True)
class Bmp390Trimming:
    """Compensation coefficients of one BMP390, from its 21 bytes of non-volatile memory at register 0x31.

    Layout and floating-point formulas: Bosch BST-BMP390-DS002, sections 3.11.1 and 8.4 to 8.6.
    """

    t1: float
    t2: float
    t3: float
    p: tuple[float, ...]  # p1 to p11

    @classmethod
    def from_nvm(cls, nvm: bytes) -> Self:
        """Coefficients from the 21 bytes read at 0x31. Raises ValueError when they are not 21 or blank."""
        if len(nvm) != NVM_BYTES or nvm in (bytes(NVM_BYTES), b"\xff" * NVM_BYTES):
            raise ValueError(
                f"{len(nvm)} bytes of BMP390 coefficients ({nvm.hex() or 'none'}): {NVM_BYTES} that are not blank are needed"
            )

        t1, t2, t3, *p = _NVM.unpack(nvm)
        p[0], p[1] = p[0] - 2**14, p[1] - 2**14
        scaled = (value / 2.0**power for value, power in zip(p, _PRESSURE_POWERS, strict=True))
        return cls(t1 * 2.0**8, t2 / 2.0**30, t3 / 2.0**48, tuple(scaled))

    def compensate(self, raw_pressure: Number, raw_temperature: Number) -> tuple[Number, Number]:
        """Pressure [Pa] and temperature [K] from the uncompensated 24-bit readings, single ones or (N,) each."""
        d1 = raw_temperature - self.t1
        t = d1 * self.t2 + d1 * d1 * self.t3  # degrees Celsius
        p1, p2, p3, p4, p5, p6, p7, p8, p9, p10, p11 = self.p
        u = raw_pressure
        offset = p5 + t * (p6 + t * (p7 + t * p8))
        sensitivity = u * (p1 + t * (p2 + t * (p3 + t * p4)))
        curvature = u * u * (p9 + p10 * t) + u * u * u * p11
        return offset + sensitivity + curvature, t + ZERO_CELSIUS
