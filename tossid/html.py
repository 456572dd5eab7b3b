"""Numbers and tables as results show themselves, in Jupyter and on the console."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

ROUNDING = 1e-12
"""Size of a number below which it is what rounding leaves of zero."""


def number_words(value: float, digits: int = 4) -> str:
    """A number with so many significant digits; what rounding leaves of zero is 0.

    Args:
        value: The number.
        digits: How many at most.
    """
    return f"{value if abs(value) > ROUNDING else 0.0:.{digits}g}"


def html_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in HTML, with its texts escaped.

    Args:
        head: The columns' names; none for a table whose rows each begin with their name.
        rows: Texts, as many as there are columns.

    Returns:
        The element `table`.
    """

    def line(cells: Sequence[str], names: int) -> str:
        kinds = ["th" if i < names else "td" for i in range(len(cells))]
        return f"<tr>{''.join(f'<{k}>{escape(text)}</{k}>' for k, text in zip(kinds, cells, strict=True))}</tr>"

    top = line(head, len(head)) if head else ""
    return f"<table>{top}{''.join(line(row, 0 if head else 1) for row in rows)}</table>"
