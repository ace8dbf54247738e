"""SE(2): the laws of a group, checked on arrays; and how errors travel through it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from core.geometry import (
    adjoint,
    between,
    compose,
    compose_covariance,
    exp,
    inverse,
    log,
    to_body,
    to_map,
    wrap_angle,
)

lengths = st.floats(-100, 100)
angles = st.floats(-20, 20)
poses = st.tuples(lengths, lengths, angles).map(np.array)
stacks = arrays(np.float64, (4, 3), elements=st.floats(-50, 50))
short_turn = st.tuples(lengths, lengths, st.floats(-3.1, 3.1)).map(np.array)


def same(a: np.ndarray, b: np.ndarray, atol: float = 1e-8) -> None:
    np.testing.assert_allclose(a[..., :2], b[..., :2], atol=atol)
    np.testing.assert_allclose(wrap_angle(a[..., 2] - b[..., 2]), 0.0, atol=1e-9)


@given(st.floats(-1e4, 1e4))
def test_a_wrapped_angle_is_the_same_direction_in_the_half_open_turn(angle: float) -> None:
    wrapped = float(wrap_angle(angle))
    assert -np.pi < wrapped <= np.pi
    assert np.cos(wrapped) == pytest.approx(np.cos(angle), abs=1e-9)
    assert np.sin(wrapped) == pytest.approx(np.sin(angle), abs=1e-9)


def test_half_turns_wrap_to_plus_pi() -> None:
    np.testing.assert_array_equal(wrap_angle([np.pi, -np.pi, 0.0]), [np.pi, np.pi, 0.0])


@given(stacks, stacks, stacks)
def test_composition_is_associative_on_stacks(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> None:
    same(compose(compose(a, b), c), compose(a, compose(b, c)))


@given(stacks)
def test_the_inverse_undoes_on_both_sides(a: np.ndarray) -> None:
    same(compose(a, inverse(a)), np.zeros_like(a))
    same(compose(inverse(a), a), np.zeros_like(a))


@given(poses, poses)
def test_between_is_what_leads_from_one_to_the_other(a: np.ndarray, b: np.ndarray) -> None:
    same(compose(a, between(a, b)), b)


@given(short_turn)
def test_log_undoes_exp(twist: np.ndarray) -> None:
    np.testing.assert_allclose(log(exp(twist)), twist, atol=1e-7)


@given(poses)
def test_exp_undoes_log_up_to_whole_turns(pose: np.ndarray) -> None:
    same(exp(log(pose)), pose, atol=1e-7)


@given(st.tuples(lengths, lengths, st.floats(-1e-3, 1e-3)).map(np.array))
def test_exp_is_smooth_through_zero_turn(twist: np.ndarray) -> None:
    """Against a thousand short straight steps."""
    step = compose(np.zeros(3), twist / 1000)
    pose = np.zeros(3)
    for _ in range(1000):
        pose = compose(pose, step)
    np.testing.assert_allclose(exp(twist), pose, atol=1e-4 * (1 + np.abs(twist[:2]).max()))


@given(poses, st.tuples(lengths, lengths, st.floats(-3, 3)).map(np.array))
def test_the_adjoint_moves_a_twist_through_a_pose(pose: np.ndarray, twist: np.ndarray) -> None:
    same(compose(pose, exp(twist)), compose(exp(adjoint(pose) @ twist), pose), atol=1e-5)


@given(angles)
def test_a_covariance_turned_there_and_back_is_itself(theta: float) -> None:
    P = np.array([[2.0, 0.3, 0.1], [0.3, 1.0, -0.2], [0.1, -0.2, 0.5]])
    np.testing.assert_allclose(to_body(to_map(P, theta), theta), P, atol=1e-12)


def test_an_error_along_the_body_lies_along_the_heading() -> None:
    P = to_map(np.diag([1.0, 0.0, 0.0]), np.array(np.pi / 2))
    np.testing.assert_allclose(P, np.diag([0.0, 1.0, 0.0]), atol=1e-12)


def test_covariance_of_a_composition_agrees_with_sampling() -> None:
    rng = np.random.default_rng(4)
    a, b = np.array([1.0, -2.0, 0.8]), np.array([3.0, 0.5, -0.3])
    cov_a, cov_b = np.diag([0.01, 0.02, 0.001]), np.diag([0.02, 0.01, 0.002])
    n = 200_000
    samples = compose(
        a + rng.multivariate_normal(np.zeros(3), cov_a, n), b + rng.multivariate_normal(np.zeros(3), cov_b, n)
    )
    np.testing.assert_allclose(compose_covariance(a, cov_a, b, cov_b), np.cov(samples.T), atol=5e-4)
