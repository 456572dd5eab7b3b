"""An object of which nothing is stated."""

from __future__ import annotations

import numpy as np
import pytest

from tossid.errors import InputError
from tossid.objects import ObjectModel, body_poses, load_object, need_stated, unstated_object
from tossid.objects.unstated import hinge_of


def test_it_is_one_rigid_body_without_a_shape() -> None:
    model = unstated_object(com=(0.01, 0.0, 0.0), gyration=0.03)
    assert (model.nq, model.nv, model.n_corners) == (7, 6, 0)
    assert not model.is_stated
    assert model.center.tolist() == [0.0, 0.0, 0.0]
    assert not load_object("unknown").is_stated


def test_two_links_have_a_hinge_and_no_shape(elbow: ObjectModel) -> None:
    hinge = hinge_of(elbow)
    model = unstated_object(hinge=hinge)
    assert (model.nq, model.nv, model.n_corners, model.mass.sum()) == (8, 7, 0, 1.0)
    q = np.array([0.1, 0.2, 0.3, 0.5, 0.5, -0.5, 0.5, 1.2])
    for one, other in zip(body_poses(model, q), body_poses(elbow, q), strict=True):
        assert one == pytest.approx(other)
    assert hinge_of(unstated_object()) is None
    slide = elbow.with_changes(joint_type=np.array([0, 2]))
    with pytest.raises(InputError, match="two links on a hinge"):
        hinge_of(slide)


def test_what_needs_a_shape_says_so(cube: ObjectModel) -> None:
    need_stated(cube, "a diagnosis")
    with pytest.raises(InputError, match="a diagnosis needs a stated object"):
        need_stated(unstated_object(), "a diagnosis")
