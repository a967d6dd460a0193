"""Reports a person wants to look at: one HTML file with everything inside, readable offline."""

from orchestrator.report import figures
from orchestrator.report.chart import Band, Chart, ChartLine, ChartPoint, Curve, Panel
from orchestrator.report.document import Report, Section

__all__ = ["Band", "Chart", "ChartLine", "ChartPoint", "Curve", "Panel", "Report", "Section", "figures"]
