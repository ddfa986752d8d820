"""The conversation a peer's worker has with peer_process.py; run by the peer's Python, nothing of Anther is needed.

A line "IN.npz OUT.npz" (tab between) is a request: IN holds `index` (M, 3), the occupied voxels; OUT gets `nodes`
(J, 3) [voxels], `edges` (E, 2) and `seconds` (processor time), or `failure`. The worker says "ready" once, "done" to
each.
"""

import os
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np


def serve(skeleton: Callable[[Any], tuple[Any, Any]]) -> None:
    """Answer requests with skeleton(index) -> (nodes, edges) until the input ends."""
    replies = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what the peer prints, from compiled code too, is no reply
    print("ready", file=replies, flush=True)
    for line in sys.stdin:
        source, target = line.rstrip("\n").split("\t")
        found = _answer(skeleton, np.load(source)["index"])
        np.savez(target, **found)
        print("done", file=replies, flush=True)


def _answer(skeleton: Callable[[Any], tuple[Any, Any]], index: Any) -> dict[str, Any]:
    begin = time.process_time()
    try:
        nodes, edges = skeleton(index)
    except Exception as error:  # whatever goes wrong in the peer is its answer
        return {"failure": f"{type(error).__name__}: {error}".splitlines()[0]}
    return {"nodes": nodes, "edges": edges, "seconds": time.process_time() - begin}
