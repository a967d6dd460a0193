"""Reports a person wants to look at: one HTML file with everything inside, readable offline."""

from orchestrator.report import figures
from orchestrator.report.chart import Band, Chart, Curve, Mark, Panel, Point
from orchestrator.report.document import Report, Section

__all__ = ["Band", "Chart", "Curve", "Mark", "Panel", "Point", "Report", "Section", "figures"]
