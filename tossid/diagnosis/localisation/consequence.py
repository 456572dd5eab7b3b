"""What an effect does to whole tosses: an effect that changes none of them by more than a tolerance is no headline."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tossid.diagnosis.findings import Consequence, Interval
from tossid.diagnosis.likelihood.windows import steps_of
from tossid.diagnosis.localisation.rollouts import first_states
from tossid.diagnosis.selection.cross_validation import CrossValidator
from tossid.diagnosis.selection.search_result import SearchResult
from tossid.physics.effects import World
from tossid.rotations import geodesic_angle
from tossid.settings.diagnosis.diagnose import VerdictSettings
from tossid.types import Toss

Array = NDArray[np.float64]


def consequences(
    tosses: Sequence[Toss], validator: CrossValidator, found: SearchResult, closes: dict[str, Interval]
) -> dict[str, Consequence]:
    """What each effect of the last hypothesis does to whole tosses, by name.

    Args:
        tosses: Rolled out.
        validator: Of their windows.
        found: What the search found.
        closes: Share of the gap that each effect closes, by name.
    """
    hypothesis, settings = found.present.hypothesis, validator.settings.verdict
    if not hypothesis.effects:
        return {}
    world = hypothesis.world()
    q, v = first_states(tosses, world, validator.windows, n_threads=validator.n_threads)
    whole = whole_motions(world, tosses, q, v, validator)
    out = {}
    for name in hypothesis.names:
        without = whole_motions(hypothesis.minus(name).world(), tosses, q, v, validator)
        position, rotation = changed(whole, without, tosses, world.object.width)
        out[name] = Consequence(
            position, rotation, closes[name].value, matters(position, rotation, closes[name], settings)
        )
    return out


def matters(position: float, rotation: float, closed: Interval, settings: VerdictSettings) -> bool:
    """Whether an effect changes whole tosses, or closes the gap, beyond its tolerance.

    Args:
        position: Change of whole tosses [% of the width].
        rotation: The same [deg].
        closed: Share of the gap that it closes.
        settings: The tolerances.
    """
    return (
        position > settings.matters_position_pct
        or rotation > settings.matters_rotation_deg
        or closed.value > settings.matters_closed
    )


def whole_motions(world: World, tosses: Sequence[Toss], q: Array, v: Array, validator: CrossValidator) -> Array:
    """(B, T, nq) whole tosses as a world has them, in their frames; NaN where it diverges, and past a toss's end.

    Args:
        world: The simulator.
        tosses: B, whose lengths count.
        q: (B, nq) first poses.
        v: (B, nv) first velocities.
        validator: Of their windows.
    """
    how, dt = steps_of(world, validator.settings.likelihood.simulation), validator.windows.dt
    ticks = [toss.ticks(dt) for toss in tosses]
    steps = np.array([each[-1] for each in ticks])
    run = world.roll_out(q, v, n_steps=steps, dt=dt, **how, n_threads=validator.n_threads)
    out = np.full((len(tosses), max(map(len, tosses)), run.shape[2]), np.nan)
    for row, each in enumerate(ticks):
        out[row, : len(each)] = run[row, each]
    return out


def changed(one: Array, other: Array, tosses: Sequence[Toss], width: float) -> tuple[float, float]:
    """Medians over tosses of mean distances [% of the width] and angles [deg] over frames; infinite if any diverge.

    Medians, because contact turns any change into a large one in a few tosses.

    Args:
        one: (B, T, nq) motions, in the tosses' frames.
        other: Likewise.
        tosses: B, whose lengths count.
        width: Of the object [m].
    """
    distance, angle = np.full(len(tosses), np.inf), np.full(len(tosses), np.inf)
    for row, toss in enumerate(tosses):
        a, b = one[row, : len(toss)], other[row, : len(toss)]
        if np.isfinite(a).all() and np.isfinite(b).all():
            distance[row] = 100 * np.linalg.norm(a[:, :3] - b[:, :3], axis=1).mean() / width
            angle[row] = np.rad2deg(geodesic_angle(a[:, 3:7], b[:, 3:7])).mean()
    return float(np.median(distance)), float(np.median(angle))
