"""A made-up arm of six joints, written as a URDF of cylinders, a sphere and a box."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

from anther.arm.model import ArmModel
from anther.arm.urdf import from_urdf

AXES = ("0 0 1", "0 1 0", "0 -1 0", "1 0 0", "0 1 0", "1 0 0")
LENGTHS = (0.15, 0.0, 0.3, 0.2, 0.1, 0.1, 0.05)  # m, of the foot and of the six links
READY = (0.0, -0.6, -1.4, 0.0, 0.8, 0.0)
LIGHT = '<inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/>'
HEAVY = '<inertia ixx="0.01" iyy="0.012" izz="0.005" ixy="0.001" ixz="0" iyz="0"/>'


def text(kind: str = "revolute") -> str:
    """Return the URDF: links that point upwards at zero, a weight beside the last one, and a hand, turned a little."""
    parts = ['<link name="foot"><collision><geometry><box size="0.2 0.2 0.1"/></geometry></collision></link>']
    before = "foot"
    for i, axis in enumerate(AXES):
        below, length = LENGTHS[i : i + 2]
        shape = f'<cylinder radius="0.03" length="{length}"/>' if length else '<sphere radius="0.04"/>'
        middle = f'<origin xyz="0 0 {length / 2}"/>'
        parts += [
            f'<link name="l{i}"><inertial>{middle}<mass value="{2 - 0.25 * i}"/>{HEAVY}</inertial>',
            f"<collision>{middle}<geometry>{shape}</geometry></collision></link>",
            f'<joint name="j{i}" type="{kind}"><parent link="{before}"/><child link="l{i}"/>',
            f'<origin xyz="0 0 {below}"/><axis xyz="{axis}"/>',
            f'<limit lower="-2.5" upper="2.5" velocity="2" effort="{60 - 8 * i}"/></joint>',
        ]
        before = f"l{i}"
    for name, place in (("weight", 'xyz="0.02 0.01 0.03" rpy="0.2 0 0.1"'), ("hand", 'xyz="0 0 0.06" rpy="0 0 0.3"')):
        own = f'<inertial><origin xyz="0 0 0.01"/><mass value="0.1"/>{LIGHT}</inertial>' if name == "weight" else ""
        parts += [f'<link name="{name}">{own}</link><joint name="to_{name}" type="fixed"><parent link="l5"/>']
        parts += [f'<child link="{name}"/><origin {place}/></joint>']
    return f'<robot name="six">{"".join(parts)}</robot>'


@cache
def six() -> ArmModel:
    """Return the arm."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "six.urdf"
        path.write_text(text())
        return from_urdf("six", path, base="foot", tip="hand", acceleration=8.0, ready=READY, floor=-0.9)
