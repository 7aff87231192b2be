"""From a plan to pieces of work: the keys of every flight, duplicate flights, and the work that is still to be done."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from daq.utilities.errors import UserError
from estimation.aircraft import Aircraft, built_in_aircraft, load_aircraft, unknown_aircraft
from estimation.campaign.keys import digest_of_files, digest_of_own_code, key_of, seed_of, versions
from estimation.campaign.plan import CampaignPlan
from estimation.campaign.schema import VERSION
from estimation.campaign.sources import CampaignFlight
from estimation.campaign.tasks import CampaignError, Subject, Work
from estimation.campaign.workers.subjects import CHECK, aircraft_from_text, model_of
from estimation.estimators.estimator import Extra
from estimation.estimators.registry import find_estimator

ENVELOPE_METHOD = "ml"
"""The method that fits a model over the envelope: flights held out are judged by a likelihood."""
LONGEST_CLOCK = 1e9  # s; timers of Python overflow at 9e9


@dataclass(frozen=True)
class Planned:
    """One flight: its entry in the plan, and the work that makes its results."""

    entry: CampaignFlight
    work: Work


@dataclass(frozen=True)
class WorkList:
    """planned: flights with their work. unreadable: entries whose bytes cannot be read. duplicates: (entry, earlier entry with
    the same work)."""

    planned: Sequence[Planned]
    unreadable: Sequence[CampaignFlight]
    duplicates: Sequence[tuple[CampaignFlight, CampaignFlight]]

    @property
    def by_key(self) -> Mapping[str, Planned]:
        """Key of a piece of work -> its flight."""
        return {key: p for p in self.planned for key in p.work.pieces.values()}


def work_list(plan: CampaignPlan, entries: Iterable[CampaignFlight], folder: Path) -> WorkList:
    """The work of all flights. Raises UserError for a model, method or aircraft that cannot be used."""
    subjects = _Subjects(plan, folder)
    planned: list[Planned] = []
    unreadable: list[CampaignFlight] = []
    duplicates: list[tuple[CampaignFlight, CampaignFlight]] = []
    first: dict[str, CampaignFlight] = {}
    for entry in entries:
        if entry.source is None:
            subjects.aircraft_text(entry)  # a wrong name of an aircraft is refused even where the flight is missing
            unreadable.append(entry)
            continue
        work = _flight_work(plan, subjects.subject_of(entry))
        if work.identity in first:
            duplicates.append((entry, first[work.identity]))
            continue
        first[work.identity] = entry
        planned.append(Planned(entry, work))
    return WorkList(planned, unreadable, duplicates)


class _Subjects:
    """Subjects of a plan; model and aircraft files are read once."""

    def __init__(self, plan: CampaignPlan, folder: Path) -> None:
        self._plan, self._folder = plan, folder
        self._aircraft: dict[str, str] = {}
        self._model_checked = False
        self._text = self._model_text()

    def subject_of(self, entry: CampaignFlight) -> Subject:
        """The flight with its model and aircraft."""
        if entry.source is None:
            raise ValueError(f"{entry.location} has no source")
        c = entry.conditions
        stem = Path(self._name_of(entry)).stem
        text = self.aircraft_text(entry)
        subject = Subject(entry.source, self._plan.model, self._text, stem, text, c.mass, c.segments)
        self._check_methods(subject)
        return subject

    def _check_methods(self, subject: Subject) -> None:
        """CampaignError for a model that a method cannot estimate; a built-in model is built for the first aircraft named."""
        if self._model_checked or not (subject.model_text or subject.aircraft_text):
            return
        self._model_checked = True
        aircraft = aircraft_from_text(subject.aircraft_text, subject.aircraft) if subject.aircraft_text else None
        try:
            model = model_of(subject, aircraft or unknown_aircraft("not stated"))
        except UserError:  # this aircraft lacks something: its flights fail with that reason, those of others need not
            return
        for method in self._plan.methods:
            if problem := find_estimator(method).refuses(model):
                raise CampaignError(f"plan, methods: {problem}")

    def _name_of(self, entry: CampaignFlight) -> str:
        return entry.conditions.aircraft or self._plan.aircraft

    def aircraft_text(self, entry: CampaignFlight) -> str:
        """TOML of the aircraft that the plan names for a flight, empty for none; UserError where it cannot be had."""
        name = self._name_of(entry)
        if name and name not in self._aircraft:
            self._aircraft[name] = self._load(name).text
        return self._aircraft[name] if name else ""

    def _load(self, name: str) -> Aircraft:
        """A built-in aircraft by name, or one by its file; paths are relative to the plan."""
        return load_aircraft(name if name in built_in_aircraft() else str(self._folder / name))

    def _model_text(self) -> str:
        """TOML of a user's model; empty for a built-in one, which each flight builds for its own aircraft."""
        from estimation.models import load_model
        from estimation.models.library import BUILDERS
        from estimation.models.load import asks_for_aircraft, model_text

        model_name = self._plan.model
        if model_name in BUILDERS:
            return ""
        if model_name.endswith(".toml"):
            return model_text(load_model(self._folder / model_name))
        aircraft = self._plan.aircraft
        if asks_for_aircraft(model_name) and not aircraft:
            raise CampaignError(f"model {model_name} takes constants of an aircraft: say of which with --aircraft")
        if not aircraft:
            return model_text(load_model(model_name))
        return model_text(load_model(model_name, self._load(aircraft)))


def _flight_work(plan: CampaignPlan, subject: Subject) -> Work:
    quality = plan.check != "none"
    data = [VERSION, subject.source.sha256, subject.segments, plan.each_segment, quality, dict(versions())]
    model = [subject.model_text or subject.model, subject.aircraft_text, subject.mass]
    pieces, seeds = {}, {}
    for method in dict.fromkeys(plan.methods):
        estimator = find_estimator(method)
        supported, own_code = estimator.supports, digest_of_own_code(estimator)
        replicates = plan.bootstrap if Extra.BOOTSTRAP in supported else 0
        seeds[method] = seed_of(plan.seed, subject.source.sha256, method) if Extra.SEED in supported else 0
        content = [data, model, method, replicates, seeds[method], *([own_code] if own_code else [])]
        pieces[method] = key_of("flight", *content)
    if plan.check == "full":
        pieces[CHECK] = key_of("check", data)
    return Work(
        "flight",
        subject.source.name,
        pieces,
        (subject,),
        versions(),
        quality,
        plan.bootstrap,
        seeds,
        each_segment=plan.each_segment,
        limit_s=plan.time_limit,
    )


def unfinished(works: Iterable[Work], done: set[str]) -> Iterator[Work]:
    """The work without pieces whose keys are in `done`; none where all are."""
    for work in works:
        pieces = {piece: key for piece, key in work.pieces.items() if key not in done}
        if pieces:
            yield replace(work, pieces=pieces)


# ------------------------------------------------------------------------------------------------ groups


@dataclass(frozen=True)
class Member:
    """One flight of a group with its usable estimates: method -> parameter -> (value, variance)."""

    planned: Planned
    estimates: Mapping[str, Mapping[str, tuple[float, float]]]


def joint_work(plan: CampaignPlan, label: str, members: Sequence[Member]) -> Work | None:
    """All flights of a group in one fit by each method that has usable estimates of at least two; None for no such method."""
    pieces, seeds = {}, {}
    for method in plan.methods:
        flight_keys = sorted(m.planned.work.pieces[method] for m in members if method in m.estimates)
        if len(flight_keys) > 1:
            pieces[method] = key_of("joint", flight_keys)
            seeds[method] = seed_of(plan.seed, "joint", flight_keys)
    if not pieces:
        return None
    joint_members = [m for m in members if all(p in m.estimates for p in pieces)]
    work = _group_work(plan, "joint", f"joint fit of {label}", label, pieces, joint_members)
    return replace(work, bootstrap=plan.bootstrap, seeds=seeds)


def _in_order(members: Sequence[Member]) -> list[Member]:
    """Flights in the order of their content: no number depends on the order of the plan, or on versions, which are in the
    keys."""
    return sorted(members, key=lambda m: (m.planned.work.subjects[0].source.sha256, m.planned.work.identity))


def _group_work(
    plan: CampaignPlan, kind: str, name: str, label: str, pieces: Mapping[str, str], members: Sequence[Member]
) -> Work:
    """Work on several flights. Its time limit is the sum of theirs."""
    ordered = _in_order(members)
    subjects = tuple(m.planned.work.subjects[0] for m in ordered)
    limit = min(plan.time_limit * len(subjects), LONGEST_CLOCK)
    segments = plan.each_segment
    return Work(kind, name, pieces, subjects, versions(), False, each_segment=segments, limit_s=limit, group=label)


def envelope_work(plan: CampaignPlan, label: str, members: Sequence[Member]) -> Work | None:
    """All flights of a group with a usable estimate in one model over the envelope; None for too few of them."""
    from estimation.campaign.aerodynamics.joint import FEWEST

    if len(members) < FEWEST:
        return None
    code = digest_of_files(("estimation/campaign/aerodynamics",))
    pieces = {ENVELOPE_METHOD: key_of("envelope", code, sorted(m.planned.work.identity for m in members))}
    return _group_work(plan, "envelope", f"model over the envelope of {label}", label, pieces, members)


def match_works(plan: CampaignPlan, label: str, members: Sequence[Member]) -> Iterator[Work]:
    """Each flight predicted with the weighted means of the others' estimates."""
    ordered = _in_order(members)
    sums = {
        method: _WeightedSums(m.estimates[method] for m in ordered if method in m.estimates) for method in plan.methods
    }
    for member in ordered:
        values = {
            method: sums[method].without(estimates)
            for method, estimates in member.estimates.items()
            if sums[method].flights > 1
        }
        if values:
            pieces = {m: key_of("match", member.planned.work.pieces[m], v) for m, v in values.items()}
            yield Work(
                "match",
                member.planned.entry.name,
                pieces,
                member.planned.work.subjects,
                versions(),
                values=values,
                limit_s=plan.time_limit,
                group=label,
            )


class _WeightedSums:
    """Sums of each parameter over flights, weighted by inverse variance, from which one flight can be subtracted."""

    def __init__(self, tables: Iterable[Mapping[str, tuple[float, float]]]) -> None:
        self.flights = 0
        self._sums: dict[str, tuple[float, float, int]] = {}
        for table in tables:
            self.flights += 1
            for name, (value, variance) in table.items():
                weighted_sum, weight, count = self._sums.get(name, (0.0, 0.0, 0))
                self._sums[name] = (weighted_sum + value / variance, weight + 1.0 / variance, count + 1)

    def without(self, flight: Mapping[str, tuple[float, float]]) -> dict[str, float]:
        """Weighted means over all flights but this one, of the parameters that another flight has."""
        means = {}
        for name, (weighted_sum, weight, count) in self._sums.items():
            value, variance = flight.get(name, (0.0, math.inf))
            if count > (name in flight):
                means[name] = (weighted_sum - value / variance) / (weight - 1.0 / variance)
        return means
