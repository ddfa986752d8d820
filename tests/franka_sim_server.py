"""Serves franka-sim's arm, which speaks libfranka's protocol, and writes down where it was. Run by its own Python.

franka-sim fetches its model by git; here it is made from the URDF that comes with it. That has no rotor inertia,
without which the arm shakes itself apart: a little is added. How it moves is therefore not an FR3's; the protocol is.
"""

from __future__ import annotations

import logging
import os
import re
import sys
import threading
import time
from pathlib import Path

JOINT = 'damping="0.003" frictionloss="0.2"', 'damping="1" armature="0.2"'


def main(folder: Path) -> None:
    import franka_sim  # noqa: PLC0415  # pyright: ignore[reportMissingImports]
    import mujoco  # noqa: PLC0415

    urdf = (Path(franka_sim.__file__).parent / "models" / "fr3.urdf").read_text()
    spec = mujoco.MjSpec.from_string(re.sub(r"<(visual|collision)\b.*?</\1>", "", urdf, flags=re.S))
    spec.compile()
    (folder / "fr3.xml").write_text(spec.to_xml().replace(*JOINT))
    os.environ["FR3_MJCF"] = str(folder / "fr3.xml")
    from franka_sim.franka_sim_server import FrankaSimServer  # noqa: PLC0415  # pyright: ignore[reportMissingImports]

    server = FrankaSimServer(
        host="127.0.0.1", enable_gripper=False, enforce_comm_constraints=True, enforce_motion_limits=True
    )

    def write() -> None:
        with (folder / "log").open("w") as log:
            while True:
                sim = server.physics_sim
                mode = int(server.robot_state.state["robot_mode"])
                numbers = (time.monotonic(), sim.data.time, mode, *sim.get_robot_state()["q"])
                log.write(" ".join(map(str, numbers)) + "\n")
                log.flush()
                time.sleep(2e-3)

    logging.basicConfig(level=logging.INFO)  # "Server ready for new client" is waited for
    threading.Thread(target=write, daemon=True).start()
    server.start()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
