"""A trained model as a value: its losses, its parameters with intervals, and how it shows itself."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tossid.models import EpochRecord, TrainedModel, build_model, variant
from tossid.objects import ObjectModel
from tossid.settings.training import TrainSettings


@pytest.fixture(scope="module")
def trained(cube: ObjectModel) -> TrainedModel:
    settings = TrainSettings(model=variant("cn"))
    known = {"friction": {"value": 0.1817, "ci95": [0.171, 0.192]}}
    parameters = {"friction": 0.18, "gravity_ms2": 9.81, "corners": [1.0], "uncertainty": {"intervals": known}}
    stages = [("contact", 0.4), ("contact", 0.2), ("rollout-20", 0.05)]
    history = tuple(EpochRecord(stage, 1, 2 * loss, loss, {"prediction": loss}, 3, 0.1, True) for stage, loss in stages)
    return TrainedModel(build_model(settings.model, cube), settings, parameters, history, 1.5)


def test_losses_are_named_after_their_stage(trained: TrainedModel) -> None:
    assert trained.history[0].losses() == {
        "contact/train": 0.8,
        "contact/validation": 0.4,
        "contact/prediction": 0.4,
    }


def test_a_parameter_is_shown_with_its_interval_or_alone(trained: TrainedModel) -> None:
    assert trained.intervals["friction"]["ci95"] == [0.171, 0.192]
    assert repr(trained).splitlines() == [
        "TrainedModel cn of cube, 3 epochs",
        "  gravity_ms2: 9.81",
        "  friction: 0.1817 (0.171 to 0.192)",
    ]
    assert replace(trained, parameters={}).intervals == {}


def test_what_tosses_leave_open_is_shown_without_numbers(trained: TrainedModel) -> None:
    known = {"friction": {"value": 0.1817, "ci95": None, "reason": "the tosses leave it open"}}
    shown = replace(trained, parameters={"uncertainty": {"intervals": known}})
    assert repr(shown).splitlines()[1:] == ["  friction: not determined"]
    assert "0.1817" not in shown._repr_html_()


def test_a_notebook_shows_a_curve_for_each_stage(trained: TrainedModel) -> None:
    html = trained._repr_html_()
    assert html.count("<svg") == 2
    assert "rollout-20: validation loss 0.05" in html
    assert "<td>0.1817 (0.171 to 0.192)</td>" in html
