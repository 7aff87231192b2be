"""Long records are thinned without folding, where the model's motion allows it, and that is said."""

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from estimation.models import load_model
from estimation.models.base import Model
from estimation.session.thinned import LONG, low_passed, thinned
from groundstation.flight import Flight

ROLL_MODE = 12.0  # rad/s
ROLL = f"""
equations = '''
p_dot = L_p*p + L_da*delta_a
'''
states = ["p"]
inputs = [{{ name = "delta_a", control = true }}]
outputs = ["p"]
parameters = [{{ name = "L_p", unit = "1/s", start = {-ROLL_MODE / 2} }}, {{ name = "L_da", unit = "1/s2", start = -10.0 }}]
"""


@pytest.fixture
def model(tmp_path: Path) -> Model:
    path = tmp_path / "roll.toml"
    path.write_text(ROLL)
    return load_model(str(path))


def rolling(rate: float, samples: int, seed: int = 7) -> Flight:
    """A roll mode driven by an aileron that moves every 0.4 s, exact at the samples where the aileron is straight."""
    rng = np.random.default_rng(seed)
    time = np.arange(samples) / rate
    corners = np.arange(0.0, time[-1] + 1.0, 0.4)
    aileron = np.interp(time, corners, 0.05 * rng.standard_normal(corners.size))
    decay = np.exp(-ROLL_MODE / rate)
    p = lfilter([0.5, 0.5], [1.0, -decay], -40.0 * aileron * (1 - decay) / ROLL_MODE)
    return Flight.build("roll", time, {"p": p + 0.002 * rng.standard_normal(samples), "delta_a": aileron})


def test_what_lies_above_the_new_rate_does_not_fold_and_what_lies_below_stays() -> None:
    time = np.arange(4000) / 250.0
    slow = np.sin(2 * np.pi * 2.3 * time)
    flight = Flight.build("f", time, {"p": slow + 0.5 * np.sin(2 * np.pi * 48.0 * time)})  # at 50 Hz this would be 2 Hz
    thin = low_passed(flight, 5, ["p"])
    assert thin.sample_interval == pytest.approx(0.02)
    inner = slice(40, -40)
    assert np.abs(thin["p"] - slow[::5])[inner].max() < 5e-3  # the ripple of the filter; folded it would be 0.5


def test_a_hole_stays_a_hole() -> None:
    time = np.arange(3000) / 200.0
    beta = np.sin(time)
    beta[900:1100] = np.nan
    thin = low_passed(Flight.build("f", time, {"beta": beta}), 4, ["beta"])
    missing = np.isnan(thin["beta"])
    assert missing[228:272].all()
    assert not missing[:224].any()
    assert not missing[276:].any()


def test_a_long_record_is_thinned_to_what_its_fastest_mode_needs(model: Model) -> None:
    (thin,) = thinned(model, [rolling(400.0, LONG + 5000)])
    assert thin.sample_interval == pytest.approx(0.02)
    (note,) = [n.text for n in thin.notes if "thinned" in n.text]
    assert "thinned to 50 Hz" in note
    assert float(note.split("fastest mode has ")[1].split()[0]) == pytest.approx(ROLL_MODE, rel=0.15)


def test_a_short_record_is_left_as_it_is(model: Model) -> None:
    flight = rolling(400.0, LONG // 2)
    assert thinned(model, [flight])[0] is flight
