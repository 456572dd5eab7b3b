"""Inertial parameterisations: they hold what they were given, stay physical, and are refused by name."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from tossid.errors import InputError
from tossid.models.inertia import KINDS, divergence, make_inertia
from tossid.objects import ObjectModel


def shifted(cube: ObjectModel) -> ObjectModel:
    inertia = np.array([[[8e-4, 2e-5, -1e-5], [2e-5, 9e-4, 3e-5], [-1e-5, 3e-5, 1e-3]]])
    return cube.with_changes(com=np.array([[1e-3, -2e-3, 6e-3]]), inertia=inertia)


@pytest.mark.parametrize("kind", KINDS)
def test_it_starts_at_the_given_inertia(cube: ObjectModel, elbow: ObjectModel, kind: str) -> None:
    with pytest.raises(InputError, match="log_cholesky"):
        make_inertia(cube, kind="cholesky", learn=True)
    for model in (shifted(cube), elbow):
        mass, moment, at_origin = (part.detach().numpy() for part in make_inertia(model, kind=kind, learn=True)())
        np.testing.assert_allclose(mass, model.mass, rtol=1e-12)
        np.testing.assert_allclose(moment, model.mass[:, None] * model.com, atol=1e-15)
        for b in range(model.n_bodies):
            c = model.com[b]
            expected = model.inertia[b] + model.mass[b] * (c @ c * np.eye(3) - np.outer(c, c))
            np.testing.assert_allclose(at_origin[b], expected, atol=1e-12)


@pytest.mark.parametrize("kind", ["log_cholesky", "direct"])
@settings(max_examples=50, deadline=None)
@given(numbers=st.lists(st.floats(-2, 2), min_size=9, max_size=9))
def test_every_parameter_value_gives_a_physical_inertia(cube: ObjectModel, kind: str, numbers: list[float]) -> None:
    inertia = make_inertia(cube, kind=kind, learn=True)
    learned = [p for p in inertia.parameters() if p.requires_grad]
    torch.nn.utils.vector_to_parameters(
        torch.nn.utils.parameters_to_vector(learned) + torch.tensor(numbers, dtype=torch.float64), learned
    )
    mass, moment, at_origin = (part.detach().numpy()[0] for part in inertia())
    c = moment / mass
    about_com = at_origin - mass * (c @ c * np.eye(3) - np.outer(c, c))
    sigma = 0.5 * np.trace(about_com) * np.eye(3) - about_com
    assert np.linalg.eigvalsh(sigma)[0] > -1e-9 * np.trace(sigma)


@pytest.mark.parametrize("kind", KINDS)
def test_the_divergence_is_zero_at_the_given_inertia_and_unbounded_towards_zero_inertia(
    elbow: ObjectModel, kind: str
) -> None:
    given_ = tuple(part.detach() for part in make_inertia(elbow, learn=False)())
    inertia = make_inertia(elbow, kind=kind, learn=True)
    assert float(divergence(inertia(), given_).detach()) == pytest.approx(0.0, abs=1e-10)
    sizes = []
    for share in (0.5, 0.05, 0.005):
        light = elbow.with_changes(
            mass=elbow.mass * [1, share], inertia=elbow.inertia * np.array([1, share])[:, None, None]
        )
        sizes.append(float(divergence(make_inertia(light, kind=kind, learn=False)(), given_)))
        # of a body scaled by s, each of the four eigenvalues says s - log s - 1
        assert sizes[-1] == pytest.approx(4 * (share - np.log(share) - 1), rel=1e-6)
    assert sizes[0] < sizes[1] < sizes[2]
