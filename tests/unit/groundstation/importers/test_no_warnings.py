"""What damaged logs hold warns of nothing: absurd and missing values are judged in silence."""

import numpy as np
import pytest

from groundstation.flight.contradictions import contradictions_of
from groundstation.importers.draft_names import unit_of
from groundstation.importers.evidence import _correct_swapped_tubes
from groundstation.importers.instances import with_primaries
from groundstation.importers.series import TimeSeries

pytestmark = pytest.mark.filterwarnings("error")
TIME = np.arange(0.0, 4.0, 0.1)
NOTHING = np.full(TIME.size, np.nan)


@pytest.mark.parametrize("second", [NOTHING, np.full(TIME.size, 3.0)])
def test_a_pitot_that_never_was_is_compared_with_none(second: np.ndarray) -> None:
    values = {
        "ARSP.DiffPress": NOTHING,
        "ARSP.Airspeed": NOTHING,
        "ARSP[1].DiffPress": second,
        "ARSP[1].Airspeed": second,
    }
    series = {n: TimeSeries(TIME, v) for n, v in values.items()}
    assert with_primaries(series).contradictions == ()
    assert _correct_swapped_tubes(dict(series)) == []


def test_units_and_contradictions_of_absurd_values() -> None:
    rng = np.random.default_rng(1)
    absurd = {
        n: 10.0 ** rng.uniform(-300, 300, TIME.size)
        for n in ("ax", "ay", "az", "p", "q", "r", "phi", "theta", "psi", "V")
    }
    stopped = np.repeat(TIME[::2], 2)  # each stamp twice
    for name in ("ax", "p"):
        assert unit_of(name, {n: n for n in absurd}, absurd, stopped).unit
    for hole in (slice(0, 20), slice(20, None)):
        absurd["V"][hole], absurd["vn"], absurd["ve"] = np.nan, NOTHING, np.ones(TIME.size)
        contradictions_of(TIME, {**absurd, "p_dynamic": absurd["ax"], "vd": absurd["ay"]})
