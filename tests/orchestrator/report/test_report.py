"""A report is one safe file that opens offline, and its figures show what they were given."""

from __future__ import annotations

import base64
import json
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plotly.offline import get_plotlyjs

from identification.estimation.validation import whiteness
from orchestrator.display.table import text
from orchestrator.display.thinning import thin
from orchestrator.formats import read, write
from orchestrator.report import Report, figures
from orchestrator.report.plot import plot_traces
from orchestrator.trace import Trace

EVIL = "<script>alert('x')</script>&\"</style>"


class Page(HTMLParser):
    """Tags, attributes and visible words of a page."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.links: list[str] = []
        self.words = ""
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.links += [value or "" for name, value in attrs if name in ("src", "href", "action", "data", "srcset")]

    def handle_data(self, data: str) -> None:
        if self.tags and self.tags[-1] not in ("script", "style"):
            self.words += data


def oscillation(count: int = 9000) -> Trace:
    time = np.linspace(0.0, 4.0, count)
    return Trace(time, {"angle": np.sin(6 * time), "speed": 6 * np.cos(6 * time)}, {"angle": "rad"}, "swing")


def full_report(word: str) -> Report:
    report = Report(word, word)
    section = report.section(word)
    section.paragraph(word)
    section.callout("warning", word)
    section.highlights([(word, word, word)])
    section.provenance({word: word})
    section.table([word, "n"], [[word, 1.0]], caption=word)
    trace = Trace(np.arange(3.0), {word: np.arange(3.0)}, {word: word})
    section.figure(figures.overlay(trace, [(word, trace)]), caption=word)
    return report


def values(array: Any) -> list[float]:
    """The numbers of a plotly array, which plotly may hold in base64."""
    if isinstance(array, dict):
        return np.frombuffer(base64.b64decode(array["bdata"]), dtype=array["dtype"]).tolist()
    return list(array)


def without_plotly(html: str) -> str:
    assert html.count(get_plotlyjs()) == 1
    return html.replace(get_plotlyjs(), "")


def test_every_text_is_escaped_wherever_it_stands() -> None:
    clean, evil = Page(without_plotly(full_report("word").render())), full_report(EVIL).render()
    page = Page(without_plotly(evil))
    assert page.tags == clean.tags
    assert "<script>alert" not in evil
    assert page.words.count(EVIL) == clean.words.count("word")


def test_nothing_is_loaded_from_outside() -> None:
    html = without_plotly(full_report("word").render())
    assert [link for link in Page(html).links if not link.startswith("#")] == []
    assert not re.search(r"https?://|@import|url\(", html)
    assert "default-src 'none'" in html


def test_figures_cannot_be_uploaded_by_a_click() -> None:
    config = re.search(r'(\{"displaylogo".*?\]\]\})', full_report("word").render())
    assert config is not None
    settings = json.loads(config[1])
    assert settings["showSendToCloud"] is False
    assert "sendChartToCloud" not in [button for group in settings["modeBarButtons"] for button in group]


def test_plotly_is_in_the_file_once_and_only_where_there_are_figures() -> None:
    report = full_report("word")
    report.section("more").figure(figures.overlay(oscillation()))
    assert report.render().count(get_plotlyjs()) == 1
    plain = Report("plain")
    plain.section("words").paragraph("no figure")
    assert len(plain.render()) < 20_000


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
    measured = oscillation()
    figure = figures.overlay(measured, [("model", oscillation(500).select(["angle"]))], ["speed", "angle"])
    assert [figure.layout.yaxis.title.text, figure.layout.yaxis2.title.text] == ["speed", "angle [rad]"]
    assert figure.layout.xaxis2.title.text == "time [s]"
    assert [curve.name for curve in figure.data] == ["measured", "measured", "model"]
    assert all(len(values(curve.x)) <= 2000 for curve in figure.data)
    assert figure.layout.xaxis.matches == "x2"


def test_overlay_names_every_curve_once_in_its_legend() -> None:
    figure = figures.overlay(oscillation(), [("a", oscillation()), ("b", oscillation())])
    assert [curve.name for curve in figure.data if curve.showlegend] == ["measured", "a", "b"]


@pytest.mark.parametrize("count", [1, 3, 32, 100])
def test_a_grid_has_one_window_for_each_recording(count: int) -> None:
    windows = [(f"run {number}", oscillation(50), [("model", oscillation(40))]) for number in range(count)]
    figure = figures.overlays_grid(windows, "angle")
    assert [note.text for note in figure.layout.annotations] == [title for title, _, _ in windows]
    assert len({curve.yaxis for curve in figure.data}) == count
    assert sum(curve.showlegend for curve in figure.data) == 2


def test_the_picture_of_a_residual_shows_the_autocorrelation_and_the_band_of_its_verdict() -> None:
    biased = 0.3 + 0.1 * np.random.default_rng(5).normal(size=2000)
    test = whiteness([biased])
    figure = figures.residuals(np.arange(2000.0), biased, test.autocorrelation, test.band, "rad")
    assert values(figure.data[1].y) == test.autocorrelation[1:].tolist()
    band = next(shape for shape in figure.layout.shapes if shape.type == "rect")
    assert (band.y0, band.y1) == (-test.band, test.band)
    assert not test.white and min(values(figure.data[1].y)) > band.y1  # drawn as it is judged
    assert figure.layout.yaxis.title.text == "residual [rad]"


def test_frequency_response_is_in_decibels_over_a_logarithmic_axis() -> None:
    figure = figures.frequency_response([("52 g", [1.0, 10.0], [1.0, 0.1])], [("model", [1.0], [10.0])], "rad/V")
    shown = {curve.name: (curve.mode, values(curve.y)) for curve in figure.data}
    assert shown["52 g"] == ("markers", pytest.approx([0.0, -20.0]))
    assert shown["model"] == ("lines", pytest.approx([20.0]))
    assert figure.layout.xaxis.type == "log"
    assert figure.layout.yaxis.title.text == "magnitude [dB re 1 rad/V]"


def test_bars_stand_apart_by_group_and_show_the_target() -> None:
    figure = figures.bars({"train": {"a": 0.97, "b": 0.95}, "validation": {"c": 0.96}}, 0.94, "FIT")
    assert {(bar.name, tuple(bar.y), tuple(bar.x)) for bar in figure.data} == {
        ("train", ("a", "b"), (0.97, 0.95)),
        ("validation", ("c",), (0.96,)),
    }
    assert figure.layout.shapes[0].x0 == 0.94
    assert figure.layout.barmode == "overlay"


def test_bars_of_the_same_name_in_two_groups_do_not_hide_each_other() -> None:
    figure = figures.bars({"published": {"a": 0.46}, "calibrated": {"a": 0.97}})
    assert figure.layout.barmode == "group"


def test_correlation_heatmap_spans_minus_one_to_one() -> None:
    figure = figures.correlation_heatmap(["p1", "p2"], [[1.0, -0.4], [-0.4, 1.0]])
    assert (figure.data[0].zmin, figure.data[0].zmax) == (-1, 1)
    assert list(figure.data[0].x) == list(figure.data[0].y) == ["p1", "p2"]


@pytest.mark.parametrize("sample", [np.random.default_rng(1).normal(size=500), np.full(5, 3.0)])
def test_a_histogram_counts_every_value_once(sample: np.ndarray[Any, Any]) -> None:
    figure = figures.distribution(sample, "inertia", "kg·m²", {"true": 1.0})
    assert sum(values(figure.data[0].y)) == len(sample)
    assert figure.layout.annotations[0].text == "true"
    assert figure.layout.xaxis.title.text == "inertia [kg·m²]"


def test_labels_are_shown_as_they_are_not_as_plotlys_markup() -> None:
    figure = figures.overlay(oscillation(), [('<a href="http://x">b</a>', oscillation())])
    assert "<a" not in figure.data[-1].name


def test_all_figures_share_one_look() -> None:
    trace = oscillation(100)
    drawn: list[go.Figure] = [
        figures.overlay(trace),
        figures.residuals(trace.time, trace["angle"], np.ones(21), 0.1),
        figures.bars({"a": {"b": 1.0}}),
        figures.distribution(trace["angle"], "x"),
    ]
    looks = {(figure.layout.font.family, figure.layout.paper_bgcolor, figure.layout.colorway) for figure in drawn}
    assert len(looks) == 1


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
