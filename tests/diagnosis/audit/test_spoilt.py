"""A spoilt simulator is restored by the truth that belongs to it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.diagnosis.tossed import seen
from tossid.diagnosis.audit.cases import Case
from tossid.diagnosis.audit.spoilt import Reference, real_tosses, spoil
from tossid.diagnosis.audit.strengths import SPOILT, world_with
from tossid.objects import ObjectModel, load_object
from tossid.physics.effects import World
from tossid.settings.diagnosis.audit import AuditSettings
from tossid.store import Dataset, write_dataset


@pytest.mark.parametrize("name", sorted(SPOILT))
def test_the_truth_restores_the_simulator(name: str) -> None:
    stated = World(load_object("cube"))
    alone = {
        "gravity": {"g_ms2": 9.7},
        "com_offset": {"x_m": 0.001, "y_m": 0.0, "z_m": 0.0},
        "inertia": {"scale_rel": 1.1},
        "friction": {"mu": 0.2},
        "geometry": {"size_rel": 1.02},
    }
    reference = Reference({"restitution": {"e": 0.2}}, alone)
    unspoilt = world_with(world_with(stated, reference.effects), {name: alone[name]})
    spoilt, truth = spoil(Case(0, "spoilt", "real", (name,), (), 7), stated, reference)
    restored = world_with(spoilt, truth["effects"])
    assert spoilt.object.restitution == 0.2
    for before, after in ((unspoilt.object, restored.object),):
        np.testing.assert_allclose(after.com, before.com, atol=1e-12)
        np.testing.assert_allclose(after.inertia, before.inertia, rtol=1e-9)
        np.testing.assert_allclose(after.corner_pos, before.corner_pos, rtol=1e-9)
        assert after.friction == pytest.approx(before.friction)
    assert restored.gravity == pytest.approx(unspoilt.gravity)
    assert (spoilt.gravity, spoilt.object.friction) != (unspoilt.gravity, unspoilt.object.friction) or (
        not np.allclose(spoilt.object.corner_pos, unspoilt.object.corner_pos)
        or not np.allclose(spoilt.object.com, unspoilt.object.com)
        or not np.allclose(spoilt.object.inertia, unspoilt.object.inertia)
    )


def test_real_tosses_are_drawn_the_same_again(cube: ObjectModel, tmp_path: Path) -> None:
    tosses = tuple(seen(World(cube), cube, 8, seed=0))
    path = tmp_path / "real.h5"
    write_dataset(Dataset(cube, tosses, 148.0, "test", {}), path)
    names = [[t.name for t in real_tosses(path, AuditSettings(tosses=6, seed=seed))[0]] for seed in (0, 0, 1)]
    assert names[0] == names[1] != names[2]
    assert len(names[0]) == 6
    assert names[0] == sorted(names[0])
