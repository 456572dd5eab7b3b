"""Variants and kinds of models by name, as `conf/model` shows them, and starts that are drawn by a seed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipelines.config.compose import load, part_of
from pipelines.config.places import CONF
from pipelines.config.schemas import TrainConfig
from tossid.errors import ConfigError
from tossid.models import VARIANTS, ModelSettings, Objective, build_model, register_model, variant
from tossid.models.random_start import BALL, CORNER_OFFSET, FRICTION, draw_start
from tossid.models.registry import settings_from
from tossid.objects import ObjectModel
from tossid.settings.kinds import to_plain
from tossid.settings.training import TrainSettings

STAGES = {
    "cn": ["contact", "rollout-20", "rollout-90"],
    "cnrp": ["continuous", "contact", "rollout-20", "rollout-90"],
    "cnrpi": ["flight", "continuous", "contact", "friction", "inertia", "rollout-20", "rollout-90"],
    "diffsim": ["flight", "continuous", "friction", "rollout-20", "rollout-90"],
    "e2e": ["one-step"],
    "cnrp_world": ["continuous", "contact", "rollout-20", "rollout-90"],
    "paper_cn": ["together"],
    "paper_cnrp": ["together"],
    "paper_cnrpi": ["together"],
}


def test_conf_shows_the_librarys_variants() -> None:
    assert {path.stem for path in (CONF / "model").glob("*.yaml")} == set(VARIANTS)
    for name, settings in VARIANTS.items():
        assert load("train", TrainConfig, [f"model={name}"]).model == settings
    assert part_of(load("train", TrainConfig), TrainSettings) == TrainSettings()


@pytest.mark.parametrize("name", VARIANTS)
def test_a_variant_has_the_stages_and_parameters_of_its_settings(cube: ObjectModel, name: str) -> None:
    model = build_model(variant(name), cube)
    plans = {plan.name: plan for plan in model.stages()}
    assert list(plans) == STAGES[name]
    if name == "e2e":
        assert model.mechanics() is None
        return
    mechanics = model.mechanics()
    assert (mechanics.k_res is not None) == (name not in ("cn", "paper_cn"))
    assert mechanics.carried_gravity == variant(name).gravity
    if "rollout-90" not in plans:
        return
    last = plans["rollout-90"]
    assert last.objective is Objective.ROLLOUT
    assert (last.contact_law is not None) == (name in ("cnrpi", "diffsim"))
    corners = any(parameter.shape == cube.corner_pos.shape for parameter in last.parameters)
    assert corners == (name == "diffsim")


def test_a_link_predicts_stretches_of_half_the_first_horizon_and_then_of_it(elbow: ObjectModel) -> None:
    model = build_model(replace(variant("cn"), horizons=(21, 90)), elbow)
    assert [plan.horizon for plan in model.stages() if plan.objective is Objective.ROLLOUT] == [10, 21]


def test_settings_come_back_from_plain_values() -> None:
    own = replace(variant("cnrp"), name="mine", learn_inertia=True, start_com=(0.001, 0.0, 0.0), horizons=(5,))
    assert settings_from(to_plain(own)) == own
    # of an earlier version, whose impacts happened where steps end
    assert settings_from({"name": "cnrpi", "gravity": 0.0}) == replace(variant("cnrpi"), gravity=0.0, impact_parts=1)


def test_an_unknown_name_is_refused_and_a_builtin_kind_cannot_be_taken(cube: ObjectModel) -> None:
    with pytest.raises(ConfigError, match="cnrpi"):
        variant("cnrip")
    with pytest.raises(ConfigError, match="contactnets"):
        build_model(replace(variant("cn"), kind="contactnet"), cube)
    with pytest.raises(ConfigError, match="'e2e' is already registered"):
        register_model("e2e", ModelSettings, build_model)


def test_corners_are_off_by_a_normal_number_or_in_a_ball(cube: ObjectModel) -> None:
    rng = np.random.default_rng(0)
    drawn, scales = zip(*(draw_start(cube, rng) for _ in range(40)), strict=True)
    off = np.concatenate([start.corner_pos - cube.corner_pos for start in drawn])
    np.testing.assert_allclose(off.std(), CORNER_OFFSET * 0.5 * cube.width, rtol=0.1)
    assert all(FRICTION[0] <= start.friction <= FRICTION[1] for start in drawn)
    np.testing.assert_allclose(drawn[0].inertia, scales[0] * cube.inertia)
    ball, _ = draw_start(cube, rng, ball=True, inertia=False)
    assert np.linalg.norm(ball.corner_pos, axis=1).max() <= BALL
    np.testing.assert_array_equal(ball.inertia, cube.inertia)


def test_the_seed_draws_a_models_start(cube: ObjectModel) -> None:
    first, again, other = (build_model(variant("paper_cnrpi"), cube, seed=seed).learned_object() for seed in (0, 0, 1))
    np.testing.assert_array_equal(first.corner_pos, again.corner_pos)
    assert first.friction == again.friction != other.friction
    assert np.abs(first.inertia / cube.inertia.max()).max() != np.abs(other.inertia / cube.inertia.max()).max()
    given = build_model(replace(variant("paper_cn"), random_start=False), cube).learned_object()
    np.testing.assert_allclose(given.corner_pos, cube.corner_pos)
