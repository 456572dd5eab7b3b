"""Wireframes, films, and errors that are lined up along rollouts with a band of their mean."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.stats import norm

from tests.evaluation.figures.motions import toss_and_rollout
from tests.models.made import toss_of
from tossid.errors import InputError
from tossid.evaluation.figures import (
    errors_along,
    films,
    hull_film,
    save_film,
    toss_film,
)
from tossid.evaluation.figures.films import rgb
from tossid.evaluation.figures.geometry import UNSEEN, exaggeration
from tossid.evaluation.figures.style import MUTED
from tossid.evaluation.figures.tosses import mean_band
from tossid.evaluation.figures.wireframe import view_from, wireframe
from tossid.motion import frames_in_flight
from tossid.objects import ObjectModel, corner_positions
from tossid.types import Rollout


def test_a_cube_has_twelve_edges_and_nine_are_seen_from_a_view_that_keeps_up_and_right(cube: ObjectModel) -> None:
    frame = wireframe(cube.corner_pos)
    lengths = np.linalg.norm(np.diff(cube.corner_pos[frame.edges], axis=1)[:, 0], axis=1)
    np.testing.assert_allclose(lengths, np.full(12, 0.1048))
    assert frame.visible(np.array([1.0, 0, 0, 0]), view_from(0.5, 0.4).toward).sum() == 9
    assert len(wireframe(cube.corner_pos[:3]).edges) == 3, "a flat body is drawn all the same"
    front = view_from(-np.pi / 2, 0.0)
    np.testing.assert_allclose(front(np.eye(3)), [[1, 0], [0, 0], [0, 1]], atol=1e-12)
    np.testing.assert_allclose(front.toward, [0, -1, 0], atol=1e-12)


def test_the_factor_is_round(cube: ObjectModel) -> None:
    for size, factor in ((1e-3, 10.0), (1e-5, 100.0), (30e-3, 1.0), (0.0, 1.0)):
        assert exaggeration(cube, cube.with_changes(corner_pos=cube.corner_pos + np.array([size, 0, 0]))) == factor


# ---------------------------------------------------------------- films


def test_a_film_s_predicted_object_is_where_it_is_predicted(elbow: ObjectModel) -> None:
    q = np.zeros((9, 8))
    q[:, 2], q[:, 3] = np.linspace(0.4, 0.1, 9), 1.0
    toss, apart = toss_of("a", q), q.copy()
    apart[:, 0] += 0.2
    same = toss_film(toss, replace(toss), elbow, name="cnrp")
    other = toss_film(toss, replace(toss, q=apart), elbow, name="cnrp")
    dark = lambda frames: (frames[:, 40:].max(axis=-1) < 90).sum(axis=(1, 2))  # noqa: E731
    assert (dark(same) == 0).all()  # hidden under the prediction
    assert (dark(other) > 50).all()
    with pytest.raises(InputError):
        toss_film(toss, replace(toss.frames(slice(0, 5))), elbow, name="cnrp")


def test_tosses_cut_the_space_down_to_the_object(
    cube: ObjectModel, elbow: ObjectModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of forty tosses of five frames each, in all of which the cube touches the ground."""
    monkeypatch.setattr(films, "HULL_PICTURES", 6)
    rng, tosses = np.random.default_rng(3), []
    for number in range(40):
        q = np.concatenate([np.zeros((5, 3)), rng.normal(size=(5, 4))], axis=1)
        q[:, 3:] /= np.linalg.norm(q[:, 3:], axis=1, keepdims=True)
        q[:, 2] = -corner_positions(cube, q)[..., 2].min(axis=1)
        tosses.append(toss_of(f"{number}", q))
    film = hull_film(tosses, cube)
    # columns over which the grey hull reaches, below the caption
    grey = [(np.abs(frame[30:].astype(int) - rgb(MUTED)).max(axis=-1) < 12).any(axis=0) for frame in film]
    first, last = (np.ptp(np.flatnonzero(each)) if each.any() else 0 for each in (grey[0], grey[-1]))
    assert first > 1.5 * last
    crossed = [(frame == rgb(UNSEEN)).all(axis=-1).sum() for frame in film]
    assert crossed[0] > 0
    assert crossed[-1] == 0  # forty tosses have shown all corners
    path = save_film(film, tmp_path / "hull.gif", frame_ms=300)
    with Image.open(path) as written:
        assert (written.n_frames, written.size) == (len(film), (480, 360))
    with pytest.raises(InputError, match="one rigid body"):
        hull_film(tosses[:1], elbow)


# ---------------------------------------------------------------- along rollouts


def test_errors_are_lined_up_at_first_contact(cube: ObjectModel) -> None:
    toss, run = toss_and_rollout(cube)
    later = toss.frames(slice(9, None))
    short = Rollout(run.t[9:], run.q[9:], run.v[9:], run.lam_n[9:])
    along = errors_along([toss, later], [run, short], cube)
    assert along.position_error_pct.shape == (2, len(toss))
    first = frames_in_flight([toss], cube)[0]
    np.testing.assert_allclose(along.time, toss.t - toss.t[first], atol=1e-9)
    np.testing.assert_allclose(along.position_error_pct[0], 100 * 0.010 / 0.1048)
    np.testing.assert_allclose(along.rotation_error_deg[0], 20)
    assert np.isnan(along.position_error_pct[1, :8]).all()
    np.testing.assert_allclose(along.position_error_pct[1, 9:], 100 * 0.010 / 0.1048)


def test_the_band_covers_the_true_mean_95_times_in_100() -> None:
    values = norm.rvs(size=(12, 4000), random_state=np.random.default_rng(0))
    _, low, high = mean_band(values)
    assert np.mean((low < 0) & (high > 0)) == pytest.approx(0.95, abs=0.012)
    values[:, 0] = np.nan
    values[3, 0] = 1.0
    assert np.isnan(mean_band(values)[0][0]), "one toss has no interval"
