"""The record that describes an estimator, the task that its fit gets, and the extras that it may support."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import TYPE_CHECKING

from estimation.aircraft import Aircraft
from estimation.models.base import Model

if TYPE_CHECKING:
    from estimation.estimators.result import Result
    from estimation.prepare.flight_data import FlightData
    from groundstation.flight import Flight


class Extra(Enum):
    """A request beyond the estimates; the value is its option on the command line."""

    PROFILE = "--profile"
    BOOTSTRAP = "--bootstrap"
    SEED = "--seed"
    STEPWISE = "--stepwise"
    RAW_INPUTS = "--raw-inputs"
    KEEP_HELD = "--keep-held"


@dataclass(frozen=True)
class Extras:
    """The requested extras. profile: parameters; bootstrap: replicates (0: the estimator's default); seed: of its random numbers
    and networks; raw_inputs: measured inputs are not de-noised; stepwise: terms are selected by partial F; keep_held: repeated
    values of slow and stuck sensors count as measurements."""

    profile: tuple[str, ...] = ()
    bootstrap: int = 0
    seed: int = 0
    raw_inputs: bool = False
    stepwise: bool = False
    keep_held: bool = False

    @property
    def asked(self) -> tuple[Extra, ...]:
        """Those that differ from their default."""
        return tuple(extra for extra in Extra if getattr(self, extra.name.lower()))


NO_EXTRAS = Extras()


@dataclass(frozen=True)
class Task:
    """One fit: `model` to one flight, or to several together. device: where networks are trained (cpu, cuda or auto).

    number: of the fit in its session, so that each has its own random numbers. tell: called with the name of each long piece of
    work when it begins. plain: the model without added terms, for estimators that cannot use these. memory: prepared flights of
    the session, whose flights have unique names.
    """

    model: Model
    flights: "Sequence[Flight]"
    aircraft: Aircraft
    extras: Extras = NO_EXTRAS
    device: str = "cpu"
    number: int = 0
    tell: Callable[[str], None] = lambda text: None
    plain: Model | None = None
    memory: "dict[object, FlightData]" = field(default_factory=dict, compare=False, repr=False)

    def for_estimator(self, estimator: "Estimator") -> "Task":
        """The task, with its plain model where the estimator refuses the full model but not the plain one."""
        if self.plain is None or not estimator.refuses(self.model) or estimator.refuses(self.plain):
            return self
        return replace(self, model=self.plain)

    @property
    def data(self) -> "list[FlightData]":
        """The flights prepared for the model, as the extras say."""
        return self._prepared(feedback=True)

    @property
    def smooth(self) -> "list[FlightData]":
        """The flights prepared for a regression, whose controls are de-noised throughout."""
        return self._prepared(feedback=False)

    def _prepared(self, feedback: bool) -> "list[FlightData]":
        """The prepared flights; methods and fits of a session that use the same signals share them."""
        from estimation.prepare.flight_data import Preparation
        from estimation.prepare.pipeline import prepare

        preparation = Preparation(
            denoise=not self.extras.raw_inputs, keep_held=self.extras.keep_held, feedback=feedback
        )
        flights = []
        for flight in self.flights:
            key = (flight.name, self.model.states, self.model.inputs, self.model.outputs, preparation)
            if key not in self.memory:
                self.memory[key] = prepare(self.model, flight, preparation)
            flights.append(self.memory[key])
        return flights

    @property
    def repaired(self) -> "Sequence[Flight]":
        """The flights, without wild values and repeats, for a method that reads their columns itself."""
        from estimation.prepare.conditioned import repair_columns

        columns = [s.source for s in (*self.model.inputs, *self.model.outputs, *self.model.states)]
        return [repair_columns(f, columns, keep_held=self.extras.keep_held).flight for f in self.flights]


@dataclass(frozen=True)
class Look:
    """Colour and marker of an estimator in figures, as matplotlib names them."""

    colour: str
    marker: str


@dataclass(frozen=True)
class Estimator:
    """A way to find the parameters of a model.

    name: in `--method` and JSON; title: in progress and reports. fit: raises EstimationError where model or flights cannot be
    used; a fit that fails is a Result whose status says so. supports: the extras that `fit` uses. fit_each: fits each flight of
    the task by itself; only where that is cheaper than one call of `fit` for each. rank: place in lists. look: in figures, by
    default chosen for it. needs_aircraft: takes geometry and mass from the aircraft, not from the model. refuses: why it cannot
    use a model, as far as that is known without a flight; empty where it can.
    """

    name: str
    title: str
    fit: "Callable[[Task], Result]"
    supports: frozenset[Extra] = frozenset()
    fit_each: "Callable[[Task], list[Result]] | None" = None
    rank: int = 100
    look: Look | None = None
    needs_aircraft: bool = False
    refuses: Callable[[Model], str] = lambda model: ""
