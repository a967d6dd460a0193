"""References are accepted deliberately, whole, with where they are from, and never over what is somebody else's."""

from __future__ import annotations

import errno
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import Result

from fmus import files as fmu_files
from fmus.files import sha256
from fmus.packaging import targets
from orchestrator import formats
from orchestrator.formats import parquet
from orchestrator.scenario import references
from orchestrator.scenario.expectations import OnSignal
from orchestrator.scenario.run import run_scenario
from orchestrator.scenario.schema import load_scenario
from orchestrator.trace import Trace
from tests.support.commands import servotwin

SWING = """
title: A swing
components:
  hand: {model: pendulum, parameters: {angle_start: 1.0}}
run: {stop: 0.5, step: 0.001}
expect:
  - {signal: hand.angle, reference: accepted, within: 1.0e-3}
cases:
  - {name: high}
  - {name: low, set: {hand.angle_start: 0.2}}
"""

SAMPLED = """
title: A sampled source
components:
  source: {model: excitation, parameters: {amplitude: 1.0, frequency: 1.0}}
  channel: {model: daq, parameters: {sample_time: 0.05}}
connections: [source.signal -> channel.signal]
run: {stop: 2, step: 0.001}
expect:
  - {signal: channel.measured, reference: accepted, within: 1.0e-3}
"""


@pytest.fixture
def swing(tmp_path: Path) -> Path:
    file = tmp_path / "swing.yaml"
    file.write_text(SWING)
    return file


def command(*arguments: object, code: int = 0) -> Result:
    answer = servotwin(*arguments)
    assert answer.exit_code == code, answer.output
    return answer


def accept(scenario: Path, *options: object, code: int = 0) -> dict[str, Any]:
    answer = command("accept", scenario, "--out", scenario.parent / "out", "--json", *options, code=code)
    document: dict[str, Any] = json.loads(answer.stdout) if code == 0 else {"said": answer.stderr}
    return document


def changes(document: dict[str, Any]) -> dict[str, tuple[str, bool]]:
    return {one["case"]: (one["change"], one["written"]) for one in document["references"]}


def reference(scenario: Path, case: str = "high") -> Path:
    return scenario.parent / "references" / scenario.stem / f"{case}.parquet"


def edit(scenario: Path, old: str, new: str) -> None:
    assert old in scenario.read_text()
    scenario.write_text(scenario.read_text().replace(old, new))


def test_a_scenario_without_its_reference_fails_until_one_is_accepted(swing: Path) -> None:
    before = run_scenario(swing)
    assert not before.passed
    assert "servotwin accept" in before.cases[0].checks[0].found
    assert changes(accept(swing)) == {"high": ("new", True), "low": ("new", True)}
    assert run_scenario(swing).passed


def test_only_what_differs_is_written_and_with_all_the_rest_too(swing: Path) -> None:
    accept(swing)
    untouched = sha256(reference(swing, "low"))
    edit(swing, "angle_start: 1.0", "angle_start: 1.01")
    assert not run_scenario(swing).passed
    shown = accept(swing, "--dry-run")
    assert changes(shown) == {"high": ("differs", False), "low": ("agrees", False)}
    (high,) = shown["references"][0]["signals"]
    assert high["beyond"] and high["first"] == 0 and high["by"] == pytest.approx(0.01)
    assert not run_scenario(swing).passed
    assert changes(accept(swing)) == {"high": ("differs", True), "low": ("agrees", False)}
    assert sha256(reference(swing, "low")) == untouched
    assert run_scenario(swing).passed
    assert changes(accept(swing, "--all")) == {"high": ("agrees", True), "low": ("agrees", True)}


def test_what_differs_is_what_the_expectation_says(swing: Path) -> None:
    edit(swing, "within: 1.0e-3}", "nrmse: {at_most: 0.05}, after: 0.2}")
    accept(swing)
    edit(swing, "angle_start: 1.0", "angle_start: 1.01")
    document = accept(swing)
    assert changes(document)["high"] == ("agrees", False)
    assert document["references"][0]["signals"][0]["largest"] == pytest.approx(0.009, rel=0.02)  # from 0.2 s on
    edit(swing, "angle_start: 1.01", "angle_start: 1.2")
    assert not run_scenario(swing).passed
    assert changes(accept(swing))["high"] == ("differs", True)


@pytest.mark.slow
def test_signals_that_are_held_are_kept_as_steps(swing: Path) -> None:
    swing.write_text(SAMPLED)
    accept(swing)
    run = run_scenario(swing)
    assert run.passed
    trace, _ = references.read(reference(swing, "run"))
    (condition,) = (expected.leaves[0] for expected in run.scenario.cases[0].expected)
    assert isinstance(condition, OnSignal) and condition.hold
    full = run.cases[0].trace
    kept = trace.resampled(full.time, hold=trace.names)["channel.measured"]
    assert len(trace) < len(full) / 5 and np.max(np.abs(kept - full["channel.measured"])) <= 0.05 * 1e-3


def test_references_that_no_case_asks_for_are_told_by_a_run_too(swing: Path) -> None:
    accept(swing)
    edit(swing, "name: low", "name: high-up")
    assert run_scenario(swing).scenario.notes == [f"{reference(swing, 'low')}: no case asks for this reference"]


def test_a_run_that_became_shorter_than_its_reference_is_refused_but_where_it_is_asked_for(swing: Path) -> None:
    accept(swing)
    edit(swing, "stop: 0.5,", "stop: 0.3,")
    said = command("run", swing, "--out", swing.parent / "run", code=2).stderr
    assert "goes from 0 to 0.5 s, and the run only from 0 to 0.3 s; run as long, take another with" in said
    edit(swing, "accepted, within", "accepted, before: 0.3, within")
    command("run", swing, "--out", swing.parent / "run")
    edit(swing, "stop: 0.3, step: 0.001", "stop: 0.294, step: 0.007")  # it ends less than a step before
    command("run", swing, "--out", swing.parent / "run")


def test_one_case_is_accepted_alone(swing: Path) -> None:
    accept(swing, "--case", "low")
    assert not reference(swing).exists() and reference(swing, "low").exists()
    assert "has no case 'middle'; its cases are high, low" in accept(swing, "--case", "middle", code=2)["said"]


def test_a_reference_says_where_it_is_from_and_what_it_replaces(swing: Path) -> None:
    accept(swing)
    first = sha256(reference(swing))
    edit(swing, "angle_start: 1.0", "angle_start: 1.01")
    accept(swing)
    trace, provenance = references.read(reference(swing))
    assert (provenance["scenario"], provenance["case"], provenance["replaces"]) == ("swing.yaml", "high", first)
    assert provenance["by"] and provenance["at"].endswith("+00:00") and "servotwin" in provenance["versions"]
    assert provenance["sha256"]["swing.yaml"] == sha256(swing)
    assert provenance["sha256"].keys() == {"swing.yaml", "model pendulum"}
    assert provenance["samples"] == 501 and len(trace) < 150
    assert sha256(swing.parent / "out" / "replaced" / "1_swing" / "high.parquet") == first


def test_the_lines_of_a_reference_are_within_a_twentieth_of_the_tolerance_of_the_run(swing: Path) -> None:
    accept(swing)
    run = run_scenario(swing).cases[0].trace
    trace, _ = references.read(reference(swing))
    assert np.max(np.abs(trace.resampled(run.time)["hand.angle"] - run["hand.angle"])) <= 0.05 * 1e-3
    assert reference(swing).stat().st_size < 6000


def tampered(file: Path, change: Any) -> None:
    trace, provenance = references.read(file)
    with file.open("wb") as target:
        parquet.write_small(change(trace), target, {references.PROVENANCE: json.dumps(provenance)})


def with_nan(trace: Trace) -> Trace:
    values = trace["hand.angle"].copy()
    values[3] = np.nan
    return Trace(trace.time, {"hand.angle": values}, trace.units, trace.name)


@pytest.mark.parametrize(
    ("change", "said", "why"),
    [
        (with_nan, "hand.angle is not finite at", "is not finite"),
        (
            lambda trace: trace.renamed({"hand.angle": "hand.speed"}),
            "is no reference of hand.angle",
            "without hand.angle",
        ),
        (lambda trace: trace.between(0, 0.3), "not 0 to 0.5 s", "of 0 to 0.3"),
        (
            lambda trace: Trace(trace.time, dict(trace.signals), {"hand.angle": "N.m"}, trace.name),
            "N.m does not fit rad",
            "in N.m instead of rad",
        ),
    ],
)
def test_a_reference_of_other_signals_units_or_times_or_with_a_nan_is_refused_and_can_be_replaced(
    swing: Path, change: Any, said: str, why: str
) -> None:
    accept(swing)
    tampered(reference(swing), change)
    answer = command("run", swing, "--out", swing.parent / "run", code=2)
    assert said in answer.stderr and "Traceback" not in answer.stderr
    document = accept(swing)
    assert why in document["references"][0]["why"] and changes(document)["high"][1]
    assert run_scenario(swing).passed


@pytest.mark.parametrize("content", [b"not a table", b"", "a table"])
def test_a_file_that_is_not_ours_is_neither_taken_for_a_reference_nor_replaced(
    swing: Path, content: bytes | str
) -> None:
    reference(swing).parent.mkdir(parents=True)
    if isinstance(content, bytes):
        reference(swing).write_bytes(content)
    else:
        formats.write(Trace(np.array([0.0, 1.0]), {"hand.angle": np.zeros(2)}), reference(swing))
    before = reference(swing).read_bytes()
    command("run", swing, "--out", swing.parent / "run", code=2)
    accept(swing, code=2)
    assert reference(swing).read_bytes() == before and not reference(swing, "low").exists()


def test_two_scenarios_do_not_share_their_references(swing: Path) -> None:
    accept(swing)
    twin = swing.with_suffix(".yml")
    twin.write_text(SWING)
    assert "is a reference of" in accept(twin, code=2)["said"]
    command("run", twin, "--out", swing.parent / "run", code=2)
    reference(swing).unlink()
    reference(swing, "low").unlink()
    answer = command("accept", swing, twin, "--out", swing.parent / "out", code=2)
    assert "so would" in answer.stderr and not reference(swing).exists()


def test_a_full_disk_leaves_every_reference_as_it_was(swing: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    accept(swing)
    before = {file: file.read_bytes() for file in reference(swing).parent.iterdir()}
    edit(swing, "angle_start: 1.0", "angle_start: 1.01")
    edit(swing, "angle_start: 0.2", "angle_start: 0.21")
    write = fmu_files._write

    def full(part: Path, content: Any, for_good: bool) -> None:
        if "low.parquet" in part.name:
            part.write_bytes(content[:100])
            raise OSError(errno.ENOSPC, "No space left on device")
        write(part, content, for_good)

    monkeypatch.setattr(fmu_files, "_write", full)
    assert "No space left on device" in accept(swing, code=2)["said"]
    assert {file: file.read_bytes() for file in reference(swing).parent.iterdir()} == before
    told = json.loads((swing.parent / "out" / "manifest.json").read_text())
    assert [one["written"] for one in told["references"]] == [False, False]


def test_one_of_a_platform_is_kept_beside_those_of_others(swing: Path) -> None:
    edit(swing, "reference: accepted", "reference: accepted per platform")
    accept(swing)
    (high,) = reference(swing).parent.glob("high.*.parquet")
    other = high.with_name("high.aarch64-darwin.parquet")
    high.rename(other)
    assert not run_scenario(swing).passed
    document = accept(swing)
    assert document["unused"] == [] and changes(document)["high"] == ("new", True) and other.exists()
    assert run_scenario(swing).passed


def test_references_that_no_case_asks_for_are_told(swing: Path) -> None:
    accept(swing)
    edit(swing, "name: low", "name: lower")
    document = accept(swing)
    assert document["unused"] == [str(reference(swing, "low"))]
    assert reference(swing, "low").exists() and reference(swing, "lower").exists()


def test_references_whose_scenario_is_gone_are_told_and_other_folders_are_not(swing: Path) -> None:
    accept(swing)
    other = swing.rename(swing.with_name("pendulum.yaml"))
    measured = swing.parent / "references" / "measured"
    measured.mkdir()
    formats.write(Trace(np.array([0.0, 1.0]), {"y": np.zeros(2)}), measured / "y.parquet")
    (measured / "damaged.parquet").write_bytes(b"x")
    assert accept(other)["unused"] == [str(reference(swing).parent)]


def test_expectations_that_the_run_does_not_meet_are_told_when_it_is_accepted(swing: Path) -> None:
    edit(swing, "cases:", "  - {signal: hand.angle, below: 0.5}\ncases:")
    (doubt,) = accept(swing)["doubts"]
    assert "case high: hand.angle stays below 0.5 rad does not hold (largest 1 rad)" in doubt


def test_a_reference_that_is_too_large_is_refused(swing: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(references, "LARGEST", 2000)
    assert "would take" in accept(swing, code=2)["said"] and not reference(swing).exists()


def test_a_run_that_fails_gives_no_reference_and_others_of_the_same_command_do(swing: Path) -> None:
    broken = swing.with_name("broken.yaml")
    broken.write_text(SWING.replace("model: pendulum", "model: no_such_model"))
    answer = command("accept", swing.parent, "--out", swing.parent / "out", code=2)
    assert "no_such_model" in answer.stderr and reference(swing).exists()


def test_the_terminal_shows_numbers_and_curves_of_what_differs(swing: Path) -> None:
    accept(swing)
    edit(swing, "angle_start: 1.0", "angle_start: 1.5")
    said = command("accept", swing, "--out", swing.parent / "out").stdout
    assert "500" in said and ". old  * new  # both" in said and "high.parquet: differs, written" in said
    assert (swing.parent / "out" / "report.html").stat().st_size > 0


def test_a_reference_holds_what_is_compared_with_it_and_no_more(tmp_path: Path) -> None:
    early = "{signal: hand.angle, before: 0.1, reference: accepted, within: 1.0e-6}"
    late = "{signal: hand.speed, after: 0.05, before: 0.3, reference: accepted, within: 2.0e-2}"
    file = tmp_path / "swing.yaml"
    head = SWING.partition("expect:")[0]
    file.write_text(f"{head}expect: [{early}, {late}]\n")
    command("accept", file, "--out", tmp_path / "out")
    kept = formats.read(tmp_path / "references" / "swing" / "run.parquet").trace
    assert (kept.time[0], kept.time[-1]) == (0.0, pytest.approx(0.301))
    assert np.ptp(kept.between(0.102, 1.0)["hand.angle"]) == 0.0
    assert np.count_nonzero(kept.time > 0.102) < 60 < np.count_nonzero(kept.time <= 0.102)
    result = run_scenario(file)
    assert result.passed
    command("test", file, "--out", tmp_path / "suite")
    command("compare", file, file)


@pytest.mark.parametrize(
    ("asked", "apart"), [("nrmse: {at_most: 1.0e-6}", 1e-6 * 0.3), ("deviation: {at_most: 2.0e-7 rad}", 2e-7)]
)
def test_a_reference_is_as_fine_as_the_bound_that_it_is_for(tmp_path: Path, asked: str, apart: float) -> None:
    file = tmp_path / "swing.yaml"
    head = SWING.partition("expect:")[0]
    file.write_text(f"{head}expect: [{{signal: hand.angle, reference: accepted, {asked}}}]\n")
    command("accept", file, "--out", tmp_path / "out")
    (case,) = run_scenario(file).cases
    assert case.passed
    kept = formats.read(tmp_path / "references" / "swing" / "run.parquet").trace
    off = kept.resampled(case.trace.time)["hand.angle"] - case.trace["hand.angle"]
    assert 0 < np.abs(off).max() < 0.06 * apart * np.ptp(case.trace["hand.angle"]) / 0.3 + 1e-12


def test_references_of_a_scenarios_own_components_are_not_asked_of_other_fmus_and_that_is_told(
    swing: Path, tmp_path: Path
) -> None:
    accept(swing)
    heavy = targets.build("pendulum", tmp_path / "heavy.fmu", parameters={"angle_start": 0.7})
    assert not run_scenario(load_scenario(swing), {"hand.angle_start": 0.7}).passed
    other = run_scenario(load_scenario(swing, fmus={"hand": heavy}))
    assert [case.checks for case in other.cases] == [(), ()]
    told = "not asked of other FMUs than its own: hand.angle follows its reference within 0.001"
    assert told in other.scenario.notes
    assert not load_scenario(swing, references=False, fmus={"hand": heavy}).notes
