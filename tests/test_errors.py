"""Errors and results as values: from workers as they were, as plain JSON, with the versions of what computed."""

from __future__ import annotations

import json
import pickle
import platform
from dataclasses import dataclass
from pathlib import Path

import numba
import numpy as np
import pytest
import torch

from tossid.errors import ConfigError, DivergedError, FileError, MotionError, SolverError, TossidError
from tossid.plain_json import jsonable
from tossid.versions import ABSENT, computing_versions, differing_versions


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


@dataclass
class Row:
    name: str
    values: np.ndarray


def test_everything_that_a_result_holds_has_a_form() -> None:
    value = {
        1: Path("a/b"),
        "array": np.array([[1.0, np.nan], [np.inf, 2.0]]),
        "tensor": torch.tensor([1, 2]),
        "row": Row("x", np.arange(2)),
        "set": {3},
        "flag": np.True_,
        "none": None,
    }
    expected = {
        "1": "a/b",
        "array": [[1.0, None], [None, 2.0]],
        "tensor": [1, 2],
        "row": {"name": "x", "values": [0, 1]},
        "set": [3],
        "flag": True,
        "none": None,
    }
    assert jsonable(value) == expected
    assert json.loads(json.dumps(jsonable(value), allow_nan=False)) == expected


def test_what_has_no_form_is_named() -> None:
    with pytest.raises(TypeError, match="object has no JSON form"):
        jsonable({"inside": [object()]})


def test_versions_are_those_that_run() -> None:
    found = computing_versions()
    assert found["python"] == platform.python_version()
    assert found["numba"] == numba.__version__
    assert found["torch"] == torch.__version__
    assert ABSENT not in (found[name] for name in ("numpy", "scipy", "llvmlite", "mujoco"))


def test_differences_name_the_package_and_both_versions() -> None:
    here = {"numpy": "2.4.1", "torch": "2.13.0"}
    assert differing_versions(here, dict(here)) == []
    assert differing_versions(here, {"numpy": "2.4.2"}) == [
        ("numpy", "2.4.1", "2.4.2"),
        ("torch", "2.13.0", ABSENT),
    ]
