"""How long what was sent has still to wait for a bus that others keep busy.

Adapters say that they have taken a frame, seldom that it has got out. What others send is heard, so that the time is
known which they leave; in that, frames get out.
"""

from __future__ import annotations

import can

from orchestrator.can import frame_time
from orchestrator.can.live.bus import BusSettings

_WINDOW = 0.02  # over which idle time is counted: frames come in bunches [s]


class Backlog:
    """An estimate from the frames on a bus; none where its bit rate is not known.

    Times are those of one clock [s].
    """

    def __init__(self, settings: BusSettings) -> None:
        self._settings = settings
        self._busy = self._left = 0.0  # of the bus: what others took, and what our frames need that have not got out
        self._begun: float | None = None
        self._since: float | None = None

    def sent(self, frame: can.Message) -> None:
        """A frame of ours was taken."""
        self._left += self._duration(frame)

    def heard(self, frame: can.Message) -> None:
        """Somebody else's frame has passed."""
        self._busy += self._duration(frame)

    def look(self, now: float) -> None:
        """Let out what there was time for until now [s]."""
        if self._begun is None:
            self._begun = now
        elif now - self._begun >= _WINDOW:
            self._left = max(0.0, self._left - max(0.0, now - self._begun - self._busy))
            if not self._left:
                self._since = None
            elif self._since is None:
                self._since = self._begun
            self._begun, self._busy = now, 0.0

    def empty(self) -> bool:
        """Whether all has got out."""
        return not self._left

    def age(self, now: float) -> float:
        """For how long something has waited."""
        return 0.0 if self._since is None else now - self._since

    def _duration(self, frame: can.Message) -> float:
        bus = self._settings
        if bus.bitrate is None or frame.is_error_frame:
            return 0.0
        rate = bus.data_bitrate if frame.bitrate_switch else None
        return frame_time.seconds(
            frame.dlc, frame.is_extended_id, frame.is_remote_frame, frame.is_fd, bus.bitrate, rate
        )
