"""What analyses by hand share: a line that bears outliers, and intervals over resampled recordings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Part = TypeVar("Part")


def robust_line(columns: Array, y: Array) -> Array:
    """(P,) least squares with Cauchy's weights."""
    w, b = np.ones(len(y)), np.zeros(columns.shape[1])
    for _ in range(30):
        b = np.asarray(np.linalg.lstsq(columns * w[:, None], y * w, rcond=None)[0], dtype=np.float64)
        r = y - columns @ b
        size = 2 * 1.4826 * np.median(np.abs(r)) + 1e-12
        w = np.asarray(1 / np.sqrt(1 + (r / size) ** 2), dtype=np.float64)
    return b


def with_interval(
    recordings: Sequence[Sequence[Part]],
    statistic: Callable[[list[Part]], Mapping[str, float]],
    resamples: int = 500,
) -> dict[str, Array]:
    """(3,) value and 95 % interval of each figure, over resampled recordings.

    Args:
        recordings: What each recording shows.
        statistic: The figures of what some of them show.
        resamples: How many draws.
    """
    rng, n = np.random.default_rng(0), len(recordings)
    drawn = [statistic([part for i in rng.integers(0, n, n) for part in recordings[i]]) for _ in range(resamples)]
    return {
        name: np.array([value, *np.nanpercentile([each[name] for each in drawn], [2.5, 97.5])])
        for name, value in statistic([part for recording in recordings for part in recording]).items()
    }
