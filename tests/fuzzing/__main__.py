"""Fuzzes kinds of files one after the other: `python -m tests.fuzzing [TARGET...] --minutes 60` (extra `fuzz`).

A fault is anything but a result or a ServotwinError: another exception, an input that takes more than `one.SLOW` of the
processor or `HANGING`, a dead process, memory that grows. Each is kept in the folder of results with the input that
shows it. A target has a folder of its own for temporary files, since it clears away what is left there.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from tests.fuzzing.targets import TARGETS, seeds

MEMORY = 4096  # [MB]
GROWN = 20  # from one pass over all inputs to the next [MB]
HANGING = 600  # [s], on however busy a machine


def main(arguments: Sequence[str] | None = None) -> int:
    """1 where a fault was found."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzzing", description=__doc__)
    parser.add_argument("targets", nargs="*", metavar="TARGET", help=f"of {', '.join(TARGETS)}; all by default")
    parser.add_argument("--minutes", type=float, default=60.0, help="for each target")
    parser.add_argument("--out", type=Path, default=Path("out/fuzzing"), help="where faults are kept")
    parsed = parser.parse_args(arguments)
    print(f"{'target':14}{'inputs':>10}{'a second':>10}{'taken':>10}{'slowest [s]':>13}{'grown [MB]':>12}  faults")
    faults = 0
    for name in parsed.targets or TARGETS:
        faults += _fuzzed(name, parsed.minutes * 60, parsed.out / name)
    return int(faults > 0)


def _fuzzed(name: str, seconds: float, out: Path) -> int:
    """How many faults a target shows."""
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        corpus, aside = Path(folder) / "corpus", Path(folder) / "tmp"
        corpus.mkdir()
        aside.mkdir()
        own = os.environ | {"TMPDIR": str(aside)}
        for number, content in enumerate(seeds(name, Path(folder))):
            (corpus / str(number)).write_bytes(content)
        done = subprocess.run(
            [
                *(sys.executable, "-m", "tests.fuzzing.one", name, str(out.resolve()), str(corpus)),
                *(f"-max_total_time={seconds:.0f}", f"-timeout={HANGING}", f"-rss_limit_mb={MEMORY}", "-max_len=65536"),
                f"-artifact_prefix={out.resolve()}/",
            ],
            capture_output=True,
            check=False,
            env=own,
        )
        again = [sys.executable, "-m", "tests.fuzzing.again", name, str(corpus)]
        growth = float(subprocess.run(again, capture_output=True, check=True, text=True, env=own).stdout)
    counted = json.loads((out / "counts.json").read_text())
    found = sorted(counted["faults"])
    if growth > GROWN:
        found.append(f"a pass over all inputs adds {growth:.0f} MB")
    if done.returncode:
        (out / "end.txt").write_bytes(done.stderr[-20000:])
        found.append(f"the process ended with {done.returncode}, see {out / 'end.txt'}")
    used = f"{counted['inputs']:10,}{counted['inputs'] / seconds:10,.0f}{counted['taken']:10,}"
    print(f"{name:14}{used}{counted['slowest']:13.2f}{growth:12.1f}  {'; '.join(found) or 'none'}", flush=True)
    return len(found)


if __name__ == "__main__":
    sys.exit(main())
