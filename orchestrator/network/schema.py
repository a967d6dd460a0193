"""How a scenario describes its buses."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field, model_validator

from orchestrator.network.bus_spec import BusSpec
from orchestrator.yaml_file import Block, Time

Rate = Annotated[int, Field(gt=0)]


class BusBlock(Block):
    """A CAN bus between FMUs with terminals after FMI-LS-BUS, named as a component that gives its `load`.

    Attributes:
        database: of nodes that exchange signals, relative to this file; else the one that their FMU brings along.
    """

    explained_by = (BusSpec,)

    nodes: Annotated[list[str], Field(min_length=1)]
    bitrate: Rate | None = None
    data_bitrate: Rate | None = None
    direct: bool = BusSpec.direct
    database: Path | None = None
    most_late: Annotated[Time, Field(gt=0)] | None = None
    give_up: Time = Field(BusSpec.give_up, gt=0)

    @model_validator(mode="after")
    def _direct_is_a_wire(self) -> BusBlock:
        if self.direct and (self.bitrate or self.data_bitrate or self.database):
            raise ValueError("a `direct` wire passes operations on as they are: remove what else is said of it")
        return self

    def spec(self, base: Path) -> BusSpec:
        """The bus; its database is relative to `base`."""
        database = None if self.database is None else base / self.database
        times = self.most_late, self.give_up
        return BusSpec(tuple(self.nodes), self.bitrate, self.data_bitrate, self.direct, database, *times)
