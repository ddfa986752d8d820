"""Real labelled plants as scanned and disturbed, by a strict rule: is the grasp right, and if not, was it doubted?

    python tools/record.py experiments/disturbed_plants.py --page docs/reports/real_plants.md

Every sixth seedling of trackplant3d_tomato1a, the tomato and maize of real_plants.py and two hard plants
(salk_benthi_D18, gavriel_maize_28.2.23_2); each as scanned, tilted by 20 and 40 degrees towards four sides, with a
tenth of its points, cut in half, seen from one side, with noise and with outliers (`real/strict.py`).

Keys of --json: strict_grasp_on_stem, into_leaf, root_ok (shares of the plants as scanned), tilt20 and tilt40 (share of
grasps on the stem), flagged_wrong and false_flags (share of wrong and of right grasps with a confidence below 0.75, a
refusal being wrong and doubted; all disturbances), strict_cases, strict_wrong.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from grasping_page import insert
from real.plants import HARD, LABELLED, labelled_plants
from real.strict import judged_all, metrics, table
from rich.console import Console
from rich.progress import track
from wide_truth import markdown

from anther.files import write_json

DATA = Path(os.environ.get("ANTHER_DATA", Path(__file__).parents[2] / "shared" / "data"))


def main() -> None:
    """Run, print the table and each wrong grasp, write --json and --page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DATA / "clouds", help="folder of the clouds")
    parser.add_argument("--json", type=Path, help="write the metrics here")
    parser.add_argument("--page", type=Path, help="write the table into this docs page")
    parser.add_argument("--every", type=int, default=6, help="of the 93 seedlings every so many")
    parser.add_argument("--quick", action="store_true", help="every 31st seedling")
    parser.add_argument("--seed", type=int, default=0, help="for uniformity; what is random is the same in each run")
    args = parser.parse_args()
    console = Console()
    plants = list(labelled_plants(args.data, 31 if args.quick else args.every, LABELLED + HARD))
    rows = judged_all(track(plants, "plants", console=console))
    found = table(rows)
    console.print(found)
    for row in rows:
        if not row.on_stem:
            console.print(
                f"{row.plant}, {row.kind}: grasp off the stem, confidence {row.confidence:.2f}", highlight=False
            )
    if args.page:
        insert(args.page, markdown(found))
    if args.json:
        write_json(args.json, metrics(rows))


if __name__ == "__main__":
    main()
