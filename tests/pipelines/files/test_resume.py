"""What is kept of an unfinished training."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from pipelines.files.resume import STATE, Unfinished
from tossid.errors import FileError


def test_a_state_comes_back_until_it_is_cleared(tmp_path: Path) -> None:
    kept = Unfinished(tmp_path / "under_way", code="a")
    assert kept.run() is None
    assert kept.state() is None
    kept.begin("0123")
    kept.save({"weights": torch.arange(3)})
    again = Unfinished(tmp_path / "under_way", code="a")
    assert again.run() == "0123"
    found = again.state()
    assert found is not None
    assert found["weights"].tolist() == [0, 1, 2]
    again.clear()
    assert kept.state() is None
    assert not kept.folder.exists()


def test_what_other_code_has_left_is_known(tmp_path: Path) -> None:
    kept = Unfinished(tmp_path, code="a")
    assert not kept.of_other_code()
    kept.begin("0123")
    assert not kept.of_other_code()
    assert Unfinished(tmp_path, code="b").of_other_code()
    (tmp_path / "run.json").write_text('{"run": "0123"}')  # of a version that did not note its code
    assert kept.of_other_code()


def test_a_damaged_state_is_named_with_the_way_out(tmp_path: Path) -> None:
    kept = Unfinished(tmp_path, code="a")
    (tmp_path / STATE).write_bytes(b"half")
    with pytest.raises(FileError, match="restart=true starts anew"):
        kept.state()
    torch.save({"schema": "another"}, tmp_path / STATE)
    with pytest.raises(FileError, match="not a training's state of schema"):
        kept.state()
