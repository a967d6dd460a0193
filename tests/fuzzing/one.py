"""Fuzzes one kind of files in this process: what its parent asks for."""

from __future__ import annotations

import hashlib
import json
import logging
import sys
import tempfile
import traceback
from pathlib import Path
from time import perf_counter, process_time

import atheris

with atheris.instrument_imports(include=["fmus", "orchestrator", "identification", "cantools", "ruamel"]):
    from fmus.errors import ServotwinError
    from tests.fuzzing.targets import TARGETS

SLOW = 20  # of the processor [s]


class Fuzzing:
    """Uses inputs and counts what came of them."""

    def __init__(self, name: str, out: Path, folder: Path) -> None:
        self._target, self._out = TARGETS[name], out
        self._file = folder / f"input{self._target.suffix}"
        self._told = perf_counter()
        self.counts = {"inputs": 0, "taken": 0, "slowest": 0.0, "faults": []}

    def __call__(self, content: bytes) -> None:
        self._file.write_bytes(content)
        begun = process_time()
        try:
            self._target.use(self._file)
            self.counts["taken"] += 1
        except ServotwinError as error:
            if "\n" in str(error):
                self._fault(content, "an error of several lines", str(error))
        except Exception as error:
            self._fault(content, _signature(error), traceback.format_exc())
        taken = process_time() - begun
        if taken > SLOW:
            self._fault(content, f"takes over {SLOW} s", f"{taken:.1f} s of the processor")
        self.counts["inputs"] += 1
        self.counts["slowest"] = max(self.counts["slowest"], taken)
        if perf_counter() - self._told > 1.0 or self.counts["inputs"] == 1:
            self._tell()

    def _fault(self, content: bytes, signature: str, details: str) -> None:
        if signature in self.counts["faults"]:
            return
        self.counts["faults"].append(signature)
        name = hashlib.sha256(signature.encode()).hexdigest()[:12]
        (self._out / f"{name}{self._target.suffix}").write_bytes(content)
        (self._out / f"{name}.txt").write_text(f"{signature}\n{details}")
        self._tell()

    def _tell(self) -> None:
        self._told = perf_counter()
        (self._out / "counts.json").write_text(json.dumps(self.counts))


def _signature(error: Exception) -> str:
    """What and where: the same for inputs that show the same fault."""
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if "/site-packages/" not in frame.filename]
    last = frames[-1]
    return f"{type(error).__name__} at {Path(last.filename).name}:{last.lineno}"


if __name__ == "__main__":
    name, out, *options = sys.argv[1:]
    logging.disable()
    with tempfile.TemporaryDirectory() as aside:
        atheris.Setup([sys.argv[0], *options], Fuzzing(name, Path(out), Path(aside)))
        atheris.Fuzz()
