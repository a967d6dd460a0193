"""Loops on a bus with somebody else's rig at the other end, and what befalls them: a script each tells what came."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path

from fmus.packaging import archive
from tests.support.cases.case import Case, Step

_HUB = Step("sed -i s/orchestrator.can.slcan_hub/orchestrator.can.slcan.hub/ ../common/peer.py run.py")
_XML = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="h" guid="h">
  <CoSimulation modelIdentifier="h" canHandleVariableCommunicationStepSize="true"/>
  <ModelVariables>
    <ScalarVariable name="x" valueReference="0" causality="input"><Real start="0"/></ScalarVariable>
    <ScalarVariable name="y" valueReference="1" causality="output"><Real/></ScalarVariable>
    <ScalarVariable name="hang_at" valueReference="2" causality="parameter" variability="tunable">
      <Real start="1e9"/></ScalarVariable>
    <ScalarVariable name="mode" valueReference="3" causality="parameter" variability="tunable">
      <Real start="0"/></ScalarVariable>
  </ModelVariables>
  <ModelStructure><Outputs><Unknown index="2"/></Outputs></ModelStructure>
</fmiModelDescription>
"""


def _misbehaving(folder: Path) -> None:
    """Compile the FMU of the bus' cases."""
    common = folder.parent / "common"
    subprocess.run(["cc", "-shared", "-fPIC", "-w", "-o", common / "h.so", common / "h.c"], check=True)
    files = {"modelDescription.xml": _XML.encode(), "binaries/linux64/h.so": (common / "h.so").read_bytes()}
    archive.write(common / "h.fmu", files)


def _live(
    name: str, shows: Sequence[str] = (), hides: Sequence[str] = (), prepare: Callable[[Path], None] | None = None
) -> Case:
    return Case(f"live/{name}", [_HUB, Step("python run.py", 0, shows, hides)], prepare)


_ENDED = r"rc {code} result kept True \| Command frames on the bus \d+ \|[^\n]*last \[[^\n]*, 0\.0\]"


CASES = {
    "live/adapter_refuses": _live(
        "adapter_refuses", [r"from t = 1 s on rc 3\b", r"from the start rc 3\b"], [r"rc 0\b"]
    ),
    "live/bench_never_back": _live(
        "bench_never_back", [r"came back: [1-9]\d+ rc 0", "bus lost", "bus back", "were not sent: the bus was lost"]
    ),
    "live/calibrate_faults": _live(
        "calibrate_faults",
        [
            r"== good  rc 0\n\s+wheel\.inertia +0\.01 +0\.02 +(0\.00999|0\.0100)",
            r"== gap  rc 0\n\s+wheel\.inertia +0\.01 +0\.02 +(0\.00999|0\.0100)",
            r"== crc  rc 0\n\s+wheel\.inertia +0\.01 +0\.02 +(0\.00999|0\.0100)",
            r"== late  rc 0\n\s+wheel\.inertia +0\.01 +0\.02 +(0\.00999|0\.0100)",
            r"== late steady: \[Sensors\] rc 0\n\s+wheel\.inertia +0\.01 +0\.02 +(0\.00999|0\.0100)",
            "gap of torque from 5.0",
            "Command 200",
            "wrong checksums of torque",
            "late stamps of torque",
        ],
    ),
    "live/controller_nan": _live("controller_nan", [_ENDED.format(code=3), r"ctl\.torque: is nan after the step from"]),
    "live/disk_full": Case(
        "live/disk_full",
        [
            _HUB,
            Step("mkdir -p ../common/small && mount -t tmpfs -o size=2m tmpfs ../common/small"),
            Step(
                "python run.py; code=$?; umount -l ../common/small; exit $code",
                0,
                [
                    r"rc 3\b",
                    r"\.blf: cannot be written \(No space left[^\n]*\d+ frames up to there are kept",
                    r"\nfailed \d",
                ],
                ["servotwin: file:", r"\nunfinished"],
            ),
        ],
    ),
    "live/fmu_hangs_or_dies": _live(
        "fmu_hangs_or_dies",
        [
            f"mode 0\\n[^$]*?{_ENDED.format(code='(3|130)')}",
            *(f"mode {mode}\\n{_ENDED.format(code=3)}" for mode in (1, 5, 6)),
            "no step has ended for",
        ],
        ["had to be killed"],
        _misbehaving,
    ),
    "live/hangup": _live(
        "hangup", [f"{name}\\n{_ENDED.format(code=130)}" for name in ("SIGHUP", "SIGQUIT", "SIGTERM")]
    ),
    "live/procedure_beside_fails": _live(
        "procedure_beside_fails", [r"FAILED[^\n]*can bench", "nothere.yaml: no such file"], ["could not open port"]
    ),
    "live/safe_lost_on_full_bus": _live(
        "safe_lost_on_full_bus", ["rc 3", "safe values of Command may not have got out", r"last command 0\.0"]
    ),
    "live/silent_sensor_drives": _live(
        "silent_sensor_drives", [r"last \[0\.0, 0\.0, 0\.0\]", "torque rests: without ctl.speed"]
    ),
    "live/stale_frames_at_start": _live(
        "stale_frames_at_start", [r"worst 0\.0\d s"], [r"started [1-9]", r"worst (0\.[1-9]|[1-9])"]
    ),
    "live/three_interrupts": _live("three_interrupts", ["safe value last in 8 of 8"]),
    "live/two_hubs_one_folder": _live(
        "two_hubs_one_folder", ["has the ports of another hub", r"first (\S+) now \1\n", "second alive False"]
    ),
    "live/two_senders": _live("two_senders", ["Command is also sent by somebody else"]),
}
