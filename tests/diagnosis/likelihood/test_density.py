"""Student's density of whitened residuals: scales of groups, and log densities."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.stats import t

from tossid.diagnosis.likelihood.density import log_density, student_deviance, student_scales
from tossid.settings.diagnosis.likelihood import DensitySettings

NU = DensitySettings().degrees_of_freedom


def test_deviance_is_quadratic_for_small_residuals() -> None:
    assert student_deviance(np.array([1e-3]))[0] == pytest.approx(5 / 4 * 1e-6, rel=1e-5)


def test_a_scale_maximises_the_likelihood_of_its_group() -> None:
    rng = np.random.default_rng(0)
    group = rng.integers(-1, 3, size=(40, 8))
    residuals = np.array([3.0, 7.0, 20.0, 1e6])[group][..., None] * rng.standard_t(NU, size=(40, 8, 6))
    found = student_scales(residuals, group, 5, DensitySettings())
    for g in range(3):
        own = residuals[group == g].ravel()
        best = minimize_scalar(lambda s, own=own: -t.logpdf(own / s, NU).sum() + own.size * np.log(s), bounds=(0.1, 99))
        assert found[g] == pytest.approx(best.x, rel=1e-4)
    np.testing.assert_array_equal(found[3:], 1.0)


def test_a_scale_is_at_least_one() -> None:
    nothing = np.zeros((2, 3, 6))
    np.testing.assert_array_equal(student_scales(nothing, np.zeros((2, 3), int), 1, DensitySettings()), 1.0)


def test_log_densities_are_students_but_for_a_constant_an_entry() -> None:
    rng = np.random.default_rng(1)
    residuals, scale = (
        rng.normal(size=(5, 4, 6)) * 10.0 ** rng.integers(-3, 4, size=(5, 4, 6)),
        rng.uniform(1, 9, (5, 4)),
    )
    inside = rng.random((5, 4)) < 0.7
    out = log_density(residuals, inside, scale)
    constant = t.logpdf(0.0, NU)
    plain = t.logpdf(residuals / scale[..., None], NU) - constant - np.log(scale)[..., None]
    np.testing.assert_allclose(out, np.where(inside[..., None], plain, 0.0).sum((1, 2)), rtol=1e-12)
