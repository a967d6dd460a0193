"""What all results share."""

from __future__ import annotations

from identification.result_sections import parameter_rows
from identification.results import ParameterSummary


def test_a_large_array_has_one_row_and_a_small_one_all_of_its_own() -> None:
    entry: ParameterSummary = {"value": 1.0, "std": None, "ci95": None, "unit": "1", "start": None}
    names = ["c.kp", *(f"c.K[1,{i}]" for i in range(16)), *(f"c.A[1,{i}]" for i in range(17))]
    _, rows = parameter_rows(dict.fromkeys(names, entry))
    assert [row[0] for row in rows] == [*names[:17], "c.A, 17 elements"]
