"""Tensor files for the importers' tests."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch


def save(path: Path, rows: np.ndarray) -> None:
    torch.save(torch.from_numpy(rows.copy()), path)


def scaled(folder: Path, columns: slice, factor: float) -> None:
    for path in folder.glob("*.pt"):
        rows = torch.load(path, weights_only=True).numpy()
        rows[..., columns] *= factor
        save(path, rows)
