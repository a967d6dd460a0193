"""Text logs as many tools write them: lines of every kind that each knows."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence

import numpy as np

from tests.support.can.can_samples import START

BUSMASTER = """***BUSMASTER Ver 3.2.2***
***PROTOCOL CAN***
***[START LOGGING SESSION]***
***START DATE AND TIME 7:3:2024 9:20:11:250***
***HEX***
***SYSTEM MODE***
***<Time><Tx/Rx><Channel><CAN ID><Type><DLC><DataBytes>***
"""
TRC = ";$FILEVERSION={}\n;$STARTTIME=45244.0\n;---+--   ----+----\n"
KINDS = {
    "asc": (
        ".asc",
        "date Thu Mar 07 09:20:11.250 2024\nbase hex  timestamps absolute\n",
        [
            "   {t:.6f} 1  {i:X}x             Rx   d 2 {a:02X} 00  Length = 240000 BitCount = 124 ID = 291",
            "   {t:.6f} 2  {s:X}  Tx   d 8 {a:02X} 0A 00 00 00 00 00 FF",
            "   {t:.6f} CANFD   1 Rx {s:X}    Name 1 0 9 12 {a:02X} 1 2 3 4 5 6 7 8 9 A B  130000  130 3000 1 2 3 4",
            "   {t:.6f} CANFD   2 Tx {i:X}x  0 1 2  2 {a:02X} 01 98283 101 200000 1 2 3",
            "   {t:.6f} 1  {s:X} Rx r 4",
            "   {t:.6f} 1  ErrorFrame",
            "   {t:.6f} 1  Statistic: D 0 R 0 XD 0 XR 0 E 0 O 0 B 0.00%",
        ],
    ),
    "asc dec": (
        ".asc",
        "date jeu. mars 07 09:20:11 2024\nbase dec  timestamps absolute\n",
        ["   {t:.6f} 1  {s}  Rx   d 3 {a} 255 0", "   {t:.6f} 1  {i}x  Tx   d 0"],
    ),
    "asc relative": (
        ".asc",
        "base hex  timestamps relative\n",
        ["   0.00{a:03d}0 1  {s:X}  Rx   d 1 {a:02X}", "   0.000100 1  Statistic: D 0", "  0.001000 1 {s:X} TxRq d 0"],
    ),
    "candump": (
        ".log",
        "",
        [
            "({t:.6f}) can0 {s:03X}#{a:02X}00",
            "({t:.6f}) vcan0 {i:08X}#{a:02X}0A00000000000F R",
            "({t:.6f}) can_left {s:03X}##1{a:02X}0A00000000000F00112233 T",
            "({t:.6f}) can0 {s:03X}#R4",
            "({t:.6f}) can1 20000004#0008000000000000",
            "({t:.6f}) can0 {s:03X}#{a:02X}000A0000000000_C",
        ],
    ),
    "candump -x": (
        ".log",
        "",
        [
            " ({t:.6f})  can0  TX - -  {s:03X}   [2]  {a:02X} 00",
            " ({t:.6f})  can1  RX B E  {i:08X}  [12]  {a:02X} 01 02 03 04 05 06 07 08 09 0A 0B",
            " ({t:.6f})  can0  RX - -  {s:03X}   [0]  remote request",
            " ({t:.6f})  can0  {i:08X}   [3]  {a:02X} 00 22   '...'",
            "  can0  {s:03X}   [1]  {a:02X}",
            " ({t:.6f})  can0  {s:03X}   {{C}}  {a:02X} 01 02 03 04 05 06 07",
        ],
    ),
    "candump -i": (
        ".log",
        "",
        [
            " ({t:.6f})  can0  {s:03X}   [2]  {a:08b} 00000010",
            " ({t:.6f})  can0  {i:08X}   [2]  00000010`{a:08b}",
            " ({t:.6f})  can0  {i:08X}   [3]  00`22`{a:02X}",
            " ({t:.6f})  can0  {s:03X}   [1]  {a:08b}",
        ],
    ),
    "kvaser": (
        ".txt",
        "Chn Identifier Flg   DLC  D0...1...2...3...4...5...6..D7       Time     Dir\n",
        [
            " 0    {s:08X}         2  {a:02X}  0A                            {t:.6f} R",
            " 1    {i:08X} X       8  {a:02X}  01  02  03  04  05  06  07    {t:.6f} T",
            " 0    {s:08X}         0                                        {t:.6f} R",
            " 0    {s:08X} R       4                                        {t:.6f} R",
            " 0    ErrorFrame                                               {t:.6f} R",
        ],
    ),
    "trc 1.1": (
        ".trc",
        TRC.format("1.1"),
        ["  {n})  {t:.1f}  Rx  {s:04X}  2  {a:02X} 02", "  {n})  {t:.1f} Error 0000 0"],
    ),
    "trc 1.2": (
        ".trc",
        TRC.format("1.2"),
        ["  {n})  {t:.3f} 2 Tx {i:08X}  3  {a:02X} 02 00", "{n}) {t:.1f} 1 Rx 0123 2 RTR"],
    ),
    "trc 2.1": (
        ".trc",
        TRC.format("2.1").replace(";---", ";$COLUMNS=N,O,T,B,I,d,R,L,D\n;---"),
        [
            "  {n}  {t:.3f} DT 1 {s:04X} Rx - 2 {a:02X} 02",
            "  {n}  {t:.3f} FB 1 {i:08X} Tx - 9 {a:02X} 02 03 04 05 06 07 08 09 0A 0B 0C",
            "  {n}  {t:.3f} RR 1 {s:04X} Rx - 4",
            "  {n}  {t:.3f} ST Rx 00 00 00 00",
        ],
    ),
    "python-can": (
        ".csv",
        "timestamp,arbitration_id,extended,remote,error,dlc,data\n",
        ["{t!r},0x{s:x},0,0,0,2,{a64}", "{t!r},0x{i:x},1,0,0,0,", "{t!r},0x{s:x},0,1,0,4,"],
    ),
    "gvret": (
        ".csv",
        "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n",
        ["{n}0000,{s:08X},false,Rx,0,2,{a:02X},0A,", "{n}0000,{i:08X},true,Tx,1,8,{a:02X},0A,0,1,2,3,4,5,"],
    ),
    "canedge": (
        ".csv",
        "TimestampEpoch;BusChannel;ID;IDE;DLC;DataLength;Dir;EDL;BRS;DataBytes\n",
        ["{t:.6f};1;{s:X};0;3;3;0;0;0;{a:02X}0A00", "{t:.6f};2;{i:X};1;9;12;1;1;1;{a:02X}0A00000000000000112233"],
    ),
    "canoe": (
        ".csv",
        '"Time[ms]","Chn","ID","Name","Dir","DLC","Data"\n',
        ['"{t:.3f}","1","{s:X}","Rig","Rx","3","{a:02X} 0A 00"', "{t:.3f},2,{i:X}x,Rig,Tx,2,{a:02X} 0B"],
    ),
    "vector": (
        ".csv",
        "Time;Chn;ID;Name;Dir;DLC;Data length;Data\n",
        ["{t:.6f};CAN 1;{s:X};Rig;Rx;2;2;{a:02X} 0A", "{t:.6f};CAN 2;{i:X}x;;Tx;1;1;{a:02X}"],
    ),
    "busmaster": (
        ".log",
        BUSMASTER,
        [
            "9:20:1{d}:2500 Rx 1 0x{s:X} s 2 {a:02X} 0A ",
            "09:20:12:0001 Tx 2 0x{i:08X} x 1 {a:02X}",
            "9:20:12:0001 Rx 1 0x{s:X} sr 2",
        ],
    ),
}


def text_of(kind: str, choices: Sequence[int]) -> str:
    """A log of this kind with one line a choice."""
    _, head, forms = KINDS[kind]
    rng = np.random.default_rng(len(choices))
    lines = []
    for number, choice in enumerate(choices):
        octet = int(rng.integers(0, 256))
        values = {
            "n": number + 1,
            "d": number % 10,
            "t": START + number * 0.001,
            "i": int(rng.integers(1 << 11, 1 << 29)),
            "s": int(rng.integers(0, 1 << 11)),
            "a": octet,
            "a64": b64encode(bytes([octet, 0])).decode(),
        }
        lines.append(forms[choice % len(forms)].format(**values))
    return head + "".join(line + "\n" for line in lines)
