"""Files of JSON lines."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipelines.files.json_lines import add_line, lines_so_far, read_lines


def test_lines_come_back_in_their_order(tmp_path: Path) -> None:
    path = tmp_path / "lines.jsonl"
    assert lines_so_far(path) == []
    with pytest.raises(FileNotFoundError):
        read_lines(path)
    lines = [{"case": "one", "values": [1.0, 2.5]}, {"case": "two"}]
    for line in lines:
        add_line(path, line)
    assert read_lines(path) == lines_so_far(path) == lines
