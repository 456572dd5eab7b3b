"""Which tosses the figures of an evaluation show, and how given gravity is called."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import tossid
from tests.evaluation.test_evaluate import model_of
from tests.models.made import tosses
from tossid.evaluation.score_figures import acceleration_figure, gravity_given, ranked, score_figures
from tossid.models import TrainedModel, build_model, variant
from tossid.objects import ObjectModel
from tossid.settings.training import TrainSettings
from tossid.store import Dataset


def test_the_median_and_the_worst_of_the_finite_errors_are_shown() -> None:
    assert ranked(np.array([3.0, np.inf, 1.0, 2.0])) == {"median": 3, "worst": 0}
    assert ranked(np.array([1.0, 2.0])) == {"median": 0, "worst": 1}
    assert ranked(np.array([np.nan, 5.0])) == {"median": 1}
    assert ranked(np.array([np.nan])) == {}


@pytest.mark.parametrize(
    ("gravity", "words"), [(0.0, "given no gravity"), (9.81, "given 1 times the true gravity"), (19.62, "2 times")]
)
def test_given_gravity_in_words(gravity: float, words: str) -> None:
    assert words in gravity_given(gravity)


def test_a_model_that_is_no_rigid_body_has_no_figure_of_accelerations(cube: ObjectModel) -> None:
    dataset = Dataset(cube, tuple(tosses(cube, 2, seed=2, frames=40)), 148.0, "made")
    scores = tossid.evaluate(model_of(cube), dataset)
    assert acceleration_figure(scores).keys() == {"residual_over_toss"}
    assert "geometry_at_angles" not in score_figures(scores)
    settings = TrainSettings(model=variant("e2e"))
    network = TrainedModel(build_model(settings.model, cube), settings, {})
    assert acceleration_figure(tossid.evaluate(network, dataset)) == {}


def test_a_single_toss_has_no_worst_one(cube: ObjectModel, tmp_path: Path) -> None:
    dataset = Dataset(cube, tuple(tosses(cube, 1, seed=2, frames=40)), 148.0, "made")
    names = set(score_figures(tossid.evaluate(model_of(cube, gravity=9.0), dataset)))
    assert "toss_comparison_median" in names
    assert "toss_comparison_worst" not in names
