"""The formats of text by name, as `orchestrator.can.log_suffixes` tells them."""

from __future__ import annotations

from typing import Any

from orchestrator.can.logs.text.asc import ASC
from orchestrator.can.logs.text.busmaster import BUSMASTER
from orchestrator.can.logs.text.candump import CANDUMP
from orchestrator.can.logs.text.form import TextFormat
from orchestrator.can.logs.text.kvaser import KVASER
from orchestrator.can.logs.text.table import TABLE
from orchestrator.can.logs.text.trc import TRC

FORMATS: dict[str, TextFormat[Any]] = {
    "asc": ASC,
    "busmaster": BUSMASTER,
    "candump": CANDUMP,
    "kvaser": KVASER,
    "table": TABLE,
    "trc": TRC,
}
