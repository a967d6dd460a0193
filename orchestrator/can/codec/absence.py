"""Why signals of a database are not in a log: which of identifier, length, sender or channel it is."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from fmus.errors import TraceError
from fmus.words import listed
from orchestrator.can.database.addressing import j1939
from orchestrator.can.database.message import MessageSpec
from orchestrator.can.statistics import FrameStatistics, identifier_text


class AbsentError(TraceError):
    """Signals have no value in a log.

    Attributes:
        messages: those that would bring them.
        statistics: of the frames that were decoded.
    """

    def __init__(
        self,
        place: str,
        problem: str,
        fix: str = "check the database, the channel and the log",
        messages: Sequence[MessageSpec] = (),
        statistics: FrameStatistics | None = None,
    ) -> None:
        super().__init__(place, problem, fix)
        self.messages, self.statistics = tuple(messages), statistics or FrameStatistics()

    def reasons(self, identifiers: Collection[str], most: int = 3) -> str:
        """Why, for the first messages for which there is more to say than that they are not in the log.

        Args:
            identifiers: of all frames in the log, whatever their channel.
        """
        found = [f"{message.name}: {why}" for message in self.messages if (why := self._why(message, identifiers))]
        return listed(found, most, "; ")

    def _why(self, message: MessageSpec, identifiers: Collection[str]) -> str:
        name, statistics, identifier = message.name, self.statistics, identifier_text(message.id, message.extended)
        if not message.signals:
            left_out = [f"{signal} is left out: {why}" for signal, why in message.left_out.items()]
            return "the database has no sound signal of it" + (f", {listed(left_out)}" if left_out else "")
        if count := statistics.short[name]:
            return f"{count} frames of {identifier} are too short for its {message.length} bytes"
        if count := statistics.other_sources[name]:
            return f"{count} frames come from another source address"
        if (count := statistics.checksums[name]) and count == statistics.messages[name]:
            return f"all of its {count} frames have a wrong checksum; see that the database declares the right one"
        if statistics.messages[name]:
            return "its frames do not hold the signal (another multiplexer value, or no finite one)"
        elsewhere = _elsewhere(message, identifier, identifiers)
        return elsewhere or (f"its identifier {identifier} is not in the log" if len(self.messages) < 4 else "")


def _elsewhere(message: MessageSpec, identifier: str, identifiers: Collection[str]) -> str:
    """As what its frames come instead; "" where they do not come at all."""
    if identifier in identifiers:
        return f"{identifier} comes over another channel only"
    if (other := identifier_text(message.id, not message.extended)) in identifiers and message.id < 1 << 11:
        return f"its identifier comes as {other}, {'standard' if message.extended else 'extended'} only"
    if message.extended and (alike := _of_group(message.id, identifiers)):
        source = "over another channel" if message.addressing else "from another source address (--source any)"
        return f"its J1939 group comes {source}, as {alike}"
    return ""


def _of_group(identifier: int, identifiers: Collection[str]) -> str:
    """An extended identifier of the same group; "" where there is none."""
    mask = j1939(identifier).mask
    alike = (other for other in identifiers if len(other) == 8 and int(other, 16) & mask == identifier & mask)
    return next(alike, "")
