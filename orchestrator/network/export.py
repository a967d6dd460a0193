"""From a model and the database of a bus to what the model's network FMU sends and receives.

A signal is the variable of the model that has its name: a message with outputs is sent, one with inputs received.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from fmus.errors import DatabaseError, InputError
from fmus.modelling.model import Model, Variable
from fmus.packaging.native.network import Checksum, Frame, FrameSignal, Network
from orchestrator.can.codec.fields import check_sendable, longest, raw_limits
from orchestrator.can.database.database import Database, load
from orchestrator.can.database.message import MessageSpec, SignalSpec, checksum_byte
from orchestrator.can.database.protection import ALGORITHMS
from orchestrator.can.frames import CLASSIC
from orchestrator.crossing import Crossing, crossing, documents_of, named
from orchestrator.network.paged import in_order, pages_of, place_of, presence_of, received_by

_MOST = 256  # frames of one FMU


@dataclass(frozen=True)
class ExportedNetwork:
    """What a model has on a bus.

    Attributes:
        notes: what is not on it, or not as somebody might think, a line each.
        crossings: how values pass between units.
    """

    network: Network
    notes: tuple[str, ...]
    crossings: tuple[Crossing, ...]

    def document(self) -> dict[str, object]:
        """Frames and their variables, for somebody to see."""
        return {
            "terminal": self.network.name,
            "frames": [
                {
                    "name": frame.name,
                    "id": frame.id,
                    "period": frame.period * 1e-9 if frame.sent else None,
                    "variables": [signal.variable for signal in frame.signals if signal.variable],
                }
                for frame in self.network.frames
            ],
            "units": documents_of(self.crossings),
            "notes": self.notes,
        }


def exported(model: Model, file: Path) -> ExportedNetwork:
    """What the network FMU of a model exchanges.

    Raises:
        DatabaseError: the file cannot be read; or it does not fit the model: no signal has the name of a variable, a
            message is both sent and received, has no period, or is of a kind that a network FMU does not write.
        WiringError: a signal is of another quantity than its variable.
    """
    if file.suffix.lower() != ".dbc":
        raise InputError(f"--bus {file}", "is no DBC", "give a file .dbc")
    database = load(file)
    found: list[Frame] = []
    crossings: list[Crossing] = []
    notes: list[str] = [*database.notes]
    for message in database.messages:
        frame = _frame(model, database, message, crossings, notes)
        found += [] if frame is None else [frame]
    if not found:
        names = ", ".join(v.name for v in model.variables if v.causality in ("input", "output"))
        raise DatabaseError(file, f"has no signal that is called as a variable of {model.name}", f"it has {names}")
    if len(found) > _MOST:
        raise DatabaseError(file, f"has {len(found)} frames of {model.name}", f"an FMU has at most {_MOST}")
    _check_sources(file, found)
    carried = {signal.variable for frame in found for signal in frame.signals}
    left = [v.name for v in model.variables if v.causality in ("input", "output") and v.name not in carried]
    notes += [f"{', '.join(left)}: in no frame, and as without a bus"] if left else []
    return ExportedNetwork(Network(file.stem, tuple(found), file.read_bytes()), tuple(notes), tuple(crossings))


def _frame(
    model: Model, database: Database, message: MessageSpec, crossings: list[Crossing], notes: list[str]
) -> Frame | None:
    """The frame of a message; None where it is nothing to the model."""
    place = f"{database.path}: {message.name}"
    named = {one.name: model.by_name[one.name] for one in message.signals if one.name in model.by_name}
    causes = {variable.causality for variable in named.values()} & {"input", "output"}
    if not causes:
        return None
    if len(causes) > 1:
        one, other = (next(n for n, v in named.items() if v.causality == cause) for cause in ("output", "input"))
        problem = f"has {one}, an output of {model.name}, and {other}, an input"
        raise DatabaseError(place, problem, "a message has one sender: take them apart")
    (causality,) = causes
    taken = [signal for signal in message.signals if signal.name in named and named[signal.name].causality == causality]
    _check_kind(place, message, causality)
    if causality == "output":
        check_sendable(message)
    signals = tuple(_signal(place, message, signal, named[signal.name], causality, crossings) for signal in taken)
    mask = received_by(database, message)
    frame = Frame(
        message.name,
        message.id,
        message.extended,
        message.fd,
        message.length,
        0,
        signals,
        mask=mask,
        counter=_counter(place, message),
        checksum=_checksum(message),
    )
    return frame if causality == "input" else _sent(place, message, frame, notes)


def _counter(place: str, message: MessageSpec) -> tuple[FrameSignal, int] | None:
    if message.protection is None or not message.protection.counter:
        return None
    counting = message.signal(message.protection.counter)
    modulus = message.protection.modulus or 1 << counting.length
    return FrameSignal("", *place_of(place, counting), 1.0, 0.0, 0.0, modulus - 1.0), modulus


def _checksum(message: MessageSpec) -> Checksum | None:
    protection = message.protection
    if protection is None or not protection.checksum:
        return None
    crc, byte = ALGORITHMS[protection.algorithm], checksum_byte(message.signal(protection.checksum))
    assert byte is not None
    return Checksum(byte, message.length, crc.polynomial, crc.start, crc.mask, protection.data_id)


def _sent(place: str, message: MessageSpec, frame: Frame, notes: list[str]) -> Frame:
    """The frame as it is sent."""
    if not message.cycle:
        raise DatabaseError(place, "has no period, by which a network FMU sends it", "give it a GenMsgCycleTime")
    protection = message.protection
    filled = {signal.variable for signal in frame.signals}
    filled |= {protection.counter, protection.checksum} if protection else set()
    others = [signal for signal in message.signals if signal.name not in filled]
    if others:
        notes.append(f"{message.name}: {', '.join(s.name for s in others)} rest at the initial value, or zero")
    given = [signal.variable for signal in frame.signals]
    return replace(
        frame,
        signals=in_order(place, message, frame.signals),
        length=longest(message),
        period=round(message.cycle * 1e9),
        pages=pages_of(place, message, given),
    )


def _check_kind(place: str, message: MessageSpec, causality: str) -> None:
    """See that a message is of a kind that a network FMU writes and reads."""
    if message.addressing is not None and message.length > CLASSIC and not message.fd:
        problem = f"has {message.length} bytes, which J1939 sends in several frames"
        raise DatabaseError(place, problem, "take it apart")
    if message.of_any_sender and causality == "output":
        raise DatabaseError(place, "has no address of a sender in its identifier", "give it that of the model")
    if message.left_out:
        name, why = next(iter(message.left_out.items()))
        raise DatabaseError(f"{place}.{name}", why, "correct the database")


def _signal(
    place: str,
    message: MessageSpec,
    signal: SignalSpec,
    variable: Variable,
    causality: str,
    crossings: list[Crossing],
) -> FrameSignal:
    presence = presence_of(place, message, signal)
    place = f"{place}.{signal.name}"
    lies = place_of(place, signal)
    ends = named(signal.unit), named("" if variable.unit == "1" else variable.unit)
    crossed = crossing(place, *(ends if causality == "input" else ends[::-1]))
    crossings.append(crossed)
    factor, offset = crossed.conversion.factor, crossed.conversion.offset
    if causality == "output":  # from the variable to the signal: turned round
        factor, offset = 1 / factor, -offset / factor
    gain, bias = factor * signal.scale, factor * signal.offset + offset
    if variable.type != "Real" and (gain != int(gain) or bias != int(bias) or signal.is_float):
        problem = f"has values that are not whole, and {variable.name} is {variable.type}"
        raise DatabaseError(place, problem, "see to its scale")
    low, high = raw_limits(signal)
    return FrameSignal(variable.name, *lies, gain, bias, float(low), float(high), presence)


def _check_sources(file: Path, frames: list[Frame]) -> None:
    """See that an input is in one frame only."""
    source: dict[str, str] = {}
    for frame in frames:
        for signal in frame.signals if not frame.sent else ():
            if other := source.get(signal.variable):
                problem = f"is in {other} and in {frame.name}, which would set one input"
                raise DatabaseError(f"{file}: {signal.variable}", problem, "call one of them otherwise")
            source[signal.variable] = frame.name
