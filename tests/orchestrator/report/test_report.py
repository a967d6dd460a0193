"""A report is one safe file that opens offline, and its figures show what they were given."""

from __future__ import annotations

import json
import re
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from identification.estimation.validation import whiteness
from orchestrator.display.table import text
from orchestrator.display.thinning import thin
from orchestrator.formats import read, write
from orchestrator.report import Chart, Report, document, figures
from orchestrator.report.document import write_shared
from orchestrator.report.drawings import ChartGrid
from orchestrator.report.plot import plot_traces
from orchestrator.trace import Trace
from tests.support.tools.reports import EVIL, Page, full_report


def oscillation(count: int = 9000) -> Trace:
    time = np.linspace(0.0, 4.0, count)
    return Trace(time, {"angle": np.sin(6 * time), "speed": 6 * np.cos(6 * time)}, {"angle": "rad"}, "swing")


def test_every_text_is_escaped_wherever_it_stands() -> None:
    clean, evil = Page(full_report("word").render()), full_report(EVIL).render()
    page = Page(evil)
    assert page.tags == clean.tags
    assert "<script>alert" not in evil
    assert page.words.count(EVIL) == clean.words.count("word")


def test_charts_are_given_every_text_as_it_is() -> None:
    clean, evil = (json.dumps(Page(full_report(word).render()).charts) for word in ("word", EVIL))
    assert clean.count('"word') > 20
    assert evil.replace(json.dumps(EVIL)[1:-1], "word") == clean


def test_nothing_is_loaded_from_outside() -> None:
    html = full_report("word").render()
    assert [link for link in Page(html).links if not link.startswith("#")] == []
    assert not re.search(r"https?://|@import|url\(", html)
    assert "default-src 'none'" in html


def test_figures_cannot_be_uploaded_by_a_click() -> None:
    script = (resources.files("orchestrator.report") / "chart.js").read_text(encoding="utf-8")
    for way_out in ("fetch(", "XMLHttpRequest", "WebSocket", "sendBeacon", "EventSource", "open(", "location", "eval"):
        assert way_out not in script.replace("this.fetch(", "")
    html = full_report("word").render()
    assert "connect-src" not in html and "form-action 'none'" in html  # what default-src 'none' forbids stays forbidden
    assert "plotly" not in html


def test_the_script_of_charts_is_in_the_file_once_and_only_where_there_are_charts() -> None:
    script = (resources.files("orchestrator.report") / "chart.js").read_text(encoding="utf-8")
    report = full_report("word")
    report.section("more").figure(figures.overlay(oscillation()))
    assert report.render().count(script) == 1
    plain = Report("plain")
    plain.section("words").paragraph("no figure")
    assert len(plain.render()) < 20_000


def test_the_script_of_charts_stays_small() -> None:
    script = (resources.files("orchestrator.report") / "chart.js").read_text(encoding="utf-8")
    assert len(script.splitlines()) <= 400


def test_the_contents_lead_to_every_section() -> None:
    report = Report("title")
    for heading in ("first", "second"):
        report.section(heading).paragraph("text")
    html = report.render()
    for target in (link[1:] for link in Page(html).links):
        assert html.count(f'id="{target}"') == 1
    assert len(Page(html).links) == 2


def test_the_same_report_is_the_same_bytes() -> None:
    assert full_report("word").render() == full_report("word").render()


def test_a_report_is_written_whole(tmp_path: Path) -> None:
    path = full_report("größe").write(tmp_path / "out" / "report.html")
    assert path.read_text(encoding="utf-8") == full_report("größe").render()
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize(
    ("cell", "shown"),
    [
        (None, "–"),
        ("−", "−"),
        (3, "3"),
        (-12345678, "−12345678"),
        (0.00213149, "0.0021315"),
        (-1.4e-5, "−1.4e−5"),
        (1e300, "1e300"),
        (float("nan"), "nan"),
        (float("-inf"), "−inf"),
        (True, "yes"),
        (np.float64(2.5), "2.5"),
        (np.int64(7), "7"),
    ],
)
def test_numbers_in_cells_are_short_and_readable(cell: float, shown: str) -> None:
    assert text(cell) == shown


def test_columns_of_numbers_stand_to_the_right() -> None:
    report = Report("t")
    report.section("s").table(["name", "value", "gap"], [["a", 1.0, None], ["b", 2.0, 3.0]])
    report.sections[0].table(["name", "value"], [["a", "1 ± 2"]], numeric=[1])
    cells = re.findall(r'<td( class="n")?>', report.render())
    assert [bool(right) for right in cells] == [False, True, True, False, True, True, False, True]


def test_a_row_of_another_length_than_the_headers_is_refused() -> None:
    with pytest.raises(ValueError, match="1 cells under 2 headers"):
        Report("t").section("s").table(["a", "b"], [["x"]])


@given(
    st.lists(st.floats(-1e6, 1e6) | st.just(float("nan")), min_size=1, max_size=400),
    st.integers(10, 60),
)
def test_thinning_keeps_ends_extremes_and_order_within_the_limit(samples: list[float], limit: int) -> None:
    time, curve = np.arange(float(len(samples))), np.array(samples)
    x, y = thin(time, curve, limit)
    assert len(x) <= limit or len(x) == 0
    assert np.all(np.diff(x) > 0)
    assert (x[0], x[-1]) == (time[0], time[-1])
    assert np.array_equal(y, curve[x.astype(int)], equal_nan=True)
    if not np.all(np.isnan(curve)):
        assert np.nanmax(y) == np.nanmax(curve)
        assert np.nanmin(y) == np.nanmin(curve)


def test_thinning_keeps_a_single_sample_spike_and_a_long_gap() -> None:
    curve = np.zeros(100_000)
    curve[54_321] = 1.0
    curve[70_000:80_000] = np.nan
    x, y = thin(np.arange(1e5), curve)
    assert len(x) <= 2000
    assert x[np.nanargmax(y)] == 54_321
    assert np.isnan(y).sum() > 50


def test_overlay_has_a_window_a_signal_and_units_on_the_axes() -> None:
    measured = oscillation().select(["speed", "angle"])
    chart = figures.overlay(measured, [("model", oscillation(500).select(["angle"]))])
    assert [panel.title for panel in chart.panels] == ["speed", "angle [rad]"]
    assert chart.x == "time [s]"
    assert [[curve.label for curve in panel.curves] for panel in chart.panels] == [["measured"], ["measured", "model"]]
    assert [len(np.asarray(curve.y)) for curve in chart.panels[1].curves] == [9000, 500]  # every sample, not some


def test_overlay_names_every_curve_once_in_its_legend() -> None:
    chart = figures.overlay(oscillation(), [("a", oscillation()), ("b", oscillation())])
    assert legend_of(chart) == ["measured", "a", "b"]


def legend_of(chart: Chart | ChartGrid) -> list[str]:
    report = Report("t")
    report.section("s").figure(chart)
    [legend] = re.findall(r'<div class="legend">(.*?)</div>', report.render())
    return re.findall(r"</i>(.*?)</", legend)


@pytest.mark.parametrize("count", [1, 3, 32, 100])
def test_a_grid_has_one_window_for_each_recording(count: int) -> None:
    windows = [(f"run {number}", oscillation(50), [("model", oscillation(40))]) for number in range(count)]
    grid = figures.overlays_grid(windows, "angle")
    assert [title for title, _ in grid.charts] == [title for title, _, _ in windows]
    assert all(len(chart.panels) == 1 and len(chart.panels[0].curves) == 2 for _, chart in grid.charts)
    assert legend_of(grid) == ["measured", "model"]


def test_the_picture_of_a_residual_shows_the_autocorrelation_and_the_band_of_its_verdict() -> None:
    biased = 0.3 + 0.1 * np.random.default_rng(5).normal(size=2000)
    test = whiteness([biased])
    residual, correlation = figures.residuals(
        np.arange(2000.0), biased, test.autocorrelation, test.band, "rad"
    ).drawings
    assert isinstance(residual, Chart) and isinstance(correlation, Chart)
    [heights], [band] = correlation.panels[0].curves, correlation.panels[0].bands
    assert np.array_equal(heights.y, test.autocorrelation[1:])
    assert (np.unique(band.lower), np.unique(band.upper)) == (-test.band, test.band)
    assert not test.white and np.min(heights.y) > test.band  # drawn as it is judged
    assert residual.panels[0].title == "residual [rad]"


def test_frequency_response_is_in_decibels_over_a_logarithmic_axis() -> None:
    chart = figures.frequency_response([("52 g", [1.0, 10.0], [1.0, 0.1])], [("model", [1.0], [10.0])])
    shown = {curve.label: (curve.style, list(np.asarray(curve.y))) for curve in chart.panels[0].curves}
    assert shown["52 g"] == ("dots", pytest.approx([0.0, -20.0]))
    assert shown["model"] == ("line", pytest.approx([20.0]))
    assert chart.log_x
    assert chart.panels[0].title == "magnitude [dB]"


def test_bars_stand_apart_by_group_and_show_the_target() -> None:
    report = Report("t")
    report.section("s").figure(figures.bars({"train": {"a": 0.97, "b": 0.95}, "validation": {"c": 0.5}}, 0.94, "FIT"))
    html = report.render()
    places = re.findall(
        r'<i class="k(\d)" style="left:([\d.]+)%;width:([\d.]+)%"></i><b style="left:([\d.]+)%"></b>', html
    )
    assert [(int(group), float(left)) for group, left, *_ in places] == [(0, 0), (0, 0), (1, 0)]
    assert [float(width) for _, _, width, _ in places] == pytest.approx([100, 100 * 95 / 97, 100 * 50 / 97], abs=1e-3)
    assert [float(target) for *_, target in places] == pytest.approx([100 * 94 / 97] * 3, abs=1e-3)
    assert Page(html).words.count("FIT, at least 0.94") == 1


def test_bars_of_negative_values_begin_at_zero() -> None:
    report = Report("t")
    report.section("s").figure(figures.bars({"a": {"low": -1.0, "high": 3.0, "none": float("nan")}}))
    places = re.findall(r"left:([\d.]+)%;width:([\d.]+)%", report.render())
    assert [tuple(map(float, place)) for place in places] == [(0, 25), (25, 75), (0, 0)]


def test_bars_of_the_same_name_in_two_groups_do_not_hide_each_other() -> None:
    report = Report("t")
    report.section("s").figure(figures.bars({"published": {"a": 0.46}, "calibrated": {"a": 0.97}}))
    rows = re.findall(r'<tr><th>a</th><td class="n">(.*?)</td><td class="bar"><i class="(.*?)"', report.render())
    assert rows == [("0.46", "k0"), ("0.97", "k1")]


def test_correlations_are_told_by_sign_and_strength() -> None:
    report = Report("t")
    report.section("s").figure(figures.correlation_heatmap(["p1", "p2"], [[1.0, -0.4], [-0.4, float("nan")]]))
    html = report.render()
    cells = re.findall(
        r"<td style=\"background:color-mix\(in srgb,var\(--(c\d)\) (\d+)%,transparent\)\">(.*?)</td>", html
    )
    assert cells == [("c0", "75", "1.00"), ("c1", "30", "−0.40"), ("c1", "30", "−0.40")]
    assert html.count("<th>p1</th>") == html.count("<th>p2</th>") == 2


@pytest.mark.parametrize("sample", [np.random.default_rng(1).normal(size=500), np.full(5, 3.0)])
def test_a_histogram_counts_every_value_once(sample: np.ndarray[Any, Any]) -> None:
    chart = figures.distribution(sample, "inertia", "kg·m²")
    [outline] = chart.panels[0].curves
    assert np.sum(np.asarray(outline.y)[1:-1:2]) == len(sample)
    assert np.all(np.diff(outline.x) >= 0)
    assert chart.x == "inertia [kg·m²]"


def test_labels_are_shown_as_they_are_not_as_markup() -> None:
    label = '<a href="http://x">b</a>'
    report = Report("t")
    report.section("s").figure(figures.overlay(oscillation(), [(label, oscillation())]))
    page = Page(report.render())
    assert label in page.words and page.tags.count("a") == 1
    assert page.charts[0]["panels"][0]["curves"][1]["label"] == label


def test_all_figures_take_their_colours_from_the_one_sheet_of_the_page() -> None:
    script = (resources.files("orchestrator.report") / "chart.js").read_text(encoding="utf-8")
    sheet = (resources.files("orchestrator.report") / "style.css").read_text(encoding="utf-8")
    assert not re.search(r"#[0-9a-f]{3,8}\b|rgba?\(", script)
    light, dark = re.split(r"@media screen.*dark", sheet.partition(":root.paper")[0])
    names = [*(f"c{number}" for number in range(6)), "measured", "reference", "band", "error", "grid", "ink", "soft"]
    for name in names:
        assert all(len(re.findall(rf"--{name}:", part)) == 1 for part in (light, dark))


def test_a_plot_of_recordings_says_what_is_odd_about_them(tmp_path: Path) -> None:
    rows = ["time,angle [rad],dead,holes", "0,1,5,1", "1,2,5,", "3,4,5,2", "2,3,5,0"]
    (tmp_path / "odd.csv").write_text("\n".join(rows) + "\n")
    write(oscillation(), tmp_path / "good.parquet")
    recordings = [read(tmp_path / "odd.csv"), read(tmp_path / "good.parquet")]
    words = Page(plot_traces(recordings).render()).words
    for part in (
        "odd",
        "swing",
        "1 stamps out of order",
        "dead never changes",
        "holes is not finite in 1 of 4 samples",
    ):
        assert part in words
    assert recordings[0].sha256 in words
    assert "angle never" not in words


def test_reports_of_one_folder_share_script_and_style(tmp_path: Path) -> None:
    write_shared(tmp_path)
    page = full_report("word").write(tmp_path / "group" / "one" / "report.html", shared="../..").read_text()
    shared = re.findall(r'(?:src|<link rel="stylesheet" href)="(.*?)"', page)
    assert [(page_of(tmp_path, link)).read_text() for link in shared] == [shipped("style.css"), shipped("chart.js")]
    alone = full_report("word").render()
    assert len(alone) - len(page) > 0.95 * (len(shipped("style.css")) + len(shipped("chart.js")))
    assert shipped("chart.js") not in page and not re.search(r"https?://", page)
    assert "script-src 'unsafe-inline' 'self' file:" in page and "file:" not in alone


def page_of(folder: Path, link: str) -> Path:
    return folder / "group" / "one" / link


def shipped(name: str) -> str:
    return (resources.files("orchestrator.report") / name).read_text(encoding="utf-8")


def test_scripts_that_differ_have_different_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A page of an earlier version in the same folder keeps the script that knows its numbers."""
    write_shared(tmp_path)
    before = {file.name for file in tmp_path.iterdir()}
    monkeypatch.setattr(document, "_shipped", lambda name: f"another {name}")
    write_shared(tmp_path)
    assert len(before) == 2 and len(list(tmp_path.iterdir())) == 4
