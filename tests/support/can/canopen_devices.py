"""A CANopen device as its EDS tells it: objects, and process data that map them."""

from __future__ import annotations

VARIABLE = "[{section}]\nParameterName={name}\nObjectType=0x7\nDataType={type}\nAccessType=rw\nPDOMapping=1\n"
RECORD = "[{index:04X}]\nParameterName=record\nObjectType=0x9\nSubNumber={count}\n"
ENTRY = VARIABLE + "{key}={value}\n"


def record(index: int, entries: dict[int, tuple[int, str]], key: str = "DefaultValue") -> str:
    """A record of entries: subindex -> type and value."""
    subs = (
        ENTRY.format(section=f"{index:04X}sub{sub:X}", name=f"entry {sub}", type=kind, key=key, value=value)
        for sub, (kind, value) in entries.items()
    )
    return RECORD.format(index=index, count=len(entries)) + "".join(subs)


def mapping(index: int, *entries: str, key: str = "DefaultValue") -> str:
    return record(index, {0: (5, str(len(entries)))} | {n: (7, e) for n, e in enumerate(entries, 1)}, key)


OBJECTS = (
    VARIABLE.format(section="6041", name="Statusword", type=6)
    + VARIABLE.format(section="6064", name="Position actual value", type=4)
    + VARIABLE.format(section="2000", name="Temperature", type=8)
)
EDS = (
    "[DeviceInfo]\nVendorName=x\n"
    + OBJECTS
    + record(0x1800, {0: (5, "5"), 1: (7, "$NODEID+0x180"), 5: (6, "20")})
    + mapping(0x1A00, "0x60410010", "0x60640020")
    + record(0x1801, {0: (5, "2"), 1: (7, "0x80000280")})
    + mapping(0x1A01, "0x60410010")
    + record(0x1402, {0: (5, "2"), 1: (7, "0x345")})
    + mapping(0x1602, "0x00050008", "0x20000020", "0x30000110")
)
