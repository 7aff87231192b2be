"""The answer of the gap workflow as data: the source of the JSON file, the page and the lines on the terminal."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from estimation.engine.kernel import Array
from estimation.gap.answer.shape import Shape, rounded, rounded_estimate, rounded_fields
from estimation.models.base import Model


class GapVerdict(StrEnum):
    """The verdict of a run."""

    NO_GAP = "no_gap"
    GAP_CLOSED = "gap_closed"
    GAP_REDUCED = "gap_reduced"
    UNKNOWN = "unknown_effect"
    CANNOT_TELL = "cannot_tell"


@dataclass(frozen=True)
class Gap:
    """Rms over all outputs of residual over measurement noise, before and after an effect is added.

    floor, highest: median and upper end of the same for simulated flights with nothing hidden; enough: closed share from which
    the gap counts as closed; confirmed: share of what the effect predicts for held-out flights that their likelihood confirms,
    None for training flights and where these flights cannot tell; gained: whether that likelihood is larger with the effect."""

    before: float
    after: float
    floor: float
    highest: float = 0.0
    enough: float = 1.0
    confirmed: float | None = None
    gained: bool = False

    @property
    def says_nothing(self) -> bool:
        """Whether a closed share has no meaning: nothing stood above the floor, little is closed of a gap that flights with
        nothing hidden have too, or weather makes the gap grow with an effect that the likelihood confirms or does not doubt."""
        outgrown = self.grows and (self.gained or self.confirmed is not None)
        return self.within_floor or outgrown or (self.before <= self.highest and self.closed < self.enough)

    @property
    def grows(self) -> bool:
        """Whether the gap is no smaller with the effect."""
        return self.after >= self.before

    @property
    def grows_beyond_nulls(self) -> bool:
        """Whether the gap is no smaller with the effect, and larger than flights with nothing hidden have."""
        return self.grows and self.after > self.highest

    @property
    def within_floor(self) -> bool:
        """Whether the gap was no larger than flights with nothing hidden usually have: nothing to close."""
        return self.before <= self.floor

    @property
    def share(self) -> str:
        """The closed share as text; "-" where it has no meaning."""
        return "-" if self.says_nothing and self.confirmed is None else f"{self.counted:.0%}"

    @property
    def closed(self) -> float:
        """1 - (after^2 - floor^2)/(before^2 - floor^2), in 0..1."""
        if self.within_floor:
            return self._closed_of_nothing
        remaining = max(self.after**2 - self.floor**2, 0.0)
        return min(max(1.0 - remaining / (self.before**2 - self.floor**2), 0.0), 1.0)

    @property
    def counted(self) -> float:
        """The closed share for the verdict. Where the gap says nothing it is what the likelihood confirms; without that, whatever
        made the gap smaller, or the likelihood larger, closed it."""
        if not self.says_nothing:
            return self.closed
        return self._closed_of_nothing if self.confirmed is None else self.confirmed

    @property
    def _closed_of_nothing(self) -> float:
        return 0.0 if self.grows and not self.gained else 1.0

    def to_json(self) -> dict[str, float | None]:
        data = {**rounded_fields(self, before=4, after=4, floor=4), "closed": rounded(self.counted)}
        return data if self.confirmed is None else {**data, "confirmed": rounded(self.confirmed)}


@dataclass(frozen=True)
class Where:
    """Where the disagreement is. segments: (from, to [s]). regime: the flight condition in words. origin: sensor | physics |
    undecided, by the kinematic check."""

    equation: str
    channels: tuple[str, ...]
    segments: tuple[tuple[float, float], ...]
    regime: str
    origin: str = ""

    def to_json(self) -> dict[str, Any]:
        segments = [[rounded(a, 3), rounded(b, 3)] for a, b in self.segments]
        return {
            "equation": self.equation, "channels": list(self.channels), "segments": segments, "regime": self.regime,
            "origin": self.origin,
        }  # fmt: skip


@dataclass(frozen=True)
class Migration:
    """A base derivative that had absorbed part of the effect. bounds: its change over its standard deviation."""

    before: float
    after: float
    bounds: float
    prior: float | None

    def to_json(self) -> dict[str, Any]:
        data = {"from": rounded(self.before, 6), "to": rounded(self.after, 6), "bounds": rounded(self.bounds, 2)}
        if self.prior:
            data["percent_of_prior"] = rounded(100 * (self.after - self.before) / abs(self.prior), 1)
        return data


@dataclass(frozen=True)
class Weighed:
    """A member of the set of effects that explain the gap about equally well."""

    effect: str
    weight: float
    title: str = ""
    separate_by: str = ""


@dataclass(frozen=True)
class EffectStep:
    """One effect found.

    estimates: parameter -> (value, standard deviation). absorbed: share of the signature that the base's own parameters can
    imitate. followed: control -> time [s] by which the base had shifted it to imitate the effect, where sampling leaves less
    open; the gap before is then without that shift. sampling_bound: part of the bound of a time [s] that comes from sampling and
    that no flight can reduce. shape: what is known of an unknown effect beyond where it acts.
    """

    effect: str
    title: str
    form: str
    confidence: float
    members: tuple[Weighed, ...]
    separate_by: str
    estimates: Mapping[str, tuple[float, float]]
    units: Mapping[str, str]
    score: float
    threshold: float
    where: Where
    gap: Gap
    holdout: Gap | None
    migrated: Mapping[str, Migration]
    absorbed: float | None = None
    equation: str = ""
    practical: str = ""
    followed: Mapping[str, float] = field(default_factory=dict)
    sampling_bound: float = 0.0
    text: str = ""
    shape: Shape | None = None

    def to_json(self) -> dict[str, Any]:
        return {
            "effect": self.effect, "title": self.title,
            "form": self.form if self.shape is None else self.shape.to_json(), "confidence": rounded(self.confidence),
            "set": [{"effect": m.effect, "weight": rounded(m.weight)} for m in self.members],
            "separate_by": self.separate_by,
            "parameters": {n: {**rounded_estimate(e, 8), "unit": self.units.get(n, "")} for n, e in self.estimates.items()},
            **rounded_fields(self, score=3, threshold=3), "where": self.where.to_json(),
            "gap": self.gap.to_json(), "holdout": None if self.holdout is None else self.holdout.to_json(),
            "migrated": {n: m.to_json() for n, m in self.migrated.items()},
            "absorbed": rounded(self.absorbed, 3), "equation": self.equation, "practical": self.practical,
            "followed_by_timing": {n: rounded(v, 5) for n, v in self.followed.items()}, "text": self.text,
        }  # fmt: skip


HELD_OUT = "on the held-out flights"  # how a reason ends that comes from them


@dataclass(frozen=True)
class Rejected:
    """A hypothesis or shape that was not accepted."""

    effect: str
    why: str

    @property
    def unconfirmed(self) -> bool:
        """Whether it is significant on the training flights, and the held-out flights alone speak against it."""
        return self.why.endswith(HELD_OUT)


@dataclass(frozen=True)
class Tie:
    """Two hypotheses whose signatures these flights can hardly tell apart."""

    first: str
    second: str
    cosine: float


@dataclass(frozen=True)
class Histories:
    """One flight for pictures: (N, ny) measured, and of the model before and after. floor: (ny,) standard deviation of the
    residual of simulated flights with nothing hidden."""

    flight: str
    holdout: bool
    time: Array
    measured: Array
    before: Array
    after: Array
    floor: Array


PRIOR_FROZEN = "prior parameters frozen"  # the stage with the base parameters as believed before the flights


@dataclass(frozen=True)
class DisagreementView:
    """The disagreement at one stage.

    gap: rms of residual over noise; channels: the same of each output; times: (flight, from, to [s], gap) in windows;
    regime: signal -> bins; equations: rms of the part missing in each coefficient (of a state's rate where the model has no
    coefficient); missing: per record, equation -> (N,) history of that part.
    """

    stage: str
    gap: float
    channels: Mapping[str, float]
    times: tuple[tuple[str, float, float, float], ...]
    regime: Mapping[str, Sequence[Mapping[str, float]]]
    equations: Mapping[str, float]
    missing: tuple[Mapping[str, Array], ...]

    def to_json(self) -> dict[str, Any]:
        return {
            "stage": self.stage,
            "gap": round(self.gap, 4),
            "channels": {n: round(v, 4) for n, v in self.channels.items()},
            "times": [[n, round(a, 3), round(b, 3), round(g, 4)] for n, a, b, g in self.times],
            "regime": {n: list(rows) for n, rows in self.regime.items()},
            "equations": {n: float(f"{v:.3g}") for n, v in self.equations.items()},
        }


@dataclass(frozen=True)
class GapResult:
    """The answer of one run.

    minimum_detectable: effect or parameter -> smallest size that would have been seen. scores: effect -> score, highest first;
    threshold: family-wise, from nulls; nominal_threshold: with an exact noise model. files: of model_before and model_after.
    details: further entries of the JSON document.
    """

    verdict: GapVerdict
    text: str
    minimum_detectable: Mapping[str, float]
    steps: tuple[EffectStep, ...]
    scores: Mapping[str, float]
    threshold: float
    nominal_threshold: float
    rejected: tuple[Rejected, ...]
    ties: tuple[Tie, ...]
    model_before: Model
    model_after: Model
    files: tuple[str, str] = ("", "")
    notes: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    histories: tuple[Histories, ...] = ()
    views: tuple[DisagreementView, ...] = ()
    details: Mapping[str, Any] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """The document of `gap --json`."""
        return {
            "version": 1,
            "verdict": self.verdict.value,
            "text": self.text,
            "minimum_detectable": {n: rounded(v, 8) for n, v in self.minimum_detectable.items()},
            "steps": [s.to_json() for s in self.steps],
            "model_before": self.files[0],
            "model_after": self.files[1],
            "scores": {n: rounded(v, 3) for n, v in self.scores.items()},
            **rounded_fields(self, threshold=3, nominal_threshold=3),
            "ties": [[t.first, t.second, rounded(t.cosine, 3)] for t in self.ties],
            "rejected": [{"effect": r.effect, "why": r.why} for r in self.rejected],
            "notes": list(self.notes),
            **self.details,
        }
