"""The stages of an analysis after the import: contradictions, air data, stretches, model, estimate, gap, and the page."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from daq.utilities.errors import UserError
from daq.utilities.outputs import write_json
from estimation.analysis.choice import (
    RICHEST,
    ChosenStretches,
    choose_stretches,
    models_to_try,
    moved_controls,
    without_failures,
)
from estimation.analysis.outcome import Analysis, is_coefficient, parameters_of, recommendation_of, roughly, verdict_of
from estimation.analysis.stages import Stage, Stages
from estimation.analysis.unknown_aircraft import without_aircraft
from estimation.session.recipe import AIR, AIRSPEED, RECONSTRUCTION, Recipe, recipe
from groundstation.flight import Flight, read_flight
from groundstation.flight.marks import marks_of

METHODS_MEASURED = ("ml", "fem", "ls")
METHODS_RECONSTRUCTED = ("ml",)
"""Where angles are reconstructed: the other methods would take them as exact."""
STRUCTURES = ("test", "auto")
"""Values of `--structure` in the order of trial: the model as it is, then with the terms that it lacks."""
FEWEST_FOR_GAP = 2
"""Flights, those held out included."""
MOST_NEXT = 12  # steps that are proposed

Tell = Callable[[str, float], None]


@dataclass(frozen=True)
class ImportedFlights:
    """flights: imported, for the estimate; holdout: left out of every fit; keys: of the import of each; repeated: whether an
    import was done in this run."""

    flights: tuple[Flight, ...]
    holdout: tuple[Flight, ...]
    keys: tuple[str, ...]
    repeated: bool


def analyse_flights(
    imported: ImportedFlights, aircraft: str | None, aircraft_key: str, stages: Stages, tell: Tell
) -> Analysis:
    """Everything after the import; writes `answer.json` and `index.html` into the folder of the stages.

    aircraft: as for `--aircraft`; aircraft_key: digest of its file. tell: takes the present step and the fraction done.
    """
    tell("contradictions", 0.15)
    parts = [without_failures(f) for f in (*imported.flights, *imported.holdout)]
    contradicted = [{"flight": f.name, **c.to_json()} for f, found in parts[: len(imported.flights)] for c in found]
    air = [_with_air(f, [key, aircraft_key], stages, tell) for (f, _), key in zip(parts, imported.keys, strict=True)]
    tell("stretches", 0.3)
    stretches = [choose_stretches(f) for f, _ in air]
    training, holdout = stretches[: len(imported.flights)], stretches[len(imported.flights) :]
    recipe_of_log = recipe(training[0].flight)
    key_content = {"air": _keys(air[: len(training)]), "by": [c.by for c in training], "aircraft": aircraft_key}
    unknown_aircraft = aircraft is None and not any(f.provenance.aircraft for f in imported.flights)
    estimate = without_file = None
    if unknown_aircraft:
        tell("what can be said without an aircraft file", 0.4)
        stage = stages.run(
            "without_aircraft",
            key_content,
            lambda: without_aircraft([c.flight for c in training], recipe_of_log, [s.content for _, s in air]),
        )
        without_file = stage.content
    else:
        stage = _estimated(training, recipe_of_log, aircraft, key_content, stages, tell)
        estimate = stage.content or None
    gap = (
        None
        if unknown_aircraft
        else _gap(training, holdout, estimate, aircraft, {"air": _keys(air), "estimate": stage.key}, stages, tell)
    )
    stages_repeated = {
        "import": imported.repeated,
        "air": any(s.repeated for _, s in air),
        "without aircraft" if unknown_aircraft else "estimate": stage.repeated,
        "gap": gap is not None and gap.repeated,
    }
    repeated = [name for name, done in stages_repeated.items() if done]
    content = _content(imported, training, contradicted, recipe_of_log, estimate, gap, without_file)
    answer = Analysis(content, _pages(stages.folder, estimate, gap), tuple(repeated))
    write_json(answer.to_json(), stages.folder / "answer.json")
    answer.report(stages.folder)
    tell("done", 1.0)
    return answer


def _keys(air: Sequence[tuple[Flight, Stage]]) -> list[str]:
    return [stage.key for _, stage in air]


def _with_air(flight: Flight, key: Sequence[str], stages: Stages, tell: Tell) -> tuple[Flight, Stage]:
    """The flight with reconstructed air data where they were not measured and can be reconstructed; and that stage."""
    path = stages.path(f"air_{flight.name}.mcap")
    have = {c for c in flight.columns if flight.measured(c)}
    if have.issuperset(AIR) or not (have.issuperset(RECONSTRUCTION) and have & set(AIRSPEED)):
        return flight, stages.run(f"air_{flight.name}", [*key, "as measured"], dict)

    def work() -> dict[str, Any]:
        from estimation.answers.reconstruction import reconstruct

        tell(f"air data of {flight.name}", 0.2)
        reconstruction = reconstruct(flight, path)
        return {"said": list(reconstruction.lines()), **reconstruction.to_json()}

    try:
        stage = stages.run(f"air_{flight.name}", [*key, "reconstructed"], work, path)
    except UserError as error:
        reason = str(error)
        return flight, stages.run(f"air_{flight.name}", [*key, reason], lambda: {"said": [reason]})
    return (replace(read_flight(path), name=flight.name), stage) if path.is_file() else (flight, stage)


def _estimated(
    training: Sequence[ChosenStretches],
    recipe_of_log: Recipe,
    aircraft: str | None,
    key_content: Mapping[str, Any],
    stages: Stages,
    tell: Tell,
) -> Stage:
    """The estimate of the richest model whose estimate is recommended; of the richest, where none is."""
    flights = [c.flight for c in training]
    models = models_to_try(recipe_of_log, sorted({c for f in flights for c in moved_controls(f)}))

    def work() -> dict[str, Any]:
        from estimation.answers.estimates import Estimates, estimate

        methods = METHODS_RECONSTRUCTED if any(f.reconstructed for f in flights) else METHODS_MEASURED
        first: Estimates | None = None
        rejected: list[str] = []
        lacks = False
        for i, (model, structure) in enumerate((m, s) for m in models for s in STRUCTURES):
            if structure == "auto" and not lacks:
                continue  # no term is lacking
            tell(f"estimate of {model}", 0.35 + 0.3 * i / (len(STRUCTURES) * len(models)))
            answer = estimate(flights, model, methods, aircraft=aircraft, joint=len(flights) > 1, structure=structure)
            recommendation = recommendation_of(answer.to_json())
            if recommendation.get("method", "none") != "none":
                return _write_estimate(answer, stages.folder, rejected)
            lacks = bool(recommendation.get("lacks"))
            rejected.append(f"{model}: {recommendation.get('why', 'nothing recommended')}")
            first = first or answer
        return _write_estimate(first, stages.folder, rejected[1:]) if first is not None else {}

    return stages.run("estimate", {**key_content, "models": models}, work)


def _write_estimate(answer: Any, folder: Path, rejected: Sequence[str]) -> dict[str, Any]:
    """The estimate as JSON, its page and its model as files."""
    answer.report(folder / "estimate")
    answer.save(folder / "model.toml")
    return {**answer.to_json(), "tried": list(rejected)}


def _gap(
    training: Sequence[ChosenStretches],
    holdout: Sequence[ChosenStretches],
    estimate: Mapping[str, Any] | None,
    aircraft: str | None,
    key_content: Mapping[str, Any],
    stages: Stages,
    tell: Tell,
) -> Stage | None:
    """What the model lacks, where there are flights enough and an estimate is recommended."""
    if len(training) + len(holdout) < FEWEST_FOR_GAP or recommendation_of(estimate).get("method", "none") == "none":
        return None
    model = str((estimate or {}).get("model", RICHEST[1]))

    def work() -> dict[str, Any]:
        from estimation.answers.gaps import gap

        tell("what the model lacks", 0.65)
        answer = gap(
            model, [c.flight for c in training], [c.flight for c in holdout], aircraft=aircraft,
            progress=lambda what, share: tell(what, 0.65 + 0.33 * share),
        )  # fmt: skip
        answer = answer.with_models(stages.folder / "gap" / "models")
        answer.report(stages.folder / "gap")
        return answer.to_json()

    return stages.run("gap", {**key_content, "model": model}, work)


def _pages(folder: Path, estimate: Mapping[str, Any] | None, gap: Stage | None) -> dict[str, str]:
    pages = [("Derivatives", "estimate", bool(estimate)), ("Gap", "gap", gap is not None)]
    return {
        name: f"{room}/index.html"
        for name, room, exists in pages
        if exists and (folder / room / "index.html").is_file()
    }


def _content(
    imported: ImportedFlights,
    training: Sequence[ChosenStretches],
    contradicted: Sequence[Mapping[str, Any]],
    recipe_of_log: Recipe,
    estimate: Mapping[str, Any] | None,
    gap: Stage | None,
    without_file: Mapping[str, Any] | None,
) -> dict[str, Any]:
    if estimate:
        verdict = verdict_of(estimate, _stretches_text(training), contradicted)
    elif without_file:
        verdict = str(without_file["verdict"])
    else:
        verdict = _why_no_model(training, recipe_of_log)
    return {
        "version": 1,
        "flights": [_flight_entry(f) for f in imported.flights],
        "holdout": [_flight_entry(f) for f in imported.holdout],
        "contradictions": list(contradicted),
        "modes": [
            {"flight": f.name, "mode": m.name, "from": m.start, "to": m.stop}
            for f in imported.flights
            for m in marks_of(f).modes
        ],
        "stretches": [s for c in training for s in c.to_json()],
        "model": estimate["model"] if estimate else None,
        "estimate": estimate,
        "gap": None if gap is None else gap.content,
        **({"without_aircraft": without_file} if without_file else {}),
        "verdict": verdict,
        "next": _next_steps(training, imported, contradicted, recipe_of_log, estimate, gap, without_file)[:MOST_NEXT],
        "notes": list(
            dict.fromkeys([n for c in training for n in c.notes] + [n.text for f in imported.flights for n in f.notes])
        ),
    }


def _flight_entry(flight: Flight) -> dict[str, Any]:
    return {
        "name": flight.name,
        "path": flight.provenance.path,
        "sha256": flight.provenance.sha256,
        "samples": len(flight),
        "duration_s": float(flight.time[-1] - flight.time[0]),
        "channels": flight.channels,
    }


def _stretches_text(training: Sequence[ChosenStretches]) -> str:
    count = sum(len(c.flight.segments) for c in training)
    criteria = ", ".join(dict.fromkeys(c.by if c.by.startswith("mode:") else c.by.partition(" ")[0] for c in training))
    return (
        f"over {count} stretch{'es' if count != 1 else ''} by {criteria}"
        if criteria != "all"
        else "over all that was flown"
    )


def _why_no_model(training: Sequence[ChosenStretches], recipe_of_log: Recipe) -> str:
    """Why no model can be estimated."""
    able = [m.model for m in recipe_of_log.models if m.able]
    if able:
        controls = sorted({c for t in training for c in moved_controls(t.flight)})
        moved_text = f"only {', '.join(controls)} moved" if controls else "no surface moved"
        return f"No derivatives: {moved_text}, which is no input for {', '.join(able)}; fly doublets or 3-2-1-1s"
    nearest = min(recipe_of_log.models, key=lambda m: (bool(m.slow), len(m.missing)))
    reason = nearest.slow or f"it lacks {', '.join(nearest.missing)}"
    return f"No derivatives: the log is not enough for any model; nearest is {nearest.model}: {reason}"


def _next_steps(
    training: Sequence[ChosenStretches],
    imported: ImportedFlights,
    contradicted: Sequence[Mapping[str, Any]],
    recipe_of_log: Recipe,
    estimate: Mapping[str, Any] | None,
    gap: Stage | None,
    without_file: Mapping[str, Any] | None,
) -> list[str]:
    """Steps that a person can take, the most important first."""
    steps = [f"settle in {c['flight']}: {c['text']}" for c in contradicted if c.get("stops")]
    steps += list(without_file["next"]) if without_file else []
    if without_file and not any(m.able for m in recipe_of_log.models):
        steps.append(
            f"channels: {recipe_of_log.air}; 'sideslip import LOG --draft-map -o map.toml' proposes what each column is"
        )
    steps += [c.hint for c in training if c.hint]
    recommendation = recommendation_of(estimate)
    lacks = ", ".join(str(term) for term in recommendation.get("lacks", ()))
    steps += [f"settle what the model may lack ({lacks}): the page of the derivatives explains each"] if lacks else []
    if estimate and recommendation.get("method", "none") == "none":
        steps += [str(d.get("text", "")) for f in estimate.get("flights", []) for d in f.get("doubts", [])]
    if not estimate and not without_file:
        steps += [f"{sensor} would make possible: {', '.join(models)}" for sensor, models in recipe_of_log.adds.items()]
        if not any(f.measured(c) for f in imported.flights for c in ("delta_a", "delta_e", "delta_r")):
            steps.append(
                "say which servo output moves which surface: 'sideslip import LOG --draft-map -o map.toml', then --map map.toml"
            )
    rough = [f"{n} ({roughly(p):.0%})" for n, p in parameters_of(estimate).items() if roughly(p) and is_coefficient(n)]
    if rough and recommendation.get("method", "none") != "none":
        steps.append(
            f"known to a quarter or worse: {', '.join(rough)}; larger inputs, or more flights of them, narrow that"
        )
    if estimate and gap is None and len(imported.flights) + len(imported.holdout) < FEWEST_FOR_GAP:
        steps.append("give a second flight, or one with --holdout, to find out what the model lacks")
    return [s for s in dict.fromkeys(steps) if s]
