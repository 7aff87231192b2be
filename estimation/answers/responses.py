"""`frequency`: the response of an output to an input over frequency, with its error, a fitted transfer function and levels."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from daq.utilities.packages import optional
from daq.utilities.plain_words import comma_separated
from estimation.answers.answer import Answer, Rows, picture_writers, table_writers
from estimation.threads import single_threaded

if TYPE_CHECKING:
    import pandas as pd

    from estimation.frequency.answer import FrequencyResult
    from estimation.frequency.handling import RatedAircraft
    from estimation.resolve import AnyAircraft, Flights, Names
    from groundstation.flight import Flight


@single_threaded
def frequency(
    flights: "Flights",
    input: str,
    output: str,
    *,
    with_: "Names | None" = None,
    fit: bool = False,
    form: str | None = None,
    band: tuple[float, float] | None = None,
    points: int = 60,
    windows: Sequence[float] = (),
    segments: str | None = None,
    kind: str = "",
    category: str = "B",
    aircraft: "AnyAircraft" = None,
) -> "Response":
    """Response of one column to another over one flight or several.

    Args:
        flights: a Flight, a file, or a list of them; raw recordings are calibrated.
        input: the column that was moved: delta_a, cmd_a.
        output: the column that responds: p, r, beta, ay.
        with_: other inputs whose share is removed, by default all other surfaces that moved; () for none.
        fit: also fit a transfer function.
        form: of the fit: roll, dutch-roll, short-period, or orders like 1/2.
        band: frequencies from, to [Hz].
        points: number of frequencies.
        windows: their lengths [s].
        segments: use only these stretches: "1:9,12:20" [s], "mode:FBWA", "V > 12".
        kind: class of a piloted aircraft for handling-quality levels: I to IV.
        category: of the flight phase for handling-quality levels: A, B or C.
        aircraft: its mass decides whether levels apply.

    Raises:
        UserError: the input did not move, a column is missing or the flights are too short.

    Example::

        answer = ss.frequency("sweep.mcap", "delta_a", "p", fit=True)
        print(answer.summary())
    """
    from estimation.frequency.answer import frequency_answer
    from estimation.frequency.forms import form_for
    from estimation.frequency.handling import RatedAircraft
    from estimation.frequency.response import ResponseOptions, frequency_response
    from estimation.resolve import read_flights

    form_name = form or ("auto" if fit else None)
    if form_name is not None:
        form_for(input, output, form_name)  # refuses a mistyped form before a flight is read
    rated = RatedAircraft(kind, category)  # refuses a mistyped class likewise
    other_inputs = None if with_ is None else tuple(n for n in comma_separated(with_) if n != "none")
    options = ResponseOptions(other_inputs, band, points, tuple(windows))
    selected = read_flights(flights, segments)
    rated = _with_mass(rated, selected, aircraft)
    response = frequency_response(selected, input, output, options)
    return Response(frequency_answer(response, form_name, rated), tuple(selected))


def _with_mass(rated: "RatedAircraft", flights: "Sequence[Flight]", aircraft: "AnyAircraft") -> "RatedAircraft":
    """The rated aircraft with its mass where that is known. Raises AircraftError where a given aircraft is not found."""
    from estimation.aircraft.library import aircraft_of
    from estimation.errors import AircraftError

    try:
        return replace(rated, mass=aircraft_of(flights, aircraft).mass)
    except AircraftError:
        if aircraft is not None:
            raise
        return rated  # the response itself needs no aircraft


@dataclass(frozen=True, repr=False)
class Response(Answer):
    """The answer of `frequency`. `answer.response` has the arrays: omega, H, magnitude, phase, std, std_phase, coherence."""

    answer: "FrequencyResult"
    flights: "tuple[Flight, ...]"

    def fit(self, form: str = "auto", kind: str = "", category: str = "B", mass: float | None = None) -> "Response":
        """The answer with a transfer function of `form` (roll, dutch-roll, short-period, orders like 1/2) and its levels.

        kind: class I to IV of a piloted aircraft, for levels; category: of the flight phase; mass [kg]: by default that of the
        aircraft where it is known.
        """
        from estimation.frequency.answer import frequency_answer
        from estimation.frequency.handling import RatedAircraft

        rated = RatedAircraft(kind, category, self.answer.aircraft.mass if mass is None else mass)
        return replace(self, answer=frequency_answer(self.answer.response, form, rated))

    def to_json(self) -> dict[str, Any]:
        return self.answer.to_json()

    def to_pandas(self) -> "pd.DataFrame":
        """A row for each frequency [rad/s]; phase in rad."""
        pd = optional("pandas", "a table of pandas")

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

    def lines(self) -> Iterator[str]:
        """The lines that `sideslip frequency` prints."""
        from estimation.frequency.answer import response_lines

        return response_lines(self.answer)

    def plot(self, ax: Any = None) -> Any:
        """Draw magnitude [dB], phase [deg] and coherence over frequency; returns the three axes."""
        from matplotlib import pyplot as plt

        from estimation.frequency.figure import draw_on

        if ax is None:
            _, ax = plt.subplots(3, 1, sharex=True, figsize=(7.0, 7.0), height_ratios=(3, 3, 1.6), layout="constrained")
        draw_on(ax, self.answer.response, self.answer.fit)
        return ax

    def report(self, folder: str | Path) -> Path:
        """Write the HTML page; returns its path."""
        from estimation.frequency.answer import write_frequency_report

        return write_frequency_report(self.answer, self.flights, Path(folder))

    def writers(self) -> Mapping[str, Callable[[Path], Any]]:
        """Everything as .json, the table as .csv, the Bode figure as a picture."""
        from estimation.frequency.figure import write_figure

        pictures = picture_writers(lambda path: write_figure(self.answer.response, self.answer.fit, path))
        return {**super().writers(), **table_writers(self), **pictures}

    def headline(self) -> str:
        r = self.answer.response
        fit = "" if self.answer.fit is None else f", fit {self.answer.fit.form.name}"
        return (
            f"Response of {r.output} to {r.input}: {r.omega.size} frequencies, {r.omega[0]:.3g} to "
            f"{r.omega[-1]:.3g} rad/s{fit}"
        )

    def rows(self) -> Rows:
        """A row for each parameter of the fit; without a fit, for each frequency."""
        if self.answer.fit is not None:
            fitted = self.answer.fit.parameters.items()
            return ("parameter", "estimate", "bound", "unit"), [
                (n, f"{p.estimate:.4g}", f"{p.std:.2g}", p.unit) for n, p in fitted
            ]
        r = self.answer.response
        numbers = zip(r.omega, r.magnitude, r.std, r.coherence, strict=True)
        return ("rad/s", "magnitude", "+-", "coherence"), [
            (f"{w:.3g}", f"{m:.4g}", f"{s:.2g}", f"{c:.2f}") for w, m, s, c in numbers
        ]
