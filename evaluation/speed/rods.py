"""Speed of the rod engine beside its floor and its peers: one table, measured in one run.

    python -m evaluation.speed.rods --dismech CHECKOUT --pyelastica PYTHON_THAT_HAS_IT

The reference case is the peers' 86-node 3-D network (51-node stem, five branches of 7 edges, E 200 MPa, r 3 mm,
undamped, at rest and unstressed, gravity on at t = 0), node 20 shaken 2 mm at 30 Hz along x, dt 1 ms, force tolerance
1e-9 N; PyDiSMech runs it with implicit Euler, P19 to the letter and lumped masses ("paper"). Times are processor times
of one core after compilation, the best of the repeats, all set-up of `simulate` included; only the response map and
the second start are wall times.

Keys of the --json file: us_per_newton_86, s_per_sim_s_86 (no twist), us_per_newton_86_twist, s_per_sim_s_86_twist: as
PyDiSMech runs it; with _euler (consistent discretisation), _damped (midpoint, viscous time 0.1 ms), _midpoint
(undamped) appended; newton_per_step_86 of each; scaling_slope and memory_slope (exponent of time per Newton iteration
and of memory over nodes, 86 to 20 000), memory_bytes_per_node; response_map_s (200 nodes, 50 grips x 200 frequencies x
3 directions x 10 flowers), response_map_cpu_s; second_start_s (a new process, compiled code on disk, from its start to
10 steps done), second_start_cpu_s, second_start_import_share.
Each time has also _median, _max and _floor. With peers: dismech_* and pyelastica_*; a *_ratio is the peer's time over
ours, both of one round.

The floor and how it is counted: see BYTES below.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from anther.core import AntherError
from anther.core.files import read_json
from anther.rods import Clamp, Drive, Rods, response_map, simulate, with_gravity_equilibrium
from evaluation.harness import ONE_THREAD, finish, options, progress
from evaluation.speed.networks import bush, reference_network, tall_plant, tips
from evaluation.speed.peers import Case, run_dismech, run_pyelastica
from evaluation.speed.roofline import Roofline, measure_roofline
from evaluation.tables import markdown

# The floor of a Newton iteration is stated from two counts per node.
# Operations: count_operations.py runs the kernels on numbers that count, when this benchmark starts. On the 86-node
# network it finds 2627 (a multiply-add is two): forces and matrix 1886, factoring 550, solving 158, the rest 33. Rods
# without twist run the same kernels with a very stiff twist.
# Bytes: every array crosses once in each sweep that needs it, 8 bytes a number. Constants 23 read; positions,
# velocities, directors 22 read and 12 written; matrix and residual (52 numbers) written by the assembly, read and
# written by the factoring, read up and down by the solve: 5 x 52.
BYTES = 8.0 * (23 + 22 + 12 + 5 * 52)


def operations_per_node() -> float:
    """Floating-point operations of one Newton iteration over the nodes."""
    with tempfile.TemporaryDirectory() as folder:
        counts = Path(folder) / "counts.json"
        script = Path(__file__).with_name("count_operations.py")
        subprocess.run([sys.executable, script, "--json", counts], check=True, stdout=subprocess.DEVNULL)
        return float(read_json(counts)["operations_per_node_total"])


class Run(NamedTuple):
    """One simulation: processor seconds, Newton iterations, where the observed node ended [m]."""

    seconds: float
    iterations: int
    end: Any


def cost(case: Case, integrator: Any = "midpoint", gravity: Any = (0, 0, -9.81)) -> Run:
    """Simulate the case, keeping only its ends; the time holds all set-up."""
    drive = Drive(case.grip, np.array([1.0, 0, 0]), case.amplitude, case.hertz)
    begin = time.process_time()
    run = simulate(
        case.rods, Clamp(np.array([0, 1])), drive, case.seconds, case.dt, gravity=gravity, integrator=integrator,
        tolerance=case.tolerance, start="scanned", record_every=case.steps,
    )  # fmt: skip
    return Run(time.process_time() - begin, run.newton_iterations, run.positions[-1, case.observe])


def variants(case: Case) -> list[tuple[str, str, Case, str]]:
    """The reference as PyDiSMech runs it, and in three other ways: key, words, case, integrator."""
    rods = case.rods
    paper, damped = replace(rods, discretisation="paper"), replace(rods, viscous_time=1e-4)
    return [
        ("", "as PyDiSMech runs it", replace(case, rods=paper), "implicit_euler"),
        ("_euler", "implicit Euler", case, "implicit_euler"),
        ("_damped", "midpoint, viscous time 0.1 ms", replace(case, rods=damped), "midpoint"),
        ("_midpoint", "midpoint, undamped", case, "midpoint"),
    ]


def reference_rows(case: Case, operations: float, ceilings: Roofline, repeats: int) -> list[Row]:
    """Time per Newton iteration and per simulated second of the reference network, in all variants."""
    tail, twist = ("_twist", "with twist") if case.twist else ("", "no twist")
    limits, rows = (45.0, 0.25) if case.twist else (25.0, 0.12), []
    floor = ceilings.floor(operations * len(case.rods.nodes), BYTES * len(case.rods.nodes))
    for variant, how, shaken, integrator in progress(variants(case), f"86 nodes, {twist}"):
        key, words = tail + variant, f"86 nodes, {twist}, {how}"
        try:
            cost(replace(shaken, steps=3), integrator)
            runs = [cost(shaken, integrator) for _ in range(repeats)]
        except AntherError as failure:
            rows.append(Row(key, f"{words}: fails ({failure})", "", (), more={f"failed_86{key}": 1.0}))
            continue
        per_step = runs[0].iterations / case.steps
        each = tuple(1e6 * run.seconds / run.iterations for run in runs)
        seconds = tuple(run.seconds / case.seconds for run in runs)
        more, named = {f"newton_per_step_86{key}": per_step}, f"{words}: simulated second ({per_step:.1f} a step)"
        rows.append(Row(f"us_per_newton_86{key}", f"{words}: Newton iteration", "µs", each, 1e6 * floor, limits[0]))
        rows.append(Row(f"s_per_sim_s_86{key}", named, "s", seconds, floor * per_step / case.dt, limits[1], more))
    return rows


def scaling_rows(ceilings: Roofline, operations: float, shoots: tuple[int, ...], repeats: int) -> list[Row]:
    """How time per Newton iteration and memory grow with the nodes.

    Bushes without gravity (see `networks.bush`), with twist, a viscous time of 0.1 ms, 2 mm at 30 Hz from rest,
    tolerance 1e-7 N: forces of 20 000 nodes round to some 1e-8 N. Memory is the largest sum of numpy's arrays, and
    Python objects, at any time (the kernels allocate nothing), without the smallest network, where objects count.
    """
    nodes, times, memory = [], [], []
    made = (replace(bush(count), viscous_time=1e-4) for count in shoots)
    cases = [Case(rods, tolerance=1e-7, twist=True, steps=max(10, 34_000 // len(rods.nodes))) for rods in made]
    cost(cases[0], gravity=(0, 0, 0))
    for case in progress(cases, "nodes"):
        runs = [cost(case, gravity=(0, 0, 0)) for _ in range(repeats)]
        nodes.append(len(case.rods.nodes))
        times.append(min(run.seconds / run.iterations for run in runs))
        memory.append(peak_memory(replace(case, steps=3)))
    span, tail, last = f"{nodes[0]} to {nodes[-1]} nodes", f"{nodes[1]} to {nodes[-1]} nodes", nodes[-1]
    floor = 1e3 * ceilings.floor(operations * last, BYTES * last)
    words = f"{last} nodes, with twist: Newton iteration"
    each = {f"us_per_newton_{n}_twist_per_node": 1e6 * t / n for n, t in zip(nodes, times, strict=True)}
    per_node = float(np.polyfit(nodes[1:], memory[1:], 1)[0])
    exponents = _exponent(nodes, times), _exponent(nodes[1:], memory[1:])
    return [
        Row(f"ms_per_newton_{last}_twist", words, "ms", (1e3 * times[-1],), floor, more=each),
        Row("scaling_slope", f"time, {span}: exponent", "", (exponents[0],), limit=1.1),
        Row("memory_slope", f"memory, {tail}: exponent", "", (exponents[1],), limit=1.1),
        Row("memory_bytes_per_node", f"memory, {tail}: per node", "bytes", (per_node,)),
    ]


def _exponent(sizes: Any, values: Any) -> float:
    return float(np.polyfit(np.log(sizes), np.log(values), 1)[0])


def peak_memory(case: Case) -> float:
    """Bytes of the arrays and objects that the simulation holds at most."""
    tracemalloc.start()
    cost(case, gravity=(0, 0, 0))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


def map_rows(ceilings: Roofline, frequencies: int, repeats: int) -> list[Row]:
    """The response map of a 200-node plant; wall time, and processor time for information."""
    bare = tall_plant()
    clamp = Clamp.root(bare)
    plant, flowers = with_gravity_equilibrium(bare, clamp), tips(bare)
    hertz, grips = np.geomspace(1, 35, frequencies), np.arange(20, 120, 2)
    response_map(plant, clamp, grips, np.eye(3), hertz[:2], observe=flowers)
    walls, processor = [], []
    for _ in progress(range(repeats), "response map"):
        begin, begin_cpu = time.perf_counter(), time.process_time()
        response_map(plant, clamp, grips, np.eye(3), hertz, observe=flowers)
        walls.append(time.perf_counter() - begin)
        processor.append(time.process_time() - begin_cpu)
    words = f"response map, 200 nodes, 50 grips x {frequencies} frequencies x 3 directions x {len(flowers)} flowers"
    floor = ceilings.floor(map_flops(plant, grips, flowers) * frequencies, 0)
    more = {"response_map_cpu_s": min(processor), "response_map_frequencies": frequencies}
    return [Row("response_map_s", words, "s wall", tuple(walls), floor, 0.5, more)]


def map_flops(plant: Rods, grips: Any, seen: Any) -> float:
    """Operations of the map per frequency, a complex product as 6 operations, a sum as 2.

    The matrix is set up (48 numbers a node, K + i w C - w^2 M, 4 operations) and factored (313 products, 260 sums a
    node). Each of the three columns of a grip is eliminated on its way to the root, then substituted on all ways from
    the root to what is wanted (42 products, 38 sums a row each time). Counts of products and sums: count_operations.py.
    """
    above = plant.parent
    depth = np.zeros(len(above))
    wanted = np.zeros(len(above), dtype=bool)
    for j in range(1, len(above)):
        depth[j] = depth[above[j]] + 1
    for node in [*grips, *seen]:
        while node >= 0:
            wanted[node] = True
            node = above[node]  # noqa: PLW2901
    row = 42 * 6 + 38 * 2
    return len(above) * (48 * 4 + 313 * 6 + 260 * 2) + 3 * row * float(depth[grips].sum() + len(grips) * wanted.sum())


START = """
import time; begin = time.time()
import numpy as np; from evaluation.speed.networks import reference_network
from anther.rods import Clamp, Drive, simulate
imported = time.time()
simulate(reference_network(), Clamp([0, 1]), Drive(20, np.array([1.0, 0, 0]), 2e-3, 30.0), 0.01, 1e-3, start="scanned")
print(begin, imported, time.time(), time.process_time())
"""
LEAST_START = "import time, kernel; kernel.add_one(1.0); print(0, 0, time.time(), time.process_time())"
LEAST_KERNEL = "import numba\n@numba.njit(cache=True)\ndef add_one(a): return a + 1.0\n"


def start_rows(repeats: int) -> list[Row]:
    """Time from the start of a new process to ten steps done. Its floor is a process with one trivial numba kernel."""
    totals, processor, imports, least = [], [], [], []
    here = str(Path(__file__).parents[2])
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "kernel.py").write_text(LEAST_KERNEL)
        _start(LEAST_START, folder)  # compiles
        _start(START, here)  # compiles, where that is still to do
        for _ in progress(range(repeats), "second start"):
            begin, _, _, end, _ = _start(LEAST_START, folder)
            least.append(end - begin)
            begin, first, imported, end, spent = _start(START, here)
            totals.append(end - begin)
            processor.append(spent)
            imports.append((imported - first) / (end - begin))
    share = float(np.median(imports))
    more = {"second_start_import_share": share, "second_start_cpu_s": min(processor)}
    words = f"second process, start to 10 steps ({share:.0%} of it imports)"
    return [Row("second_start_s", words, "s wall", tuple(totals), min(least), 1.5, more)]


def _start(code: str, folder: str) -> tuple[float, ...]:
    """Run the code in a new process; return the time of its start and the four times that it prints [s]."""
    environment = os.environ | ONE_THREAD | {"PYTHONPATH": folder}
    begin = time.time()
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    return (begin, *(float(number) for number in done.stdout.split()))


def peer_rows(name: str, words: str, run_peer: Callable[[Case], dict[str, Any]], case: Case, rounds: int) -> list[Row]:
    """Peer and we in turn on one case: paired ratios. An implicit peer meets our implicit Euler, else our midpoint."""
    ours, theirs = [], []
    cost(replace(case, steps=3), "implicit_euler")
    for _ in progress(range(rounds), words):
        peer = run_peer(case)
        if "failed" in peer:
            return [Row(name, f"{words}: fails ({peer['failed']})", "", (), more={f"{name}_failed": 1.0})]
        theirs.append(peer)
        ours.append(cost(case, "midpoint" if "dt" in peer else "implicit_euler"))
    apart = np.linalg.norm(ours[0].end - [theirs[0][axis] for axis in "xyz"])
    more = {f"{name}_apart_mm": 1e3 * float(apart)} | ({f"{name}_dt": theirs[0]["dt"]} if "dt" in theirs[0] else {})
    seconds = tuple(peer["seconds"] / case.seconds for peer in theirs)
    ratios = tuple(peer["seconds"] / run.seconds for peer, run in zip(theirs, ours, strict=True))
    rows = [
        Row(f"{name}_s_per_sim_s", f"{words}: simulated second", "s", seconds, more=more),
        Row(f"{name}_s_per_sim_s_ratio", f"{words}: simulated second, peer over ours", "x", ratios),
    ]
    if "iterations" not in theirs[0]:
        return rows
    each = tuple(peer["seconds"] / peer["iterations"] for peer in theirs)
    ratios = tuple(peer * run.iterations / run.seconds for peer, run in zip(each, ours, strict=True))
    rows.append(Row(f"{name}_ms_per_newton", f"{words}: Newton iteration", "ms", tuple(1e3 * t for t in each)))
    rows.append(Row(f"{name}_newton_ratio", f"{words}: Newton iteration, peer over ours", "x", ratios))
    return rows


def all_peer_rows(args: argparse.Namespace, network: Rods, rounds: int) -> list[Row]:
    """The peers that were asked for: PyDiSMech on the network and on the bare stem, PyElastica on the stem.

    PyDiSMech with twist does not converge on the branched network, not even at rest under gravity; on the stem it does.
    PyElastica joins branches by springs and dashpots that the user invents, so it gets the stem alone, and its largest
    stable time step. Explicit and second order, it is paired with our midpoint rule at 1 ms. Against PyDiSMech our rods
    have its discretisation.
    """
    network = replace(network, discretisation="paper")
    stem = Rods(network.nodes[:51], network.parent[:51], 3e-3, 2e8, 1000.0, discretisation="paper")
    rows: list[Row] = []
    if args.dismech:
        peer = partial(run_dismech, args.dismech)
        rows += peer_rows(
            "dismech_86", "PyDiSMech, 86 nodes", peer, Case(replace(network, bend_over_twist=0.0)), rounds
        )
        rows += peer_rows("dismech_86_twist", "PyDiSMech, 86 nodes, twist", peer, Case(network, twist=True), rounds)
        rows += peer_rows("dismech_stem_twist", "PyDiSMech, stem, twist", peer, Case(stem, twist=True), rounds)
    if args.pyelastica:
        peer = partial(run_pyelastica, args.pyelastica)
        rows += peer_rows("pyelastica_stem", "PyElastica, stem", peer, Case(stem, twist=True), rounds)
    return rows


def measure(args: argparse.Namespace) -> tuple[list[Row], Roofline]:
    """Run everything."""
    ceilings, operations = measure_roofline(), operations_per_node()
    network, repeats, steps = reference_network(), 3 if args.quick else 9, 200 if args.quick else 1000
    rows = scaling_rows(ceilings, operations, (1, 15, 30, 59) if args.quick else (1, 4, 15, 59, 236), 3)
    for rods in (replace(network, bend_over_twist=0.0), network):
        case = Case(rods, steps=steps, twist=bool(rods is network))
        rows += reference_rows(case, operations, ceilings, repeats)
    rows += map_rows(ceilings, 20 if args.quick else 200, repeats) + start_rows(repeats)
    return rows + all_peer_rows(args, network, 1 if args.quick else 3), ceilings


COLUMNS = ("case", "unit", "best", "median", "worst", "limit", "floor", "best over floor")


@dataclass(frozen=True)
class Row:
    """One line of the table: samples in `unit`, floor and limit, if there are any; `more` goes to --json.

    Without samples the line only says what the case says: that something failed, for instance.
    """

    key: str
    case: str
    unit: str
    samples: tuple[float, ...]
    floor: float | None = None
    limit: float | None = None
    more: dict[str, float] = field(default_factory=dict)

    @property
    def metrics(self) -> dict[str, float]:
        """The row in the flat form of the --json file."""
        if not self.samples:
            return self.more
        out = {self.key: min(self.samples)} | self.more
        if len(self.samples) > 1:
            out |= {f"{self.key}_median": float(np.median(self.samples)), f"{self.key}_max": max(self.samples)}
        return out if self.floor is None else out | {f"{self.key}_floor": self.floor}

    @property
    def cells(self) -> tuple[str, ...]:
        """The row as text, one for each of COLUMNS. A single sample leaves median and worst empty."""
        if not self.samples:
            return (self.case, *("",) * (len(COLUMNS) - 1))
        best, spread = min(self.samples), ("", "")
        if len(self.samples) > 1:
            spread = (f"{np.median(self.samples):.3g}", f"{max(self.samples):.3g}")
        limit = "" if self.limit is None else f"{self.limit:g}"
        floor = ("", "") if self.floor is None else (f"{self.floor:.2g}", f"{best / self.floor:.1f}")
        return (self.case, self.unit, f"{best:.3g}", *spread, limit, *floor)


def describe(ceilings: Roofline) -> str:
    """Return what one core could do in this run, in words."""
    return (
        f"One core in this run: {ceilings.vector / 1e9:.0f} Gflop/s with SIMD (this gives the floor), "
        f"{ceilings.scalar / 1e9:.0f} one number at a time; {ceilings.small / 1e9:.0f} GB/s in the second-level cache, "
        f"{ceilings.large / 1e9:.0f} with 24 MB. Load of the machine at the end: {os.getloadavg()[0]:.1f} on "
        f"{os.cpu_count()} cores."
    )


def missed(rows: list[Row]) -> str:
    """Return which limits the best samples miss, in words."""
    over = [row for row in rows if row.samples and row.limit is not None and min(row.samples) > row.limit]
    words = "; ".join(f"{row.case} ({min(row.samples):.3g} against {row.limit:g} {row.unit})" for row in over)
    return f"Limits missed: {words or 'none'}."


def main() -> None:
    """Measure, print, write --json."""
    own = {
        "--dismech": (Path, "a checkout of dismech-python, to be run as well"),
        "--pyelastica": (Path, "a Python that has PyElastica, to be run as well"),
    }
    args = options(__doc__, quick="smaller cases, fewer repeats", own=own)
    rows, ceilings = measure(args)
    metrics = {key: value for row in rows for key, value in row.metrics.items()}
    metrics |= {f"core_{name}": value for name, value in ceilings._asdict().items()}
    finish(args, metrics, markdown(COLUMNS, [row.cells for row in rows]), missed(rows), describe(ceilings))


if __name__ == "__main__":
    main()
