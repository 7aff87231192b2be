"""Texts for a new user: the greeting, and the next step that is printed after each verb."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

GREETING = """\
Sideslip logs an aircraft's flight, brings it down by radio, and finds its aerodynamic derivatives from it.

  sideslip demo                       the whole chain on a simulated aircraft, in about a minute
  sideslip import LOG -o flight.mcap  a log of your own: CSV, Parquet, MATLAB, ULog, ArduPilot, MAVLink
  sideslip estimate flight.mcap       derivatives with their bounds

'sideslip --help' lists the verbs, 'sideslip help VERB' explains one, 'sideslip doctor' says what is installed,
'sideslip completion bash' (or zsh, fish) prints what makes the shell complete verbs and options.
"""

NEXT: Mapping[str, str] = {
    "demo": "a log of your own: sideslip import LOG -o flight.mcap",
    "fly": "sideslip estimate {out}/flight.mcap",
    "record": "sideslip verify RECORDING, then sideslip calibrate RECORDING -o flight.mcap",
    "preflight": "sideslip record {file}",
    "verify": "sideslip calibrate {file} -o flight.mcap",
    "recover": "sideslip verify {out}",
    "view": "sideslip check {file}",
    "calibrate": "sideslip check {out}, to see it: sideslip view {out}",
    "bench": "sideslip calibrate RECORDING --calibration the folder written above",
    "import": "sideslip check {out}, to see it: sideslip view {out}",
    "analyse": "open {out}/index.html",
    "export": "open {out} in the program it is for",
    "check": "sideslip estimate {file}",
    "reconstruct": "sideslip estimate {out}",
    "match": "sideslip gap {flight} --model {model}, for what the model leaves out",
    "performance": "sideslip estimate {file} --model longitudinal",
    "frequency": "sideslip estimate {file} --method ml-frequency",
    "design": "sideslip fly nominal --manoeuvre {out}, before the aircraft flies it",
    "aircraft": "sideslip estimate FLIGHT --aircraft {aircraft}",
    "campaign": "open {out}/report/index.html",
    "watch": "no alarm: watch the next flight with the same model",
    "gap": "sideslip gap again with --report DIR, for the page and the model found",
    "doctor": "sideslip demo",
}
"""Verb -> next step. {file}: the first file on the command line; {flight}: the first that is not TOML; {model}: the first word
after the verb; {aircraft}: the last word that is no option; {out}: the output; {stem}: the name of {file} without ending.

`estimate`, `ground` and `info` are missing: they print a next step that depends on their result."""

AFTER_A_FAILED_CHECK: Mapping[str, str] = {
    "preflight": "put right what stands above, then sideslip preflight {file}",
    "verify": "sideslip recover {file} -o recovered.mcap",
    "check": "sideslip view {file}, where it fails",
    "aircraft": "write in {file} what is missing, then sideslip aircraft check {file}",
    "export": "{out} is not what {file} says: sideslip export {file} again, with --force",
    "watch": "",  # its output contains the command
    "performance": "glides from near the slowest to near the fastest speed, then sideslip performance again",
}
"""Verb -> next step after a failed check, where it differs from NEXT."""

WITH_OPTION: Mapping[tuple[str, str], str] = {
    ("import", "--draft-map"): "write what is UNKNOWN in {out}, then sideslip import {file} --map {out} -o flight.mcap",
    ("fly", "--list"): "sideslip fly NAME",
    ("fly", "--port"): "sideslip calibrate {out}/onboard -o flight.mcap",
    ("import", "--recipe"): "sideslip import {file} --draft-map -o map.toml",
    ("aircraft", "new"): "",  # printed by the verb
    ("check", "--write"): "sideslip estimate {out}/{stem}.mcap",
    ("campaign", "--no-report"): "query {out}/results/*.parquet, as docs/campaign.md shows",
}
"""(Verb, option or word) -> next step, where the option changes it."""

OUTPUTS = ("-o", "--output", "--out", "--write")
SIDE_FILES = ("--aircraft", "--map", "--calibration", "--plan", "--config", "--limits", "--json", "--figure", "--rrd")
"""Options whose value is a file, but not {file}."""


def next_line(words: Sequence[str], *, failed: bool) -> str:
    """The next step after a command line; empty for --help, or a verb without one. failed: whether its check failed."""
    if not words or {"-h", "--help"} & {*words}:
        return ""
    verb, rest = words[0], words[1:]
    text = (AFTER_A_FAILED_CHECK if failed else {}).get(verb, NEXT.get(verb, ""))
    if not failed:
        text = next((t for (v, option), t in WITH_OPTION.items() if v == verb and option in rest), text)
    out = next((b for a, b in zip(rest, rest[1:], strict=False) if a in OUTPUTS), _usual_output(verb, rest))
    side_files = {b for a, b in zip(rest, rest[1:], strict=False) if a in SIDE_FILES}
    names = [w for w in rest if w not in (out, *side_files) and not w.startswith("-")]
    files = [w for w in names if Path(w).is_file()]
    file = next(iter(files), "FLIGHT")
    flight = next((w for w in files if not w.endswith(".toml")), "FLIGHT")
    model = next((w for w in rest[:1] if not w.startswith("-")), "MODEL.toml")
    aircraft = names[-1] if len(names) > 1 else "AIRCRAFT.toml"  # the first one is the word `check`
    line = text.format(out=out, file=file, flight=flight, model=model, aircraft=aircraft, stem=Path(file).stem)
    if verb == "gap" and "--report" in rest[:-1]:
        return _after_gap(Path(rest[rest.index("--report") + 1]))
    if verb == "fly" and (Path(out) / "plan.toml").is_file():
        return f"sideslip bench {out}/onboard --plan {out}/plan.toml -o calibration"
    if verb == "fly" and text == NEXT["fly"]:
        return line + _free_flight(Path(out) / "scenario.toml")
    estimates = text.startswith(("sideslip estimate {file}", "sideslip estimate {out}"))
    return line + _aircraft_option(rest, line.split()[2]) if estimates else line


def _after_gap(report: Path) -> str:
    """The next step with the model that the gap workflow wrote: of several, the one with most effects has the longest name."""
    models = sorted((report / "models").glob("*+*.toml"), key=lambda p: len(p.name))
    if not models:
        return f"open {report}/index.html: its first screen says what to fly"
    return f"sideslip match {models[-1]} FLIGHT, on a flight that was not used"


def _usual_output(verb: str, rest: Sequence[str]) -> str:
    """The default output of a verb; OUT for one without."""
    if verb == "fly":
        return next((f"flights/{w}" for w in rest if Path("flights", w).is_dir()), "OUT")
    return "demo" if verb == "demo" else "OUT"


def _free_flight(scenario_file: Path) -> str:
    """The option --segments that leaves out launch and landing of a simulated flight, which are scripted; empty without these."""
    from daq.utilities.errors import UserError
    from firmware_sim.world.scenario import load_scenario

    try:
        scenario = load_scenario(scenario_file)
    except UserError:
        return ""
    start = scenario.takeoff_s
    scripted = start > 0.0 or scenario.ground.after_s > 0.0
    return f" --segments {start:g}:{start + scenario.flight.duration_s:g}" if scripted else ""


def _aircraft_option(rest: Sequence[str], flight: str) -> str:
    """The option --aircraft for an estimate of a flight: the one given, or a placeholder where the flight names no aircraft."""
    from daq.utilities.errors import UserError
    from groundstation.flight.files.reading import named_aircraft

    named = next((b for a, b in zip(rest, rest[1:], strict=False) if a == "--aircraft"), "")
    if named or not Path(flight).is_file():
        return f" --aircraft {named}" if named else ""
    try:
        return "" if named_aircraft(Path(flight)) else " --aircraft AIRCRAFT.toml"
    except UserError:
        return ""


def quiet_first(words: Sequence[str]) -> tuple[list[str], bool]:
    """The words without --quiet, and whether it was among them or SIDESLIP_QUIET is set."""
    rest = [w for w in words if w != "--quiet"]
    return rest, len(rest) < len(words) or bool(os.environ.get("SIDESLIP_QUIET"))
