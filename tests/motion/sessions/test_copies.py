"""Tosses that are there twice are found with the angle between them, and no others."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tossid.motion.sessions.copies import copy_words, find_copies, leak_words, leaking_copies
from tossid.motion.sessions.levelling import turned_track
from tossid.objects import ObjectModel
from tossid.rotations import quat_exp, quat_mul
from tossid.store import drawn_splits
from tossid.store.importers import read_contactnets
from tossid.types import PoseTrack, Toss


def copied(track: PoseTrack, name: str, yaw: float, *, lift: float = 0.0) -> PoseTrack:
    return replace(turned_track(track, quat_exp(np.array([0.0, 0.0, yaw])), lift), name=name)


def test_copies_are_found_with_their_angles(tosses: list[PoseTrack]) -> None:
    once, twice = copied(tosses[3], "a", 1.2), copied(tosses[9], "b", -2.0, lift=0.01)
    again = copied(once, "c", 0.5)
    renamed = replace(twice, name="d", q=twice.q.copy())
    quarter = quat_exp(np.array([0.5 * np.pi, 0.0, 0.0]))  # the body's axes, named otherwise
    renamed.q[:, 3:7] = quat_mul(renamed.q[:, 3:7], np.broadcast_to(quarter, (len(renamed.q), 4)))
    found = find_copies([*tosses, once, twice, again, renamed])
    assert [(copy.name, copy.of) for copy in found] == [("a", "3"), ("b", "9"), ("c", "3"), ("d", "9")]
    assert [copy.yaw for copy in found] == pytest.approx([1.2, -2.0, 1.7, -2.0], abs=1e-9)
    assert copy_words(found) == (
        "4 tosses are copies of earlier ones, turned about the vertical: "
        "a of 3 (68.8°), b of 9 (-114.6°), c of 3 (97.4°), d of 9 (-114.6°)"
    )
    assert (copy_words(found[:1]) or "").startswith("1 toss is a copy of an earlier one")


def test_tosses_that_only_resemble_each_other_are_none(tosses: list[PoseTrack]) -> None:
    assert find_copies(tosses) == ()
    assert copy_words(()) is None
    rng = np.random.default_rng(0)
    measured = copied(tosses[3], "again", 1.2)
    measured.q[:, :3] += rng.normal(0, 2e-5, (len(measured.q), 3))
    spun = copied(tosses[3], "spun", 1.2)
    spin = quat_exp(np.linspace(0, 0.01, len(spun.q))[:, None] * [0, 0, 1.0])
    spun.q[:, 3:7] = quat_mul(spun.q[:, 3:7], spin)
    cut = replace(tosses[3], name="cut", t=tosses[3].t[:-1], q=tosses[3].q[:-1], q_cov=None)
    assert find_copies([*tosses, measured, spun, cut]) == ()


def in_split(track: PoseTrack, split: str) -> Toss:
    n, nv = len(track.t), track.q.shape[1] - 1
    zero = np.zeros((n, nv, nv))
    return Toss(track.name, track.t, track.q, np.zeros((n, nv)), zero, zero, np.zeros(n, dtype=np.uint8), split)


def test_copies_in_other_splits_are_leaks(tosses: list[PoseTrack]) -> None:
    drawn = {"3": "train", "9": "test", "1": "validation", "2": "test", "4": "train", "5": ""}
    some = [in_split(track, drawn[track.name]) for track in tosses if track.name in drawn]
    assert leak_words(some) is None
    more = [
        in_split(copied(tosses[3], "a", 1.2), "validation"),
        in_split(copied(tosses[3], "b", 0.2), "test"),
        in_split(copied(tosses[9], "c", 0.2), "test"),  # both in one split
        in_split(copied(tosses[1], "d", 0.2), "train"),  # the first leaks, not the copy
        in_split(copied(tosses[2], "e", 0.2), "validation"),
        in_split(copied(tosses[4], "f", 0.2), ""),  # out of the splits
        in_split(copied(tosses[5], "g", 0.2), "test"),
    ]
    found = leaking_copies([*some, *more])
    assert {split: set(names) for split, names in found.items()} == {"test": {"b", "2"}, "validation": {"a", "1"}}
    said = leak_words([*some, *more]) or ""
    assert "2 of 5 test tosses equal one of train or validation, and 2 of 3 validation tosses one of train" in said


def test_the_published_cube_has_copies(shared_data: Path, cube: ObjectModel) -> None:
    tracks = read_contactnets(shared_data / "contactnets_cube")
    found = find_copies(tracks)
    assert len(found) == 22
    (pair,) = [copy for copy in found if copy.name == "140"]
    assert (pair.of, np.rad2deg(pair.yaw)) == ("56", pytest.approx(-169.03, abs=0.01))
    # of the splits that ingest draws, none leaks; those drawn without regard to copies do
    names = [track.name for track in tracks]
    alone, together = (
        drawn_splits(names, seed=0, copies=copies) for copies in ({}, {copy.name: copy.of for copy in found})
    )
    assert sum(alone[copy.name] != alone[copy.of] for copy in found) == 15
    assert leak_words([in_split(track, together[track.name]) for track in tracks]) is None
    leaks = leaking_copies([in_split(track, alone[track.name]) for track in tracks])
    assert (len(leaks["test"]), len(leaks["validation"])) == (8, 7)
    assert sum(alone[name] != together[name] for name in names) == 15
