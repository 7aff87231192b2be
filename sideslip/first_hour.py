"""What a newcomer meets: the greeting, what to do after each verb, and shell completion."""

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
    "match": "sideslip gap {file2}, for what the model leaves out",
    "performance": "sideslip estimate {file} --model longitudinal",
    "frequency": "sideslip estimate {file} --method ml-frequency",
    "design": "sideslip fly nominal --manoeuvre {out}, before the aircraft flies it",
    "aircraft": "sideslip estimate FLIGHT --aircraft {rest[1]}",
    "campaign": "open {out}/report/index.html",
    "watch": "sideslip gap {file}, for what an alarm was about",
    "gap": "sideslip match the child model FLIGHT, on a flight that was not used",
    "doctor": "sideslip demo",
}
"""Verb -> what to do after it. {file}, {file2}: the first and second file on the command line; {out}: what it wrote;
{rest}: the words behind the verb.

`estimate`, `ground` and `info` say it themselves, from what they found."""

AFTER_A_FAILED_CHECK: Mapping[str, str] = {
    "preflight": "put right what stands above, then sideslip preflight {file}",
    "verify": "sideslip recover {file} -o recovered.mcap",
    "check": "sideslip view {file}, where it fails",
    "aircraft": "write in {file} what is missing, then sideslip aircraft check {file}",
}
"""The same where the answer is a failed check, if that is something else."""

WITH_OPTION: Mapping[tuple[str, str], str] = {
    (
        "import",
        "--draft-map",
    ): "write down in {out} what is UNKNOWN, then sideslip import {file} --map {out} -o flight.mcap",
    ("import", "--recipe"): "sideslip import {file} --draft-map -o map.toml",
    ("aircraft", "new"): "",  # the verb says it itself
    ("check", "--write"): "sideslip estimate {out}/{stem}.mcap",
}
"""The same for an option, or a word, with which a verb does something else."""

OUTPUTS = ("-o", "--output", "--out", "--write")


def next_line(words: Sequence[str], *, failed: bool) -> str:
    """What to do after a command line; "" where there is nothing to say: help was asked for, or the verb is not ours."""
    if not words or {"-h", "--help"} & {*words}:
        return ""
    verb, rest = words[0], words[1:]
    text = (AFTER_A_FAILED_CHECK if failed else {}).get(verb) or NEXT.get(verb, "")
    if not failed:
        text = next((t for (v, option), t in WITH_OPTION.items() if v == verb and option in rest), text)
    out = next((b for a, b in zip(rest, rest[1:], strict=False) if a in OUTPUTS), "demo" if verb == "demo" else "OUT")
    files = [w for w in rest if w != out and not w.startswith("-") and Path(w).is_file()]
    file = _or(files, 0, "FLIGHT")
    return text.format(out=out, file=file, file2=_or(files, 1, "FLIGHT"), rest=rest, stem=Path(file).stem)


def _or(files: Sequence[str], place: int, word: str) -> str:
    return files[place] if place < len(files) else word


def quiet_first(words: Sequence[str]) -> tuple[list[str], bool]:
    """The words without --quiet, wherever it stands, and whether it was there (or SIDESLIP_QUIET in the environment)."""
    rest = [w for w in words if w != "--quiet"]
    return rest, len(rest) < len(words) or bool(os.environ.get("SIDESLIP_QUIET"))
