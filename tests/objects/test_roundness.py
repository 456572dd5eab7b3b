"""Round corners: their lowest points against brute force, and as geoms of MJCF and back."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from tossid.objects import ObjectModel, corner_positions, object_from_mjcf, to_mjcf
from tossid.objects.roundness import ball, directions, disc, ellipsoid, joined, points

AXES = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]


def geom(text: str) -> ObjectModel:
    body = f'<body name="b"><freejoint/><geom {text} mass="0.3"/></body>'
    return object_from_mjcf(f"<mujoco><worldbody>{body}</worldbody></mujoco>", name="b")


def test_ellipsoids_and_balls_reach_as_far_as_their_surfaces() -> None:
    half = np.array([0.05, 0.03, 0.02])
    surface = (directions(20000) * half) @ AXES.T
    ways = directions(40)
    found = np.einsum("ki,kci->kc", ways, ellipsoid(half, AXES).offset(ways[:, None]))[:, 0]
    assert found == pytest.approx((ways @ surface.T).max(axis=1), abs=2e-5)
    assert np.einsum("ki,kci->kc", ways, ball(0.03).offset(ways[:, None])) == pytest.approx(0.03)


def test_a_disc_touches_with_its_rim_and_lies_on_all_of_it() -> None:
    shape = disc(0.04, AXES[:, 0], edge=0.01)
    angle = np.linspace(0, 2 * np.pi, 5000)
    rim = 0.04 * (np.cos(angle)[:, None] * AXES[:, 1] + np.sin(angle)[:, None] * AXES[:, 2])
    ways = directions(40)
    found = np.einsum("ki,kci->kc", ways, shape.offset(np.repeat(ways[:, None], 3, axis=1)))
    assert found.max(axis=1) == pytest.approx((ways @ rim.T).max(axis=1) + 0.01, abs=1e-7)
    assert found.argmax(axis=1) == pytest.approx(0)
    flat = shape.offset(np.tile(AXES[:, 0], (3, 1)))
    across = flat - np.outer(flat @ AXES[:, 0], AXES[:, 0])
    assert flat @ AXES[:, 0] == pytest.approx(0.01)
    assert np.linalg.norm(across, axis=1) == pytest.approx(0.04)
    assert across.sum(axis=0) == pytest.approx(0, abs=1e-12)  # the centre of mass above it is held on all sides


def test_points_stay_points() -> None:
    both = joined([points(2), ball(0.01)])
    assert both.offset(np.tile([0.0, 0.0, -1.0], (3, 1))) == pytest.approx(
        np.array([[0, 0, 0], [0, 0, 0], [0, 0, -0.01]])
    )
    assert both.scaled(2.0).radius.tolist() == [0.0, 0.0, 0.02]
    assert both.of(np.array([False, False, True])).radius.tolist() == [0.01]


@pytest.mark.parametrize(
    ("text", "low", "corners"),
    [
        ('type="sphere" size="0.05"', 0.05, 1),
        ('type="capsule" size="0.02 0.04"', 0.06, 2),
        ('type="cylinder" size="0.05 0.03"', 0.03, 6),
        ('type="ellipsoid" size="0.06 0.045 0.035"', 0.035, 1),
    ],
)
def test_geoms_of_mjcf_stand_where_they_should(text: str, low: float, corners: int) -> None:
    model = geom(text)
    q = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    assert model.n_corners == corners
    assert corner_positions(model, q)[:, 2].min() == pytest.approx(-low)
    assert model.extent()[1][2] == pytest.approx(low)
    assert model.resized(2.0).extent()[1][2] == pytest.approx(2 * low)


@pytest.mark.parametrize(
    "text",
    [
        'type="sphere" size="0.05" pos="0.01 0 0"',
        'type="capsule" size="0.02 0.04" euler="30 20 10"',
        'type="ellipsoid" size="0.06 0.045 0.035" euler="30 20 10"',
        'type="cylinder" size="0.05 0.03" euler="30 20 10" pos="0 0.02 0"',
    ],
)
def test_a_round_object_survives_mjcf(text: str) -> None:
    model, ways = geom(text), directions(200)
    again = object_from_mjcf(to_mjcf(model))
    assert again.support(ways).max(axis=1) == pytest.approx(model.support(ways).max(axis=1), abs=2e-5)
    assert mujoco.MjModel.from_xml_string(to_mjcf(model)).nbody == 2


def test_round_edges_become_a_mesh_of_many_points() -> None:
    model = geom('type="cylinder" size="0.05 0.01"')
    edge = disc(0.04, [0, 0, 1], edge=0.01)
    rounded = model.with_changes(corner_pos=np.zeros((3, 3)), corner_body=np.zeros(3, dtype=np.int64), roundness=edge)
    again, ways = object_from_mjcf(to_mjcf(rounded)), directions(300)
    assert again.n_corners > 300
    assert again.support(ways).max(axis=1) == pytest.approx(rounded.support(ways).max(axis=1), abs=4e-4)
