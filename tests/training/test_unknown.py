"""An object of which nothing is stated, from tosses whose truth is known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import tossid
from tests.models.made import tosses
from tossid.errors import InputError
from tossid.models import TrainedModel
from tossid.motion import tosses_from_tracks
from tossid.objects import ObjectModel, load_object, unstated_object
from tossid.objects.unstated import hinge_of
from tossid.physics.identifiable import inertia_error
from tossid.rotations import quat_rotate
from tossid.settings.objects import UnknownObjectSettings
from tossid.settings.training import CN
from tossid.store import Dataset, draw_splits
from tossid.training.unknown import unknown_object
from tossid.types import PoseTrack

HALF = np.array([0.04, 0.05, 0.06])


@pytest.fixture(scope="module")
def dataset(cube: ObjectModel) -> Dataset:
    """Tosses of a brick whose frame is off its centre; the dataset states the cube."""
    center = np.array([0.01, -0.02, 0.005])
    corners = center + HALF * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    inertia = 0.4 / 3 * np.diag(HALF[[1, 2, 0]] ** 2 + HALF[[2, 0, 1]] ** 2)
    brick = cube.with_changes(
        corner_pos=corners, com=center[None], inertia=inertia[None], mass=np.array([0.4]), friction=0.25
    )
    made = draw_splits(tuple(tosses(brick, 24, seed=5, frames=80)), fractions=(0.7, 0.2, 0.1), seed=0)
    return Dataset(cube, made, 148.0, "synthetic", {}, truth=Dataset(brick, made, 148.0, "synthetic", {}))


def test_shape_centre_and_inertia_are_those_of_the_brick(dataset: Dataset) -> None:
    true = dataset.truth.object
    found = unknown_object(dataset.tosses, UnknownObjectSettings(mass=0.4))
    distance = np.linalg.norm(true.corner_pos[:, None] - found.object.corner_pos[None], axis=-1)
    assert found.object.corner_pos.shape == (8, 3)
    assert distance.min(axis=1).max() < 1.5e-3
    assert found.object.com[0] == pytest.approx(true.com[0], abs=1e-3)
    assert found.object.inertia[0] == pytest.approx(true.inertia[0], rel=0.1, abs=1e-5)
    assert found.fall.gravity == pytest.approx(9.81, abs=0.05)
    assert found.object.friction == pytest.approx(true.friction, abs=0.01)
    assert found.object.mass == pytest.approx([0.4])


def test_training_ignores_the_stated_object_and_says_what_was_shown(dataset: Dataset, tmp_path: Path) -> None:
    settings = UnknownObjectSettings(mass=0.4)
    trained = tossid.train(dataset, model="cn", object=settings, epochs=8)
    assert trained.object.n_corners == 8
    assert trained.object.friction == pytest.approx(0.25, abs=0.03)
    shown = trained.parameters["from_nothing"]
    assert len(shown["corners_m"]) == len(shown["contacts"]) == 8
    assert trained.parameters["length_scale"] == 1.0
    again = TrainedModel.load(trained.save(tmp_path / "model.pt"))
    assert again.settings.object == settings
    assert again.parameters["from_nothing"] == shown
    scores = tossid.evaluate(again, dataset.split("test"))
    assert scores.stated.width == pytest.approx(HALF.sum(), rel=0.02)
    assert scores.metrics["position_error_pct"]["mean"] < 20


def test_another_number_of_links_is_refused(dataset: Dataset, elbow: ObjectModel) -> None:
    jointed = tosses(elbow, 2, seed=1, frames=20)
    with pytest.raises(InputError, match=r"object\.links=1 is one rigid body; joints of these tosses: 1"):
        unknown_object(jointed, tree=elbow)
    with pytest.raises(InputError, match=r"object\.links=2 is two links on a hinge; joints of these tosses: 0"):
        unknown_object(dataset.tosses, UnknownObjectSettings(links=2), tree=dataset.object)


@pytest.fixture(scope="module")
def solid(elbow: ObjectModel) -> ObjectModel:
    """The elbow as two solid boxes of other masses; half edges as published."""
    half, mass = np.array([0.05, 0.025, 0.025]), np.array([0.4, 0.4])
    inertia = mass[:, None, None] / 3 * np.diag(half[[1, 2, 0]] ** 2 + half[[2, 0, 1]] ** 2)
    return elbow.with_changes(mass=mass, inertia=inertia, friction=0.25)


@pytest.fixture(scope="module")
def linked(solid: ObjectModel) -> Dataset:
    """Its tosses, in a dataset that states no more than the hinge."""
    made = draw_splits(tuple(tosses(solid, 24, seed=3, frames=80)), fractions=(0.6, 0.3, 0.1), seed=0)
    return Dataset(unstated_object(hinge=hinge_of(solid)), made, 148.0, "synthetic", {})


def test_two_links_are_those_of_the_elbow(linked: Dataset, solid: ObjectModel, tmp_path: Path) -> None:
    settings = UnknownObjectSettings(links=2, mass=0.8)
    trained = tossid.train(linked, model=replace(CN, horizons=()), object=settings, epochs=3)
    found = trained.object
    assert found.mass == pytest.approx(solid.mass, rel=0.03)
    assert found.com == pytest.approx(solid.com, abs=1.5e-3)
    assert inertia_error(found, solid) < 0.06
    assert found.friction == pytest.approx(0.25, abs=0.02)
    shown = trained.parameters["from_nothing"]
    assert [len(link["corners_m"]) for link in shown["links"]] == [8, 8]
    never = np.concatenate([link["contacts"] for link in shown["links"]]) == 0
    seen = np.concatenate([link["seen"] for link in trained.parameters["geometry"]])
    assert not seen[never].any()
    assert any("mass ratio" in what for what in shown["assumed"])
    scores = tossid.evaluate(trained, linked.split("test"))
    assert scores.metrics["position_error_pct"]["mean"] < 20
    again = load_object(tossid.export(trained, tmp_path / "links.xml").path)
    assert (again.n_joints, again.n_corners) == (1, 16)
    assert again.joint_axis[1] == pytest.approx(found.joint_axis[1], abs=1e-6)


def test_a_body_frame_that_jumps_between_tosses_is_refused(dataset: Dataset) -> None:
    """By 12 mm along x: of what both positions share, some faces hover 12 mm above the ground at rest."""
    tracks = []
    for i, toss in enumerate(tosses(dataset.truth.object, 12, seed=5, frames=180)):
        q = toss.q.copy()
        q[:, :3] += (i > 5) * quat_rotate(q[:, 3:7], np.array([0.012, 0.0, 0.0]))
        tracks.append(PoseTrack(toss.name, toss.t, q))
    with pytest.raises(InputError, match=r"tosses end up to 1[12] mm above or below it.*frame jumps"):
        unknown_object(tosses_from_tracks(tracks, unstated_object()))
