"""Models and effects of strangers: very long, in a chain, in a circle, with bounds that are none: a sentence each."""

from pathlib import Path

import pytest

from daq.utilities import limits
from estimation.errors import EffectError, ModelError
from estimation.gap.effects.catalogue import load_effects
from estimation.models.load import read_model

HEAD = """states = [{ name = "x", unit = "1" }]
outputs = [{ name = "x", unit = "1" }]
parameters = [{ name = "k", unit = "1", start = 1.0 }]
"""


def model(tmp_path: Path, lines: list[str]) -> Path:
    path = tmp_path / "own.toml"
    path.write_text(HEAD + "equations = [\n" + ",\n".join(f'"{line}"' for line in lines) + "\n]\n")
    return path


def test_a_chain_of_two_thousand_equations_is_a_sentence(tmp_path: Path) -> None:
    chain = ["a0 = k", *(f"a{n} = a{n - 1} + 1.0" for n in range(1, 2000)), "x_dot = -a1999 * x"]
    with pytest.raises(ModelError, match="at most"):
        read_model(model(tmp_path, chain))
    with pytest.raises(ModelError, match="in a chain"):
        read_model(model(tmp_path, [*chain[:300], "x_dot = -a299 * x"]))


def test_a_long_circle_is_told_by_its_end(tmp_path: Path) -> None:
    circle = [f"a{n} = a{(n + 1) % 900} + k" for n in range(900)]
    with pytest.raises(ModelError, match="run in a circle"):
        read_model(model(tmp_path, [*circle, "x_dot = -a0 * x"]))


def test_a_wide_model_and_one_that_uses_much_twice_are_taken(tmp_path: Path) -> None:
    wide = [*(f"a{n} = k * {n}.0" for n in range(300)), "x_dot = -a7 * x"]
    assert len(read_model(model(tmp_path, wide)).equations) == 301
    twice = ["a0 = k", *(f"a{n} = a{n - 1} + a{n - 1}" for n in range(1, 60)), "x_dot = -x"]
    assert len(twice) < limits.MODEL_LINES
    read_model(model(tmp_path, twice))


BOUNDS = ['"wide"', "[1.0, 2.0]", "nan", "-inf", "1e300", "true", "{ a = 1 }"]


@pytest.mark.parametrize("key", ["lower", "upper", "typical"])
@pytest.mark.parametrize("value", BOUNDS)
def test_a_bound_that_is_no_number_is_a_sentence(key: str, value: str, tmp_path: Path) -> None:
    numbers = {"lower": "-1.0", "upper": "1.0", "typical": "0.1"} | {key: value}
    path = tmp_path / "effects.toml"
    path.write_text(
        '[[effect]]\nname = "own"\ntitle = "own"\n[[effect.form]]\nterms = { Cn = "k_own * beta" }\n'
        + "[[effect.form.parameters]]\n"
        + 'name = "k_own"\nunit = "1"\n'
        + "".join(f"{k} = {v}\n" for k, v in numbers.items())
    )
    with pytest.raises(EffectError, match=r"effects\.toml"):
        load_effects(path)
