"""Results as plain JSON."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import torch

from tossid.plain_json import jsonable


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
