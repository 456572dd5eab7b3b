"""Tables for notebooks: how results show themselves in Jupyter."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape


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
