"""Motions that stay in a plane, and what they cannot show.

An object between two plates, or one that a tracker projects, moves in a plane and spins about its normal. Reflection in
that plane maps such a motion to itself. A parameter that the reflection turns into its negative, as a centre of mass
out of the plane, then changes nothing in the plane to first order, and what it would change out of the plane is not
free to happen. Other parameters change nothing at all there, as friction along the normal. Neither kind can be fitted.

Which parameters these are is tried, not listed: each is moved to either side. It is shown if the motions in the plane
differ between both sides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.likelihood.states import difference
from tossid.diagnosis.likelihood.windows import Windows, make_windows
from tossid.diagnosis.parts import Part
from tossid.objects import ObjectModel
from tossid.physics.effects import Effect, Strength, World
from tossid.rotations import quat_conj, quat_rotate
from tossid.settings.diagnosis.diagnose import DiagnoseSettings
from tossid.types import Toss

Array = NDArray[np.float64]

OUT_OF_PLANE = 0.02
"""Share of velocities along the normal, and of spins about other axes, up to which a motion is in the plane."""
MOST_WINDOWS, STEPS = 60, 2.0
"""Windows in which parameters are tried, and the steps by which each is moved to either side."""
LEAST_CHANGE, LEAST_WINDOWS = 1e-5, 0.05
"""Change of a pose [m, rad] from which a parameter does anything in a window, and the share of windows in which it
must."""
LEAST_SHARE = 0.5
"""Of what a parameter changes, that must differ in the plane between both sides for it to be shown."""


@dataclass(frozen=True)
class Plane(Part):
    """The plane in which all motion lies, and what it cannot show.

    Attributes:
        normal: (3,) its unit normal in the world.
        hidden: (effect, parameter) of all parameters that no motion in the plane can show.
        effects: Names of the effects of which nothing can be shown, or nothing that a simpler effect is not.
    """

    normal: Array
    hidden: tuple[tuple[str, str], ...] = ()
    effects: tuple[str, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """gap.json's "plane"."""
        hidden = [{"effect": effect, "parameter": name} for effect, name in self.hidden]
        return {"normal": self.normal.tolist(), "not_shown": hidden, "effects_not_shown": list(self.effects)}


def plane_normal(tosses: Sequence[Toss]) -> Array | None:
    """(3,) the unit normal of the plane in which all tosses move; None if there is none.

    It is the axis of all spins (the first right singular vector of the angular velocities in the world), if nearly all
    of the spin is about it and nearly none of the velocity along it. Objects with joints have none.

    Args:
        tosses: Of one object.
    """
    if tosses[0].v.shape[1] > 6:
        return None
    velocity = np.concatenate([toss.v[:, :3] for toss in tosses])
    spin = np.concatenate([quat_rotate(toss.q[:, 3:7], toss.v[:, 3:6]) for toss in tosses])
    _, sizes, axes = np.linalg.svd(spin, full_matrices=False)
    normal = axes[0] * np.sign(axes[0][np.argmax(np.abs(axes[0]))])
    along = float(np.linalg.norm(velocity @ normal)) / max(float(np.linalg.norm(velocity)), 1e-12)
    beside = float(np.linalg.norm(sizes[1:])) / max(float(sizes[0]), 1e-12)
    return normal if along < OUT_OF_PLANE and beside < OUT_OF_PLANE and sizes[0] > 0 else None


def in_plane(
    tosses: Sequence[Toss],
    world: World,
    library: Sequence[Effect],
    *,
    settings: DiagnoseSettings = DiagnoseSettings(),
    n_threads: int = 1,
) -> tuple[tuple[Effect, ...], Plane | None]:
    """The library as far as the tosses can show it: all of it, unless they move in a plane.

    Args:
        tosses: Of one object.
        world: The simulator.
        library: The effects to choose from.
        settings: Of the windows in which parameters are tried.
        n_threads: Of the simulator.

    Returns:
        The effects, each with the parameters that the plane shows, and the plane; None where there is none.
    """
    normal = plane_normal(tosses)
    if normal is None:
        return tuple(library), None
    windows = _windows_within(tosses, world.object, normal, settings)

    def is_determined(effect: Effect, values: Array, k: int) -> bool:
        """Whether a parameter at either side of its value makes motions in the plane that differ."""
        p = effect.parameters[k]

        def predicted(x: float) -> Array:
            moved = values.copy()
            moved[k] = min(max(x, p.low), p.high)
            return windows.predicted(effect.at(world, moved), n_threads=n_threads)

        low, high = (predicted(values[k] + side * STEPS * p.step) for side in (-1.0, 1.0))
        whole, across = difference(high, predicted(values[k])), difference(high, low)
        moved, turned = across[..., :3], across[..., 3:6]
        inside = moved - (moved @ normal)[..., None] * normal
        spun = (turned * _in_body(normal, low)).sum(-1, keepdims=True)
        # the median over windows in which it does anything: contact amplifies a few beyond measure
        differs = np.abs(np.concatenate([inside, spun], axis=-1)).max((1, 2))
        changes = np.abs(whole).max((1, 2))
        acts = changes > LEAST_CHANGE
        enough = acts.mean() > LEAST_WINDOWS
        return bool(enough and np.median(differs[acts] / changes[acts]) > LEAST_SHARE)

    def hidden_of(effect: Effect) -> tuple[str, ...]:
        """Names of the parameters that no motion in the plane shows."""
        nominal = effect.nominal(world)
        left = [k for k in range(len(nominal)) if not is_determined(effect, nominal, k)]
        if left and isinstance(effect.strength, Strength):
            # what says how an effect acts, as a wind's velocity, shows only where there is something of it
            middle = float(np.sqrt(effect.strength.low * effect.strength.high))
            strong = effect.strength.values(middle, np.full(8, 0.5))
            values = np.array([strong.get(p.name, x) for p, x in zip(effect.parameters, nominal, strict=True)])
            values[left] = nominal[left]
            left = [k for k in left if not is_determined(effect, values, k)]
        elif len(left) < len(nominal):
            left = []
        return tuple(effect.parameters[k].name for k in left)

    hidden = {effect.name: hidden_of(effect) for effect in library}
    fitted: dict[str, Effect] = {}
    for effect in library:
        kept = tuple(p for p in effect.parameters if p.name not in hidden[effect.name])
        if any(not p.form for p in kept):
            fitted[effect.name] = effect if len(kept) == len(effect.parameters) else _with_only(effect, kept)
    kept_effects = tuple(each for each in fitted.values() if not _is_special_case(each, fitted))
    names = {each.name for each in kept_effects}
    missing = tuple(effect.name for effect in library if effect.name not in names)
    pairs = tuple((name, each) for name, some in hidden.items() for each in some)
    return kept_effects, Plane(normal, pairs, missing)


def _windows_within(tosses: Sequence[Toss], model: ObjectModel, normal: Array, settings: DiagnoseSettings) -> Windows:
    """Windows whose first states lie exactly in a plane, in which parameters are tried."""
    windows = make_windows(tosses, model, settings=settings.likelihood)
    windows = windows.rows(np.unique(np.linspace(0, len(windows.toss) - 1, MOST_WINDOWS).astype(int)))
    axis, v = _in_body(normal, windows.q), windows.v.copy()
    v[:, :3] -= np.outer(v[:, :3] @ normal, normal)
    v[:, 3:6] = axis * (v[:, 3:6] * axis).sum(1, keepdims=True)
    return replace(windows, at_v=v)


def _in_body(normal: Array, poses: Array) -> Array:
    """A normal (3,) in the body frame of poses (..., 7)."""
    return np.asarray(quat_rotate(quat_conj(poses[..., 3:7]), np.broadcast_to(normal, (*poses.shape[:-1], 3))))


def _with_only(effect: Effect, kept: tuple[Any, ...]) -> Effect:
    """The effect with some of its parameters; the others stay at what changes nothing."""
    names = {p.name for p in kept}
    starts = tuple({name: x for name, x in start.items() if name in names} for start in effect.starts)
    return replace(
        effect,
        parameters=kept,
        apply=lambda world, values: effect.apply(world, {**effect.named(effect.nominal(world)), **values}),
        starts=tuple(start for start in starts if start),
    )


def _is_special_case(effect: Effect, fitted: dict[str, Effect]) -> bool:
    """Whether an effect has no more parameters left than one that it contains, and so is the same."""
    return any(len(effect.parameters) <= len(fitted[name].parameters) for name in effect.contains if name in fitted)
