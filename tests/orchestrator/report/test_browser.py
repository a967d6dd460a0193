"""Reports as readers see them, in Chromium: they open from a file, ask for nothing, and a zoom shows what is there."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from orchestrator.report import Chart, Curve, Panel, Report, figures
from orchestrator.report.document import write_shared
from orchestrator.report.entries import Entries, ListEntry
from orchestrator.trace import Trace
from tests.support.tools.browser import Seen, browsing, opened
from tests.support.tools.reports import EVIL, full_report

if TYPE_CHECKING:
    from playwright.sync_api import Browser

pytestmark = [pytest.mark.slow, pytest.mark.needs("browser", "chromium")]

COUNT, SPIKE = 300_000, 123_457


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with browsing() as started:
        yield started


def written(page: Report, folder: Path) -> Path:
    return page.write(folder / "report.html")


def one_chart(chart: Chart, folder: Path) -> Path:
    page = Report("A chart")
    page.section("Curves").figure(chart, "what it is")
    return written(page, folder)


def spiky(even: bool = True) -> Trace:
    """A sine at 1 kHz with one sample far above the others, and one far below; the stamps even or not."""
    rng = np.random.default_rng(3)
    time = np.arange(COUNT) / 1000
    if not even:
        time = np.cumsum(0.001 * rng.uniform(0.5, 1.5, COUNT))
    values = np.sin(time) + 0.01 * rng.normal(size=COUNT)
    values[SPIKE], values[SPIKE + 50_000] = 7.25, -3.5
    return Trace(time, {"angle": values}, {"angle": "rad"}, "spiky")


@pytest.mark.parametrize("word", ["plain", EVIL])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_report_opens_from_a_file_without_a_complaint_or_a_request(
    browser: Browser, tmp_path: Path, word: str, scheme: str
) -> None:
    with opened(browser, written(full_report(word), tmp_path), scheme) as seen:  # type: ignore[arg-type]
        for number in range(seen.page.locator(".chart:visible").count()):
            seen.view(number)
        assert (seen.complaints, seen.requests) == ([], [])
        assert seen.page.title() == " ".join(word.split())
        assert seen.page.locator("img").count() == 0


@pytest.mark.parametrize("even", [True, False])
def test_no_view_misses_a_peak_that_lasts_one_sample(browser: Browser, tmp_path: Path, even: bool) -> None:
    trace = spiky(even)
    with opened(browser, one_chart(figures.overlay(trace), tmp_path)) as seen:
        [[[label, lowest, highest]]] = seen.view()["panels"]
        assert label == "measured"
        assert [lowest, highest] == pytest.approx([-3.5, 7.25], abs=1e-6)
        for _ in range(20):
            share = zoomed_onto(seen, trace.time[SPIKE])
            [[[_, lowest, highest]]] = seen.view()["panels"]
            assert highest == pytest.approx(7.25, abs=1e-6)
            if share < 1e-3:
                break
        view = seen.view()
        rows = (trace.time >= view["from"]) & (trace.time <= view["to"])
        assert rows.sum() < 300
        assert [lowest, highest] == pytest.approx([trace["angle"][rows].min(), 7.25], abs=1e-6)
        assert seen.complaints == []


def zoomed_onto(seen: Seen, instant: float) -> float:
    """Zoom in about an instant; the share of the whole that is in view then."""
    view = seen.view()
    at = (instant - view["from"]) / (view["to"] - view["from"])
    seen.drag(max(at - 0.15, 0.0), min(at + 0.15, 1.0))
    view = seen.view()
    return (view["to"] - view["from"]) / (COUNT / 1000)


def test_samples_over_uneven_stamps_are_fetched_beside_these(browser: Browser, tmp_path: Path) -> None:
    page = Report("Uneven")
    page.section("Curves").figure(figures.overlay(spiky(even=False)))
    with opened(browser, written(page, tmp_path)) as seen:
        seen.view()
        begun = seen.page.evaluate(
            """() => {
                const [own, begun] = [DecompressionStream, []];
                window.DecompressionStream = function (kind) { begun.push(kind); return new own(kind); };
                document.querySelector(".chart").chart.zoom(150, 150.1);
                return begun.length;
            }"""
        )
        assert begun == 2, "stamps and samples, before either is there"
        assert seen.view()["from"] == 150


def test_keys_move_zoom_and_show_all_again(browser: Browser, tmp_path: Path) -> None:
    trace = Trace(np.linspace(0, 10, 101), {"a": np.linspace(0, 1, 101)})
    with opened(browser, one_chart(figures.overlay(trace), tmp_path)) as seen:
        seen.page.locator("canvas").focus()
        assert (seen.view()["from"], seen.view()["to"]) == (0, 10)
        seen.page.keyboard.press("+")
        assert (seen.view()["from"], seen.view()["to"]) == pytest.approx((2.5, 7.5))
        seen.page.keyboard.press("ArrowRight")
        assert (seen.view()["from"], seen.view()["to"]) == pytest.approx((3.5, 8.5))
        seen.page.keyboard.press("Shift+ArrowLeft")
        assert "a: 0.6" in seen.page.locator(".readout").inner_text()
        seen.page.keyboard.press("0")
        assert (seen.view()["from"], seen.view()["to"]) == (0, 10)


def test_the_value_at_the_pointer_is_that_of_the_nearest_sample(browser: Browser, tmp_path: Path) -> None:
    trace = Trace(np.arange(11.0), {"a": 100 + np.arange(11.0)}, {"a": "rad"})
    with opened(browser, one_chart(figures.overlay(trace), tmp_path)) as seen:
        seen.view()
        box = seen.page.locator("canvas").bounding_box()
        assert box is not None
        seen.page.mouse.move(box["x"] + 68 + 0.42 * (box["width"] - 90), box["y"] + 60)
        assert "a [rad]: 104" in seen.page.locator(".readout").inner_text()


def test_the_legend_hides_a_curve_and_what_is_left_fills_the_window(browser: Browser, tmp_path: Path) -> None:
    small, large = (Trace(np.arange(11.0), {"a": size * np.arange(11.0)}) for size in (1, 1000))
    with opened(browser, one_chart(figures.overlay(small, [("model", large)]), tmp_path)) as seen:
        assert [label for label, *_ in seen.view()["panels"][0]] == ["measured", "model"]
        seen.page.get_by_role("button", name="model").click()
        assert [label for label, *_ in seen.view()["panels"][0]] == ["measured"]
        assert seen.page.get_by_role("button", name="model").get_attribute("aria-pressed") == "false"


def test_a_plane_shows_all_of_a_curve_with_equal_units_on_both_axes(browser: Browser, tmp_path: Path) -> None:
    turn = np.linspace(0, 2 * np.pi, 400)
    circle = Chart(
        [Panel("imaginary", [Curve("loop", np.cos(turn), 3 * np.sin(turn))])], x="real", equal=True, height=400
    )
    with opened(browser, one_chart(circle, tmp_path)) as seen:
        view = seen.view()
        [[[_, lowest, highest]]] = view["panels"]
        assert [lowest, highest] == pytest.approx([-3, 3], abs=1e-3)
        box = seen.page.locator("canvas").bounding_box()
        assert box is not None
        assert (view["to"] - view["from"]) / (box["width"] - 90) == pytest.approx(6.6 / (400 - 34), rel=0.02)


def test_samples_that_are_none_leave_a_gap(browser: Browser, tmp_path: Path) -> None:
    values = np.ones(1000)
    values[300:700] = np.nan
    with opened(browser, one_chart(figures.overlay(Trace(np.arange(1000.0), {"a": values})), tmp_path)) as seen:
        seen.view()
        assert inked(seen, 0.1) and not inked(seen, 0.5) and inked(seen, 0.9)


def inked(seen: Seen, share: float) -> bool:
    """Whether anything of the first curve's colour is in the column at a share of the horizontal axis."""
    found: bool = seen.page.evaluate(
        """share => {
            const canvas = document.querySelector("canvas"), sharp = canvas.width / canvas.clientWidth;
            const x = Math.round((68 + share * (canvas.clientWidth - 90)) * sharp);
            const { data } = canvas.getContext("2d").getImageData(x, 0, 1, canvas.height);
            for (let i = 0; i < data.length; i += 4)
                if (data[i + 3] > 200 && data[i + 2] - data[i] > 100) return true;
            return false;
        }""",
        share,
    )
    return found


def test_paper_shows_all_charts_in_dark_ink_on_white(browser: Browser, tmp_path: Path) -> None:
    with opened(browser, written(full_report("word"), tmp_path), "dark") as seen:
        seen.view()
        seen.page.evaluate("dispatchEvent(new Event('beforeprint'))")
        assert seen.page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
        blank = seen.page.evaluate(
            "[...document.querySelectorAll('canvas')].filter((one) => one.clientWidth && !one.dataset.view).length"
        )
        assert blank == 0
        assert len(seen.page.pdf()) > 20_000


def test_a_chart_of_many_panels_fits_a_page_of_paper_as_it_is_shaped(browser: Browser, tmp_path: Path) -> None:
    many = Chart([Panel(f"signal {number}", [Curve("run", [0.0, 1.0], [0.0, 1.0])]) for number in range(12)])
    with opened(browser, one_chart(many, tmp_path)) as seen:
        seen.view()
        seen.page.emulate_media(media="print")
        frame, canvas = (seen.page.locator(place).bounding_box() for place in (".frame", ".frame canvas"))
        assert frame is not None and canvas is not None
        assert canvas["height"] <= 0.76 * 900 + 1 and frame["height"] <= canvas["height"] + 1
        assert canvas["width"] / canvas["height"] == pytest.approx(frame["width"] / (12 * 170 + 30), rel=0.02)


def test_a_list_shows_what_failed_alone_when_asked(browser: Browser, tmp_path: Path) -> None:
    page = Report("A suite")
    entries = [ListEntry("ok", "good", None, ("1 of 1",)), ListEntry("error", "bad", "bad/report.html", ("0 of 1",))]
    page.section("Verdicts").content.append(Entries(("scenario", "cases"), entries))
    with opened(browser, written(page, tmp_path)) as seen:
        assert seen.page.locator("tbody:visible").count() == 2
        seen.page.get_by_label("what failed").check()
        assert seen.page.locator("tbody:visible").all_inner_texts() == ["✕\tbad\t0 of 1"]
        assert seen.complaints == []


def test_what_is_folded_opens_and_its_chart_is_drawn(browser: Browser, tmp_path: Path) -> None:
    page = Report("Folded")
    page.section("More").folded("the rest").figure(figures.overlay(Trace(np.arange(9.0), {"a": np.arange(9.0)})))
    with opened(browser, written(page, tmp_path)) as seen:
        assert seen.page.locator("canvas:visible").count() == 0
        seen.page.get_by_text("the rest").click()
        [[[_, lowest, highest]]] = seen.view()["panels"]
        assert [lowest, highest] == pytest.approx([0, 8])


def test_a_report_that_shares_its_script_opens_from_a_file_and_out_of_its_folder_says_what_it_misses(
    browser: Browser, tmp_path: Path
) -> None:
    page = Report("A chart")
    page.section("Curves").figure(figures.overlay(spiky()))
    write_shared(tmp_path)
    file = page.write(tmp_path / "group" / "one" / "report.html", shared="../..")
    with opened(browser, file) as seen:
        [[[_, lowest, highest]]] = seen.view()["panels"]
        assert [lowest, highest] == pytest.approx([-3.5, 7.25], abs=1e-6)
        assert seen.complaints == []
        assert sorted(Path(request).parent for request in seen.requests) == [Path(tmp_path.as_uri())] * 2
    moved = tmp_path / "elsewhere" / "a" / "b" / "report.html"
    moved.parent.mkdir(parents=True)
    moved.write_bytes(file.read_bytes())
    with opened(browser, moved) as seen:
        assert "taken out of its folder" in seen.page.locator("header").inner_text()
