"""What a method says of a plant, in one form for all methods, and the paper's rules that turn a graph into it.

J nodes, E edges, S stem samples.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from anther.cli.skeletonize import best_grasps
from anther.core import AntherError, Array
from anther.perception import Cloud, Skeleton, Stem, find_stem, find_supports, skeletonize
from anther.pollination import Grasp


class NoAnswer(Exception):
    """A method gave no skeleton, no stem or no grasp; the text says which."""


@dataclass(frozen=True, eq=False)
class Answer:
    """A skeleton graph, its main stem and a grasp.

    Attributes:
        nodes: (J, 3) [m].
        edges: (E, 2) pairs of nodes.
        stem: edges of the main stem: (T, 2) pairs of nodes.
        grasp: (3,) grasped point [m].
        seconds: processor time it took.
    """

    nodes: Array
    edges: NDArray[Any]
    stem: NDArray[Any]
    grasp: Array
    seconds: float

    @property
    def piece_of_node(self) -> NDArray[Any]:
        """(J,) number of the piece each node is in."""
        links = (np.ones(len(self.edges)), (self.edges[:, 0], self.edges[:, 1]))
        return connected_components(sparse.coo_matrix(links, (len(self.nodes),) * 2), directed=False)[1]

    @property
    def pieces(self) -> int:
        """How many pieces the graph has."""
        return int(self.piece_of_node.max()) + 1

    @property
    def is_tree(self) -> bool:
        """Whether the graph is one connected piece without cycles."""
        return self.pieces == 1 and len(self.edges) == len(self.nodes) - 1

    @property
    def tips(self) -> int:
        """How many ends the graph has."""
        return int((np.bincount(self.edges.ravel(), minlength=len(self.nodes)) == 1).sum())


class Method(Protocol):
    """A way from a cloud to an answer.

    Raises:
        NoAnswer: it found none.
    """

    def __call__(self, cloud: Cloud) -> Answer: ...


def asked(method: Method, cloud: Cloud) -> Answer | str:
    """Return a method's answer, or in words why it has none."""
    try:
        return method(cloud)
    except NoAnswer as reason:
        return str(reason)


@dataclass(frozen=True, eq=False)
class Seen:
    """Everything Anther says of a plant, and the processor time it took [s]."""

    cloud: Cloud
    skeleton: Skeleton
    stem: Stem
    grasp: Grasp
    seconds: float

    @property
    def answer(self) -> Answer:
        """The same in the form all methods share."""
        path = np.stack([self.stem.node_ids[:-1], self.stem.node_ids[1:]], axis=1)
        return Answer(self.skeleton.nodes, self.skeleton.edges, path, self.grasp.point, self.seconds)


def anther(cloud: Cloud) -> Seen:
    """Return what Anther sees in a cloud, with its default parameters.

    Raises:
        NoAnswer: a stage failed.
    """
    begin = time.process_time()
    try:
        cloud = find_supports(cloud)
        skeleton = skeletonize(cloud)
        stem = find_stem(skeleton)
        grasp = best_grasps(stem, skeleton, cloud)[0][0]
    except AntherError as error:
        raise NoAnswer(str(error)) from error
    return Seen(cloud, skeleton, stem, grasp, time.process_time() - begin)
