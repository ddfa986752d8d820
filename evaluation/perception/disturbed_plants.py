"""Real labelled plants as scanned and disturbed, by a strict rule: is the grasp right, and if not, was it doubted?

Every second scan of the five seedlings on which no confidence was fitted (trackplant3d_tomato1a), the tomato
salk_tomato_D26 and two hard plants (salk_benthi_D18, gavriel_maize_28.2.23_2); each as scanned, tilted by 20 and 40
degrees towards four sides, with a tenth of its points, cut in half, seen from one side, with noise and with outliers
(`real/strict.py`).

Keys of --json: strict_grasp_on_stem, into_leaf, root_ok (shares of the plants as scanned), tilt20 and tilt40 (share of
grasps on the stem), flagged_wrong and false_flags (share of wrong and of right grasps with a confidence below 0.75, a
refusal being wrong and doubted; all disturbances), strict_cases, strict_wrong.
"""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from anther.perception.stem.confidence import DOUBTFUL
from evaluation.harness import finish, options, progress
from evaluation.perception.real.strict import Judged, judged_all, metrics, reported, table
from evaluation.tables import markdown

BINS = (0.25, 0.5, DOUBTFUL, 0.9)
"""Between the groups of confidence that are drawn."""


def main() -> None:
    """Run, print the table and each wrong grasp, write --json and --figure."""
    figure = "how often grasps are right by their confidence"
    args = options(__doc__, quick="every 31st seedling", data="clouds", figure=figure)
    rows = judged_all(progress(reported(args.data, quick=args.quick), "plants"))
    wrong = [
        (row.plant, row.kind, "no answer" if row.refused else f"{row.confidence:.2f}")
        for row in rows
        if not row.on_stem
    ]
    parts = ["Every grasp that is off the stem:", markdown(("plant", "seen", "confidence"), wrong)] if wrong else []
    finish(args, metrics(rows), table(rows), *parts)
    if args.figure:
        draw_reliability(rows, args.figure)


def draw_reliability(rows: list[Judged], path: Path) -> None:
    """Draw how often grasps are right by their confidence; a refusal is no grasp."""
    given = [row for row in rows if not row.refused]
    claimed, right = (np.array([float(getattr(row, name)) for row in given]) for name in ("confidence", "on_stem"))
    figure, plot = plt.subplots(figsize=(5.2, 4.6), layout="constrained")
    plot.plot([0, 1], [0, 1], color="#5d6b62", lw=1, ls=":")
    group = np.digitize(claimed, BINS)
    for of in np.unique(group):
        mine = group == of
        x, share, count = claimed[mine].mean(), right[mine].mean(), mine.sum()
        error = np.sqrt(share * (1 - share) / count)
        plot.errorbar(x, share, yerr=error, color="#2f7d4f", marker="o", capsize=2)
        plot.annotate(f"{count}", (x, share), xytext=(7, -4), textcoords="offset points", fontsize=8)
    plot.axvline(DOUBTFUL, color="#b3402e", lw=1, label="warns below")
    plot.set(xlabel="confidence of the grasp", ylabel="share that is right", xlim=(0, 1.02), ylim=(-0.02, 1.04))
    plot.set_title(f"{len(given)} grasps of real plants, as scanned and disturbed", fontsize=10)
    plot.legend(loc="lower right")
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
