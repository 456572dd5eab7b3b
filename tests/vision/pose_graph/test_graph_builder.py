"""The factor graph: what is a variable, what a constant, and which factors there are."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np

from tests.vision.sights import filmed_tumble
from tossid.objects import ObjectModel
from tossid.settings.tracking import TrackSettings
from tossid.types import Detection
from tossid.vision.cameras.camera import Camera
from tossid.vision.cameras.rig import default_rig
from tossid.vision.pose_graph.factors import TagModel
from tossid.vision.pose_graph.graph_builder import BuiltGraph, Problem, build
from tossid.vision.pose_graph.initial import initialise
from tossid.vision.pose_graph.priors import body_key, camera_key, clock_key, print_key, priors, tag_key
from tossid.vision.pose_graph.scene import Scene, observe
from tossid.vision.pose_graph.solution import TimingModel
from tossid.vision.setup.layout import TagLayout, layout_of


def _built(
    detections: list[Detection],
    cameras: tuple[Camera, ...],
    layout: TagLayout,
    *,
    prints: tuple[int, ...] = (),
    free_clock: int | None = None,
) -> tuple[Scene, BuiltGraph]:
    scene = observe(detections, cameras, layout, dropped=Counter())
    state = initialise(scene)
    free = np.arange(len(cameras)) == free_clock
    timing = TimingModel([np.zeros((len(T), 6)) for T in state.world], np.zeros(len(cameras)), free)
    used = np.ones(len(scene.step), dtype=bool)
    model = TagModel(0.0, frozenset(prints))
    problem = Problem(scene, used, priors(scene), timing, model, TrackSettings(), 1.0, False, False)
    return scene, build(problem, state, used, statics=True)


def test_only_moving_bodies_vary_where_all_else_is_given(tagged: ObjectModel) -> None:
    cameras, layout = default_rig(), layout_of(tagged)
    detections, _ = filmed_tumble(cameras, tagged, np.random.default_rng(0), n=5)
    scene, built = _built(detections, cameras, layout)
    b = next(i for i, body in enumerate(scene.bodies) if not body.is_static)
    assert sorted(built.values.keys()) == sorted(body_key(b, step) for step in range(5))
    assert camera_key(0) in built.fixed
    assert tag_key(int(scene.tag[0])) in built.fixed
    views = len(np.unique(np.stack([scene.step, scene.camera]), axis=1).T)
    assert built.graph.size() == views


def test_unknown_poses_prints_and_clocks_are_variables_with_their_priors(tagged: ObjectModel) -> None:
    true = default_rig()
    layout = layout_of(tagged)
    detections, _ = filmed_tumble(true, tagged, np.random.default_rng(1), n=20)
    cameras = (*true[:2], replace(true[2], T_rig_cam=None))
    _, built = _built(detections, cameras, layout, prints=(1,), free_clock=1)
    for key in (camera_key(2), print_key(1), clock_key(1)):
        assert built.values.exists(key)
    assert not built.values.exists(camera_key(0))
    lone = [built.graph.at(i) for i in range(built.graph.size()) if built.graph.at(i).size() == 1]
    keys = [factor.keys()[0] for factor in lone]
    assert keys.count(print_key(1)) == keys.count(clock_key(1)) == 1


def test_stillness_connects_neighbouring_steps(tagged: ObjectModel) -> None:
    cameras, layout = default_rig(), layout_of(tagged)
    detections, _ = filmed_tumble(cameras, tagged, np.random.default_rng(2), n=6)
    *static, body = layout.bodies
    _, plain = _built(detections, cameras, layout)
    _, still = _built(detections, cameras, replace(layout, bodies=(*static, replace(body, stillness=(1e-3, 1e-2)))))
    assert still.graph.size() == plain.graph.size() + 5
