"""Lost frames that are found where there are some, and where there are none: the table of docs/results/by-hand.md.

python -m experiments.vision.lost_frames FOLDER

FOLDER holds the published recordings. Simulated tosses have whole times first, and then lose a frame at three quarters
of their first impacts, without a gap in their times.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import tossid
from pipelines.cli.console import Console
from pipelines.cli.failures import guarded
from tossid.motion.sessions.lost_frames import LostFrames, Verdict, find_lost_frames
from tossid.objects import ObjectModel, load_object
from tossid.settings.objects import ObjectSettings
from tossid.settings.synthesis import LcpEngine, MujocoEngine, NoiseSettings, ReleaseSettings
from tossid.store.importers import read_contactnets, read_tum
from tossid.types import Phase, PoseTrack, Toss

TOSSES, SHARE = 60, 0.75
"""Tosses of a simulated set, and share of them that lose a frame."""
NOISE = NoiseSettings(position=1.5e-4, rotation=1.5e-3)
WORLDS: dict[str, dict[str, Any]] = {
    "rigid": {"engine": LcpEngine()},
    "restitution 0.3": {"engine": LcpEngine(), "effects": {"restitution": {"e": 0.3}}},
    "restitution 0.6": {"engine": LcpEngine(), "effects": {"restitution": {"e": 0.6}}},
    "stiff spring": {"engine": LcpEngine(), "effects": {"compliance": {"stiffness_npm": 2e4, "damping_nspm": 15.0}}},
    "soft spring": {"engine": LcpEngine(), "effects": {"compliance": {"stiffness_npm": 5e3, "damping_nspm": 8.0}}},
    "MuJoCo": {"engine": MujocoEngine()},
    "MuJoCo, soft": {"engine": MujocoEngine(soft=True)},
}
HIGH = ReleaseSettings(height=(0.2, 0.6), spin=(0.0, 15.0))
"""Releases from which objects bounce."""


def first_contact(toss: Toss) -> int:
    """Number of the first frame that follows a contact with the ground; 0 where there is none.

    Args:
        toss: With its true phases.
    """
    flies = toss.phase == Phase.FLIGHT
    return 0 if flies.all() else int(np.argmin(flies))


def with_loss(toss: Toss, frame: int) -> PoseTrack:
    """The track of a toss without a frame, and without a gap in its times.

    Args:
        toss: Evenly timed.
        frame: Number of the frame that is lost; 0: none is.
    """
    q = np.delete(toss.q, frame, axis=0) if frame else toss.q
    return PoseTrack(toss.name, toss.t[: len(q)], q)


def lossy(tosses: Sequence[Toss], truth: Sequence[Toss], rng: np.random.Generator) -> tuple[list[PoseTrack], list[int]]:
    """Tracks of which most lost a frame beside the first impact, and which frame each lost (0: none).

    Args:
        tosses: As measured.
        truth: With true phases.
        rng: Draws who loses a frame, and whether that before, of, or after the impact.
    """
    lost = []
    for true in truth:
        at = first_contact(true)
        loses = at > 0 and rng.random() < SHARE
        lost.append(at + int(rng.integers(-1, 2)) if loses else 0)
    return [with_loss(toss, frame) for toss, frame in zip(tosses, lost, strict=True)], lost


def row(name: str, found: LostFrames, more: Sequence[str] = ("", "")) -> list[str]:
    """A row of the table.

    Args:
        name: Of the tosses.
        found: In them.
        more: Further cells.
    """
    return [name, _cell(found.first), _cell(found.later), *more]


def _cell(verdict: Verdict) -> str:
    counts = "; ".join(f"{n} lost {k}" for k, n in enumerate(verdict.counts) if n)
    chance = f"; {verdict.chance} with frames too many" if verdict.chance else ""
    return f"{verdict.impacts}: {counts or 'none judged'}{chance}" + (" **lossy**" if verdict.is_lossy else "")


def recovered(found: LostFrames, tracks: Sequence[PoseTrack], tosses: Sequence[Toss], lost: Sequence[int]) -> list[str]:
    """How many judged first impacts have the right number of lost frames, and how many mended tosses the true times.

    Args:
        found: In the tracks.
        tracks: That lost frames.
        tosses: Whole.
        lost: Which frame each lost.
    """
    first = {i.toss: i.lost for i in found.impacts if i.first and i.lost is not None}
    right = sum(first[toss.name] == (frame > 0) for toss, frame in zip(tosses, lost, strict=True) if toss.name in first)
    hurt = {impact.toss for impact in found.losses}
    mended = [
        np.allclose(track.t, np.delete(toss.t, frame) if frame else toss.t, atol=1e-9)
        for track, toss, frame in zip(found.mended(tracks), tosses, lost, strict=True)
        if track.name in hurt
    ]
    return [f"{right} of {len(first)}", f"{sum(mended)} of {len(mended)}"]


def main(data: Path) -> None:
    """Print the table.

    Args:
        data: Holds contactnets_cube and mit_die.
    """
    console, cube = Console(), load_object("cube")
    die = load_object(ObjectSettings(name="die", path=data / "mit_die" / "die.xml", friction=0.3))
    rows = [row("recorded cube, 148 Hz", find_lost_frames(read_contactnets(data / "contactnets_cube"), cube))]
    for kind in ("levelled", "measured"):
        rows.append(row(f"recorded die, {kind}", find_lost_frames(read_tum(data / "mit_die" / kind, n_joints=0), die)))
    rng = np.random.default_rng(0)
    for name, world in WORLDS.items():
        for model, rate in ((cube, 148.0), (die, 250.0)):
            rows += _simulated(f"{name}, {model.name}, {rate:g} Hz", world, model, rate, rng)
    head = ("tosses", "first impacts", "later impacts", "right number", "exact times")
    console.table(head, rows)


def _simulated(
    name: str, world: dict[str, Any], model: ObjectModel, rate: float, rng: np.random.Generator
) -> list[list[str]]:
    made = tossid.synthesize(model, tosses=TOSSES, rate_hz=rate, release=HIGH, noise=NOISE, **world)
    assert made.truth is not None
    whole = find_lost_frames([with_loss(toss, 0) for toss in made.tosses], model)
    tracks, lost = lossy(made.tosses, made.truth.tosses, rng)
    found = find_lost_frames(tracks, model)
    return [row(name, whole), row(f"{name}, lossy", found, recovered(found, tracks, made.tosses, lost))]


if __name__ == "__main__":
    sys.exit(guarded(lambda: main(Path(sys.argv[1])), "lost_frames"))
