"""Tables of CAN frames as many tools export them: which column is what, by the line with the columns' names."""

from __future__ import annotations

import re
from typing import NamedTuple

SEPARATORS = ",;\t"
NAMES = {
    "time": "time timestamp timestampepoch timeoffset timestamps reltime abstime",
    "id": "id arbitrationid canid identifier messageid msgid idhex",
    "extended": "extended ide ext isextended isextendedid",
    "remote": "remote rtr isremote isremoteframe",
    "error": "error err iserror iserrorframe",
    "code": "dlc datalengthcode",
    "length": "len length datalength size",
    "direction": "dir direction txrx rxtx",
    "fd": "edl fdf fd isfd",
    "switch": "brs bitrateswitch",
    "state": "esi errorstateindicator",
    "bus": "bus",
    "channel": "channel busch buschannel chn ch chan canchannel",
    "type": "type msgtype",
    "data": "data databyte databytes payload datahex framedata",
}
ROLES = {name: role for role, names in NAMES.items() for name in names.split()}
BYTE = re.compile(r"(?:d|b|byte|data|databyte)(\d{1,2})$")
UNITS = {"s": 0, "sec": 0, "ms": 3, "us": 6, "\u00b5s": 6, "\u03bcs": 6, "ns": 9}
UNIT = re.compile(r"[(\[]\s*(.+?)\s*[)\]]")
PYTHON_CAN = "timestamp,arbitration_id,extended,remote,error,dlc,data"


class TableHead(NamedTuple):
    """Columns by what they hold.

    Attributes:
        columns: role (of `NAMES`) -> number of its column.
        octets: columns of the data bytes where each has its own.
        shift: stamps are in 10^-shift seconds; None where the names do not tell.
        base64: whether data are in it.
    """

    separator: str
    columns: dict[str, int]
    octets: tuple[int, ...]
    shift: int | None
    base64: bool


def table_head(line: str) -> TableHead | None:
    """What the columns of a table of frames are; None for any other line."""
    text = line.strip().lstrip("\ufeff").strip("*")
    if not text or len(text) > 4000:
        return None
    separator = max(SEPARATORS, key=text.count)
    names = [name.strip().strip("\"'<>").lower() for name in text.split(separator)]
    plain = [re.sub(r"[^a-z0-9]", "", UNIT.sub("", name)) for name in names]
    columns: dict[str, int] = {}
    for number, name in enumerate(plain):
        if name in ROLES:
            columns.setdefault(ROLES[name], number)
    octets = tuple(number for number, name in enumerate(plain) if BYTE.match(name))
    if not {"time", "id"} <= columns.keys() or ("data" not in columns and not octets):
        return None
    if not columns.keys() & {"code", "length", "extended", "channel", "bus"}:
        return None
    unit = UNIT.search(names[columns["time"]])
    shift = UNITS.get(unit[1]) if unit else None
    return TableHead(separator, columns, () if "data" in columns else octets, shift, text == PYTHON_CAN)
