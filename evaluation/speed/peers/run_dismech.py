"""Drive PyDiSMech (a checkout of dismech-python, main branch) through one case; print its times as JSON.

    python evaluation/speed/peers/run_dismech.py CHECKOUT CASE.npz

CASE holds nodes (N, 3), edges (M, 2), fixed (C,) and `settings`, a JSON text: radius, density, youngs, dt, steps,
tolerance [N], grip, amplitude, hertz, twist. Implicit Euler, dense solver (its default), stopped by the norm of the
residual force alone. Without twist is its option two_d_sim, as the paper's authors used it. `evaluation/speed/rods.py`
runs this file in a process of its own; only numpy and the peer are needed.
"""

from __future__ import annotations

import importlib.util
import json
import sys
import time
from typing import Any
from unittest.mock import MagicMock

import numpy as np

DRAWING = ("IPython", "IPython.display", "ipywidgets", "plotly", "plotly.graph_objects", "matplotlib")


def import_peer(checkout: str) -> Any:
    """Import dismech from the checkout; what it needs only for drawing may be missing."""
    missing = [name for name in DRAWING if importlib.util.find_spec(name.split(".", maxsplit=1)[0]) is None]
    sys.modules.update({name: MagicMock() for name in missing})
    sys.path.insert(0, f"{checkout}/src")
    return importlib.import_module("dismech")


def build_robot(peer: Any, case: Any, settings: dict[str, Any]) -> Any:
    """Return the peer's model of the case, at rest, its fixed and driven nodes held."""
    parameters = peer.SimParams(
        static_sim=False,
        two_d_sim=not settings["twist"],
        use_mid_edge=False,
        use_line_search=False,
        show_floor=False,
        log_data=False,
        log_step=1,
        dt=settings["dt"],
        max_iter=200,
        total_time=settings["steps"] * settings["dt"],
        plot_step=1,
        tol=settings["tolerance"],
        ftol=0.0,
        dtol=0.0,
    )
    air = peer.Environment()
    air.add_force("gravity", g=np.array([0.0, 0.0, -9.81]))
    thickness = peer.GeomParams(rod_r0=settings["radius"], shell_h=0)
    material = peer.Material(settings["density"], settings["youngs"], 0, 0.5, 0)
    shape = peer.Geometry(case["nodes"], case["edges"], np.empty((0, 3), dtype=np.int64))
    robot = peer.SoftRobot(thickness, material, shape, parameters, air)
    return robot.fix_nodes(case["fixed"]).fix_nodes(np.array([settings["grip"]]))


def run(checkout: str, case_file: str) -> dict[str, float]:
    """Return processor seconds, Newton iterations and the top node's last position."""
    peer = import_peer(checkout)
    case = np.load(case_file)
    settings = json.loads(str(case["settings"]))

    class Counting(peer.ImplicitEulerTimeStepper):
        iterations = 0

        def _converged(self, *arguments: Any) -> bool:
            self.iterations += 1
            return super()._converged(*arguments)

    stepper = Counting(build_robot(peer, case, settings), min_force=settings["tolerance"])
    omega, dt = 2 * np.pi * settings["hertz"], settings["dt"]

    def shake(robot: Any, t: float) -> Any:
        step = settings["amplitude"] * (np.sin(omega * t) - np.sin(omega * (t - dt)))
        return robot.move_nodes(np.array([settings["grip"]]), step, 0)

    stepper.step(shake(stepper.robot, dt))  # whatever is compiled, is compiled now
    stepper.robot, stepper.iterations = build_robot(peer, case, settings), 0
    begin = time.process_time()
    for k in range(1, settings["steps"] + 1):
        stepper.robot = stepper.step(shake(stepper.robot, k * dt))
    taken = time.process_time() - begin
    top = stepper.robot.state.q[3 * settings["observe"] :][:3]
    return {"seconds": taken, "iterations": stepper.iterations, "x": top[0], "y": top[1], "z": top[2]}


if __name__ == "__main__":
    print(json.dumps(run(sys.argv[1], sys.argv[2])))
