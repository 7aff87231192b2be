"""Frequency responses in a notebook: what `sideslip frequency` does, with the same numbers."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sideslip.api import read_flights

if TYPE_CHECKING:
    import pandas as pd

    from estimation.frequency.answer import Answer
    from groundstation.flight import Flight
    from sideslip.api import Flights


def frequency_response(
    flights: "Flights",
    input: str,
    output: str,
    *,
    with_: Sequence[str] | None = None,
    band: tuple[float, float] | None = None,
    points: int = 60,
    windows: Sequence[float] = (),
) -> "Response":
    """Response of column `output` to column `input` over one flight or several.

    `with_`: other inputs whose share is taken off, by default all other surfaces that moved, () for none. band: [Hz].
    windows: lengths [s]. Raises a UserError where the input did not move, a column is missing or the flights are too
    short.
    """
    from estimation.frequency.answer import Answer
    from estimation.frequency.response import ResponseOptions
    from estimation.frequency.response import frequency_response as responded
    from estimation.session.flights import unique_names

    read = unique_names(read_flights(flights))
    options = ResponseOptions(None if with_ is None else tuple(with_), band, points, tuple(windows))
    return Response(Answer(responded(read, input, output, options)), tuple(read))


@dataclass(frozen=True, repr=False)
class Response:
    """What `frequency_response` found. `answer.response` has the arrays: omega, H, magnitude, phase, std, std_phase,
    coherence."""

    answer: "Answer"
    flights: "tuple[Flight, ...]"

    def fit(self, form: str = "auto", kind: str = "", category: str = "B", mass: float = float("nan")) -> "Response":
        """The same with a transfer function of `form` (roll, dutch-roll, short-period, orders like 1/2) and what it says.

        kind: class I to IV of a piloted aircraft, for levels; category: of the flight phase; mass: kg, where it is known.
        """
        from estimation.frequency.answer import answer
        from estimation.frequency.handling import Craft

        return replace(self, answer=answer(self.answer.response, form, Craft(kind, category, mass)))

    def to_pandas(self) -> "pd.DataFrame":
        """A row for each frequency [rad/s]; phase in rad."""
        import pandas as pd

        r = self.answer.response
        return pd.DataFrame(
            {
                "frequency": r.omega,
                "magnitude": r.magnitude,
                "phase": r.phase,
                "coherence": r.coherence,
                "std_magnitude": r.std,
                "std_phase": r.std_phase,
            }
        )

    def summary(self) -> str:
        """What `sideslip frequency` prints."""
        from estimation.frequency.answer import lines

        return "\n".join(lines(self.answer))

    def plot(self, axes: Any = None) -> Any:
        """Magnitude [dB], phase [deg] and coherence over frequency; gives the three axes."""
        from matplotlib import pyplot as plt

        from estimation.frequency.figure import draw_on

        if axes is None:
            _, axes = plt.subplots(
                3, 1, sharex=True, figsize=(7.0, 7.0), height_ratios=(3, 3, 1.6), layout="constrained"
            )
        draw_on(axes, self.answer.response, self.answer.fit)
        return axes

    def report(self, folder: str | Path) -> Path:
        """Write the HTML page; gives its path."""
        from estimation.frequency.page import write_frequency_report

        return write_frequency_report(self.answer, self.flights, Path(folder))

    def save(self, path: str | Path) -> Path:
        """Write .json, or the figure as .png, .svg or .pdf."""
        path = Path(path)
        if path.suffix == ".json":
            from daq.contract.outputs import write_json

            write_json(self.answer.to_json(), path)
        else:
            from estimation.frequency.figure import write_figure

            write_figure(self.answer.response, self.answer.fit, path)
        return path

    def __repr__(self) -> str:
        r = self.answer.response
        fit = "" if self.answer.fit is None else f", fit {self.answer.fit.form.name}"
        return (
            f"<Response of {r.output} to {r.input}: {r.omega.size} frequencies, {r.omega[0]:.3g} to "
            f"{r.omega[-1]:.3g} rad/s{fit}>"
        )
