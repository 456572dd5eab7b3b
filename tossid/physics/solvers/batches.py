"""What the batch functions share: checked, contiguous arrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tossid.errors import InputError
from tossid.physics.solvers.problem import Array


class Problems(NamedTuple):
    """A batch of contact problems, contiguous; rows in the order of `problem`.

    Attributes:
        A: (B, 3 n, 3 n) Delassus matrices [1/kg].
        b: (B, 3 n) [m/s]; of cone programmes, their linear term c.
        mu: (B, n) friction coefficients.
    """

    A: Array
    b: Array
    mu: Array


def check_batch(A: Array, b: Array, mu: Array, warm: Array | None) -> tuple[Problems, Array]:
    """The problems as the kernels read them, and impulses (B, 3 n) to start from.

    Args:
        A: (B, 3 n, 3 n).
        b: (B, 3 n).
        mu: (), (n,) or (B, n).
        warm: (B, 3 n), which is copied; zero if None.

    Returns:
        The problems, and the impulses.

    Raises:
        InputError: shapes that do not fit, or a negative mu.
    """
    A, b = np.ascontiguousarray(A, dtype=float), np.ascontiguousarray(b, dtype=float)
    if b.ndim != 2 or b.shape[1] % 3 or A.shape != (*b.shape, b.shape[1]):
        raise InputError(f"contact problems of shapes A {A.shape} and b {b.shape}; expected (B, 3 n, 3 n) and (B, 3 n)")
    count, n = b.shape[0], b.shape[1] // 3
    mu = np.asarray(mu, dtype=float)
    if mu.shape not in ((), (n,), (count, n)):
        raise InputError(f"friction of shape {mu.shape}, expected ({n},) or ({count}, {n})")
    if (mu < 0).any():
        raise InputError(f"friction coefficient {mu.min():g} is negative")
    mu = np.ascontiguousarray(np.broadcast_to(mu, (count, n)))
    if warm is not None and np.shape(warm) != b.shape:
        raise InputError(f"warm start of shape {np.shape(warm)}, expected {b.shape}")
    lam = np.zeros(b.shape) if warm is None else np.array(warm, dtype=float, order="C")
    return Problems(A, b, mu), lam
