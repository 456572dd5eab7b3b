"""The report of a diagnosis: sentences, figures, and the page that holds them.

A figure of one's own is one function under `@report_figure(...)`; it then stands on every page.
"""

from tossid.diagnosis.report import figures, localisation_figures, session_figures
from tossid.diagnosis.report.html import report_html, report_notebook
from tossid.diagnosis.report.registry import REPORT_FIGURES, ReportFigure, report_figure, report_figures, report_pngs

__all__ = [
    "REPORT_FIGURES",
    "ReportFigure",
    "figures",
    "localisation_figures",
    "report_figure",
    "report_figures",
    "report_html",
    "report_notebook",
    "report_pngs",
    "session_figures",
]
