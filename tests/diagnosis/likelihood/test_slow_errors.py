"""Slow errors correlate where attitudes are alike, and their factors whiten them with noise."""

from __future__ import annotations

import numpy as np

from tossid.diagnosis.likelihood.slow_errors import inverse_factors, slow_covariance
from tossid.rotations import quat_exp


def test_errors_at_one_attitude_are_one_error_and_those_at_opposite_ones_are_not() -> None:
    turned = quat_exp(np.array([[0.0, 0, 0], [0, 0, 0], [0, 0, 3.0]]))
    mix = np.zeros((1, 3, 2))
    mix[0, 0, 0] = mix[0, 1, 1] = 1.0  # a third row does not exist
    std = np.array([1e-3] * 3 + [2e-2] * 3)
    slow = slow_covariance(turned[:1], turned[None, 1:], mix, std, 1.0)
    assert slow.shape == (1, 6, 4, 4)
    np.testing.assert_allclose(slow[0, :, 0, 1], std**2)
    # over the squared chord between rotations 3 rad apart, 2 sin²(3 / 2)
    np.testing.assert_allclose(slow[0, :, 0, 2], std**2 * np.exp(-2 * np.sin(1.5) ** 2))
    assert not slow[0, :, 3].any()


def test_factors_whiten_slow_errors_and_noise() -> None:
    rng = np.random.default_rng(0)
    half = rng.normal(size=(5, 6, 4, 4))
    slow, noise = half @ half.mT, rng.uniform(0.5, 2.0, (5, 4, 6))
    root = inverse_factors(slow, noise)
    cov = slow + noise.transpose(0, 2, 1)[..., None] ** 2 * np.eye(4)
    np.testing.assert_allclose(root @ cov @ root.mT, np.broadcast_to(np.eye(4), cov.shape), atol=1e-12)
    np.testing.assert_allclose(np.triu(root, 1), 0.0, atol=1e-14)
