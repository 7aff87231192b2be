"""The state of live identification as a person reads it: one line, a table of plain lines, and the same as Markdown."""

import math
from collections.abc import Iterator

from daq.identification.estimates import LiveDerivative
from daq.identification.next_manoeuvre import ManoeuvreAdvice
from groundstation.identification.session import LiveState

LONGEST_S = 600.0  # to go; beyond, it is said that this flying does not bring it
SAID = 4  # derivatives in the short line
EXCITED = math.radians(0.5)  # rad rms of the last seconds from which a control counts as being moved
CONTROL_WORDS = {"delta_a": "aileron", "delta_r": "rudder", "delta_e": "elevator"}
FIRST = "a doublet of each control: nothing can be told before both have moved"


def short_line(state: LiveState) -> str:
    """The most important in one line of the log."""
    told_derivatives = [
        state.estimates.derivatives[n] for n in state.aircraft.shown if state.estimates.derivatives[n].told
    ]
    reached_count = sum(state.to_go.get(d.name, math.inf) == 0.0 for d in told_derivatives)
    surest = sorted(told_derivatives, key=lambda d: d.std / max(abs(d.estimate), 1e-12))[:SAID]
    numbers = ", ".join(f"{d.name} {number(d)}" for d in surest)
    counts = f"{len(told_derivatives)} of {len(state.aircraft.shown)} told, {reached_count} to the wanted bound"
    return f"live: {counts}{': ' + numbers if numbers else ''}; next: {next_words(state)}"


def lines(state: LiveState) -> Iterator[str]:
    """Everything, for a terminal."""
    e = state.estimates
    yield f"{state.aircraft.name}, {e.span:.0f} s of flight in {e.rows} intervals at t = {state.time:.1f} s{_late(state)}"
    yield f"{'':9}{'now':>10}{'bound':>10}{'believed':>11}  {'by whom':<21}{'to go':>7}"
    for name in state.aircraft.shown:
        d = e.derivatives[name]
        value, bound = (f"{d.estimate:.4g}", f"{d.std:.2g}") if d.told else ("-", "-")
        row = f"{name:9}{value:>10}{bound:>10}{_believed(state, name):>11}  {state.aircraft.sources.get(name, ''):<21}"
        yield f"{row}{_to_go(state, name):>7}  {_remark(state, d)}".rstrip()
    yield from advice_lines(state)


def markdown(state: LiveState) -> str:
    """Everything, for the viewer's text pane."""
    e = state.estimates
    rows = [
        f"**{state.aircraft.name}**, {e.span:.0f} s of flight, t = {state.time:.1f} s{_late(state)}",
        "",
        "| | now | bound | believed | by | to go |",
        "|---|---|---|---|---|---|",
    ]
    for name in state.aircraft.shown:
        d = e.derivatives[name]
        value, bound = (f"**{d.estimate:.4g}**", f"{d.std:.2g}") if d.told else ("-", "-")
        source = state.aircraft.sources.get(name, "")
        rows.append(f"| {name} | {value} | {bound} | {_believed(state, name)} | {source} | {_to_go(state, name)} |")
    notes = [f"- {d.name}: {words}" for n in state.aircraft.shown if (words := _remark(state, d := e.derivatives[n]))]
    return "\n".join([*rows, "", *(f"- {line}" for line in advice_lines(state)), *notes])


def advice_lines(state: LiveState) -> Iterator[str]:
    """Excitation, what is told only together, and what to fly next."""
    for signal in state.excitation:
        rms_deg = math.degrees(state.excitation.get(signal, 0.0))
        if signal in state.estimates.still:
            movement = "has not moved yet"
        elif state.excitation.get(signal, 0.0) < EXCITED:
            movement = f"rests ({rms_deg:.1f} deg rms)"
        else:
            movement = f"moves {rms_deg:.1f} deg rms"
        yield f"{CONTROL_WORDS[signal]} {movement}"
    for pair in state.together:
        yield (
            f"{pair.first} and {pair.second} are told only together (correlation {pair.correlation:+.2f}): "
            "trust their ratio more than either"
        )
    yield f"next: {next_words(state)}"


def next_words(state: LiveState) -> str:
    """What to fly next."""
    resting_controls = [CONTROL_WORDS[s] for s in state.estimates.still]
    if resting_controls:
        controls = " and ".join(resting_controls)
        return f"{controls} doublet: {controls} {'has' if len(resting_controls) == 1 else 'have'} not moved"
    if state.advice is None:
        all_reached = all(
            state.estimates.derivatives[n].std <= bound for n, bound in state.wanted.items() if bound > 0.0
        )
        return "every wanted bound is reached" if all_reached else FIRST
    return _advised(state.advice)


def _advised(a: ManoeuvreAdvice) -> str:
    size = "" if a.share > 0.95 else f" at {100 * a.share:.0f} % of usual size"
    return f"{a.manoeuvre}{size} (bound of {a.worst} from {a.now:.1f} to {a.then:.1f} times the wanted one)"


def number(d: LiveDerivative) -> str:
    """Estimate and bound, to the digits that the bound allows."""
    places = max(0, 1 - math.floor(math.log10(d.std))) if 0.0 < d.std < math.inf else 4
    return f"{d.estimate:.{min(places, 6)}f} ±{d.std:.{min(places, 6)}f}"


def _believed(state: LiveState, name: str) -> str:
    belief = state.aircraft.airframe.beliefs.get(name)
    return "-" if belief is None else f"{belief.value:.4g}"


def _to_go(state: LiveState, name: str) -> str:
    seconds = state.to_go.get(name, math.inf)
    if seconds == 0.0:
        return "there"
    return f"{seconds:.0f} s" if seconds <= LONGEST_S else "-"


def _remark(state: LiveState, d: LiveDerivative) -> str:
    """Why it is not told; or that it is not what was believed."""
    if not d.told:
        return d.why
    belief = state.aircraft.airframe.beliefs.get(d.name)
    if belief is not None and belief.std > 0.0 and abs(d.estimate - belief.value) > 3.0 * math.hypot(d.std, belief.std):
        return "not what was believed, by more than three standard deviations"
    return ""


def _late(state: LiveState) -> str:
    return f" ({state.late} late scans still to be worked in)" if state.late else ""
