"""Tables for notebooks."""

from __future__ import annotations

from tossid.html import html_table


def test_texts_are_escaped_and_columns_named() -> None:
    made = html_table(["a", "<b>"], [["1", "x & y"]])
    assert made == "<table><tr><th>a</th><th>&lt;b&gt;</th></tr><tr><td>1</td><td>x &amp; y</td></tr></table>"


def test_rows_of_a_table_without_a_head_begin_with_their_name() -> None:
    assert html_table([], [["mass", "1"]]) == "<table><tr><th>mass</th><td>1</td></tr></table>"
