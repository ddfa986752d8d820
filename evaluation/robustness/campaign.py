"""What the fault campaigns share: what can be asked of them, and what is counted of all that struck.

Two back ends: the simulated cell (`faults.py`), and the machines' own protocols (`protocol_faults.py`).
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from rich.table import Table

from evaluation.harness import HIDDEN, Row, options
from evaluation.tables import markdown

Numbers = dict[str, float]


def asked(
    description: str | None,
    *,
    quick: str,
    out: str,
    kinds: Collection[str],
    own: Mapping[str, Any] = MappingProxyType({}),
) -> argparse.Namespace:
    """Return what is asked of a campaign whose faults are drawn by number; arguments as of `harness.options`.

    Raises:
        SystemExit: a kind that there is not.
    """
    faults = {
        "--faults": (1000, "how many"),
        "--only": {"type": int, "nargs": "*", "help": "numbers of the cases to run"},
        "--kinds": ((), "only faults of these kinds"),
        "--each": (1, "of --kinds, so many each"),
        "--base": (Path, "the stored run, made when missing; by default that of faults.py"),
        "--alone": (int, HIDDEN),
    }
    seed = (0, "of the draws")
    args = options(description, quick=quick, seed=seed, jobs="faults", out=out, own={**faults, **own})
    if unknown := set(args.kinds) - set(kinds):
        raise SystemExit(f"--kinds: got {', '.join(sorted(unknown))}; allowed: {', '.join(kinds)}")
    return args


def numbers(args: argparse.Namespace, quick: int = 1000) -> Sequence[int]:
    """Return the numbers of the cases to strike, `quick` of them with --quick."""
    return args.only or range(args.each if args.kinds else quick if args.quick else args.faults)


def crashed(why: str) -> Row:
    """Return what stands for a case whose program crashed: none of the three is good."""
    return {"unsafe": f"crashed: {why}", "record": "crashed", "continued": "crashed"}


def counted(
    rows: Sequence[Row], kinds: Iterable[str], key: Callable[[str], str], *, stops: bool = False
) -> tuple[Table, list[str], Numbers]:
    """Return the table of all faults and of each kind, those that did not end well, and the metrics.

    Args:
        rows: of each fault "kind" and "case" in words; "unsafe", "record" and "continued" say what is not good.
        kinds: in the order of the table.
        key: kind -> how its metrics begin.
        stops: rows say how long the arm moved on ("stop_s"), which is told.
    """
    metrics: Numbers = {}
    lines = []
    for kind in ("", *kinds):
        some = [row for row in rows if kind in ("", row["kind"])]
        if not some:
            continue
        counts: Numbers = {
            "faults": len(some),
            "safe_ends": sum(not row["unsafe"] for row in some),
            "records_lost": sum(bool(row["record"]) for row in some),
            "continued": sum(not row["continued"] for row in some),
        }
        line = [kind or "all", *map(str, counts.values())]
        if stops:
            times = [1e3 * row["stop_s"] for row in some if row["stop_s"] is not None]
            line.append(f"{np.median(times):.0f}, {max(times):.0f}" if times else "")
            counts |= {"stop_median_ms": float(np.median(times)), "stop_ms": max(times)} if times else {}
        lines.append(line)
        metrics |= {f"{key(kind)}_{name}".strip("_"): value for name, value in counts.items()}
    heads = ["fault", "struck", "safe ends", "records lost", "gone on with"]
    heads += ["arm stands after: median, most (ms)"] if stops else []
    bad = [
        f"{row['case']}: unsafe: {row['unsafe'] or '-'}; record: {row['record'] or '-'}; "
        f"goes on: {row['continued'] or 'yes'}"
        for row in rows
        if row["unsafe"] or row["record"] or row["continued"]
    ]
    return markdown(heads, lines), bad, metrics
