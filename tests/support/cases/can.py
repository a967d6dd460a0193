"""Logs and databases as people have them."""

from __future__ import annotations

from collections.abc import Sequence

from tests.support.cases.case import Case, Step


def _info(name: str, arguments: str, shows: Sequence[str] = (), hides: Sequence[str] = (), code: int = 0) -> Case:
    return Case(f"can/{name}", [Step(f"servotwin trace info {arguments}", code, shows, hides)])


def _converted(name: str, arguments: str, rows: int, shows: Sequence[str] = ()) -> Case:
    """A log that becomes so many rows."""
    return Case(
        f"can/{name}",
        [
            Step(f"rm -f out.csv; servotwin trace convert {arguments.replace('OUT', 'out.csv')}", 0, shows),
            Step("echo ROWS $(($(wc -l < out.csv) - 1))", 0, [f"ROWS {rows}$"]),
        ],
    )


_SOUND = (
    "mux_same_name",
    "no_definition",
    "one_id_twice",
    "overlap",
    "standard_29bit",
    "toolong",
    "two_of_a_name",
    "unused",
)
_ENCODED = ("shift_jis_backslash", "cp1251", "gbk", "gb2312_unit", "shift_jis", "cp1250")
_TERMINAL = {"absolute": 3, "date": 3, "default": 3, "extra": 3, "rawdlc": 2}

CASES = {
    "can/arxml_long_signal": _info(
        "arxml_long_signal", "run.log --dbc diag.arxml", ["no frame of the database"], ["bits or bytes"], 2
    ),
    **{
        f"can/asc_date_then_dec {name}": _info("asc_date_then_dec", f"{name}.asc --dbc rig.dbc", ["speed"], ["heat"])
        for name in ("english", "french", "iso")
    },
    "can/asc_relative": _converted("asc_relative", "run.asc OUT", 3),
    "can/asc_relative txrq": _info("asc_relative", "txrq.asc", [r"\b2\b"], [r"frames\W+4"]),
    "can/blf_header_version_3": _info("blf_header_version_3", "v3.blf", ["header"], code=2),
    "can/blf_header_version_3 v1": _info("blf_header_version_3", "v1.blf"),
    "can/candump_terminal": Case(
        "can/candump_terminal",
        [Step(f"servotwin trace info {name}.log", 0, [rf"\b{frames}\b"]) for name, frames in _TERMINAL.items()],
    ),
    "can/csv_of_other_tools gvret": _info("csv_of_other_tools", "gvret.csv --dbc rig.dbc", ["speed"]),
    "can/csv_of_other_tools canedge": _info("csv_of_other_tools", "canedge.csv --dbc rig.dbc", ["speed"]),
    "can/dbc_encoding": Case(
        "can/dbc_encoding",
        [
            Step("servotwin trace info --help", 0, ["--encoding"]),
            *(Step(f"servotwin trace info run.log --dbc {name}.dbc", 0) for name in _ENCODED),
        ],
    ),
    **{
        f"can/dbc_one_bad_message {name}": _info(
            "dbc_one_bad_message", f"run.log --dbc {name}.dbc --signal Rig.speed", ["speed"], ["WARNING.*cantools"]
        )
        for name in _SOUND
    },
    "can/dbc_twice": _info("dbc_twice", "run.log --dbc a.dbc --dbc b.dbc", ["speed", "velocity"]),
    "can/equal_stamps": _converted("equal_stamps", "run.log OUT --dbc rig.dbc", 7),
    "can/fd_message_short_frames": _info("fd_message_short_frames", "run.log --dbc rig.dbc", ["speed", "short"]),
    "can/j1939_source_address": _info("j1939_source_address", "run.log --dbc j1939.dbc", ["EngineSpeed"]),
    "can/late_message": _converted("late_message", "run.log OUT --dbc rig.dbc", 1001),
    "can/mf4_extended_in_bit31": _info("mf4_extended_in_bit31", "bit31.mf4 --dbc ext.dbc", ["10"], ["no frame"]),
    "can/mf4_extended_in_bit31 nolength": _info("mf4_extended_in_bit31", "nolength.mf4 --dbc ext.dbc"),
    "can/mf4_measurement": _info("mf4_measurement", "measurement.mf4", (), [r"frames\W+0\b"]),
    "can/mf4_unfinalized": _info("mf4_unfinalized", "unfinalized.mf4"),
    "can/two_channels": _info("two_channels", "run.log --dbc rig.dbc", [r"can0\.speed", r"can1\.speed"]),
    "can/two_channels databases": _info("two_channels", "run.log --dbc 0=rig.dbc --dbc 1=rig.dbc", ["channel|can[01]"]),
}
