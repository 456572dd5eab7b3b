"""What the batch functions share: contiguous arrays, and shapes that do not fit."""

from __future__ import annotations

import numpy as np
import pytest

from tossid.errors import InputError
from tossid.physics.solvers.batches import check_batch


def test_problems_are_made_contiguous_and_warm_starts_copied() -> None:
    A, b, warm = np.asfortranarray(np.ones((5, 6, 6))), np.ones((5, 12))[:, ::2], np.ones((5, 6))
    problems, lam = check_batch(A, b, np.array(0.3), warm)
    assert all(each.flags.c_contiguous for each in problems)
    assert problems.mu.shape == (5, 2)
    lam[:] = 0.0
    assert warm.all()


@pytest.mark.parametrize(("wrong", "says"), [
    ({"A": np.ones((5, 6, 3))}, r"A \(5, 6, 3\) and b \(5, 6\)"),
    ({"b": np.ones((5, 4))}, r"expected \(B, 3 n, 3 n\)"),
    ({"mu": np.ones(3)}, r"friction of shape \(3,\), expected \(2,\) or \(5, 2\)"),
    ({"mu": np.array([0.1, -0.2])}, "friction coefficient -0.2 is negative"),
    ({"warm": np.ones(6)}, r"warm start of shape \(6,\), expected \(5, 6\)"),
])  # fmt: skip
def test_shapes_that_do_not_fit_are_refused(wrong: dict[str, np.ndarray], says: str) -> None:
    given = {"A": np.ones((5, 6, 6)), "b": np.ones((5, 6)), "mu": np.ones(2), "warm": None} | wrong
    with pytest.raises(InputError, match=says):
        check_batch(**given)  # type: ignore[arg-type]
