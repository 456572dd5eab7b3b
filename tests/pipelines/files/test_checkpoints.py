"""The model of a run."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pipelines.files.checkpoints import trained_model
from tossid.errors import FileError, InputError


def test_a_run_without_a_model_is_named(tmp_path: Path) -> None:
    record: Any = SimpleNamespace(name="cn-g9.81", id="0123", folder=tmp_path, checkpoint=None)
    with pytest.raises(InputError, match=r"run cn-g9.81 \(0123\) has no checkpoint"):
        trained_model(record)
    record.checkpoint = tmp_path / "checkpoint.pt"
    record.checkpoint.write_bytes(b"no model")
    with pytest.raises(FileError, match=r"checkpoint.pt"):
        trained_model(record)
