"""A dataset collected in memory is the one collected in a file; a file appears whole or not at all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.store.makers import make_toss
from tossid.errors import InputError
from tossid.objects import ObjectModel
from tossid.store.dataset import Dataset
from tossid.vision.dataset_output import dataset_output


def _collected(cube: ObjectModel, out: Path | None) -> Dataset:
    rng = np.random.default_rng(0)
    with dataset_output(out) as output:
        with output.sink(cube) as sink:
            for name in ("a", "b"):
                sink.add(make_toss(name, 12, rng))
            sink.finish(rate_hz=148.0, source="tum", provenance={"command": "test"}, splits={"b": "test"})
        assert out is None or not out.exists()
    return output.dataset(out)


def test_memory_and_file_hold_the_same(cube: ObjectModel, tmp_path: Path) -> None:
    memory, file = _collected(cube, None), _collected(cube, tmp_path / "new" / "a.h5")
    assert [toss.split for toss in file.tosses][-1] == "test"
    assert (memory.rate_hz, memory.source) == (file.rate_hz, file.source)
    for one, other in zip(memory.tosses, file.tosses, strict=True):
        assert (one.name, one.split) == (other.name, other.split)
        np.testing.assert_array_equal(one.q, other.q)
        np.testing.assert_array_equal(one.v_cov, other.v_cov)


def test_an_error_leaves_what_was_there(cube: ObjectModel, tmp_path: Path) -> None:
    out = tmp_path / "a.h5"
    out.write_text("old")
    with pytest.raises(InputError, match="no tosses"), dataset_output(out) as output, output.sink(cube) as sink:
        sink.finish(rate_hz=148.0, source="tum", provenance={})
    assert out.read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["a.h5"]
