"""FMUs that tests of the engine share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.support.simulation.both_loops import Shelf, open_shelf


@pytest.fixture(scope="module")
def shelf(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shelf]:
    with open_shelf(tmp_path_factory.mktemp("fmus")) as shelf:
        yield shelf
