"""Reports with something of everything in them, and words as no one should write them."""

from __future__ import annotations

import json
from html.parser import HTMLParser
from typing import Any

import numpy as np

from orchestrator.report import Band, Chart, ChartLine, ChartPoint, Curve, Panel, Report, figures
from orchestrator.report.wiring import DiagramBox, DiagramWire, WiringDiagram
from orchestrator.trace import Trace

EVIL = "<script>alert('x')</script><img src=x onerror=alert(1)>&\"</style>"


class Page(HTMLParser):
    """Tags, attributes and visible words of a page, and what its scripts are given."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.links: list[str] = []
        self.words = ""
        self.charts: list[dict[str, Any]] = []
        self._inside = ""
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.links += [value or "" for name, value in attrs if name in ("src", "href", "action", "data", "srcset")]
        self._inside = tag if tag in ("script", "style") else ""
        self._is_chart = ("type", "application/json") in attrs and ("id", "columns") not in attrs

    def handle_endtag(self, tag: str) -> None:
        self._inside = ""

    def handle_data(self, data: str) -> None:
        if not self._inside:
            self.words += data
        elif self._is_chart:
            self.charts.append(json.loads(data))


def full_report(word: str) -> Report:
    """A report whose every text is this word, with each kind of content and of figure."""
    report = Report(word, word)
    section = report.section(word)
    section.subheading(word)
    section.paragraph(word)
    section.callout("warning", word)
    section.highlights([(word, word, word)])
    section.provenance({word: word})
    section.table([word, "n"], [[word, 1.0]], caption=word)
    time = np.arange(50.0)
    trace = Trace(time, {word: np.sin(time)}, {word: word})
    section.figure(figures.overlay(trace, [(word, trace)]), caption=word)
    section.figure(figures.overlays_grid([(word, trace, [(word, trace)])], word), caption=word)
    section.figure(figures.residuals(time, trace[word], np.linspace(1, 0, 20), 0.2, word, word), caption=word)
    section.figure(figures.frequency_response([(word, [1.0, 9.0], [1.0, 0.1])], [(word, [1.0, 9.0], [1.0, 0.2])]))
    section.figure(figures.points({word: ([1.0, 2.0], [1.0, 2.0])}, word, word))
    section.figure(figures.bars({word: {word: 0.5}, "b": {word: -0.25}}, 0.4, word, word), caption=word)
    section.figure(figures.correlation_heatmap([word, "b"], [[1.0, -0.4], [-0.4, 1.0]]), caption=word)
    section.figure(figures.distribution(np.sin(np.arange(90.0)), word, word), caption=word)
    section.figure(figures.counts([(0.0, 1.0, 4), (1.0, 10.0, 0), (10.0, 100.0, 2)], word, word), caption=word)
    marked = [ChartLine(1.0, "y", word), ChartLine(0.5, "x", word, wrong=True), ChartPoint(0.5, 1.0, word)]
    tube = Band(word, [0.0, 1.0], [0.0, 0.0], [2.0, 2.0])
    section.figure(Chart([Panel(word, [Curve(word, [0.0, 1.0], [1.0, 1.0])], marked, [tube])], x=word), word)
    boxes = [
        DiagramBox(word, word, word, {word: word}, {word: word}),
        DiagramBox("b", word, "", {word: word}, {word: word}, outside=True),
    ]
    wires = [DiagramWire((word, word), ("b", word), word), DiagramWire(("b", word), (word, word), word)]
    section.figure(WiringDiagram(boxes, wires), word)
    section.folded(word).figure(figures.overlay(trace), caption=word)
    return report
