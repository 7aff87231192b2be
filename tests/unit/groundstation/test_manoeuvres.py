import numpy as np
import pytest

from groundstation.flight import Flight, FlightError
from groundstation.flight.manoeuvres import cut_to_manoeuvres, find_manoeuvres

T = np.arange(1200) * 0.05

KINDS = {
    "step": [(1, 1.0)],
    "doublet": [(1, 0.8), (-1, 0.8)],
    "3-2-1-1": [(1, 1.2), (-1, 0.8), (1, 0.4), (-1, 0.4)],
    "multistep": [(1, 0.5), (-1, 1.0), (1, 0.5)],
}


def pulses(start: float, size: float, shape: list[tuple[int, float]]) -> np.ndarray:
    out = np.zeros_like(T)
    for sign, length in shape:
        out[(start + length > T) & (start <= T)] = sign * size
        start += length
    return out


def flight(rng: np.random.Generator, **controls: np.ndarray) -> Flight:
    columns = {
        n: controls.get(n, np.zeros_like(T)) + 0.0012 * rng.standard_normal(T.size)
        for n in ("delta_a", "delta_r", "delta_e")
    }
    return Flight.build("x", T, columns)


@pytest.mark.parametrize("kind", KINDS)
def test_named_by_its_pulses(rng: np.random.Generator, kind: str) -> None:
    trim = 0.03 + 0.01 * np.sin(0.05 * T)  # slow re-trimming is no manoeuvre
    found = find_manoeuvres(flight(rng, delta_a=pulses(20, 0.1, KINDS[kind]), delta_e=trim))
    assert [m.kind for m in found] == [kind]
    (m,) = found
    assert m.controls == ("delta_a",)
    assert m.start == pytest.approx(19.5, abs=0.11)
    assert m.stop == pytest.approx(20 + sum(d for _, d in KINDS[kind]) + 2.5, abs=0.15)
    assert m.amplitude == pytest.approx(0.1, abs=0.01)


def test_two_manoeuvres_apart_and_one_of_two_controls(rng: np.random.Generator) -> None:
    a = pulses(10, 0.1, KINDS["doublet"]) + pulses(30, 0.1, KINDS["doublet"])
    r = pulses(31, 0.08, KINDS["doublet"])
    found = find_manoeuvres(flight(rng, delta_a=a, delta_r=r))
    assert [m.kind for m in found] == ["doublet", "mixed"]
    assert found[1].controls == ("delta_a", "delta_r")
    assert found[1].title == "aileron and rudder mixed"


def test_quiet_flight_has_none(rng: np.random.Generator) -> None:
    quiet = flight(rng)
    assert find_manoeuvres(quiet) == ()
    with pytest.raises(FlightError, match="no manoeuvre"):
        cut_to_manoeuvres(quiet, ())


def test_cut_keeps_the_windows_as_segments(rng: np.random.Generator) -> None:
    whole = flight(rng, delta_a=pulses(10, 0.1, KINDS["doublet"]), delta_r=pulses(14, 0.1, KINDS["doublet"]))
    found = find_manoeuvres(whole)
    assert len(found) == 2  # their windows overlap: the first keeps the shared samples
    part = cut_to_manoeuvres(whole, found)
    assert len(part.segments) == 2
    assert part.time[0] == pytest.approx(found[0].start)
    assert np.all(np.isin(part.time, whole.time))
    for segment, m in zip(part.segments, found, strict=True):
        assert part.time[segment][-1] <= m.stop


def test_no_window_reaches_across_a_gap(rng: np.random.Generator) -> None:
    whole = flight(rng, delta_a=pulses(20, 0.1, KINDS["doublet"]))
    keep = (T < 20.5) | (T > 25)
    broken = Flight.build("x", T[keep], {k: v[keep] for k, v in whole.columns.items()})
    for m in find_manoeuvres(broken):
        inside = broken.segment[(broken.time >= m.start) & (broken.time <= m.stop)]
        assert np.unique(inside).size == 1
