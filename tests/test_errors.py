"""Errors carry their evidence, from a worker's process too."""

from __future__ import annotations

import pickle

import pytest

from tossid.errors import ConfigError, DivergedError, FileError, MotionError, SolverError, TossidError


@pytest.mark.parametrize(
    "error",
    [
        FileError("a/b.h5", "has no tosses", row=3),
        MotionError("not a number", row=2),
        ConfigError("sweep.key", "is unknown.", suggestion="sweep.keys"),
        SolverError("not solved", count=2, total=5),
        DivergedError("a loss", state=(1.0, 2.0)),
        TossidError("plain"),
    ],
    ids=lambda error: type(error).__name__,
)
def test_errors_come_back_from_workers_as_they_were(error: TossidError) -> None:
    back = pickle.loads(pickle.dumps(error))
    assert type(back) is type(error)
    assert str(back) == str(error)
    assert vars(back) == vars(error)
