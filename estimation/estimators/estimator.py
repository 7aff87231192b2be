"""What an estimator is: a record with a name, a title, a fit, and the extras that it heeds; and the task it is given."""

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
    """What may be asked of an estimator beyond its estimates; the value is the option that asks for it."""

    PROFILE = "--profile"
    BOOTSTRAP = "--bootstrap"
    SEED = "--seed"
    STEPWISE = "--stepwise"
    RAW_INPUTS = "--raw-inputs"
    KEEP_HELD = "--keep-held"


@dataclass(frozen=True)
class Extras:
    """Extras as they were asked for. profile: parameters; bootstrap: replicates (0: as usual for the estimator); seed: of its
    noise, and of networks. raw_inputs: take measured inputs with their noise. stepwise: choose terms by partial F.
    keep_held: take repeated values of slow and stuck sensors for measurements."""

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

    number: of the fit in its session, so that each draws noise of its own. tell: told each long piece of work as it begins.
    plain: the same model without terms that were added to it, for estimators that have no way for those. memory: flights that
    have been prepared already, each of a name of its own.
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
        """The task with its plain model where the estimator has no way for the whole one; itself otherwise."""
        if self.plain is None or not estimator.refuses(self.model) or estimator.refuses(self.plain):
            return self
        return replace(self, model=self.plain)

    @property
    def data(self) -> "list[FlightData]":
        """The flights prepared for the model, in the usual way or another that was asked for."""
        return self._prepared(feedback=True)

    @property
    def smooth(self) -> "list[FlightData]":
        """The same for a regression, which takes controls without any noise."""
        return self._prepared(feedback=False)

    def _prepared(self, feedback: bool) -> "list[FlightData]":
        """Each flight, once for all methods and fits of a session that see the same signals in it."""
        from estimation.prepare.flight_data import Preparation
        from estimation.prepare.pipeline import prepare

        way = Preparation(denoise=not self.extras.raw_inputs, keep_held=self.extras.keep_held, feedback=feedback)
        flights = []
        for flight in self.flights:
            key = (flight.name, self.model.states, self.model.inputs, self.model.outputs, way)
            if key not in self.memory:
                self.memory[key] = prepare(self.model, flight, way)
            flights.append(self.memory[key])
        return flights

    @property
    def repaired(self) -> "Sequence[Flight]":
        """The flights for a method that reads their columns itself, without wild values and repeats."""
        from estimation.prepare.conditioned import repair_columns

        columns = [s.source for s in (*self.model.inputs, *self.model.outputs, *self.model.states)]
        return [repair_columns(f, columns, keep_held=self.extras.keep_held).flight for f in self.flights]


@dataclass(frozen=True)
class Look:
    """How figures draw an estimator: a colour and a marker as matplotlib names them."""

    colour: str
    marker: str


@dataclass(frozen=True)
class Estimator:
    """A way to find the parameters of a model.

    name: as `--method` and the JSON have it; title: in progress and reports. fit: raises EstimationError where model or
    flights cannot be used; a fit that fails is a Result whose status says so. supports: the extras that `fit` heeds.
    fit_each: each flight of the task by itself, given only where that is cheaper than one after the other. rank: place in
    lists. look: in figures; one is chosen where none is given. needs_aircraft: takes geometry and mass from the aircraft itself.
    refuses: a sentence on a model that it has no way for, empty for others: what can be said before any flight is there.
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
