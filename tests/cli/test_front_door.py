"""Every verb and its function of Python give the same JSON for the same files, key by key and to the bit."""

import inspect
import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest

import sideslip as ss
from daq.identification.monitor import threshold
from daq.utilities.errors import UserError
from daq.utilities.outputs import write_json
from estimation import aircraft as aircraft_room
from estimation.aircraft import unknown_aircraft
from estimation.design import measured_inputs
from estimation.gap import effects
from estimation.gap.effects import Effect, catalogue
from estimation.models import load_model, write_model
from estimation.models.base import Model
from estimation.session import runner
from groundstation.flight import write_flight
from sideslip.cli import cli
from tests.support.paths import RECORDINGS

RAW = RECORDINGS / "cdfp_ld2_raw.mcap"
AIRCRAFT = Path(aircraft_room.__file__).with_name("cdfp.toml")
PLAN = """format = 1
[[fit]]
instrument = "alpha_vane"
procedure = "static_points"
method = "turned by hand"
reference_uncertainty = 0.01
degree = 1
dwell = [
    { start = 2.0, stop = 3.0, reference = 0.10 },
    { start = 6.0, stop = 7.0, reference = 0.09 },
    { start = 12.0, stop = 13.0, reference = 0.11 },
    { start = 20.0, stop = 21.0, reference = 0.08 },
]
"""


@dataclass(frozen=True)
class Files:
    """What both doors are given. model: a file of one's own; cut: its flight in two stretches."""

    first: Path
    second: Path
    whole: Path
    model: Path
    truth: Path
    estimate: Path
    other: Path
    plan: Path


@dataclass(frozen=True)
class Case:
    """A verb's words with names of `Files` in braces, and the call that means the same."""

    words: str
    call: Callable[[Files], Any]


CASES = {
    "estimate": Case(
        "estimate {first} {second} --method ml,ls --joint --hold-initial phi --profile Cl_p --seed 3 --truth {truth}",
        lambda f: ss.estimate(
            [f.first, f.second], method=["ml", "ls"], joint=True, hold_initial=("phi",), profile=["Cl_p"], seed=3,
            truth={"Cl_p": -0.4, "Cn_r": -0.05},
        ),
    ),
    "estimate, own model, live": Case(
        "estimate {whole} --model {model} --method live",
        lambda f: ss.estimate(ss.open(f.whole), f.model, "live"),
    ),
    "estimate, own model, ngn": Case(
        "estimate {first} --model {model} --method ngn",
        lambda f: ss.estimate(str(f.first), str(f.model), method="ngn"),
    ),
    "estimate, each stretch": Case(
        "estimate {whole} --method ls --segments 1:9,12:20 --each-segment --stepwise --keep-held",
        lambda f: ss.estimate(
            f.whole, method="ls", segments="1:9,12:20", each_segment=True, stepwise=True, keep_held=True
        ),
    ),
    "estimate, bootstrap": Case(
        "estimate {first} --bootstrap 10 --seed 5 --raw-inputs --free-initial all",
        lambda f: ss.estimate(f.first, bootstrap=10, seed=5, raw_inputs=True, free_initial="all"),
    ),
    "estimate, another aircraft": Case(
        "estimate {other} --aircraft cdfp --method ls", lambda f: ss.estimate(f.other, method="ls", aircraft="cdfp")
    ),
    "check": Case(
        "check {first} {whole} --factors +K_alpha,dtheta=0.01 --joint --segments 1:9 --keep-held",
        lambda f: ss.check([f.first, f.whole], "+K_alpha,dtheta=0.01", True, segments="1:9", keep_held=True),
    ),
    "check, findings": Case(
        "check {first} --factors dax,day,K_beta --aircraft cdfp",
        lambda f: ss.check(f.first, ["dax", "day", "K_beta"], aircraft="cdfp"),
    ),
    "match": Case(
        "match {model} {first} {whole} --free CY_0,Cl_0 --limit 0.2 --segments 1:9",
        lambda f: ss.match(f.model, [f.first, f.whole], ["CY_0", "Cl_0"], limit=0.2, segments="1:9"),
    ),
    "match, built-in": Case("match lateral {first}", lambda f: ss.match("lateral", f.first)),
    "watch": Case(
        "watch {whole} --model {model} --hours 1 --seed 4 --rate 2",
        lambda f: ss.watch(f.whole, f.model, hours=1.0, seed=4, rate=2.0),
    ),
    "frequency": Case(
        "frequency {whole} --input delta_a --output p --fit --form roll --band 0.3,2 --points 20 --with none --class I",
        lambda f: ss.frequency(
            f.whole, "delta_a", "p", fit=True, form="roll", band=(0.3, 2.0), points=20, with_=(), kind="I"
        ),
    ),
    "design": Case(
        "design --aircraft cdfp --kind doublet --time 4 -o {estimate}.toml",
        lambda f: ss.design("lateral", 4.0, "cdfp", kind="doublet"),
    ),
    "design, from an estimate": Case(
        "design --from {estimate} --kind 3211 --time 5 --speed 21 --seed 2 -o {estimate}.toml",
        lambda f: ss.design("lateral", 5.0, estimate=f.estimate, kind="3211", speed=21.0, seed=2),
    ),
    "reconstruct": Case(
        "reconstruct {first} -o {estimate}.csv --trim-sideslip 2",
        lambda f: ss.reconstruct(f.first, f"{f.estimate}.csv", trim_sideslip=2.0),
    ),
    "gap": Case(
        "gap {first} --holdout {second} --model {model} --nulls 20 --seed 2",
        lambda f: ss.gap(f.model, f.first, [f.second], nulls=20, seed=2),
    ),
    "info": Case(f"info {RAW}", lambda _: ss.info(RAW)),
    "info, a flight": Case("info {other}", lambda f: ss.info(f.other)),
    "verify": Case(f"verify {RAW}", lambda _: ss.verify(RAW)),
    "export": Case("export {other} -o {estimate}.parquet", lambda f: ss.export(f.other, f"{f.estimate}.parquet")),
    "export, a simulator's": Case(
        f"export {AIRCRAFT} --to neutral -o {{estimate}}.neutral.json --force",
        lambda f: ss.export(AIRCRAFT, f"{f.estimate}.neutral.json", target="neutral", force=True),
    ),
    "bench": Case(
        f"bench {RAW} --plan {{plan}} -o {{estimate}}-set --date 2026-03-01",
        lambda f: ss.bench(RAW, f.plan, f"{f.estimate}-set", day=date(2026, 3, 1)),
    ),
    "campaign": Case(
        "campaign {first} {second} --out {estimate}-campaign --aircraft cdfp --method ls --serial --no-report --check none",
        lambda f: ss.campaign(
            [f.first, f.second], f"{f.estimate}-again", aircraft="cdfp", methods="ls", serial=True, no_report=True,
            check="none",
        ),
    ),
    "aircraft check": Case("aircraft check cdfp", lambda _: ss.check_aircraft("cdfp")),
    "calibrate": Case(f"calibrate {RAW} -o {{estimate}}.mcap", lambda f: ss.calibrate(RAW, f"{f.estimate}.mcap")),
}  # fmt: skip


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Files:
    folder = tmp_path_factory.mktemp("front_door")
    whole = ss.open(RECORDINGS / "cdfp_ld4.mcap")
    half = float(whole.time[0] + whole.time[-1]) / 2.0
    made = Files(
        *(folder / n for n in ("a.mcap", "b.mcap", "w.mcap", "own.toml", "truth.json", "e.json", "o.csv", "plan.toml"))
    )
    for path, keep in (
        (made.first, whole.time < half),
        (made.second, whole.time >= half),
        (made.whole, whole.time > 0),
    ):
        write_flight(whole.part(keep, path.stem), path)
    write_flight(whole.part(whole.time < half, "o"), made.other)
    model = load_model("lateral", "cdfp").with_starts({"Cl_p": -0.45, "Cn_beta": 0.03})
    write_model(model, made.model)
    made.plan.write_text(PLAN)
    made.truth.write_text(json.dumps({"Cl_p": -0.4, "Cn_r": -0.05}))
    ss.estimate(whole, method="ls").save(made.estimate)
    return made


NEAR = ("servo_lag", "rudder_delay", "Cn_da", "Cl_betadot", "beta_lag", "gust")


def asked(files: Iterable[str | Path] = (), model: Model | None = None) -> tuple[Effect, ...]:
    """Effects of each kind: each is compiled before it is asked."""
    return tuple(effect for effect in catalogue(files, model) if effect.name in NEAR)


@pytest.fixture(scope="module")
def answers(files: Files) -> Iterator[Callable[[str], Any]]:
    """What Python gives in each case, asked once for all tests; alarms of a watch from a sixth of an hour, what a design says of
    noisy inputs from three flights, a gap by a few of the effects."""
    found: dict[str, Any] = {}

    def answer(name: str) -> Any:
        if name not in found:
            found[name] = CASES[name].call(files)
        return found[name]

    with pytest.MonkeyPatch.context() as patch:
        for constant, value in (("HOUR_S", 600.0), ("AT_ONCE", 24), ("FLIGHT_S", 25.0)):
            patch.setattr(threshold, constant, value)
        patch.setattr(measured_inputs, "USUAL_SAMPLES", 0)  # samples; every manoeuvre is a long one
        patch.setattr(measured_inputs, "LEAST_DRAWS", 3)
        patch.setattr(effects, "catalogue", asked)
        yield answer


def differences(one: Any, two: Any, where: str = "") -> Iterator[str]:
    """Places at which two JSON values are not the same."""
    if isinstance(one, dict) and isinstance(two, dict):
        yield from (f"{where}.{key}: in one only" for key in one.keys() ^ two.keys())
        for key in one.keys() & two.keys():
            yield from differences(one[key], two[key], f"{where}.{key}")
    elif isinstance(one, list) and isinstance(two, list) and len(one) == len(two):
        for i, pair in enumerate(zip(one, two, strict=True)):
            yield from differences(*pair, f"{where}[{i}]")
    elif type(one) is not type(two) or one != two:
        yield f"{where}: {one!r} and {two!r}"


@pytest.mark.parametrize("name", CASES)
def test_verb_and_function_give_the_same_json(
    name: str, files: Files, answers: Callable[[str], Any], tmp_path: Path
) -> None:
    case = CASES[name]
    words = [word.format(**vars(files)) for word in case.words.split()]
    with pytest.raises(SystemExit) as ended:
        ss.main([*words, "--json", str(tmp_path / "verb.json")])
    answer = answers(name)
    if name == "gap":
        answer = answer.with_models(tmp_path / "verb-models")
    write_json(answer.to_json(), tmp_path / "python.json")
    verb, python = (json.loads((tmp_path / f"{door}.json").read_text()) for door in ("verb", "python"))
    if name == "campaign":
        assert verb.pop("wall_s") > 0.0 < python.pop("wall_s")
    assert list(differences(verb, python)) == []
    assert ended.value.code == (0 if answer.passed else 1)


WRITES = {
    "json_path", "report_folder", "figure_path", "histories_folder", "model_path", "stretch_path", "folder", "brief", "split",
    "progress", "notice",
}  # fmt: skip
"""What a verb writes or prints, and a function hands over as an answer; and how far the work is."""
VALUES = {"design": {"values", "noise"}}
"""What only Python can be given: tables of numbers."""
RENAMED = {"control": "input", "duration": "time", "recording": "recording", "report": "json_path"}


@pytest.mark.parametrize(
    "name",
    [
        "check",
        "estimate",
        "match",
        "gap",
        "watch",
        "frequency",
        "design",
        "reconstruct",
        "calibrate",
        "verify",
        "performance",
        "export",
        "bench",
        "campaign",
    ],
)
def test_a_function_takes_what_its_verb_takes(name: str) -> None:
    command = cli.get_command(click.Context(cli), name)
    assert command is not None
    options = {RENAMED.get(str(p.name), str(p.name)) for p in command.params} - WRITES
    arguments = set(inspect.signature(getattr(ss, name)).parameters) - WRITES - VALUES.get(name, set())
    assert options - arguments <= ({"output"} if name == "design" else set())
    assert arguments <= options


def test_a_difference_in_the_last_bit_is_seen() -> None:
    assert list(differences({"a": [1.0, 0.3]}, {"a": [1.0, 0.1 + 0.2]})) == [".a[1]: 0.3 and 0.30000000000000004"]
    assert list(differences({"a": 1}, {"b": 1})) != []


ANSWERS = (
    "aircraft check",
    "bench",
    "export",
    "estimate, each stretch",
    "check, findings",
    "match",
    "frequency",
    "design",
    "reconstruct",
    "info",
    "calibrate",
)


@pytest.mark.parametrize("name", ANSWERS)
def test_every_answer_follows_the_protocol(
    name: str, answers: Callable[[str], Any], tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    """The figures of the largest page, that of estimates, are written in tests/cli/test_api.py; here they are only made."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    if name.startswith("estimate"):
        request.getfixturevalue("unwritten_figures")
    answer = answers(name)
    assert answer.summary() == "\n".join(answer.lines())
    assert answer._repr_html_().count("<tr>") > 1
    assert 3 < len(repr(answer)) < 1000
    assert answer.plot() is not None
    plt.close("all")
    assert answer.save(tmp_path / "a.json").stat().st_size > 100
    with pytest.raises(UserError, match=r"a\.xls"):
        answer.save(tmp_path / "a.xls")
    page = answer.report(tmp_path / "page").read_text(encoding="utf-8")
    assert "</html>" in page


def test_a_method_that_takes_geometry_refuses_an_aircraft_of_which_nothing_is_known(files: Files) -> None:
    """It gave other numbers, or ended in `All-NaN slice encountered`."""
    flight, model = ss.open(files.first), load_model(str(files.model))
    for method in ("live", "ngn"):
        with pytest.raises(UserError, match=f"method {method} takes geometry and mass"):
            runner.estimate(model, [flight], unknown_aircraft("somebody's"), (method,))
        with pytest.raises(UserError, match="o names no aircraft"):
            ss.estimate(files.other, files.model, method)


def test_libraries_of_linear_algebra_are_left_as_they_were(monkeypatch: pytest.MonkeyPatch) -> None:
    """Inside a public function one thread, afterwards as many as before."""
    import os

    from threadpoolctl import threadpool_info, threadpool_limits

    from estimation.threads import one_thread, single_threaded

    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    np.linalg.inv(np.eye(3))

    def threads() -> set[int]:
        return {found["num_threads"] for found in threadpool_info()}

    with threadpool_limits(2):
        with one_thread():
            assert threads() == {1}
            assert os.environ["OMP_NUM_THREADS"] == "1"
        assert threads() == {2}
        assert single_threaded(threads)() == {1}
    assert "OMP_NUM_THREADS" not in os.environ
