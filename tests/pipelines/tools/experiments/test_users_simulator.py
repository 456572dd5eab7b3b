"""On top of MuJoCo's default contact, changes by frame predict what a changed engine does; those of windows do not."""

from __future__ import annotations

from pipelines.tools.experiments.users_simulator import CASES, ENGINES, predict


def test_a_changed_engine_is_predicted_by_changes_of_frames() -> None:
    contact, *lines = predict(ENGINES["mujoco"], ["friction+", "inertia+", "height"], tosses=6, seed=3)
    assert contact["contact"]["compliance"] > 0
    for line in lines[:2]:
        assert line["nearest_closed"] > 0.9
        assert line["nearest_closed"] > line["whole_closed"] + 0.2
    assert lines[2]["nearest_closed"] > 0.999


def test_an_effect_that_an_engine_has_not_is_left_out() -> None:
    CASES["only here"] = {"cohesion": {"c_n": 0.2}}
    try:
        assert "cohesion" in list(predict(ENGINES["mujoco"], ["only here"], tosses=2, seed=1))[1]["left_out"]
    finally:
        del CASES["only here"]
