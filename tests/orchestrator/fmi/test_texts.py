"""Texts that FMUs put out are recorded as they are, in every way to run and in what holds text, and judged."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fmus.errors import TraceError, WiringError
from orchestrator import formats
from orchestrator.fmi.component import Texts
from orchestrator.fmi.isolation import Isolation
from orchestrator.scenario.run import Keeping, ScenarioFailed, ScenarioResult, run_scenario
from orchestrator.trace import Trace, joined, usable
from tests.support.commands import servotwin
from tests.support.fmus import arrays, quirks
from tests.support.tools import third_party

SAYS = 'm->time < 0.45 ? "idle" : m->time < 0.85 ? "läuft, \\"gut\\"" : "idle"'
SAID = ["idle"] * 5 + ['läuft, "gut"'] * 4 + ["idle"] * 2
SCENARIO = """
title: Lag
components: {lag: {fmu: quirks.fmu}}
run: {stop: 1, step: 0.1}
"""
RECORD = "record: [lag.x, lag.said]\n"


def scenario(folder: Path, text: str = RECORD, says: str = SAYS, **quirk: str) -> Path:
    folder.mkdir(exist_ok=True)
    quirks.build(folder / "quirks.fmu", ON_TEXT=says, **quirk)
    (folder / "lag.yaml").write_text(SCENARIO + text)
    return folder / "lag.yaml"


def only(result: ScenarioResult) -> Trace:
    (case,) = result.cases
    return case.trace


def cli(*arguments: object, code: int = 0) -> str:
    done = servotwin(*arguments)
    assert done.exit_code == code, done.output
    return " ".join((done.stdout + done.stderr).split())


def test_a_text_is_recorded_beside_numbers_which_it_does_not_change(tmp_path: Path) -> None:
    trace = only(run_scenario(scenario(tmp_path)))
    assert trace.words("lag.said") == SAID
    assert np.array_equal(trace["lag.x"], only(run_scenario(scenario(tmp_path, "record: [lag.x]\n")))["lag.x"])


@pytest.mark.slow
def test_a_text_comes_from_another_process_and_in_every_case_from_the_beginning(tmp_path: Path) -> None:
    path = scenario(tmp_path, RECORD + "cases: [{name: a}, {name: b}]\n")
    for isolation in (None, Isolation()):
        for case in run_scenario(path, isolation=isolation).cases:
            assert case.trace.words("lag.said") == SAID and case.trace.texts["lag.said"][0] == "idle"


@pytest.mark.slow
def test_texts_up_to_a_crash_are_kept(tmp_path: Path) -> None:
    path = scenario(tmp_path, ON_STEP="if (m->time > 0.65) abort();")
    with pytest.raises(ScenarioFailed) as failed:
        run_scenario(path, isolation=Isolation())
    assert only(failed.value.result).words("lag.said") == SAID[:8]


def test_elements_of_arrays_of_fmi_3_and_its_outputs_are_recorded_as_text(tmp_path: Path) -> None:
    arrays.build(tmp_path)
    (tmp_path / "a.yaml").write_text(
        "title: A\ncomponents: {c: {fmu: arrays.fmu, parameters: {p_String: [x y, z]}}}\n"
        "run: {stop: 1, step: 0.5}\nrecord: ['c.p_String']\n"
    )
    trace = only(run_scenario(tmp_path / "a.yaml"))
    assert [trace.words(name) for name in trace.names] == [["x y"] * 3, ["z"] * 3]


def test_a_text_of_a_reference_fmu_is_what_it_was_given(tmp_path: Path) -> None:
    fmu = third_party.reference(3, "Feedthrough")
    (tmp_path / "f.yaml").write_text(
        f"title: F\ncomponents: {{f: {{fmu: {fmu}, parameters: {{String_input: Grüße}}}}}}\n"
        "run: {stop: 0.2, step: 0.1}\nrecord: [f.String_output]\n"
        "expect: [{signal: f.String_output, equals: Grüße}]\n"
    )
    result = run_scenario(tmp_path / "f.yaml")
    assert result.passed and only(result).words("f.String_output") == ["Grüße"] * 3


def test_what_was_recorded_is_kept_streamed_converted_shown_and_compared(tmp_path: Path) -> None:
    path, other = scenario(tmp_path / "one"), scenario(tmp_path / "other", says=SAYS.replace("0.85", "0.75"))
    cli("run", path, "--out", tmp_path / "a")
    cli("run", path, "--stream", "--out", tmp_path / "b")
    cli("run", other, "--out", tmp_path / "c")
    file, table = tmp_path / "a" / "run.parquet", tmp_path / "lag.csv"
    whole = formats.Layout(texts=True)
    assert formats.read(file, whole).trace.words("lag.said") == SAID
    cli("compare", tmp_path / "a", tmp_path / "b")
    said = cli("compare", tmp_path / "a", tmp_path / "c", code=1)
    assert "they part first at 0.8 s: lag.said of case run says 'läuft, \"gut\"' beside 'idle'" in said
    assert "is text, of which nothing" in cli(
        "compare", tmp_path / "a", tmp_path / "b", "--within", "lag.said=1", code=2
    )
    cli("trace", "convert", file, table)
    assert formats.read(table, formats.Layout(columns={"said": "lag.said"}, texts=True)).trace.words("said") == SAID
    assert 'idle, läuft, "gut"' in cli("trace", "info", file)
    assert "lag.said: is text, which a .mat file cannot hold" in cli(
        "trace", "convert", file, tmp_path / "lag.mat", code=2
    )
    assert "läuft" in (tmp_path / "a" / "report.html").read_text()
    cli("trace", "plot", file, "--out", tmp_path / "plot.html")


def test_numbers_are_not_taken_from_text(tmp_path: Path) -> None:
    cli("run", scenario(tmp_path), "--out", tmp_path / "a")
    recording = formats.read(tmp_path / "a" / "run.parquet")
    assert recording.trace.names == ("lag.x",) and any("'lag.said' holds string" in note for note in recording.notes)
    with pytest.raises(TraceError, match="holds string, not numbers"):
        formats.read(tmp_path / "a" / "run.parquet", formats.Layout(columns={"x": "lag.said"}))


HELD = [
    ("{signal: lag.said, equals: idle, before: 0.4}", True),
    ("{signal: lag.said, equals: [idle, 'läuft, \"gut\"']}", True),
    ("{signal: lag.said, equals: idle}", False),
    ("{signal: lag.said, equals: never}", False),
    ("{all: [{signal: lag.said, equals: idle, after: 0.9}, {signal: lag.x, below: 2}]}", True),
]


@pytest.mark.parametrize(("asked", "held"), HELD)
def test_what_a_text_says_is_asked(tmp_path: Path, asked: str, held: bool) -> None:
    (case,) = run_scenario(scenario(tmp_path, f"expect: [{asked}]\n")).cases
    assert case.passed is held
    assert held or "at 0" in case.checks[0].found


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ("{signal: lag.said, below: 1}", "of which only `equals` can be asked"),
        ("{signal: lag.x, equals: idle}", "is a Real, and `equals` asks for a text"),
        ("{signal: lag.said, mode_changes: {count: 2}}", "of which only `equals` can be asked"),
    ],
)
def test_what_cannot_be_asked_of_a_text_or_a_number_is_refused(tmp_path: Path, asked: str, said: str) -> None:
    with pytest.raises(WiringError, match=said):
        run_scenario(scenario(tmp_path, f"expect: [{asked}]\n"))


def test_the_manifest_says_why_texts_are_stepped_in_python(tmp_path: Path) -> None:
    cli("run", scenario(tmp_path), "--out", tmp_path / "a")
    (case,) = json.loads((tmp_path / "a" / "manifest.json").read_text())["cases"]
    assert "lag gives texts" in str(case["stepping"])


WORDS = st.text(st.characters(blacklist_categories=["Cs", "Cc", "Zl", "Zp"]), max_size=8)


@pytest.mark.slow
@settings(deadline=None)
@given(st.lists(st.none() | WORDS, min_size=2, max_size=30))
def test_any_text_comes_back_from_parquet_and_the_same_texts_are_equal(
    tmp_path_factory: pytest.TempPathFactory, words: list[str | None]
) -> None:
    texts = Texts()
    numbers = [np.nan if word is None else texts.number("y", word) for word in words]
    time = np.arange(len(words), dtype=float)
    trace = Trace(time, {"y": np.array(numbers)}, name="t", texts={"y": texts.known.get("y", ())})
    assert trace.words("y") == words
    file = tmp_path_factory.mktemp("t") / "t.parquet"
    formats.write(trace, file)
    back = formats.read(file, formats.Layout(texts=True)).trace
    assert back.words("y") == words and back == trace
    other = tuple(reversed(trace.texts.get("y", ())))
    again = np.array([np.nan if word is None else other.index(word) for word in words])
    assert Trace(time, {"y": again}, name="t", texts={"y": other}) == trace


def test_texts_are_held_cut_joined_and_named_anew() -> None:
    trace = Trace(np.array([0.0, 1.0, 2.0]), {"y": np.array([0.0, 1.0, 0.0])}, texts={"y": ("a", "b")})
    assert trace.resampled([0.5, 1.9]).words("y") == ["a", "b"]
    assert trace.between(1, 2).renamed({"y": "z"}).shifted(1.0).words("z") == ["b", "a"]
    longer = Trace(np.array([3.0]), {"y": np.array([2.0])}, texts={"y": ("a", "b", "c")})
    assert joined([trace, longer]).words("y") == ["a", "b", "a", "c"]
    assert trace.numbers.names == () and trace.select(["y"]) == trace
    with pytest.raises(TraceError, match="holds text, not numbers"):
        usable(trace, ["y"])


@pytest.mark.slow
def test_a_streamed_run_keeps_texts_in_pieces(tmp_path: Path) -> None:
    path = scenario(tmp_path, says='m->time < 5 ? "a" : "b"')
    path.write_text(path.read_text().replace("stop: 1, step: 0.1", "stop: 10, step: 0.0001"))
    (case,) = run_scenario(path, keeping=Keeping(stream=tmp_path)).cases
    assert case.file is not None
    words = formats.read(case.file, formats.Layout(texts=True)).trace.words("lag.said")
    assert words == ["a"] * 50_000 + ["b"] * 50_001
