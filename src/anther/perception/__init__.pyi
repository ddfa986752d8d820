"""The public names of the room, and where they stand; `__init__.py` finds them when they are asked for."""

from .capture import Capture, viewed_box
from .cloud import Cloud, fuse
from .flowers import Flowers, find_flowers, flower_centres
from .formats.clouds import read_cloud
from .formats.skeletons import read_skeleton, write_skeleton
from .masks import Masks, segment
from .row_pass import SeenRow, find_hooks
from .skeleton import Skeleton, find_plants, skeletonize
from .stem import Stem, find_stem
from .supports import find_supports
from .traits import measure

__all__ = [
    "Capture",
    "Cloud",
    "Flowers",
    "Masks",
    "SeenRow",
    "Skeleton",
    "Stem",
    "find_flowers",
    "find_hooks",
    "find_plants",
    "find_stem",
    "find_supports",
    "flower_centres",
    "fuse",
    "measure",
    "read_cloud",
    "read_skeleton",
    "segment",
    "skeletonize",
    "viewed_box",
    "write_skeleton",
]
