"""The report of a diagnosis: the card, figures, and the page that holds them.

A figure of one's own is one function under `@report_figure(...)`; it then stands on every page.
"""

from tossid.diagnosis.report import figures, localisation_figures, order_figures
from tossid.diagnosis.report.card import Card, card_of
from tossid.diagnosis.report.page import report_html, report_notebook
from tossid.diagnosis.report.registry import REPORT_FIGURES, ReportFigure, report_figure, report_figures, report_pngs

__all__ = [
    "REPORT_FIGURES",
    "Card",
    "ReportFigure",
    "card_of",
    "figures",
    "localisation_figures",
    "order_figures",
    "report_figure",
    "report_figures",
    "report_html",
    "report_notebook",
    "report_pngs",
]
