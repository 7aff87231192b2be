"""From a plan to pieces of work: every flight with its keys, flights that are one and the same, and what is left to do."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from daq.utilities.errors import UserError
from estimation.aircraft import built_in_aircraft, load_aircraft, unknown_aircraft
from estimation.campaign.keys import digest_of_files, key_of, seed_of, versions
from estimation.campaign.plan import CampaignPlan
from estimation.campaign.schema import VERSION
from estimation.campaign.sources import CampaignFlight
from estimation.campaign.tasks import CampaignError, Subject, Work
from estimation.campaign.workers.subjects import CHECK, aircraft_from_text, model_of
from estimation.estimators.estimator import Extra
from estimation.estimators.registry import find_estimator

ENVELOPE_METHOD = "ml"
"""The method that a model over the envelope is fitted by: flights held out are judged by a likelihood."""
LONGEST_CLOCK = 1e9  # s; timers of Python end at 9e9


@dataclass(frozen=True)
class Planned:
    """One flight to be worked on: what the plan says of it, and the work that makes its results."""

    entry: CampaignFlight
    work: Work


@dataclass(frozen=True)
class WorkList:
    """Flights with their work; entries whose bytes cannot be had; (entry, flight that is the same) twice."""

    planned: Sequence[Planned]
    unreadable: Sequence[CampaignFlight]
    duplicates: Sequence[tuple[CampaignFlight, CampaignFlight]]

    @property
    def by_key(self) -> Mapping[str, Planned]:
        """The flight whose work each key is of."""
        return {key: p for p in self.planned for key in p.work.pieces.values()}


def work_list(plan: CampaignPlan, entries: Iterable[CampaignFlight], folder: Path) -> WorkList:
    """Keys for all flights. Raises UserError, before any work, for a model, method or aircraft that cannot be used."""
    subjects = _Subjects(plan, folder)
    planned: list[Planned] = []
    unreadable: list[CampaignFlight] = []
    duplicates: list[tuple[CampaignFlight, CampaignFlight]] = []
    first: dict[str, CampaignFlight] = {}
    for entry in entries:
        if entry.source is None:
            subjects.aircraft_text(entry)  # a wrong name is refused whether or not the flight is there
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
        self._judged = False
        self._text = self._model_text()

    def subject_of(self, entry: CampaignFlight) -> Subject:
        """The flight with its model and aircraft."""
        if entry.source is None:
            raise ValueError(f"{entry.location} has no source")
        c = entry.conditions
        stem = Path(self._name_of(entry)).stem
        text = self.aircraft_text(entry)
        subject = Subject(entry.source, self._plan.model, self._text, stem, text, c.mass, c.segments)
        self._judge(subject)
        return subject

    def _judge(self, subject: Subject) -> None:
        """CampaignError for a model that a method has no way for; a built-in one is seen with the first aircraft named."""
        if self._judged or not (subject.model_text or subject.aircraft_text):
            return
        self._judged = True
        craft = aircraft_from_text(subject.aircraft_text, subject.aircraft) if subject.aircraft_text else None
        try:
            model = model_of(subject, craft or unknown_aircraft("not stated"))
        except UserError:  # this aircraft lacks something: its flights will say so, those of others can do without
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
            location = name if name in built_in_aircraft() else str(self._folder / name)
            self._aircraft[name] = load_aircraft(location).text
        return self._aircraft[name] if name else ""

    def _model_text(self) -> str:
        """TOML of a model of one's own; empty for a built-in one, which takes each flight's aircraft."""
        from estimation.models import load_model
        from estimation.models.library import BUILDERS
        from estimation.models.load import asks_for_aircraft, model_text

        model_name = self._plan.model
        if model_name in BUILDERS:
            return ""
        if model_name.endswith(".toml"):
            return model_text(load_model(self._folder / model_name))
        craft = self._plan.aircraft
        if asks_for_aircraft(model_name) and not craft:
            raise CampaignError(f"model {model_name} takes constants of an aircraft: say of which with --aircraft")
        if not craft:
            return model_text(load_model(model_name))
        location = craft if craft in built_in_aircraft() else str(self._folder / craft)
        return model_text(load_model(model_name, load_aircraft(location)))


def _flight_work(plan: CampaignPlan, subject: Subject) -> Work:
    quality = plan.check != "none"
    data = [VERSION, subject.source.sha256, subject.segments, plan.each_segment, quality, dict(versions())]
    model = [subject.model_text or subject.model, subject.aircraft_text, subject.mass]
    pieces, seeds = {}, {}
    for method in dict.fromkeys(plan.methods):
        able = find_estimator(method).supports
        replicates = plan.bootstrap if Extra.BOOTSTRAP in able else 0
        seeds[method] = seed_of(plan.seed, subject.source.sha256, method) if Extra.SEED in able else 0
        pieces[method] = key_of("flight", data, model, method, replicates, seeds[method])
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


def left_to_do(works: Iterable[Work], done: set[str]) -> Iterator[Work]:
    """Work reduced to the pieces whose keys are not there."""
    for work in works:
        pieces = {piece: key for piece, key in work.pieces.items() if key not in done}
        if pieces:
            yield replace(work, pieces=pieces)


# ------------------------------------------------------------------------------------------------ groups


@dataclass(frozen=True)
class Member:
    """One flight of a group with the estimates that others are predicted by: method -> parameter -> (value, variance)."""

    planned: Planned
    estimates: Mapping[str, Mapping[str, tuple[float, float]]]


def joint_work(plan: CampaignPlan, label: str, members: Sequence[Member]) -> Work | None:
    """All flights of a group in one fit by each method that found something in at least two of them."""
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


def _group_work(
    plan: CampaignPlan, kind: str, name: str, label: str, pieces: Mapping[str, str], members: Sequence[Member]
) -> Work:
    """Work on several flights, in an order that no plan changes; as long as for one after the other, as far as clocks count."""
    ordered = sorted(members, key=lambda m: m.planned.work.identity)
    subjects = tuple(m.planned.work.subjects[0] for m in ordered)
    limit = min(plan.time_limit * len(subjects), LONGEST_CLOCK)
    segments = plan.each_segment
    return Work(kind, name, pieces, subjects, versions(), False, each_segment=segments, limit_s=limit, group=label)


def envelope_work(plan: CampaignPlan, label: str, members: Sequence[Member]) -> Work | None:
    """All flights of a group, those with a usable estimate, in one model over the envelope; None for too few of them."""
    from estimation.campaign.aerodynamics.joint import FEWEST

    if len(members) < FEWEST:
        return None
    code = digest_of_files(("estimation/campaign/aerodynamics",))
    pieces = {ENVELOPE_METHOD: key_of("envelope", code, sorted(m.planned.work.identity for m in members))}
    return _group_work(plan, "envelope", f"model over the envelope of {label}", label, pieces, members)


def match_works(plan: CampaignPlan, label: str, members: Sequence[Member]) -> Iterator[Work]:
    """Each flight predicted by the weighted mean of the others."""
    ordered = sorted(members, key=lambda m: m.planned.work.identity)  # sums do not depend on the order of the plan
    sums = {method: _Sums(m.estimates[method] for m in ordered if method in m.estimates) for method in plan.methods}
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


class _Sums:
    """Weighted sums of each parameter over flights, from which one flight can be taken out again."""

    def __init__(self, tables: Iterable[Mapping[str, tuple[float, float]]]) -> None:
        self.flights = 0
        self._sums: dict[str, tuple[float, float, int]] = {}
        for table in tables:
            self.flights += 1
            for name, (value, variance) in table.items():
                top, weight, count = self._sums.get(name, (0.0, 0.0, 0))
                self._sums[name] = (top + value / variance, weight + 1.0 / variance, count + 1)

    def without(self, own: Mapping[str, tuple[float, float]]) -> dict[str, float]:
        """Means over the other flights; parameters that no other flight tells are left out."""
        means = {}
        for name, (top, weight, count) in self._sums.items():
            value, variance = own.get(name, (0.0, math.inf))
            if count > (name in own):
                means[name] = (top - value / variance) / (weight - 1.0 / variance)
        return means
