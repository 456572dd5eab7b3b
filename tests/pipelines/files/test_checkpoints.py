"""The model of a run."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipelines.files.checkpoints import trained_model
from pipelines.tracking.runs import RunRecord
from tossid.errors import FileError, InputError


def test_a_run_without_a_model_is_named(tmp_path: Path) -> None:
    path = tmp_path / "checkpoint.pt"
    with pytest.raises(InputError, match=r"run cn-g9.81 \(0123\) has no checkpoint"):
        trained_model(RunRecord("0123", "cn-g9.81", tmp_path, None))
    path.write_bytes(b"no model")
    with pytest.raises(FileError, match=r"checkpoint.pt"):
        trained_model(RunRecord("0123", "cn-g9.81", tmp_path, path))
