"""Elastic supports: springs between the ground and a node, a taut string, a floor that only pushes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anther.core.checks import check_array, check_range
from anther.core.errors import bad_input

Array = NDArray[np.float64]

STIFFEST = 1e9
"""Of supports [N/m, N m/rad]; beyond it rounding eats the stiffness of the rods."""


@dataclass(frozen=True, slots=True, eq=False)
class Support:
    """An elastic support: springs between the ground and one node. Supports of the same node add.

    It is mechanics; the strings, stakes and poles that a cloud shows are `perception.find_supports`.

    The force on the node at x is `force` - `translation` (x - x0) with its scanned position x0; the moment opposes the
    rotation of the node from its scanned direction.

    Attributes:
        node: number of the node; a rotation spring needs one besides the root.
        translation: stiffness [N/m]: one number, alike in all directions or along `direction` alone; (3,) along x, y
            and z; or a symmetric (3, 3) tensor.
        rotation: stiffness [N m/rad], given likewise, about the axes of the world. It exerts nothing in the scanned
            shape.
        direction: (3,) of any length > 0: the only one in which single numbers act; None means all.
        force: (3,) on the node in the scanned shape [N]. None means the share of the weight that
            `with_gravity_equilibrium` finds, and 0 without it.
        one_sided: whether it pushes along `direction` only and lets go where it would pull, without friction: a floor
            along its normal, a string that may go slack towards its hook.
        gap: distance [m] along `direction` at which the node of a one-sided support stands off in the scanned shape.
    """

    node: int
    translation: Any = 0.0
    rotation: Any = 0.0
    direction: Any = None
    force: Any = None
    one_sided: bool = False
    gap: float = 0.0

    def __post_init__(self) -> None:
        along = None
        if self.direction is not None:
            along = check_array("support direction", self.direction, (3,))
            if not np.any(along):
                raise bad_input("support direction", given=along, allowed="a length above 0", do="Give an axis.")
            along = along / np.linalg.norm(along)
            object.__setattr__(self, "direction", check_array("support direction", along, (3,)))
        for name in ("translation", "rotation"):
            self.stiffness(name)
        if self.force is not None:
            object.__setattr__(self, "force", check_array("support force", self.force, (3,)))
        check_range("support gap", self.gap, 0, 1e3, "m")
        self._check_one_sided(along)

    def stiffness(self, name: Literal["translation", "rotation"]) -> Array:
        """Return the (3, 3) tensor of either stiffness [N/m, N m/rad].

        Raises:
            InputError: it is none.
        """
        unit = "N/m" if name == "translation" else "N m/rad"
        return _tensor(f"support {name}", getattr(self, name), self.direction, unit)

    def _check_one_sided(self, along: Array | None) -> None:
        if not self.one_sided:
            if self.gap:
                raise bad_input("support gap", given=self.gap, allowed="one-sided supports", do="Set one_sided.")
            return
        if along is None or not np.any(self.translation):
            given = "no direction" if along is None else "no translation stiffness"
            raise bad_input("one-sided support", given=given, allowed="direction and translation", do="Give both.")
        push = np.zeros(3) if self.force is None else np.asarray(self.force)
        pulls = push @ along < 0 or np.linalg.norm(push - (push @ along) * along) > 1e-9 * np.linalg.norm(push)
        if pulls or (self.gap > 0 and np.any(push)):
            allowed = "a push along its direction, 0 across a gap"
            raise bad_input("force of a one-sided support", given=push, allowed=allowed, do="Turn it, or leave it out.")

    @classmethod
    def string(cls, node: int, towards: ArrayLike, tension: float, stretching: float) -> Support:
        """Return a taut string from a node to its hook.

        Along itself it has the stiffness EA / length, across it tension / length: right while it is taut and the node
        moves by little of its length.

        Args:
            node: the node that it holds.
            towards: (3,) from the node to the hook [m].
            tension: in the scanned shape [N].
            stretching: EA [N].
        """
        way = check_array("string", towards, (3,))
        length = float(np.linalg.norm(way))
        check_range("length of a string", length, 1e-3, 1e3, "m")
        check_range("tension of a string", tension, 0, 1e5, "N")
        check_range("stretching stiffness of a string", stretching, 0, STIFFEST, "N")
        along = np.outer(way, way) / length**2
        stiffness = stretching / length * along + tension / length * (np.eye(3) - along)
        return cls(node, stiffness, force=tension / length * way)

    @classmethod
    def floor(
        cls, nodes: ArrayLike, stiffness: float, *, height: float = 0.0, radius: float = 0.0
    ) -> tuple[Support, ...]:
        """Return a floor under every node (N, 3) [m]: one-sided, without friction.

        Nodes that are lower than the floor in the scanned shape touch it where they are.

        Args:
            nodes: of the rods.
            stiffness: of the floor under one node [N/m].
            height: z of the floor [m].
            radius: of the stem, whose axis lies so much higher [m].
        """
        gaps = np.maximum(np.asarray(nodes, dtype=np.float64)[:, 2] - height - radius, 0)
        up = (0.0, 0.0, 1.0)
        return tuple(cls(j, stiffness, direction=up, one_sided=True, gap=float(g)) for j, g in enumerate(gaps))


def _tensor(name: str, value: Any, along: Array | None, unit: str) -> Array:
    """Return the (3, 3) stiffness that was given as a number, (3,), or itself.

    Raises:
        InputError: another shape, not finite, not symmetric, or negative in a direction.
    """
    shape = np.shape(value)
    if shape not in ((), (3,), (3, 3)) or (shape and along is not None and np.any(value)):
        allowed = "one number" if along is not None else "a number, (3,) or (3, 3)"
        raise bad_input(name, given=f"shape {shape}", allowed=allowed, do="Add supports of the same node.")
    given = check_array(name, value, shape)
    tensor = given if shape == (3, 3) else given * (np.eye(3) if along is None else np.outer(along, along))
    sizes = np.linalg.eigvalsh((tensor + tensor.T) / 2)
    if not np.allclose(tensor, tensor.T, rtol=1e-9) or sizes[0] < -1e-9 * abs(sizes[-1]) or sizes[-1] > STIFFEST:
        worst = sizes[0] if sizes[0] < 0 else sizes[-1]
        allowed = f"symmetric, 0 to {STIFFEST:g} {unit}"
        raise bad_input(name, given=f"{worst:g} {unit}", allowed=allowed, do="Check sign and unit.")
    return check_array(name, tensor, (3, 3))


def check_supports(supports: tuple[Support, ...], count: int) -> None:
    """Refuse supports of no node of 0 .. count - 1, and a rotation spring at the root."""
    for support in supports:
        if not 0 <= support.node < count:
            given, allowed = support.node, f"0 to {count - 1}"
            raise bad_input("support node", given=given, allowed=allowed, do="Check the node number.")
        if support.node == 0 and np.any(support.rotation):
            do = "Use Clamp.root, and joint_compliance = 1 / stiffness of the edges that leave the root."
            raise bad_input("support rotation", given="one at the root", allowed="other nodes", do=do)


def springs_of(supports: tuple[Support, ...], nodes: Array, forces: Array) -> Array:
    """Return (S, 14) springs that draw nodes: the rows `Model.supports`.

    Args:
        supports: S of them.
        nodes: (N, 3) scanned positions [m].
        forces: (S, 3) that they exert there [N].
    """
    touch = 1e-10  # so far [m] off stands what bears nothing in the scanned shape: rounding decides nothing
    rows = np.zeros((len(supports), 14))
    rows[:, 13] = 1
    for row, support, force in zip(rows, supports, forces, strict=True):
        place, K = nodes[support.node], support.stiffness("translation")
        if support.one_sided:
            along, pressed = support.direction, force @ support.direction / np.trace(K)
            place = place + (pressed or -max(support.gap, touch)) * along
            row[10:13], row[13] = along, 0
        row[0], row[1:4], row[4:10] = support.node, place, upper(K)
    return rows


def upper(tensors: Array) -> Array:
    """Return (..., 6) entries 11, 12, 22, 13, 23, 33 of symmetric (..., 3, 3) tensors."""
    return tensors[..., [0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]


def full(entries: Array) -> Array:
    """Return the symmetric (..., 3, 3) tensors of (..., 6) entries, see `upper`."""
    return entries[..., [[0, 1, 3], [1, 2, 4], [3, 4, 5]]]


def hold_joint(near: Array, own: Array, held: Array) -> tuple[Array, Array, Array]:
    """Return what a rotation spring makes of the joint at its node.

    The node turns with the spring, and with either edge through the compliance between them. Without it as an unknown,
    the star of three springs is a triangle: the joint, and a spring from the ground to either edge.

    Args:
        near, own: (3, 3) compliances between the node and the edge before it, and the edge after it [rad/(N m)].
        held: (3, 3) stiffness between the node and the ground [N m/rad].

    Returns:
        Compliance of the joint, stiffness of the ground springs on the edge before and on the edge after.
    """
    joint = near + own + own @ held @ near
    before, after = np.linalg.solve(joint, own @ held), np.linalg.solve(joint.T, near @ held)
    symmetric = [(matrix + matrix.T) / 2 for matrix in (joint, before, after)]
    return symmetric[0], symmetric[1], symmetric[2]
