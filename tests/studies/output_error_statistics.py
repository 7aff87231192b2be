"""Statistics of the output-error estimates over many seeds: ratio of error to bound, and coverage.

Run: python -m tests.studies.output_error_statistics [seeds]. The last result is kept in docs/estimation.md.
"""

import sys

import numpy as np

from estimation.estimators.output_error import OutputErrorOptions, output_error
from estimation.models import load_model
from tests.estimation.truth import NOISE, STRONG, TRUE, Case, fly

PLAIN = {k: v for k, v in NOISE.items() if k in ("beta", "p", "r", "phi", "ay")}
CASES = {
    "white noise, exact inputs": Case(noise=PLAIN, servo=None),
    "all sensors noisy": Case(noise=NOISE, servo=None),
    "all sensors noisy, servo lag": Case(noise=NOISE, phase=0.0213),
    "light gusts": Case(noise=NOISE, gust=0.12, phase=0.0213),
    "gusts": Case(noise=NOISE, gust=0.3, phase=0.0213),
}


def study(case: Case, seeds: int, seed: int = 1) -> dict[str, np.ndarray]:
    """Error over bound, (seeds, parameters), for the plain and the corrected bound."""
    model = load_model("lateral")
    flights, _ = fly(case, np.random.default_rng(seed), seeds)
    rows: dict[str, list[list[float]]] = {"plain": [], "corrected": [], "relative": []}
    for flight in flights:
        result = output_error(model, flight, options=OutputErrorOptions(compile_="always"))
        e = [result.parameters[n] for n in STRONG]
        rows["plain"].append([(x.estimate - TRUE[x.name]) / x.std for x in e])
        rows["corrected"].append([(x.estimate - TRUE[x.name]) / x.std_coloured for x in e])
        rows["relative"].append([(x.estimate - TRUE[x.name]) / abs(TRUE[x.name]) for x in e])
    return {k: np.array(v) for k, v in rows.items()}


def main() -> None:
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    chosen = sys.argv[2:] or list(CASES)
    for name in chosen:
        z = study(CASES[name], seeds)
        print(f"\n{name}, {seeds} seeds")
        print("parameter   rms error/bound   rms error/corrected   95 % coverage corrected   bias %   rms %")
        for i, parameter in enumerate(STRONG):
            plain, corrected, relative = (z[k][:, i] for k in ("plain", "corrected", "relative"))
            print(
                f"{parameter:<10}{np.sqrt(np.mean(plain**2)):12.2f}{np.sqrt(np.mean(corrected**2)):20.2f}"
                f"{100 * np.mean(np.abs(corrected) < 1.96):22.1f}{100 * relative.mean():18.2f}"
                f"{100 * np.sqrt(np.mean(relative**2)):9.2f}"
            )
        c = z["corrected"]
        print(f"all: corrected rms {np.sqrt(np.mean(c**2)):.2f}, coverage {100 * np.mean(np.abs(c) < 1.96):.1f} %")


if __name__ == "__main__":
    main()
