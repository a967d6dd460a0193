"""Subspace identification in other tools, each in a process of its own: `python subspace_peers.py TOOL DATA MODEL`.

Reads `u`, `y`, `block` and `order` from one .npz file, writes A, B, C, D to another and prints the seconds of each
repetition as one JSON list. Stands alone: the tools live in an environment of their own.
"""

from __future__ import annotations

import json
import sys
from time import perf_counter
from typing import Any

import numpy as np

REPEATS = 3
TOOLS = ("nfoursid", "sippy_n4sid", "sippy_moesp", "sippy_cva")


def nfoursid(u: Any, y: Any, block: int, order: int) -> Any:
    """A, B, C, D by nfoursid's PO-MOESP."""
    import pandas as pd
    from nfoursid.nfoursid import NFourSID

    inputs, outputs = [f"u{i}" for i in range(u.shape[1])], [f"y{i}" for i in range(y.shape[1])]
    table = pd.DataFrame(np.hstack([u, y]), columns=inputs + outputs)
    estimator = NFourSID(table, output_columns=outputs, input_columns=inputs, num_block_rows=block)
    estimator.subspace_identification()
    found, _ = estimator.system_identification(rank=order)
    return found.a, found.b, found.c, found.d


def sippy(u: Any, y: Any, block: int, order: int, method: str) -> Any:
    """A, B, C, D by one of SIPPY's subspace methods."""
    from sippy_unipi import system_identification

    found = system_identification(y.T, u.T, method, SS_f=block, SS_p=block, SS_fixed_order=order, SS_D_required=True)
    return found.A, found.B, found.C, found.D


def main() -> None:
    tool, source, target = sys.argv[1:]
    data = np.load(source)
    arguments = data["u"], data["y"], int(data["block"]), int(data["order"])
    taken = []
    for _ in range(REPEATS):
        begun = perf_counter()
        matrices = nfoursid(*arguments) if tool == "nfoursid" else sippy(*arguments, tool.split("_")[1].upper())
        taken.append(perf_counter() - begun)
        if taken[0] > 20:
            break
    a, b, c, d = matrices
    np.savez(target, a=a, b=b, c=c, d=d)
    print(json.dumps(taken))


if __name__ == "__main__":
    main()
