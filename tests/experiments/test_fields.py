"""The study of fields: how tosses are thrown, and what of a field is recovered."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from experiments import fields
from tossid.models import TrainedModel, build_model, variant
from tossid.physics.effects import all_effects
from tossid.physics.effects.wrenches import acceleration_of_forces, airborne
from tossid.settings.training import TrainSettings


def test_held_out_tosses_are_in_the_stripes_and_between_them() -> None:
    thrown = fields.throw("steady vortex", tosses=6, held_out=3, seed=0)
    assert "steady_vortex" not in {effect.name for effect in all_effects()}
    assert [toss.split for toss in thrown.learned.tosses] == ["train"] * 6 + ["validation"] * 3 + ["test"] * 3
    for tosses, odd in ((thrown.inside, 0), (thrown.between, 1)):
        assert len(tosses) == 3
        x = np.concatenate([toss.q[airborne(thrown.world.object, toss.q), 0] for toss in tosses])
        assert set(np.floor(x / fields.STRIPE_M) % 2) == {odd}
    q, v = thrown.between[0].q, thrown.between[0].v
    force = 0.37 * (acceleration_of_forces(thrown.world, q, v)[:, :3] + [0, 0, 9.81])
    np.testing.assert_allclose(np.linalg.norm(force, axis=1), 1.0, rtol=1e-6)
    np.testing.assert_allclose((force * q[:, :3]).sum(1), 0, atol=1e-9)


def test_a_field_that_a_model_has_is_recovered_whole() -> None:
    thrown = fields.throw("vortex", tosses=6, held_out=3, seed=0)
    model = build_model(variant("cnrp_world"), thrown.learned.object)
    trained = TrainedModel(model, TrainSettings(), {})
    assert fields.recovered(trained, thrown.world, thrown.between)[0] == pytest.approx(0.0)
    with torch.no_grad():
        model.k_res.linear_world[0, 2], model.k_res.linear_world[1, 1] = -0.3 / 0.37, 0.3 / 0.37
    assert fields.recovered(trained, thrown.world, thrown.between)[0] == pytest.approx(1.0)


@pytest.mark.slow
def test_a_vortex_is_recovered_between_the_stripes() -> None:
    case = {"field": "vortex", "seed": 0, "tosses": 60, "held_out": 15}
    between = {name: fields.learned({**case, "model": name})["between [%]"] for name in ("cnrp", "cnrp_world")}
    assert float(between["cnrp_world"]) > 90 > float(between["cnrp"])
