"""Whether using files takes memory that does not come back: `python -m tests.fuzzing.again TARGET FOLDER`.

In the process that fuzzes, what the fuzzer itself learns grows, and a single large input raises the peak for good.
Here all that it came upon is used again and again in a process of its own, and the memory in use is compared from one
pass to the next, where nothing is new any more.
"""

from __future__ import annotations

import gc
import logging
import os
import shutil
import sys
import tempfile
from contextlib import suppress
from pathlib import Path

from tests.fuzzing.targets import TARGETS

PASSES = 3  # the first of which may load and keep what is kept once


def in_use() -> float:
    """Memory that this process has now [MB]."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGESIZE") / 1e6


def grown(name: str, folder: Path) -> float:
    """What the last pass over the files of a folder added, faults aside [MB]."""
    target, after = TARGETS[name], []
    with tempfile.TemporaryDirectory() as aside:
        used = Path(aside) / f"input{target.suffix}"
        for _ in range(PASSES):
            for file in sorted(folder.iterdir()):
                shutil.copyfile(file, used)
                with suppress(Exception):  # faults are told by the process that fuzzes
                    target.use(used)
            after.append(in_use())
    return after[-1] - after[-2]


if __name__ == "__main__":
    logging.disable()
    print(grown(sys.argv[1], Path(sys.argv[2])))
