"""mink's compiled operations on SE(3) are those of its classes, for which they stand in."""

import numpy as np
import pytest

from models import random_quaternion
from rmrc.problem import lie

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
