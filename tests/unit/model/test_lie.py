"""mink's compiled operations on SE(3) are those of its classes, for which they stand in."""

import numpy as np
import pytest

from models import random_quaternion
from rmrc.model import lie

# Both sides are the same formulas in double precision; jlog amplifies rounding near half a turn.
ROUNDING = 1e-9

PAIRS = {
    "rminus": (lie.rminus, lie._rminus, 2),
    "jlog": (lie.jlog, lie._jlog, 1),
    "inverse": (lie.inverse, lie._inverse, 1),
    "inverse_multiply": (lie.inverse_multiply, lie._inverse_multiply, 2),
    "adjoint": (lie.adjoint, lie._adjoint, 1),
}


def random_pose(rng: np.random.Generator) -> np.ndarray:
    return np.concatenate([random_quaternion(rng), rng.normal(size=3)])


@pytest.mark.parametrize("name", PAIRS)
def test_compiled_operations_are_those_of_the_classes(name: str) -> None:
    rng = np.random.default_rng(0)
    compiled, plain, arguments = PAIRS[name]
    for _ in range(200):
        poses = [random_pose(rng) for _ in range(arguments)]
        assert compiled(*poses) == pytest.approx(plain(*poses), abs=ROUNDING)


def test_a_pose_of_a_matrix_and_a_position_is_that_of_the_classes() -> None:
    rng = np.random.default_rng(1)
    for _ in range(200):
        pose = random_pose(rng)
        matrix = np.zeros(9)
        lie.mujoco.mju_quat2Mat(matrix, pose[:4])
        compiled, plain = lie.pose_of(matrix, pose[4:]), lie._pose_of(matrix, pose[4:])
        assert compiled == pytest.approx(plain, abs=ROUNDING)


def test_turn_back_undoes_the_rotation_of_a_pose() -> None:
    rng = np.random.default_rng(2)
    pose, twist = random_pose(rng), rng.normal(size=6)
    rotation = lie.SO3(pose[:4]).as_matrix()
    turned = np.concatenate([rotation @ twist[:3], rotation @ twist[3:]])
    assert lie.turn_back(pose, turned) == pytest.approx(twist, abs=ROUNDING)


ANGLES = (0.0, 1e-12, 1e-9, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 0.1, 0.499, 0.501, 1.0, 3.0, np.pi)
EXACT = 1e-12
"""What double precision leaves of series and closed forms of numbers of the order of 1."""


def power_series(twist: np.ndarray) -> np.ndarray:
    """Return Jl⁻¹ (6, 6) as the inverse of Jl = Σ adⁿ/(n + 1)!."""
    linear, angular = (lie._cross_matrix(half) for half in (twist[:3], twist[3:]))
    adjoint = np.block([[angular, linear], [np.zeros((3, 3)), angular]])
    left, term = np.zeros((6, 6)), np.eye(6)
    for n in range(1, 60):
        left += term / n
        term = term @ adjoint / n
    return np.linalg.inv(left)


def quaternion_of(rotation: np.ndarray) -> np.ndarray:
    half = 0.5 * float(np.linalg.norm(rotation))
    return np.concatenate([[np.cos(half)], 0.5 * np.sinc(half / np.pi) * rotation])


@pytest.mark.parametrize("angle", ANGLES)
def test_the_inverse_left_jacobian_is_exact_at_every_angle(angle: float) -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        axis = rng.normal(size=3)
        twist = np.concatenate([rng.normal(size=3), angle * axis / np.linalg.norm(axis)])
        assert lie.inverse_left_jacobian(twist) == pytest.approx(power_series(twist), abs=EXACT)


@pytest.mark.parametrize("angle", ANGLES)
def test_the_logarithm_of_a_motion_is_exact_at_every_angle(angle: float) -> None:
    """T = exp(ρ, ω) has the translation V(ω) ρ with V = Jl of SO(3)."""
    rng = np.random.default_rng(4)
    for _ in range(20):
        axis = rng.normal(size=3)
        twist = np.concatenate([rng.normal(size=3), angle * axis / np.linalg.norm(axis)])
        whole = np.linalg.inv(power_series(twist)[:3, :3])
        pose = np.concatenate([quaternion_of(twist[3:]), whole @ twist[:3]])
        found = lie.log_motion(pose)
        if angle == np.pi and found[3:] @ twist[3:] < 0.0:  # half a turn has two axes
            found[3:] *= -1.0
            continue
        assert found == pytest.approx(twist, abs=EXACT)
