"""Group laws, Jacobians by finite differences, and SciPy as an independent witness."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from tossid import rotations as rot

SMALL = st.floats(-10, 10, allow_subnormal=False)
vectors = arrays(float, 3, elements=SMALL)


@st.composite
def quaternions(draw: st.DrawFn) -> np.ndarray:
    raw = draw(arrays(float, 4, elements=SMALL).filter(lambda q: np.linalg.norm(q) > 1e-2))
    return raw / np.linalg.norm(raw)


def same_rotation(a: np.ndarray, b: np.ndarray, tolerance: float = 1e-12) -> bool:
    return bool(min(np.abs(a - b).max(), np.abs(a + b).max()) < tolerance)


@given(quaternions(), quaternions(), vectors)
def test_quaternions_rotate_as_their_factors_in_turn_their_matrices_and_scipy(
    a: np.ndarray, b: np.ndarray, x: np.ndarray
) -> None:
    near, R = 1e-12 * (1 + np.abs(x).max()), rot.quat_to_matrix(a)
    np.testing.assert_allclose(rot.quat_rotate(rot.quat_mul(a, b), x), R @ rot.quat_rotate(b, x), atol=2 * near)
    np.testing.assert_allclose(R @ x, rot.quat_rotate(a, x), atol=near)
    np.testing.assert_allclose(R, Rotation.from_quat(rot.wxyz_to_xyzw(a)).as_matrix(), atol=1e-13)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-13)
    back = rot.matrix_to_quat(R)
    assert back[0] >= 0
    assert same_rotation(back, a)


@pytest.mark.parametrize("axis", [[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [-1, 2, 3]])
def test_half_turns_survive_the_matrix(axis: list[float]) -> None:
    rotvec = np.pi * np.array(axis) / np.linalg.norm(axis)
    R = rot.rotvec_to_matrix(rotvec)
    np.testing.assert_allclose(rot.rotvec_to_matrix(rot.matrix_to_rotvec(R)), R, atol=1e-12)


@given(vectors.filter(lambda x: np.linalg.norm(x) < np.pi - 1e-6))
def test_log_undoes_exp(rotvec: np.ndarray) -> None:
    np.testing.assert_allclose(rot.quat_log(rot.quat_exp(rotvec)), rotvec, atol=1e-9)


@given(quaternions())
def test_log_takes_the_shorter_way(quat: np.ndarray) -> None:
    rotvec = rot.quat_log(quat)
    assert np.linalg.norm(rotvec) <= np.pi + 1e-12
    np.testing.assert_allclose(rotvec, rot.quat_log(-quat), atol=1e-9 if abs(quat[0]) > 1e-9 else 10)
    assert same_rotation(rot.quat_exp(rotvec), quat, 1e-9)


@given(quaternions(), vectors.filter(lambda x: np.linalg.norm(x) < 3))
def test_boxminus_is_the_body_frame_difference(quat: np.ndarray, theta: np.ndarray) -> None:
    moved = rot.quat_mul(quat, rot.quat_exp(theta))
    np.testing.assert_allclose(rot.quat_boxminus(moved, quat), theta, atol=1e-9)
    assert rot.geodesic_angle(moved, quat) == pytest.approx(np.linalg.norm(theta), abs=1e-9)


@given(vectors.filter(lambda x: np.linalg.norm(x) < 3))
def test_right_jacobian_matches_finite_differences(theta: np.ndarray) -> None:
    step = 1e-6
    numeric = np.stack(
        [
            (
                rot.quat_boxminus(rot.quat_exp(theta + step * e), rot.quat_exp(theta))
                - rot.quat_boxminus(rot.quat_exp(theta - step * e), rot.quat_exp(theta))
            )
            / (2 * step)
            for e in np.eye(3)
        ],
        axis=1,
    )
    np.testing.assert_allclose(rot.right_jacobian(theta), numeric, atol=1e-7)
    np.testing.assert_allclose(rot.right_jacobian(theta) @ rot.right_jacobian_inv(theta), np.eye(3), atol=1e-10)


@given(vectors, quaternions(), vectors, quaternions(), vectors)
def test_transforms_compose_and_invert(
    p_a: np.ndarray, q_a: np.ndarray, p_b: np.ndarray, q_b: np.ndarray, x: np.ndarray
) -> None:
    T_a, T_b = rot.transform(p_a, q_a), rot.transform(p_b, q_b)
    points = x[None]
    once = rot.transform_points(T_a @ T_b, points)
    np.testing.assert_allclose(once, rot.transform_points(T_a, rot.transform_points(T_b, points)), atol=1e-10)
    np.testing.assert_allclose(rot.transform_inv(T_a) @ T_a, np.eye(4), atol=1e-10)


def test_quat_continuous_flips_only_signs() -> None:
    t = np.linspace(0, 4 * np.pi, 200)
    smooth = rot.quat_exp(np.stack([t, 0 * t, 0 * t], axis=-1))
    signs = np.random.default_rng(0).choice([-1.0, 1.0], size=200)
    signs[0] = 1.0
    np.testing.assert_allclose(rot.quat_continuous(signs[:, None] * smooth), smooth, atol=1e-15)


def test_functions_take_batches() -> None:
    rng = np.random.default_rng(1)
    quat = rot.quat_normalize(rng.normal(size=(2, 3, 4)))
    x = rng.normal(size=(2, 3, 3))
    rotated = rot.quat_rotate(quat, x)
    for i in np.ndindex(2, 3):
        np.testing.assert_allclose(rotated[i], rot.quat_to_matrix(quat[i]) @ x[i], atol=1e-13)
        np.testing.assert_allclose(rot.right_jacobian(x)[i], rot.right_jacobian(x[i]))
