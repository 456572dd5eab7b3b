"""Trained models as values, and in files: what is written comes back, older files open, damaged ones are refused."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from tossid.errors import FileError
from tossid.models import EpochRecord, TrainedModel, build_model, variant
from tossid.models.trained import LOG_COHESION, OLDER, checkpoint_bytes
from tossid.objects import ObjectModel
from tossid.settings.kinds import to_plain
from tossid.settings.training import TrainSettings


def trained(cube: ObjectModel, name: str) -> TrainedModel:
    """An untrained model with offsets in all its parameters."""
    settings = TrainSettings(model=replace(variant(name), hidden=4, gravity=5.0, start_corners=1e-3), seed=3)
    model = build_model(settings.model, cube, seed=3)
    rng = np.random.default_rng(0)
    with torch.no_grad():
        for parameter in model.state_dict().values():
            parameter += 0.01 * torch.from_numpy(rng.normal(size=tuple(parameter.shape)))
    record = EpochRecord("contact", 1, 0.2, 0.1, {"prediction": 0.2}, 3, 0.01, True)
    return TrainedModel(
        model, settings, {"friction": 0.2}, (record,), 1.5, Path("/data/tosses.h5"), "a" * 64, {"numpy": "2.4.1"}
    )


def same_motion(one: TrainedModel, other: TrainedModel) -> None:
    q = np.array([[0, 0, 0.3, 0.8, 0.6, 0, 0]])
    v = np.array([[0.5, 0, -1, 1, 2, 3.0]])
    runs = [each.model.simulator().rollout(q, v, n_steps=30, dt=1 / 148).q for each in (one, other)]
    np.testing.assert_array_equal(*runs)


@pytest.mark.parametrize("name", ["cn", "cnrpi", "diffsim", "e2e"])
def test_what_is_saved_comes_back(cube: ObjectModel, tmp_path: Path, name: str) -> None:
    before = trained(cube, name)
    after = TrainedModel.load(before.save(tmp_path / "model.pt"))
    for field in ("settings", "parameters", "history", "seconds", "data", "sha256", "name", "versions"):
        assert getattr(after, field) == getattr(before, field), field
    same_motion(before, after)


OLD_KEYS = [
    "name", "gravity", "hidden", "residual_weight", "complementarity", "dissipation", "penetration", "gap_scale",
    "horizons", "inertia", "start_inertia", "start_com", "length_scale", "velocity_lag",
]  # fmt: skip
"""The keys of the first checkpoints of schema 2."""


def content_of(trained: TrainedModel) -> dict[str, Any]:
    content: dict[str, Any] = torch.load(io.BytesIO(checkpoint_bytes(trained)), weights_only=True)
    return content


@pytest.mark.parametrize("name", ["cn", "cnrp", "cnrpi", "diffsim", "e2e"])
def test_a_checkpoint_of_the_schema_before_opens(cube: ObjectModel, tmp_path: Path, name: str) -> None:
    now = trained(cube, name)
    plan = replace(now.settings.model, start_corners=0.0, impact_parts=1)
    model = build_model(plan, cube, seed=3)
    model.load_state_dict(now.model.state_dict())
    now = replace(now, model=model, settings=replace(now.settings, model=plan))
    content, plain = content_of(now), to_plain(plan)
    weights = {key.replace("k_res.", "residual."): value for key, value in with_log(content["model"]).items()}
    old = {"schema": OLDER, "config": {key: plain[key] for key in OLD_KEYS}, "object": content["object"]}
    old |= {"seed": 3, "data": "/data/tosses.h5", "sha256": "a" * 64, "model": weights, "fit": {}}
    torch.save(old, tmp_path / "old.pt")
    opened = TrainedModel.load(tmp_path / "old.pt")
    assert opened.settings == now.settings
    assert opened.data == Path("/data/tosses.h5")
    assert opened.parameters == opened.model.parameters_report()
    same_motion(now, opened)


def with_log(model: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """Weights with the logarithm of cohesion, as schemas 2 and 3 have them."""
    law = model.get("contact_law.value")
    return model if law is None else {**model, "contact_law.value": torch.cat([law[:2], law[2:].log()])}


def test_a_checkpoint_with_the_logarithm_of_cohesion_opens(cube: ObjectModel, tmp_path: Path) -> None:
    now = trained(cube, "cnrpi")
    content = content_of(now)
    del content["versions"]  # which the first of them had not
    torch.save({**content, "schema": LOG_COHESION, "model": with_log(content["model"])}, tmp_path / "old.pt")
    opened = TrainedModel.load(tmp_path / "old.pt")
    assert opened.versions == {}
    cohesion = opened.object.cohesion
    assert cohesion == pytest.approx(now.object.cohesion, rel=1e-12)
    assert cohesion > 0


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda content: checkpoint_bytes(content)[:5000], "not a readable checkpoint"),
        (lambda content: {**content_of(content), "schema": "tossid.checkpoint/99"}, "not a checkpoint of schema"),
        (lambda content: {**content_of(content), "model": {}}, "damaged checkpoint"),
    ],
)
def test_what_is_no_checkpoint_is_refused(cube: ObjectModel, tmp_path: Path, spoil: Any, says: str) -> None:
    spoilt, path = spoil(trained(cube, "cn")), tmp_path / "model.pt"
    path.write_bytes(spoilt) if isinstance(spoilt, bytes) else torch.save(spoilt, path)
    with pytest.raises(FileError, match=says):
        TrainedModel.load(path)


def test_a_model_shows_its_parameters_intervals_and_curves(cube: ObjectModel) -> None:
    """And what tosses leave open without a number."""
    known = {"friction": {"value": 0.1817, "ci95": [0.171, 0.192]}}
    parameters = {"friction": 0.18, "gravity_ms2": 9.81, "corners": [1.0], "uncertainty": {"intervals": known}}
    stages = [("contact", 0.4), ("contact", 0.2), ("rollout-20", 0.05)]
    history = tuple(EpochRecord(stage, 1, 2 * loss, loss, {"prediction": loss}, 3, 0.1, True) for stage, loss in stages)
    assert history[0].losses() == {"contact/train": 0.8, "contact/validation": 0.4, "contact/prediction": 0.4}
    settings = TrainSettings(model=variant("cn"))
    shown = TrainedModel(build_model(settings.model, cube), settings, parameters, history, 1.5)
    lines = ["TrainedModel cn of cube, 3 epochs", "  gravity_ms2: 9.81", "  friction: 0.1817 (0.171 to 0.192)"]
    assert repr(shown).splitlines() == lines
    html = shown._repr_html_()
    assert html.count("<svg") == 2
    assert "rollout-20: validation loss 0.05" in html
    assert "<td>0.1817 (0.171 to 0.192)</td>" in html
    unsure = {"friction": {"value": 0.1817, "ci95": None, "reason": "the tosses leave it open"}}
    open_ = replace(shown, parameters={"uncertainty": {"intervals": unsure}})
    assert repr(open_).splitlines()[1:] == ["  not determined: friction"]
    assert "0.1817" not in open_._repr_html_()
    assert replace(shown, parameters={}).intervals == {}
