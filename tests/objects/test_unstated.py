"""An object of which nothing is stated."""

from __future__ import annotations

import pytest

from tossid.errors import InputError
from tossid.objects import ObjectModel, load_object, need_stated, unstated_object


def test_it_is_one_rigid_body_without_a_shape() -> None:
    model = unstated_object(com=(0.01, 0.0, 0.0), gyration=0.03)
    assert (model.nq, model.nv, model.n_corners) == (7, 6, 0)
    assert not model.is_stated
    assert model.center.tolist() == [0.0, 0.0, 0.0]
    assert not load_object("unknown").is_stated


def test_what_needs_a_shape_says_so(cube: ObjectModel) -> None:
    need_stated(cube, "a diagnosis")
    with pytest.raises(InputError, match="a diagnosis needs a stated object"):
        need_stated(unstated_object(), "a diagnosis")
