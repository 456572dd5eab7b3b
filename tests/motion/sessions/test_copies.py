"""Tosses that are there twice are found with the angle between them, and no others."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tossid.motion.sessions.copies import copy_words, find_copies
from tossid.motion.sessions.levelling import turned_track
from tossid.objects import ObjectModel
from tossid.rotations import quat_exp, quat_mul
from tossid.store.importers import read_contactnets
from tossid.types import PoseTrack


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


def test_the_published_cube_has_copies(shared_data: Path, cube: ObjectModel) -> None:
    found = find_copies(read_contactnets(shared_data / "contactnets_cube"))
    assert len(found) == 22
    (pair,) = [copy for copy in found if copy.name == "140"]
    assert (pair.of, np.rad2deg(pair.yaw)) == ("56", pytest.approx(-169.03, abs=0.01))
