"""Statistics of the frequency domain: coverage of frequency responses and fits, and output error there against the time domain.

`python -m tests.studies.frequency_statistics [responses] [fits] [estimates] [--seeds 20]`: all three unless named. Responses
and fits are of a linear aircraft with a closed form (`tests.unit.estimation.frequency.linear_aircraft`), estimates of flights of
`second_truth`. The last result is kept in docs/frequency.md.
"""

import argparse

import numpy as np

from estimation.estimators.frequency_domain.estimate import frequency_output_error
from estimation.estimators.output_error import output_error
from estimation.estimators.result import Result
from estimation.frequency.response import ResponseOptions, frequency_response
from estimation.frequency.transfer import fit_transfer
from estimation.models import load_model
from groundstation.flight import Flight
from tests.studies.live_statistics import second_flights
from tests.unit.estimation.frequency.linear_aircraft import DUTCH_ROLL, ROLL, Case, Plant, fly

PLANTS = {"roll": (ROLL, "delta_a", "p"), "dutch roll": (DUTCH_ROLL, "delta_r", "r")}
CASES = tuple(
    Case(seconds, kind=kind, noise=noise, colour=colour)
    for kind in ("multisine", "chirp", "doublets")
    for seconds, noise, colour in ((30.0, 0.01, 0.0), (90.0, 0.02, 0.8))
)
TRUE = {
    "roll": {"K": 8.0, "T_R": 0.2, "tau": 0.1},
    "dutch roll": {"K": 4.0, "b0": 1.0, "zeta_d": 0.15, "omega_d": 4.5, "tau": 0.0},
}
TOLD = ("CY_beta", "CY_r", "CY_dr", "Cl_beta", "Cl_p", "Cl_r", "Cl_da", "Cl_dr", "Cn_beta", "Cn_p", "Cn_r", "Cn_dr")
GUST = 0.1  # deg rms of sideslip


def flown(plant: Plant, control: str, output: str, case: Case, seed: int) -> Flight:
    return fly({control: plant}, output, case, np.random.default_rng([seed, 7]))


def responses(seeds: int) -> None:
    """Points within 1.96 of their error, median error."""
    print("| plant | input | s | noise | points | magnitude % | phase % | median error % |")
    print("|---|---|---|---|---|---|---|---|")
    for name, (plant, control, output) in PLANTS.items():
        for case in CASES:
            size, turn, error = [], [], []
            for seed in range(seeds):
                options = ResponseOptions(with_=(), points=40)
                r = frequency_response(flown(plant, control, output, case, seed), control, output, options)
                H = plant.at(r.omega)
                size += list(np.abs(r.magnitude - np.abs(H)) < 1.96 * r.std)
                turn += list(np.abs(np.angle(r.H / H)) < 1.96 * r.std_phase)
                error += list(r.std / r.magnitude)
            shown = f"{100 * np.mean(size):.0f} | {100 * np.mean(turn):.0f} | {100 * np.median(error):.1f}"
            print(
                f"| {name} | {case.kind} | {case.seconds:g} | {case.noise:g}, {case.colour:g} | {len(size)} | {shown} |"
            )


def fits(seeds: int) -> None:
    """Bias, rms error, rms over bound and coverage of every unknown of the fits."""
    print("| plant | input | unknown | bias % | rms % | rms / bound | covered % |")
    print("|---|---|---|---|---|---|---|")
    for name, (plant, control, output) in PLANTS.items():
        for kind in ("multisine", "doublets"):
            off: dict[str, list[tuple[float, float]]] = {n: [] for n in TRUE[name]}
            for seed in range(seeds):
                case = Case(60.0, kind=kind, colour=0.5)
                options = ResponseOptions(with_=())
                flight = flown(plant, control, output, case, seed + 100)
                fit = fit_transfer(frequency_response(flight, control, output, options))
                for n, p in fit.parameters.items():
                    off[n].append((p.estimate - TRUE[name][n], p.std))
            for n, pairs in off.items():
                error, bound = np.array(pairs).T
                scale = 100 / (TRUE[name][n] or 0.1)  # of a delay of none: in tenths of a second
                score = error / bound
                print(
                    f"| {name} | {kind} | {n} | {scale * error.mean():+.1f} | {scale * np.sqrt(np.mean(error**2)):.1f} | "
                    f"{np.sqrt(np.mean(score**2)):.2f} | {100 * np.mean(np.abs(score) < 1.96):.0f} |"
                )


def estimates(seeds: int) -> None:
    """Both methods over flights of the second simulator."""
    model = load_model("lateral", "cdfp")
    found: list[tuple[Result, Result]] = []
    truths = []
    for k, (columns, truth) in enumerate(second_flights(seeds, GUST)):
        flight = Flight.build(f"f{k}", columns["time"], {n: v for n, v in columns.items() if n != "time"})
        found.append((output_error(model, flight), frequency_output_error(model, flight)))
        truths.append(truth)
    print(
        "| derivative | ml: bias % | rms % | covered % | ml-frequency: bias % | rms % | covered % | apart, rms in bounds |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for n in TOLD:
        true = np.array([t[n] for t in truths])
        cells = []
        for which in (0, 1):
            error = np.array([f[which].values[n] for f in found]) - true
            bound = np.array([f[which].parameters[n].std_coloured for f in found])
            size = 100 / np.mean(np.abs(true))
            covered = 100 * np.mean(np.abs(error) < 1.96 * bound)
            cells.append(f"{size * error.mean():+.1f} | {size * np.sqrt(np.mean(error**2)):.1f} | {covered:.0f}")
        apart = [(b.values[n] - a.values[n]) / a.parameters[n].std_coloured for a, b in found]
        print(f"| {n} | {cells[0]} | {cells[1]} | {np.sqrt(np.mean(np.square(apart))):.2f} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", nargs="*", default=["responses", "fits", "estimates"])
    parser.add_argument("--seeds", type=int, default=20)
    asked = parser.parse_args()
    for name in asked.what:
        {"responses": responses, "fits": fits, "estimates": estimates}[name](asked.seeds)
        print(flush=True)


if __name__ == "__main__":
    main()
