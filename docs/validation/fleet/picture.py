"""Each aircraft of a fleet against the others, derivative by derivative: python docs/validation/fleet/picture.py CAMPAIGN OUT.png

Each point is the mean over an aircraft's flights in parts of the mean over all, its bar 95 % by the scatter of the flights and
their bounds, whichever is larger.
"""

import sys
from pathlib import Path

import matplotlib as mpl
import pandas as pd

mpl.use("agg")
from matplotlib import pyplot as plt

SHOWN = ("Cl_da", "Cl_p", "Cl_beta", "Cn_beta", "Cn_r", "Cn_dr", "CY_beta")


def main(campaign: Path, picture: Path) -> None:
    table = pd.read_parquet(campaign / "results")
    table = table[
        (table.kind == "estimate") & (table.status == "ok") & table.identifiable & table.parameter.isin(SHOWN)
    ]
    figure, axes = plt.subplots(figsize=(8.0, 3.6), layout="constrained")
    fleet = sorted(table.configuration.unique())
    for k, name in enumerate(fleet):
        of_name = table[table.configuration == name].groupby("parameter")
        mean, count = of_name.estimate.mean(), of_name.estimate.count()
        spread = pd.concat([of_name.estimate.std(), of_name.std_coloured.mean()], axis=1).max(axis=1) / count**0.5
        whole = table.groupby("parameter").estimate.mean()
        places = [SHOWN.index(p) + 0.15 * (k - (len(fleet) - 1) / 2) for p in mean.index]
        axes.errorbar(
            places,
            mean / whole[mean.index],
            1.96 * spread / whole[mean.index].abs(),
            fmt="o",
            ms=4,
            capsize=2,
            label=name,
        )
    axes.axhline(1.0, color="0.7", lw=0.8, zorder=0)
    axes.set_xticks(range(len(SHOWN)), SHOWN)
    axes.set_ylabel("part of the fleet's mean")
    axes.legend(ncols=len(fleet), loc="upper center", frameon=False)
    figure.savefig(picture, dpi=110)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
