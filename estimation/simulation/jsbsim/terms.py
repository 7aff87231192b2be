"""Sums of products as data: what functions of JSBSim become on their way to our equation text.

A factor is a piece of text that stands by itself (a symbol, a call, a bracket) with a whole power; so that what is divided by
cancels exactly, and a term that is a number times a regressor is seen to be one.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

DIGITS = 15  # significant, of a written number: what sixteen would add is the rounding of unit conversions


@dataclass(frozen=True)
class Product:
    """A number times factors (text -> whole power, none of them zero)."""

    number: float
    factors: Mapping[str, int] = field(default_factory=dict)

    @property
    def key(self) -> frozenset[tuple[str, int]]:
        return frozenset(self.factors.items())

    def times(self, other: "Product") -> "Product":
        factors = dict(self.factors)
        for text, power in other.factors.items():
            factors[text] = factors.get(text, 0) + power
        return Product(self.number * other.number, {t: n for t, n in factors.items() if n})

    def to_power(self, power: int) -> "Product":
        return Product(self.number**power, {t: n * power for t, n in self.factors.items() if n * power})


@dataclass(frozen=True)
class Sum:
    """Products, no two of the same factors, none of them zero."""

    products: tuple[Product, ...] = ()

    @property
    def number(self) -> float | None:
        """The number that it is, None where it is none."""
        if not self.products:
            return 0.0
        return self.products[0].number if len(self.products) == 1 and not self.products[0].factors else None

    @property
    def single(self) -> Product | None:
        """The one product that it is, None where it is none or several."""
        return self.products[0] if len(self.products) == 1 else None

    def plus(self, *others: "Sum") -> "Sum":
        return collected(p for part in (self, *others) for p in part.products)

    def times(self, other: "Sum") -> "Sum":
        """The product; of two long sums one stays in brackets."""
        a, b = (self, other) if len(self.products) <= len(other.products) else (other, self)
        if len(a.products) > 1:
            b = factor(f"({text_of(b)})")
        return collected(p.times(q) for p in a.products for q in b.products)

    def scaled(self, number: float) -> "Sum":
        return collected(Product(p.number * number, p.factors) for p in self.products)

    def inverse(self) -> "Sum":
        """One over it. Raises ZeroDivisionError for nothing."""
        if not self.products:
            raise ZeroDivisionError
        one = self.single
        return Sum((one.to_power(-1),)) if one is not None else Sum((Product(1.0, {f"({text_of(self)})": -1}),))


def collected(products: Iterable[Product]) -> Sum:
    """A sum, equal products taken together and zeros left away."""
    found: dict[frozenset[tuple[str, int]], Product] = {}
    for p in products:
        known = found.get(p.key)
        found[p.key] = p if known is None else Product(known.number + p.number, p.factors)
    return Sum(tuple(p for p in found.values() if p.number != 0.0))


def constant(number: float) -> Sum:
    return Sum((Product(float(number)),)) if number else Sum()


def factor(text: str, number: float = 1.0) -> Sum:
    """A number times one factor."""
    return Sum((Product(number, {text: 1}),))


def number_text(value: float) -> str:
    return repr(float(f"{value:.{DIGITS}g}"))


def text_of(terms: Sum) -> str:
    """Equation text; `0` for nothing."""
    written = "0"
    for i, p in enumerate(terms.products):
        sign = "-" if p.number < 0 else "" if i == 0 else "+"
        body = product_text(Product(abs(p.number), p.factors))
        written = f"{sign}{body}" if i == 0 else f"{written} {sign} {body}"
    return written


def product_text(p: Product) -> str:
    above = [_power(t, n) for t, n in p.factors.items() if n > 0]
    below = [_power(t, -n) for t, n in p.factors.items() if n < 0]
    number = float(f"{p.number:.{DIGITS}g}")
    if number != 1.0 or not above:
        above.insert(0, number_text(number))
    return "*".join(above) + "".join(f"/{t}" for t in below)


def _power(text: str, power: int) -> str:
    return text if power == 1 else f"{text}^{power}"
