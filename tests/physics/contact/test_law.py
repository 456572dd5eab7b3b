"""The law of one corner, in its limits."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tossid.kernels import kernel
from tossid.objects import ObjectModel
from tossid.physics import make_system
from tossid.physics.contact import law
from tossid.physics.contact.holding import resist
from tossid.physics.contact.law import UNKNOWN, ContactLaw, make_contact_law
from tossid.settings.contact import ContactSettings

H = 1 / 148


@kernel(keep=False)
def times(one, h):  # type: ignore[no-untyped-def]
    """(s, shares of the speed that an added mass keeps along the normal and across)."""
    along, across = law.kept_speed(one, h)
    return law.recovery_time(one, h), along, across


@kernel(keep=False)
def heights(one, z, sunk, h):  # type: ignore[no-untyped-def]
    return law.above_ground(one, z, 0, sunk, h)


def law_with(cube: ObjectModel, *, added_mass: float = 0.0, **changes: float) -> ContactLaw:
    found = make_contact_law(make_system(cube.with_changes(**changes)), ContactSettings(), H)
    return found._replace(beyond=found.beyond._replace(added_mass=added_mass))


def test_a_rigid_corner_is_back_within_the_step_and_its_relaxation(cube: ObjectModel) -> None:
    assert times(law_with(cube), H) == (H, 0.0, 0.0)
    assert times(law_with(cube, relaxation=0.02), H)[0] == H + 0.02


@pytest.mark.parametrize("relaxation", [0.0, 1e-3, 0.05])
def test_a_spring_s_own_damping_is_taken_off_its_damper(cube: ObjectModel, relaxation: float) -> None:
    """s is h without a damper, and the damper's own time where that is long."""
    s, along, across = times(law_with(cube, compliance=1e-5, relaxation=relaxation), H)
    assert max(H, relaxation) <= s <= H + relaxation
    assert (along, across) == (0.0, 0.0)


def test_an_added_mass_keeps_the_speed_in_short_steps(cube: ObjectModel) -> None:
    soft = law_with(cube, compliance=1e-5, relaxation=2e-3, added_mass=3.0)
    kept = [times(soft, h)[1:] for h in (1e-2, 1e-4, 1e-7)]
    for along, across in kept:
        assert 0 < along < 1
        assert 0 < across < 1
    assert kept[2] == pytest.approx((1.0, 1.0), abs=1e-3)
    s, along, across = times(soft, H)
    assert s == pytest.approx(math.hypot(H, 2e-3) + 3.0 * 1e-5 / H)
    assert across == pytest.approx(3.0 / (3.0 + H * 2e-3 / 1e-5))  # m' / (m' + h d), d = relaxation / compliance


@pytest.mark.parametrize("speed", [0.02, 0.005])
def test_rigid_ground_gives_way_where_a_toss_begins_in_it_and_rises(cube: ObjectModel, speed: float) -> None:
    one = make_contact_law(make_system(cube), ContactSettings(recovery_speed=speed), H)
    sunk = np.array([UNKNOWN])
    assert heights(one, -1e-3, sunk, H) == 0.0
    found = [heights(one, -1e-3, sunk, H) for _ in range(20)]
    np.testing.assert_allclose(found, np.maximum(-1e-3, -speed * H * np.arange(1, 21)), atol=1e-15)
    for z, rigid in ((0.01, True), (-1e-3, False)):
        sunk = np.array([UNKNOWN])
        assert heights(one._replace(rigid=rigid), z, sunk, H) == z
        assert heights(one._replace(rigid=rigid), z, sunk, H) == z


@kernel(keep=False)
def resisted(impulse, L, row, y, xi):  # type: ignore[no-untyped-def]
    resist(impulse, L, row, y, xi)


def test_a_spin_is_slowed_or_stopped_and_loses_energy() -> None:
    """Resistance to spin is an angular impulse that stops a spin and never turns it."""
    rng, stopped = np.random.default_rng(1), 0
    for _ in range(100):
        root = rng.normal(size=(4, 4))
        S, row, before, impulse = root @ root.T + np.eye(4), rng.normal(size=4), rng.normal(size=4), rng.uniform(0, 2)
        after, L = before.copy(), np.linalg.cholesky(S)
        np.fill_diagonal(L, 1 / np.diag(L))
        resisted(impulse, L, row, np.zeros(4), after)
        taken = S @ (before - after)
        share = taken @ row / (row @ row)
        np.testing.assert_allclose(taken, share * row, atol=1e-10)  # about the row's axis alone
        assert abs(share) <= impulse + 1e-12
        assert (row @ after) * (row @ before) >= -1e-12
        assert after @ S @ after <= before @ S @ before + 1e-12
        if abs(row @ after) < 1e-12:
            stopped += 1
        else:
            assert abs(share) > impulse - 1e-12
    assert 20 < stopped < 100
