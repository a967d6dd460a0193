"""Which files are logs of CAN frames. Told here without python-can, which takes a second or two to be imported."""

from __future__ import annotations

from pathlib import Path

SUFFIXES = (".asc", ".blf", ".csv", ".db", ".log", ".mf4", ".trc")
CSV_HEADER = "timestamp,arbitration_id,extended,remote,error,dlc,data"


def is_log(path: str | Path) -> bool:
    """Whether a file is a log of frames by its suffix; a .csv is one when it has python-can's header."""
    file = Path(path)
    if file.suffix.lower() != ".csv":
        return file.suffix.lower() in SUFFIXES
    try:
        with file.open("rb") as content:
            return content.readline(len(CSV_HEADER) + 8).strip() == CSV_HEADER.encode()
    except OSError:
        return False
