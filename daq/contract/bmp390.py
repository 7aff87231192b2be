"""The pressure chip's own compensation, of single readings on board and of whole recordings on the ground."""

from dataclasses import dataclass
from typing import Any, Protocol, Self, TypeVar

from daq.contract.constants import ZERO_CELSIUS


class Arithmetic(Protocol):
    """A number, or an array of them."""

    def __add__(self, other: Any, /) -> Self: ...
    def __radd__(self, other: Any, /) -> Self: ...
    def __sub__(self, other: Any, /) -> Self: ...
    def __mul__(self, other: Any, /) -> Self: ...
    def __rmul__(self, other: Any, /) -> Self: ...


Number = TypeVar("Number", bound=Arithmetic)

NVM_BYTES = 21


@dataclass(frozen=True)
class Bmp390Trimming:
    """Compensation coefficients of one BMP390, from its 21 bytes of non-volatile memory at register 0x31.

    Layout and floating-point formulas: Bosch BST-BMP390-DS002, sections 3.11.1 and 8.4 to 8.6.
    """

    t1: float
    t2: float
    t3: float
    p: tuple[float, float, float, float, float, float, float, float, float, float, float]

    @classmethod
    def from_nvm(cls, nvm: bytes) -> Self:
        """Coefficients from the 21 bytes read at 0x31. Raises ValueError when they are not 21 or blank."""
        if len(nvm) != NVM_BYTES or nvm in (bytes(NVM_BYTES), b"\xff" * NVM_BYTES):
            raise ValueError(
                f"{len(nvm)} bytes of BMP390 coefficients ({nvm.hex() or 'none'}): {NVM_BYTES} that are not blank are needed"
            )

        def unsigned(at: int) -> int:
            return int.from_bytes(nvm[at : at + 2], "little")

        def signed(at: int, size: int = 1) -> int:
            return int.from_bytes(nvm[at : at + size], "little", signed=True)

        return cls(
            t1=unsigned(0) * 2.0**8,
            t2=unsigned(2) / 2.0**30,
            t3=signed(4) / 2.0**48,
            p=(
                (signed(5, 2) - 2**14) / 2.0**20,
                (signed(7, 2) - 2**14) / 2.0**29,
                signed(9) / 2.0**32,
                signed(10) / 2.0**37,
                unsigned(11) * 2.0**3,
                unsigned(13) / 2.0**6,
                signed(15) / 2.0**8,
                signed(16) / 2.0**15,
                signed(17, 2) / 2.0**48,
                signed(19) / 2.0**48,
                signed(20) / 2.0**65,
            ),
        )

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
