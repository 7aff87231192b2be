"""`sideslip frequency` and `sideslip.frequency_response`, as people and scripts meet them."""

import json
from pathlib import Path

import numpy as np
import pytest

import sideslip as ss
from groundstation.flight import Flight, write_flight
from tests.unit.estimation.frequency.linear_aircraft import ROLL, Case, fly

KEYS = ("frequency", "magnitude", "phase", "coherence", "std_magnitude", "std_phase")


@pytest.fixture(scope="module")
def flight() -> Flight:
    return fly({"delta_a": ROLL}, "p", Case(30.0), np.random.default_rng(40))


@pytest.fixture
def path(flight: Flight, tmp_path: Path) -> Path:
    write_flight(flight, tmp_path / "sweep.csv")
    return tmp_path / "sweep.csv"


def run(*words: object) -> int:
    with pytest.raises(SystemExit) as ended:
        ss.main(["frequency", *(str(w) for w in words)])
    return int(ended.value.code or 0)


def test_everything_that_is_asked_for_is_written(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = path.parent
    words = ("--input", "delta_a", "--output", "p", "--fit", "--points", 20)
    assert run(path, *words, "--json", folder / "f.json", "-o", folder / "f.svg", "--report", folder / "page") == 0
    out = capsys.readouterr().out
    assert "H = K exp(-tau s) / (s + 1/T_R)" in out
    assert "no levels: name the class" in out
    found = json.loads((folder / "f.json").read_text())
    assert len({len(found[k]) for k in KEYS}) == 1
    assert all(np.isfinite(found[k]).all() for k in KEYS)
    omega = np.array(found["frequency"])
    np.testing.assert_allclose(found["magnitude"], np.abs(ROLL.at(omega)), rtol=0.35)
    assert found["fit"]["parameters"]["tau"]["estimate"] == pytest.approx(0.1, abs=0.04)
    assert (found["fit"]["form"], len(found["fit"]["denominator"])) == ("roll", 2)
    assert (folder / "f.svg").read_text().startswith("<?xml")
    page = (folder / "page" / "index.html").read_text()
    assert "Transfer function" in page
    assert "data:image/svg+xml" in page
    assert (folder / "page" / "tables" / "frequency_response.csv").read_text().count("\n") == len(omega) + 1


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--input", "delta_r", "--output", "p"], "lacks 'delta_r'"),
        (["--input", "delta_a", "--output", "q"], "lacks 'q'"),
        (["--input", "delta_a", "--output", "p", "--with", "delta_e"], "lacks 'delta_e'"),
        (["--input", "delta_a", "--output", "p", "--form", "2/1"], "form 2/1"),
        (["--input", "delta_a", "--output", "p", "--band", "1"], "give two frequencies"),
        (["--input", "delta_a", "--output", "p", "--band", "a,b"], "give numbers"),
        (["--input", "delta_a", "--output", "p", "--windows", "nan"], "give numbers"),
        (["--input", "delta_a", "--output", "p", "--class", "V"], "class 'V'"),
        (["--input", "delta_a", "--output", "p", "-o", "x.doc"], "no known kind of picture"),
        (["--input", "delta_a", "--output", "p", "--aircraft", "none"], "none"),
    ],
)
def test_what_cannot_be_used_is_one_sentence(
    words: list[str], said: str, path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(path, *words) == 2
    err = capsys.readouterr().err
    assert len(err.splitlines()) == 1
    assert said.replace("lacks ", "").strip("'") in err


def test_a_hostile_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Infinities, empty cells and a column of nonsense sizes: one sentence, no trace."""
    rows = [f"{0.05 * k},{'inf' if k % 7 else ''},{1e300 * (-1) ** k}" for k in range(400)]
    (tmp_path / "bad.csv").write_text("time,delta_a,p\n" + "\n".join(rows) + "\n")
    assert run(tmp_path / "bad.csv", "--input", "delta_a", "--output", "p") == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_in_a_notebook(flight: Flight, tmp_path: Path) -> None:
    found = ss.frequency_response(flight, "delta_a", "p", points=20).fit()
    table = found.to_pandas()
    assert tuple(table.columns) == KEYS
    assert "fit roll" in repr(found)
    assert "T_R" in found.summary()
    assert found.save(tmp_path / "f.json").is_file()
    assert found.save(tmp_path / "f.png").stat().st_size > 10_000
    axes = found.plot()
    assert [a.get_xscale() for a in axes] == ["log"] * 3
    from matplotlib import pyplot as plt

    plt.close("all")
