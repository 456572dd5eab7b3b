"""Small datasets and recordings for the store's tests."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from tossid.objects import ObjectModel
from tossid.rotations import quat_exp
from tossid.store import Dataset
from tossid.types import SPLITS, Toss

H = 1 / 148
HALF = 0.0524
"""Of the published cube's width [m]."""

ARRAYS = ("t", "q", "v", "q_cov", "v_cov", "phase")
"""Of a toss."""


def spinning(n: int, rng: np.random.Generator, *, n_joints: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """t (n,), q and v of something that flies and turns at a constant rate: q and v belong together."""
    t = np.arange(n) * H
    spin, speed = rng.normal(size=3) * 4, rng.normal(size=3)
    rates = rng.normal(size=n_joints)
    q = np.concatenate([[0, 0, 0.3] + speed * t[:, None], quat_exp(spin * t[:, None]), rates * t[:, None]], axis=1)
    v = np.tile(np.concatenate([speed, spin, rates]), (n, 1))
    return t, q, v


def make_toss(name: str, n: int, rng: np.random.Generator, *, n_joints: int = 0, split: str = "") -> Toss:
    t, q, v = spinning(n, rng, n_joints=n_joints)
    nv = v.shape[1]
    roots = rng.normal(size=(2, n, nv, nv)) * 1e-3
    q_cov, v_cov = roots @ roots.swapaxes(-1, -2)
    return Toss(name, t, q, v, q_cov, v_cov, rng.integers(0, 6, size=n).astype(np.uint8), split)


def make_dataset(model: ObjectModel, *, tosses: int = 4, seed: int = 0) -> Dataset:
    rng = np.random.default_rng(seed)
    made = tuple(
        make_toss(f"toss_{i:04d}", 12 + i, rng, n_joints=model.n_joints, split=SPLITS[i % 3]) for i in range(tosses)
    )
    provenance = {"command": "test", "seed": seed, "noise": 0.5, "exact": True, "covariance_source": "made up"}
    return Dataset(object=model, tosses=made, rate_hz=148.0, source="test", provenance=provenance)


def assert_same(a: Dataset, b: Dataset) -> None:
    assert (a.rate_hz, a.source, a.provenance) == (b.rate_hz, b.source, b.provenance)
    assert [type(x) for x in a.provenance.values()] == [type(b.provenance[key]) for key in a.provenance]
    assert [(toss.name, toss.split) for toss in a.tosses] == [(toss.name, toss.split) for toss in b.tosses]
    for x, y in zip(a.tosses, b.tosses, strict=True):
        for name in ARRAYS:
            np.testing.assert_array_equal(getattr(x, name), getattr(y, name))
            assert getattr(x, name).dtype == getattr(y, name).dtype


def contactnets_rows(n: int, rng: np.random.Generator) -> np.ndarray:
    """A toss in half widths whose cube comes down to its own half width."""
    _, q, v = spinning(n, rng)
    q[:, 2] += HALF - q[:, 2].min()
    return np.concatenate([q[:, :3] / HALF, q[:, 3:], v[:, :3] / HALF, v[:, 3:], np.zeros((n, 6))], axis=1)


def pll_rows(n: int, rng: np.random.Generator, n_joints: int = 1) -> np.ndarray:
    _, q, v = spinning(n, rng, n_joints=n_joints)
    return np.concatenate([q[:, 3:7], q[:, :3], q[:, 7:], v[:, 3:6], v[:, :3], v[:, 6:]], axis=1)


def save(path: Path, rows: np.ndarray) -> None:
    torch.save(torch.from_numpy(rows.copy()), path)


def scaled(folder: Path, columns: slice, factor: float) -> None:
    for path in folder.glob("*.pt"):
        rows = torch.load(path, weights_only=True).numpy()
        rows[..., columns] *= factor
        save(path, rows)
