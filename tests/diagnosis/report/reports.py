"""Diagnoses whose pages say all that a page can say."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from tests.diagnosis.by_hand import EFFECTS, STATED, brings, diagnosis, finding, with_place, without_effects
from tossid.diagnosis.findings import Brings, Change, ChangeLeft, Felt, Finding, Interval, OverOrder, Stretch
from tossid.diagnosis.learned import LearnedForces, StandsFor
from tossid.diagnosis.localisation.disagreement import SolverDisagreement
from tossid.diagnosis.localisation.noise import MeasuredNoise
from tossid.diagnosis.localisation.witnesses import Witness
from tossid.diagnosis.plane import Plane
from tossid.diagnosis.result import Diagnosis, Interruption, Unseen
from tossid.types import RecordingOrder, Session

CUBE = STATED.object
RELEASE = {
    "attitude_wxyz": [1.0, 0.0, 0.0, 0.0],
    "velocity_ms": [0.0, 1.5, -0.5],
    "lowest_corner_m": 0.12,
    "position_m": [0.3, -0.2, 0.2],
    "horizontal_speed_ms": 1.5,
    "vertical_speed_ms": -0.5,
    "spin_rads": 8.0,
    "spin_body_rads": [8.0, 0.0, 0.0],
    "joints": [0.5],
    "joint_rates": [2.0],
}
NEXT_TOSS = {
    "release": RELEASE, "between": ["friction", "cohesion"], "separation_sd": 12.3, "separation_of_tosses_seen_sd": 2.0,
}  # fmt: skip
PATCH: dict[str, Any] = {
    "keys": {"object.friction": {"before": 0.18, "after": 0.3}},
    "changes": [
        {"effect": "friction", "where": "geom 'a&b'", "attribute": "friction", "before": "0.18", "after": "0.3",
         "exact": True, "note": ""},
        {"effect": "linear_drag", "where": "option", "attribute": "viscosity", "before": "0", "after": "1",
         "exact": False, "note": ""},
    ],
    "recording": {"length_scale": "divide recorded lengths by 1.01"},
    "not_expressed": {"magnus": "MuJoCo has it for ellipsoids only"},
    "mjcf": "<mujoco/>",
    "rerun": {
        "engine": "MuJoCo 4", "on": "tosses that took part in the fit", "n_tosses": 20, "not_in_it": ["magnus"],
        "position_error_pct": {"before": {"value": 5.8, "ci95": [5.7, 5.9]},
                               "after": {"value": 0.3, "ci95": [0.2, 0.4]}},
        "rotation_error_deg": {w: {"value": 1.0, "ci95": [0.9, 1.1]} for w in ("before", "after")},
    },
}  # fmt: skip
NO_PATCH = {"keys": {}, "changes": [], "recording": {}, "not_expressed": {}, "mjcf": None, "rerun": None}


def recording_order() -> RecordingOrder:
    values = np.random.default_rng(0).normal(size=(30, 3))
    values[:12, :2] += 5
    values[3] = np.nan
    first = Session("0", "11", 12, (0.041, 0.0), (0.001, 0.001), levelled=True)
    second = Session("12", "29", 18, (0.0, 0.0), (0.001, 0.001), changed={"normal": 0.00175})
    names, places = tuple(map(str, range(30))), np.random.default_rng(1).normal(size=(30, 2))
    turns, session_of = np.tile([1.0, 0.0, 0.0, 0.0], (30, 1)), np.repeat([0, 1], [12, 18])
    of = ("normal_x", "normal_y", "gravity"), values, places, turns, np.zeros(30), session_of, ("times overlap",)
    return RecordingOrder((first, second), "names", names, *of)


def changing(name: str, *parts: tuple[str, str, dict[str, Interval]], **order: Any) -> Finding:
    """An effect that changes over the order of recording."""
    stretches = tuple(Stretch(first, last, 10, values) for first, last, values in parts)
    over = OverOrder(
        **{"form": "steps", "stretches": stretches, "rate": {}, "undone": False, "p_value": 0.001, **order}
    )
    return finding(EFFECTS[name], "identified", over_order=over)


def stepped() -> Diagnosis:
    """Friction steps at the tenth of twenty tosses, a camera was moved before the twelfth, and gravity drifts."""
    made, places = diagnosis(CUBE), np.random.default_rng(0).normal(size=(20, 2))
    before, after = ({"mu": Interval(x, x - 0.01, x + 0.01)} for x in (0.2, 0.3))
    tilts = (
        {"x_rad": Interval(x, x, x), "y_rad": Interval(y, y, y)}
        for x, y in ((np.radians(2.35), 0.0), (0.0, np.radians(0.1)))
    )
    found = (
        changing("friction", ("0", "9", before), ("10", "19", after)),
        changing("world_tilt", *zip(("0", "12"), ("11", "19"), tilts, strict=True), p_value=0.0015, undone=True),
        changing(
            "gravity", ("0", "0", {}), ("19", "19", {}), form="drift", rate={"g_ms2": Interval(1e-3, 9e-4, 1.1e-3)}
        ),
    )
    tosses = tuple(map(str, range(20)))
    return replace(made, findings=found, change=(), tosses=tosses, places=places, order=recording_order())


def unsure() -> Diagnosis:
    """One effect is not sure, one is too small to feel, one is not determined, and something is left."""
    e, wide, none = Interval(0.13, 0.08, 0.18), Interval(0.0, -np.inf, np.inf), Interval(np.nan, np.nan, np.nan)
    made = diagnosis(CUBE)
    return replace(
        made,
        verdict="partly_explained",
        findings=(
            *made.findings[:2],
            finding(EFFECTS["restitution"], "candidate", parameters={"e": e}, felt=Felt(2.0, 1.0), frequency=0.62),
            finding(
                EFFECTS["gravity"], "identified", parameters={"g_ms2": Interval(9.79, 9.78, 9.8)}, felt=Felt(0.1, 0.1)
            ),
            finding(
                EFFECTS["com_offset"],
                "candidate",
                parameters={"x_m": Interval(0.003, 0.002, 0.004), "y_m": wide, "z_m": none},
            ),
        ),
        change=(
            *made.change,
            Change("restitution", "e", 0.0, e),
            Change("com_offset", "x_m", -3.6e-15, Interval(0.003, 0.0028, 0.0032)),
            Change("com_offset", "y_m", 0.0, Interval(-1e-5, -2e-4, 1.5e-4)),
            Change("length_scale", "scale_rel", 1.0, Interval(1.016, 1.016, 1.016)),
            Change("velocity_friction", "static_mu", 0.18, Interval(0.26, 0.25, 0.27)),
            Change("velocity_friction", "speed_ms", 0.2, Interval(0.25, 0.2, 0.3)),
        ),
        unexplained={"impact": Interval(0.3, 0.2, 0.4)},
        changes_left=(ChangeLeft("12", 0.001),),
        gap=replace(made.gap, odd=("3", "7")),
        probability_none=0.03,
    )


def beside() -> Diagnosis:
    """With all that may be said beside, of a user's simulator in which some whole tosses diverge."""
    made = diagnosis(CUBE)
    after = made.brings.after.copy()
    after[:3] = np.nan
    return replace(
        made,
        noise=MeasuredNoise(1.5, 1.0),
        plane=Plane(np.array([0.0, 1.0, 0.0]), (("com_offset", "y_m"), ("magnus", "c_ns2pm")), ("magnus",)),
        learned=LearnedForces(0.5, 0.0, False, (StandsFor("linear_drag", {"c_nspm": 0.05}, 0.9),), 0.1),
        unseen=Unseen(6, Interval(0.9, 0.8, 0.95), made.brings),
        remarks=("Tosses left out: one.",),
        tosses_of="a & b <c>",
        passes=412.0,
        disagreement=SolverDisagreement(4.0, 0.9, 0.7),
        brings=Brings("python", made.brings.before, after, 0.1),
        witnesses=(
            Witness("friction", "friction", 0.18, 0.3, Interval(0.29, 0.2, 0.4), 7, Interval(0.31, 0.3, 0.32), True),
        ),
        next_toss=NEXT_TOSS,
    )


def reports() -> dict[str, Diagnosis]:
    """By name, a diagnosis of each kind."""
    made, no_gap = diagnosis(CUBE), without_effects(CUBE, "no_gap")
    lost = np.full_like(made.brings.after, np.nan)
    suspects = (("restitution", 30.0), ("inertia", 3.0))
    within = without_effects(CUBE, "within_solver_disagreement")
    return {
        "explained": replace(made, brings=replace(made.brings, engine="mujoco"), patch=PATCH),
        "with its patch in another engine": replace(made, patch={**PATCH, "rerun": {"problem": "it <diverged>"}}),
        "with all beside": beside(),
        "partly explained": unsure(),
        "changing": stepped(),
        "by place": replace(with_place(CUBE), patch=NO_PATCH, next_toss={"release": None, "reason": "<none>"}),
        "not judged": replace(made, folds=0, draws=0, brings=replace(brings(5.8, 0.34, n=1), unseen=False)),
        "diverged": replace(made, brings=replace(made.brings, after=lost)),
        "interrupted": replace(
            made, verdict="incomplete", interruption=Interruption("fitting friction", suspects), folds=0, draws=0
        ),
        "no gap": no_gap,
        "few tosses": without_effects(CUBE, "unexplained", n=8),
        "within noise": replace(made, brings=brings(12.5, 0.8, n=20)),
        "within solver disagreement": replace(within, disagreement=SolverDisagreement(4.0, 0.9, 0.7)),
    }
