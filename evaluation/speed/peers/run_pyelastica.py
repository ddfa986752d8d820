"""Drive PyElastica through one straight stem, held at its foot and shaken at one node; print its times as JSON.

    PYTHON_WITH_PYELASTICA evaluation/speed/peers/run_pyelastica.py CASE.npz

CASE is that of run_dismech.py, its nodes on a straight line. Position Verlet, explicit: of a few time steps the largest
is taken with which the stem stays whole. A joint of branches needs connections whose stiffness the user invents, so
the stem alone is compared. `evaluation/speed/rods.py` runs this file in a process of its own.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import elastica  # pyright: ignore[reportMissingImports]
import numpy as np

TIME_STEPS = (2.5e-5, 2e-5, 1.5e-5, 1e-5, 5e-6, 2.5e-6)
"""[s], from the largest."""


class Shaken(elastica.ConstraintBase):
    """The first element does not move; the grip node follows a sine along x."""

    def __init__(self, grip: int, amplitude: float, omega: float, **rest: Any) -> None:
        super().__init__(**rest)
        self.grip, self.amplitude, self.omega = grip, amplitude, omega
        self.foot = self.system.position_collection[:, :2].copy()
        self.frame = self.system.director_collection[..., 0].copy()
        self.home = self.system.position_collection[:, grip].copy()

    def constrain_values(self, system: Any, time: float) -> None:
        """Put the held places where they belong at `time` [s]."""
        system.position_collection[:, :2] = self.foot
        system.director_collection[..., 0] = self.frame
        system.position_collection[:, self.grip] = self.home
        system.position_collection[0, self.grip] += self.amplitude * np.sin(self.omega * time)

    def constrain_rates(self, system: Any, time: float) -> None:
        """Give the held places the speed that they have at `time` [s]."""
        system.velocity_collection[:, :2] = 0
        system.omega_collection[:, 0] = 0
        system.velocity_collection[:, self.grip] = 0
        system.velocity_collection[0, self.grip] = self.amplitude * self.omega * np.cos(self.omega * time)


class Simulator(elastica.BaseSystemCollection, elastica.Constraints, elastica.Forcing):
    """What of the peer is used."""


def build(case: Any, settings: dict[str, Any]) -> tuple[Any, Any]:
    """Return the peer's simulator and its one rod."""
    nodes = case["nodes"]
    length = float(np.linalg.norm(nodes[-1] - nodes[0]))
    rod = elastica.CosseratRod.straight_rod(
        len(nodes) - 1,
        nodes[0],
        (nodes[-1] - nodes[0]) / length,
        np.array([1.0, 0.0, 0.0]),
        length,
        settings["radius"],
        settings["density"],
        youngs_modulus=settings["youngs"],
        shear_modulus=settings["youngs"] / 3,
    )
    simulator = Simulator()
    simulator.append(rod)
    simulator.add_forcing_to(rod).using(elastica.GravityForces, acc_gravity=np.array([0.0, 0.0, -9.81]))
    simulator.constrain(rod).using(
        Shaken, grip=settings["grip"], amplitude=settings["amplitude"], omega=2 * np.pi * settings["hertz"]
    )
    simulator.finalize()
    return simulator, rod


def shake(case: Any, settings: dict[str, Any], dt: float, duration: float) -> tuple[float, Any]:
    """Return the processor seconds spent and the rod at the end."""
    simulator, rod = build(case, settings)
    stepper, now = elastica.PositionVerlet(), np.float64(0)
    begin = time.process_time()
    for _ in range(round(duration / dt)):
        now = stepper.step(simulator, now, np.float64(dt))
    return time.process_time() - begin, rod


def run(case_file: str) -> dict[str, float]:
    """Return processor seconds, the time step and the top node's last position."""
    case = np.load(case_file)
    settings = json.loads(str(case["settings"]))
    duration = settings["steps"] * settings["dt"]
    for dt in TIME_STEPS:
        shake(case, settings, dt, 3 * dt)  # whatever is compiled, is compiled now
        seconds, rod = shake(case, settings, dt, duration)
        position = rod.position_collection
        edges = np.linalg.norm(np.diff(position, axis=1), axis=0) / np.linalg.norm(
            np.diff(case["nodes"], axis=0), axis=1
        )
        if np.all(np.abs(edges - 1) < 0.01):  # NaN is refused as well
            top = position[:, settings["observe"]]
            return {"seconds": seconds, "dt": dt, "x": top[0], "y": top[1], "z": top[2]}
    raise SystemExit(f"PyElastica: no time step of {TIME_STEPS} is stable here")


if __name__ == "__main__":
    print(json.dumps(run(sys.argv[1])))
