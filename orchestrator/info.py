"""What a file or folder holds, as plain values for `servotwin info`."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fmus import words
from fmus.errors import InputError
from fmus.packaging import archive, defaults
from fmus.packaging.native import foreign_sources
from fmus.parameters.related import related, state
from orchestrator.can.log_suffixes import is_log
from orchestrator.fmi import terminals
from orchestrator.marks import listed
from orchestrator.progress import Progress, silent
from orchestrator.rational import written
from orchestrator.results import MARKS, RECORD
from orchestrator.ssp import is_ssp

if TYPE_CHECKING:
    from orchestrator import formats
    from orchestrator.fmi.clocks.declared import Clock
    from orchestrator.fmi.interface import Interface, Port
    from orchestrator.trace import Trace

FIRST_ROWS = 5
_TEXTS, _LONGEST = 6, 40  # texts of a signal that are shown, and how much of each
_SHOWN = 64  # elements of an array that are listed singly
InfoDocument = Mapping[str, object]
"""A JSON document, to be shown and not to be looked into."""


def about(path: Path) -> InfoDocument:
    """The contents of an FMU, an SSP, a trace, or a folder of results.

    Raises:
        InputError: there is no such file, or it is none of these.
    """
    if not path.exists():
        raise InputError(path, "there is no such file or folder", "check the path")
    if path.is_dir():
        return about_result(path)
    if path.suffix.lower() == ".fmu":
        return about_fmu(path)
    if is_ssp(path):
        return about_ssp(path)
    return about_trace(path)


def about_fmu(path: Path) -> InfoDocument:
    """Version, abilities and variables of an FMU; for one of ours also what its values come from."""
    from fmus.parameters.write_back import PROVENANCE  # noqa: PLC0415 (it brings lxml along)
    from orchestrator.fmi.file import FmuDescription  # noqa: PLC0415 (it brings FMPy along)

    fmu, files = FmuDescription(path), archive.read(path)
    interface = fmu.interface
    document: dict[str, object] = {
        "name": interface.model_name,
        "fmi": interface.fmi_version,
        "interfaces": ", ".join(fmu.kinds),
        "description": fmu.description.description or "",
        "tool": fmu.description.generationTool or "",
        "platforms": sorted({name.split("/")[1] for name in files if re.match("binaries/[^/]+/[^/]", name)})
        or ["none"],
        "sources": foreign_sources.brings(files),
        "defaults from resources": defaults.RESOURCE in files,
        "state can be saved": interface.has_state,
        **({"needs": "its tool, installed"} if bool(fmu.offer.needsExecutionTool) else {}),
        "inputs": _ports(interface, "input"),
        "outputs": _ports(interface, "output"),
        "parameters": _ports(interface, "parameter"),
        **_about_others(interface),
        **_about_terminals(fmu.path),
        "units": _about_units(interface),
    }
    if along := related(str(path), files):
        document["related files"] = [
            {"name": one.source, "role": one.role, "file": state(one, files), "description": one.description}
            for one in along
        ]
    if PROVENANCE in files:
        provenance = _document(path, files[PROVENANCE])
        document["calibrated by"] = f"{provenance.get('title', '')} ({provenance.get('method', '')})"
    return document


def about_ssp(path: Path) -> InfoDocument:
    """Components, wires and values of a system as an SSP."""
    from orchestrator.ssp.document import imported  # noqa: PLC0415 (it brings FMPy along)

    found = imported(path)
    document, run = found.document, found.document.get("run", {})
    components = {name: Path(one["fmu"]).name for name, one in document["components"].items()}
    return {
        "name": document["title"],
        **{key: str(run[key]) for key in ("stop", "step") if key in run},
        "components": [
            {"name": name, "in the SSP": found.names[name], "FMU": file} for name, file in components.items()
        ],
        "values": [
            {"name": f"{name}.{variable}", "value": value}
            for name, one in document["components"].items()
            for variable, value in one.get("parameters", {}).items()
        ],
        "connections": [{"connection": line} for line in document["connections"]],
        "stimuli": [{"name": name, **block} for name, block in document.get("stimuli", {}).items()],
        "recorded": [{"name": name} for name in document.get("record", [])],
        "notes": list(found.notes),
    }


def _ports(interface: Interface, causality: str) -> list[InfoDocument]:
    """Its variables; of a large array a single entry."""
    found: list[InfoDocument] = []
    for port in interface.of(causality):
        size = 1 if port.array is None else math.prod(port.array.shape)
        if not port.alone and (size <= _SHOWN or port.element == 0):
            entry = {"name": port.name, "start": port.start, "unit": port.unit or "", "description": port.description}
            if size > _SHOWN and port.array is not None:
                last = ",".join(map(str, port.array.shape))
                entry |= {"name": f"{port.name} to {port.array.name}[{last}]", "start": None}
            found.append(entry)
    return found


def _about_units(interface: Interface) -> list[InfoDocument]:
    """What the units of the variables mean, and on whose word."""
    ports = {port.unit: port.measure for port in interface.ports.values() if port.unit}
    return [
        {
            "name": name,
            "means": "not known" if known.unit is None else str(known.unit),
            "by": "" if known.unit is None else "the FMU" if known.declared else "its name",
        }
        for name, known in sorted(ports.items())
    ]


def _about_others(interface: Interface) -> InfoDocument:
    """What there is beside inputs, outputs and parameters: what gives arrays their sizes, and what is no number."""
    alone = [port for port in interface.ports.values() if port.alone]
    lists = {
        "structural parameters": _ports(interface, "structuralParameter"),
        f"clocks{'' if interface.event_mode else ' (never ticked)'}": [
            {**_alone(port), **_ticking(interface.clocks[port.name])} for port in alone if port.type == "Clock"
        ],
        "binary variables": [_alone(port) for port in alone if port.type == "Binary"],
        "left out": [{"name": name, "why": why} for name, why in interface.left_out.items()],
        "doubtful": [{"name": name, "why": why} for name, why in interface.doubts.items()],
    }
    return {key: entries for key, entries in lists.items() if entries}


def _about_terminals(path: Path) -> InfoDocument:
    """Its terminals, with their members and those of the terminals within."""
    entries: list[InfoDocument] = []
    for terminal in terminals.read(path).values():
        inner = [f"{name} ({', '.join(one.members)})" for name, one in terminal.inner.items()]
        entries.append(
            {"name": terminal.name, "kind": terminal.kind, "members": ", ".join([*terminal.members, *inner])}
        )
    return {"terminals": entries} if entries else {}


def _ticking(clock: Clock) -> InfoDocument:
    interval = "" if clock.interval is None else f"{written(clock.interval)} s"
    shift = f"{written(clock.shift)} s" if clock.shift else ""
    return {"ticks": str(clock.kind), "interval": interval, "shift": shift}


def _alone(port: Port) -> InfoDocument:
    return {"name": port.name, "causality": port.causality, "description": port.description}


def about_trace(path: Path, layout: formats.Layout | None = None, progress: Progress = silent) -> InfoDocument:
    """Signals and time stamps of a recording; of a matrix without names what a layout has to say.

    Of a CAN log without a database its frames.
    """
    if path.is_file() and is_log(path) and (layout is None or layout.database is None):
        return about_log(path, progress)
    from orchestrator import formats  # noqa: PLC0415 (it brings pyarrow along)

    asked = layout or formats.Layout(texts=True)
    return _about_recording(formats.read(path, asked, progress), asked)


def _about_recording(recording: formats.Recording, asked: formats.Layout) -> InfoDocument:
    from orchestrator.formats.layout import spelled  # noqa: PLC0415 (see above)

    trace, head = recording.trace, recording.trace.rows(slice(FIRST_ROWS))
    return {
        "name": trace.name,
        "samples": len(trace),
        "from": float(trace.time[0]),
        "to": float(trace.time[-1]),
        "stamps": str(recording.stamps),
        **_about_reading(recording),
        **_about_acceptance(recording),
        "sha256": recording.sha256,
        "signals": [_about_signal(trace, name) for name in trace.names],
        "rows": [
            {"time": float(stamp), **{name: _cell(head, name, row) for name in head.names}}
            for row, stamp in enumerate(head.time)
        ],
        **({} if recording.layout is None else {"layout": spelled(recording.layout, asked)}),
    }


def _about_acceptance(recording: formats.Recording) -> InfoDocument:
    """Of a reference who accepted it, when, of what, and what went in."""
    if recording.path.suffix.lower() != ".parquet":
        return {}
    from orchestrator.scenario import references  # noqa: PLC0415 (see above)

    found = references.provenance(recording.path)
    if found is None:
        return {}
    return {
        "reference of": f"{found['scenario']}, case {found['case']}",
        "accepted": f"by {found['by']}, {found['at']}, on {found['platform']}",
        "made with": [{"name": name, "version": version} for name, version in found["versions"].items()],
        "made of": [{"name": name, "sha256": digest} for name, digest in found["sha256"].items()],
    }


def _about_signal(trace: Trace, name: str) -> InfoDocument:
    values = trace[name]
    if name in trace.texts:
        return _about_texts(trace, name)
    known = values[np.isfinite(values)]
    missing, infinite = int(np.isnan(values).sum()), int(np.isinf(values).sum())
    return {
        "name": name,
        "unit": trace.unit(name) or "",
        "min": float(known.min()) if len(known) else None,
        "max": float(known.max()) if len(known) else None,
        **({"missing": missing} if missing else {}),
        **({"infinite": infinite} if infinite else {}),
    }


def _about_texts(trace: Trace, name: str) -> InfoDocument:
    """How many different texts there are, the first of them, and how many are missing."""
    missing = int(np.isnan(trace[name]).sum())
    came = list(dict.fromkeys(text for text in trace.words(name) if text is not None))
    shown = [text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..." for text in came]
    return {
        "name": name,
        "unit": trace.unit(name) or "",
        "min": None,
        "max": None,
        **({"missing": missing} if missing else {}),
        "texts": words.listed(shown, _TEXTS),
    }


def _cell(trace: Trace, name: str, row: int) -> float | str | None:
    if name in trace.texts:
        return trace.words(name)[row]
    value = float(trace[name][row])
    return str(value) if math.isinf(value) else None if math.isnan(value) else value


def _about_reading(recording: formats.Recording) -> InfoDocument:
    """When time 0 was, and what was found while the file was read and decoded."""
    document: dict[str, object] = {}
    if recording.start is not None:
        from orchestrator.can.logs.frame_count import moment  # noqa: PLC0415

        document["start"] = moment(recording.start)
    document |= {"marked": listed(recording.marks)} if recording.marks else {}
    return document | {"notes": list(recording.notes), "found": dict(recording.found)}


def about_log(path: Path, progress: Progress = silent) -> InfoDocument:
    """Frames of a CAN log by identifier, and what could not be read."""
    from orchestrator.can import logs  # noqa: PLC0415 (it brings python-can along)
    from orchestrator.can.logs.findings import NO_ZONE  # noqa: PLC0415
    from orchestrator.can.logs.frame_count import FrameCount  # noqa: PLC0415

    log, count = logs.read(path, progress), FrameCount()
    for batch in log:
        count.feed(batch)
    notes = [*([NO_ZONE] if log.findings.zoneless else []), *log.findings.lines()]
    return {"name": path.stem, **count.document(), **({"notes": notes} if notes else {})}


def about_result(folder: Path) -> InfoDocument:
    """Title, figures and files of a result folder."""
    mark = next((folder / mark for mark in MARKS if (folder / mark).is_file()), None)
    if mark is None and (folder / "manifest.jsonl").is_file():
        from orchestrator.batch.sweep.told.unfinished import about_unfinished  # noqa: PLC0415 (it brings pyarrow along)

        return about_unfinished(folder)
    if mark is None:
        raise InputError(folder, "holds no result", f"give a folder with {' or '.join(MARKS)}")
    document = _document(mark, mark.read_bytes())
    facts: dict[str, object] = {"name": document.get("title", "")}
    facts |= {
        key: document[key]
        for key in ("method", "passed", "interrupted", "held", "runs", "points", "failed")
        if key in document
    }
    parameters = document.get("parameters", {})
    if not isinstance(parameters, dict) or not all(isinstance(entry, dict) for entry in parameters.values()):
        raise InputError(mark, "its `parameters` are no parameters", "run the command again")
    if parameters:
        facts["parameters"] = [{"name": name, **entry} for name, entry in parameters.items()]
    facts |= _about_models(document)
    facts["files"] = sorted(
        str(file.relative_to(folder)) for file in folder.rglob("*") if file.is_file() and file.name != RECORD
    )
    return facts


def _about_models(document: Mapping[str, object]) -> InfoDocument:
    """The linear models of a result, and which of them was written."""
    models = document.get("models")
    if not isinstance(models, dict):
        return {}
    known = [(name, one) for name, one in models.items() if isinstance(one, dict)]
    keys = ("order", "step", "stable", "why")
    listed = [{"name": name, **{key: one[key] for key in keys if key in one}} for name, one in known]
    written = document.get("written")
    return {"models": listed, **({"written": written} if isinstance(written, str) else {})}


def _document(place: Path, text: bytes) -> dict[str, object]:
    """A JSON object that we once wrote, or what somebody made of it."""
    try:
        document = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(place, f"is not JSON ({error})", "run the command again") from error
    if not isinstance(document, dict):
        raise InputError(place, "holds no JSON object", "run the command again")
    return document
