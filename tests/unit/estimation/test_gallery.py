"""Two of the awkward flights of `tests/studies/gallery.py`, with truth from JSBSim; the rest is a study."""

from pathlib import Path

import pytest

pytest.importorskip("jsbsim", reason="JSBSim is not installed: pip install '.[jsbsim]'")

from tests.studies.gallery import KINDS, METHODS, ROWS, outcome, row_named  # needs jsbsim


@pytest.mark.parametrize("title", ["12 bits", "MATLAB file in degrees, knots and g"])
def test_the_recommended_method_is_not_off(title: str, tmp_path: Path) -> None:
    kind = next(k for k in KINDS if k.name == "L17")
    found = outcome(row_named(title), kind, 10, tmp_path)
    assert found.recommended in METHODS
    assert len(found.errors[found.recommended]) >= 12  # of fourteen derivatives
    assert not found.off(found.recommended)


def test_every_row_has_a_name_of_its_own() -> None:
    assert len({r.title for r in ROWS}) == len(ROWS) == 10
