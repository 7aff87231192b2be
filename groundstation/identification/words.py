"""The state of live identification as text: one line, a table for a terminal, and Markdown for the viewer."""

import math
from collections.abc import Iterator

from daq.identification.airframe import Airframe
from daq.identification.estimates import LiveDerivative
from daq.identification.next_manoeuvre import LONG, ManoeuvreAdvice
from daq.identification.point_quality import CONTROL_WORDS, FlownPoint
from groundstation.identification.session import LiveState

LONGEST_S = 600.0  # to go; a longer time is not shown
MOST_NAMES = 4  # derivatives in one line
GO_ON_S = 60.0  # to go until the next bound; if longer, the present input should stop
LEAST_GAIN = 1.1  # ratio of the bounds before and after a test point from which it is shown
LEAST_PEAK = math.radians(0.5)  # from which a test point has moved a control [rad]
LINE = 99  # characters of a line on the link: two messages of STATUSTEXT
EXCITED = math.radians(0.5)  # rms of the last seconds from which a control is shown as moved [rad]
CONTRADICTION = 3.0  # standard deviations between estimate and belief from which they contradict each other
FIRST = "a doublet of each control: nothing can be identified before both have moved"


def short_line(state: LiveState) -> str:
    """One line for the log: how many derivatives are identified, the best of them, and what to fly next."""
    identified = _identified(state)
    reached_count = sum(state.to_go.get(d.name, math.inf) == 0.0 for d in identified)
    surest = sorted(identified, key=lambda d: d.std / max(abs(d.estimate), 1e-12))[:MOST_NAMES]
    numbers = ", ".join(f"{d.name} {estimate_text(d)}" for d in surest)
    counts = f"{len(identified)} of {len(state.aircraft.shown)} identified, {reached_count} to the wanted bound"
    return f"live: {counts}{': ' + numbers if numbers else ''}; next: {next_words(state)}"


def _identified(state: LiveState) -> list[LiveDerivative]:
    """The shown derivatives that are identified so far."""
    derivatives = (state.estimates.derivatives[n] for n in state.aircraft.shown)
    return [d for d in derivatives if d.told]


def state_lines(state: LiveState) -> Iterator[str]:
    """The complete state as lines for a terminal."""
    e = state.estimates
    yield f"{state.aircraft.name}, {e.span:.0f} s of flight in {e.rows} intervals at t = {state.time:.1f} s{_late_note(state)}"
    yield f"{'':9}{'now':>10}{'bound':>10}{'believed':>11}  {'by whom':<21}{'to go':>7}"
    for name in state.aircraft.shown:
        d = e.derivatives[name]
        value, bound = (f"{d.estimate:.4g}", f"{d.std:.2g}") if d.told else ("-", "-")
        row = f"{name:9}{value:>10}{bound:>10}{_believed(state, name):>11}  {state.aircraft.sources.get(name, ''):<21}"
        yield f"{row}{_to_go(state, name):>7}  {_remark(state, d)}".rstrip()
    yield from advice_lines(state)


def markdown(state: LiveState) -> str:
    """The complete state for the viewer's text pane; what to fly next comes first, since the pane may be small."""
    e, point = state.estimates, list(point_lines(state))
    to_do = [f"**{line}**" for line in (*point[-1:], _next_line(state))]
    rows = [
        f"**{state.aircraft.name}**, {e.span:.0f} s of flight, t = {state.time:.1f} s{_late_note(state)}",
        "",
        *(f"- {line}" for line in (*to_do, *point[:-1])),
        "",
        "| | now | bound | to go | believed | by |",
        "|---|---|---|---|---|---|",
    ]
    for name in state.aircraft.shown:
        d = e.derivatives[name]
        value, bound = (f"**{d.estimate:.4g}**", f"{d.std:.2g}") if d.told else ("-", "-")
        source = state.aircraft.sources.get(name, "")
        rows.append(f"| {name} | {value} | {bound} | {_to_go(state, name)} | {_believed(state, name)} | {source} |")
    notes = [f"- {d.name}: {words}" for n in state.aircraft.shown if (words := _remark(state, d := e.derivatives[n]))]
    return "\n".join([*rows, "", *(f"- {line}" for line in _motion_lines(state)), *notes])


def advice_lines(state: LiveState) -> Iterator[str]:
    """Lines on mass, excitation, correlated derivatives, the test point, and what to fly next."""
    yield from _motion_lines(state)
    yield from point_lines(state)
    yield _next_line(state)


def _next_line(state: LiveState) -> str:
    return f"next: {next_words(state)}"


def _motion_lines(state: LiveState) -> Iterator[str]:
    if math.isfinite(state.mass):
        yield _mass_words(state.mass, state.aircraft.airframe)
    if math.isfinite(state.cg_x):
        yield _cg_words(state.cg_x, state.aircraft.airframe)
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
            f"{pair.first} and {pair.second} are identified only together (correlation {pair.correlation:+.2f}): "
            "trust their ratio more than either"
        )


def _mass_words(mass: float, airframe: Airframe) -> str:
    if abs(mass / airframe.mass - airframe.mass_ratio(mass)) > 1e-9:
        return f"mass reads {mass:.4g} kg, which is not this aircraft's: {airframe.mass:.4g} kg as stated are taken"
    return f"mass {mass:.4g} kg as measured, {airframe.mass:.4g} kg as stated"


def _cg_words(cg_x: float, airframe: Airframe) -> str:
    if airframe.cg_ahead(cg_x) != cg_x:
        return f"cg_x reads {cg_x:.3g} m, further than a tenth of the span: the centre of gravity as stated is taken"
    return f"centre of gravity {cg_x:+.3g} m ahead of the stated one, as measured"


def point_lines(state: LiveState) -> Iterator[str]:
    """Lines on the present or last test point: its inputs, its faults, the bounds that it narrowed, and what to do."""
    point = state.point
    if point is None:
        return
    moves = ", ".join(f"{control} {degrees:.1f} deg" for control, degrees in _peaks_deg(point).items())
    gust = max(point.gusts.values(), default=math.nan)
    air = f", gusts {math.degrees(gust):.1f} deg" if math.isfinite(gust) else ""
    status = "under way" if point.moving else "flown"
    yield f"test point {status}: {moves or 'nothing'} for {point.seconds:.1f} s at {point.speed:.1f} m/s{air}"
    for fault in point.faults:
        yield f"test point: {fault}"
    gained = [(name, factor) for name, factor in _gained(state) if factor >= LEAST_GAIN]
    if gained:
        yield "test point has narrowed " + ", ".join(
            f"{name} {factor:.1f} times" for name, factor in gained[:MOST_NAMES]
        )
    yield f"test point: {point_decision(state)}"


def _peaks_deg(point: FlownPoint) -> dict[str, float]:
    """Control -> peak [deg], of the controls that a test point moved."""
    return {CONTROL_WORDS[n]: math.degrees(v) for n, v in point.peaks.items() if v >= LEAST_PEAK}


def point_decision(state: LiveState) -> str:
    """Whether to go on with the present test point, to stop, to repeat it, or to fly something else."""
    point = state.point
    if point is None:
        return "none flown yet"
    open_bounds = {n: state.to_go.get(n, math.inf) for n, bound in state.wanted.items() if bound > 0.0}
    lacking = {n: seconds for n, seconds in open_bounds.items() if seconds > 0.0}
    if not lacking:
        return "stop, every wanted bound is reached"
    within = sorted((seconds, n) for n, seconds in lacking.items() if seconds <= GO_ON_S)
    if point.moving and within:
        soon = ", ".join(f"{n} in {max(seconds, 1.0):.0f} s" for seconds, n in within[:MOST_NAMES])
        return f"go on, at this rate bounds are reached of {soon}"
    if point.moving:
        return "stop, this input brings no bound within a minute"
    if point.faults:
        return f"repeat it: {point.faults[0]}"
    if state.advice is not None and state.advice.peaks.keys() == _peaks_deg(point).keys():
        return "good; once more of the same axis brings most"
    return "good; need not be repeated"


def _gained(state: LiveState) -> list[tuple[str, float]]:
    """Identified derivatives with the ratio of their bounds before the test point and now, the largest first."""
    factors = [(d.name, state.before.get(d.name, math.inf) / d.std) for d in _identified(state) if d.std > 0.0]
    return sorted(((n, f) for n, f in factors if math.isfinite(f)), key=lambda pair: -pair[1])


def point_line(state: LiveState) -> str:
    """A completed test point in one line of at most LINE characters, for the telemetry link."""
    point = state.point
    assert point is not None
    reached = sum(seconds == 0.0 for seconds in state.to_go.values())
    moves = " ".join(f"{control} {degrees:.0f}" for control, degrees in _peaks_deg(point).items())
    worst = "" if state.advice is None else f", {state.advice.worst} {state.advice.now:.1f}x"
    verdict = "repeat" if point.faults else "good"
    return f"point {moves} deg: {verdict}; {reached}/{len(state.to_go)} there{worst}; next {next_short(state)}"[:LINE]


def next_short(state: LiveState) -> str:
    """What to fly next, in few characters."""
    if state.advice is None:
        return "-"
    peaks = " ".join(f"{math.degrees(v):.1f}" for v in state.advice.peaks.values())
    return f"{state.advice.manoeuvre} {peaks} deg {state.advice.seconds:.0f} s"


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
    size = " and ".join(f"{math.degrees(peak):.1f}" for peak in a.peaks.values())
    flown = f"{a.manoeuvre}, {size} deg for {a.seconds:.1f} s, then hands off to {LONG:.0f} s"
    return f"{flown} (bound of {a.worst} from {a.now:.1f} to {a.then:.1f} times the wanted one)"


def estimate_text(d: LiveDerivative) -> str:
    """Estimate and standard deviation, with as many decimals as the latter supports."""
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
    """Why a derivative is not identified, or that it contradicts the prior belief; else empty."""
    if not d.told:
        return d.why
    belief = state.aircraft.airframe.beliefs.get(d.name)
    if (
        belief is not None
        and belief.std > 0.0
        and abs(d.estimate - belief.value) > CONTRADICTION * math.hypot(d.std, belief.std)
    ):
        return "not what was believed, by more than three standard deviations"
    return ""


def _late_note(state: LiveState) -> str:
    return f" ({state.late} late scans still to be worked in)" if state.late else ""
