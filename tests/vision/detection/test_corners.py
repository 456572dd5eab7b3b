"""Each corner's own covariance is what its error is, whatever blur and noise; and it leans the way its edges do."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
import pytest

from tests.vision.films import shot, true_corners
from tossid.objects import ObjectModel
from tossid.rotations import quat_normalize
from tossid.settings.ingestion import DetectSettings
from tossid.settings.rendering import RenderSettings
from tossid.types import Frame
from tossid.vision.cameras.rig import default_rig
from tossid.vision.detection.corners import refine_corners
from tossid.vision.detection.detect import TagFinder
from tossid.vision.rendering.render import Renderer

Measure = Callable[[float, float], tuple[np.ndarray, np.ndarray]]


@pytest.fixture(scope="module")
def measured(tagged: ObjectModel) -> Measure:
    """Corner errors (n, 4, 2) and covariances (n, 4, 2, 2) over random poses, at a noise and a blur."""

    @functools.cache
    def of(noise: float, blur: float) -> tuple[np.ndarray, np.ndarray]:
        (camera,) = default_rig(n_cameras=1)
        renderer = Renderer(tagged, [camera], RenderSettings(noise=noise, blur=blur, samples=24))
        rng, errors, covs = np.random.default_rng(1), [], []
        for _ in range(26):
            q = np.array([*rng.uniform([-0.3, -0.3, 0.06], [0.3, 0.3, 0.4]), *quat_normalize(rng.normal(size=4))])
            frame = Frame(camera.name, 0.0, shot(renderer, q, camera.name, rng))
            for d in TagFinder(camera, tagged, DetectSettings(predict=False, refine=False)).find(frame):
                corners, cov, good = refine_corners(frame.image, camera, d.corners)
                if good:
                    errors.append(corners - true_corners(camera, tagged, q, d))
                    covs.append(cov)
        return np.array(errors), np.array(covs)

    return of


@pytest.mark.parametrize(("noise", "blur"), [(1.5, 0.4), (1.5, 1.6), (6.0, 0.4)])
def test_normalised_errors_are_as_expected(measured: Measure, noise: float, blur: float):
    errors, covs = measured(noise, blur)
    assert len(errors) > 20
    nees = np.einsum("nci,ncij,ncj->nc", errors, np.linalg.inv(covs), errors) / 2
    assert 0.7 < nees.mean() < 1.5
    assert 0.5 < np.median(nees) / (np.log(4) / 2) < 1.6  # not by a few bad ones that many good ones make up for


def test_noise_and_blur_show_in_the_covariance(measured: Measure):
    sharp, noisy, blurred = (
        np.median(np.linalg.det(measured(noise, blur)[1])) ** 0.25
        for noise, blur in ((1.5, 0.4), (6.0, 0.4), (1.5, 1.6))
    )
    assert noisy > 1.15 * sharp  # the renderer's own grain counts as noise too
    assert blurred > 1.5 * sharp


def test_a_corner_is_known_best_across_its_edges(measured: Measure):
    """A tag seen aslant: where two edges meet at a sharp angle, the corner is uncertain along its bisector."""
    errors, covs = measured(6.0, 0.4)
    stretch = np.sqrt(np.divide(*np.linalg.eigvalsh(covs).T[::-1]))
    assert np.quantile(stretch, 0.9) > 1.7
    across = np.linalg.eigh(covs)[1]
    small, large = (np.median(np.abs(np.sum(errors * across[..., k], axis=-1))[stretch.T > 1.7]) for k in (0, 1))
    assert large > 1.6 * small


def test_what_is_no_tag_is_left_as_it_is():
    (camera,) = default_rig(n_cameras=1)
    corners = np.array([[300.0, 280.0], [340.0, 280.0], [340.0, 240.0], [300.0, 240.0]])
    for image in (np.full((512, 640), 90, np.uint8), np.random.default_rng(0).integers(0, 255, (512, 640), np.uint8)):
        found, cov, good = refine_corners(image, camera, corners)
        assert not good
        np.testing.assert_array_equal(found, corners)
        assert not cov.any()
    outside = corners + np.array([290.0, 0.0])
    assert not refine_corners(np.zeros((512, 640), np.uint8), camera, outside)[2]
