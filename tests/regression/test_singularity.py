"""At, next to and across singularities: finite, bounded, without chatter, without a halt."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

import rmrc
from models import REPOSITORY, config
from rmrc import Status

Array = NDArray[np.float64]

# Rounding of the program's solution, relative.
ROUNDING = 1e-6
DT = 1e-3  # s
GAIN = 10.0  # 1/s
FLOOR, LARGEST = 0.01, 0.1
# A joint below this rate, rad/s, 1 % of the path's, is at rest.
REST = 5e-3
WINDOW = 50  # steps, 50 ms
# A joint may turn round on the way in, and once more on the way out.
TURNS = 2
# Largest change of a joint rate in a step of 1 ms on a path of 0.5 rad/s through a singularity,
# rad/s: the most is 0.23, on links of 1 m with the damping at its floor; undamped it is 9 to 480.
JUMP = 0.3
# The same of an arm with a posture, next to where the direction that the hand loses turns by 180°
# in a step: the most is 0.006. Damping along that direction alone gives 0.25.
TURNING = 0.02
# m; the error of a reached target, decayed for about 3 s at 10 1/s.
REACHED = 1e-4
OFF = {"position": "off", "velocity": "off"}
POSTURE = {"name": "posture", "type": "posture", "B": 0.01, "gain": 1.0}
WAYS = ("off", "sigma_min", "manipulability", "error")
ARM = tuple(
    f"left_{joint}"
    for joint in (
        *("shoulder_pitch", "shoulder_roll", "shoulder_yaw"),
        *("elbow", "wrist_yaw", "wrist_pitch"),
    )
)


@dataclass(frozen=True)
class Singularity:
    """A robot, the rows it is asked for, and a configuration where they lose one."""

    scene: str
    q: tuple[float, ...]
    """Of the joints that may move."""
    site: str = "hand"
    rows: tuple[int, ...] = (0, 1, 2, 3, 4, 5)
    others: dict[str, Any] = field(default_factory=dict)

    def controller(self, adapt: str, *tasks: dict[str, Any], **others: Any) -> rmrc.Controller:
        weight = [float(row in self.rows) for row in range(6)]
        hand = {"name": "hand", "type": "frame", "frame": {"site": self.site}, "B": weight}
        options = {
            "dt": DT,
            "limits": OFF,
            "damping": {"lambda": FLOOR, "adapt": adapt, "largest": LARGEST},
            **self.others,
            **others,
        }
        scene = str(REPOSITORY / "scenes" / f"{self.scene}.xml")
        hand |= {"axes": "world", "gain": GAIN}
        return rmrc.Controller(rmrc.compile(config(scene, [hand, *tasks], **options)))

    def at(self, made: rmrc.Controller, step: Array | float = 0.0) -> Array:
        """Return the configuration (nq,) a step over the dofs away from the singular one."""
        problem = made.problem
        q, tangent = problem.start.copy(), np.zeros(problem.model.nv)
        q[problem.model.jnt_qposadr[problem.model.dof_jntid[problem.dofs]]] = self.q
        tangent[problem.dofs] = step
        mujoco.mj_integratePos(problem.model, q, tangent, 1.0)
        return q


SINGULARITIES = {
    "planar_2r stretched": Singularity("planar_2r", (0.3, 0.0), rows=(0, 1)),
    "planar_3r stretched": Singularity("planar_3r", (0.3, 0.0, 0.0), rows=(0, 1)),
    "planar_3r stretched pose": Singularity("planar_3r", (0.3, 0.0, 0.4), rows=(0, 1, 5)),
    "ur5e wrist": Singularity("ur5e", (0.2, -1.2, 1.3, -0.6, 0.0, 0.3), "tool"),
    "ur5e elbow": Singularity("ur5e", (0.2, -1.2, 0.0, -0.6, 0.8, 0.3), "tool"),
    "panda upright": Singularity("panda", (0.0,) * 7),
    "biped elbow": Singularity(
        "biped", (0.3, 0.1, 0.2, 0.0, 0.3, 0.4), "left_hand", others={"dofs": ARM}
    ),
}
each_singularity = pytest.mark.parametrize("name", SINGULARITIES)
each_way = pytest.mark.parametrize("adapt", WAYS)


def aim(made: rmrc.Controller, q: Array, offset: Array) -> None:
    """Put the hand's target at an offset from its place at q, with the same orientation."""
    pose = made.problem.forward(q)["hand"]
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, pose[:3, :3].ravel())
    assert made.set_target("hand", pose[:3, 3] + offset, quaternion)


def directed(size: int, seed: int = 0) -> Array:
    """Return a random unit vector, none of whose entries is small."""
    rng = np.random.default_rng(seed)
    vector = rng.uniform(0.5, 1.0, size) * rng.choice([-1.0, 1.0], size)
    return vector / np.linalg.norm(vector)


@each_singularity
@each_way
def test_the_rate_is_bounded_at_any_distance(name: str, adapt: str) -> None:
    singularity = SINGULARITIES[name]
    made = singularity.controller(adapt)
    away = directed(made.problem.dofs.size)
    offset = np.array([0.3, -0.2, 0.1]) * [row in singularity.rows for row in range(3)]
    sigmas = []
    for distance in (0.0, 1e-12, 1e-9, 1e-6, 1e-4, 1e-2):
        q = singularity.at(made, distance * away)
        aim(made, q, offset)
        step = made.step(q)
        assembly = made.engine.assembly
        assert np.isfinite(step.v).all()
        bound = GAIN * np.linalg.norm(offset) / (2.0 * assembly.damping)
        assert np.linalg.norm(step.v) <= bound * (1.0 + ROUNDING)
        assert (Status.DAMPED in step.flags) == (adapt != "off")
        sigmas.append(assembly.sigma_min())
    assert sigmas[0] < 1e-12
    assert sigmas[-1] > 1e-6


@each_singularity
def test_where_it_is_singular_the_damping_is_the_largest(name: str) -> None:
    singularity = SINGULARITIES[name]
    for adapt in ("sigma_min", "manipulability"):
        made = singularity.controller(adapt)
        made.step(singularity.at(made))
        assert made.engine.assembly.damping == pytest.approx(np.hypot(FLOOR, LARGEST))


def crossing(singularity: Singularity, made: rmrc.Controller, seed: int) -> Array:
    """Return the configurations of a line through the singularity at 0.5 rad/s."""
    direction = 0.5 * directed(made.problem.dofs.size, seed)
    times = np.arange(-100, 101) * DT
    return np.array([singularity.at(made, t * direction) for t in times])


def assert_calm(v: Array) -> None:
    """Assert that rates (steps, n) neither jump nor chatter."""
    assert np.isfinite(v).all()
    assert np.abs(np.diff(v, axis=0)).max() < JUMP
    for rate in v.T:
        moving = np.flatnonzero(np.abs(rate) > REST)
        turned = np.zeros(rate.size)
        turned[moving[1:]] = np.diff(np.sign(rate[moving])) != 0.0
        assert np.convolve(turned, np.ones(WINDOW)).max() <= TURNS


@each_singularity
@each_way
@pytest.mark.parametrize("tasks", [[], [POSTURE]], ids=["hand", "posture"])
def test_the_hand_follows_a_path_across_without_chatter(
    name: str, adapt: str, tasks: list[dict[str, Any]]
) -> None:
    singularity = SINGULARITIES[name]
    made = singularity.controller(adapt, *tasks)
    path = crossing(singularity, made, seed=0)
    made.reset(path[0])
    rates = []
    for q in path:
        aim(made, q, np.zeros(3))
        rates.append(made.step().v)
    assert_calm(np.array(rates))


@each_singularity
@each_way
@pytest.mark.parametrize("tasks", [[], [POSTURE]], ids=["hand", "posture"])
def test_an_arm_that_is_carried_across_is_asked_for_no_chatter(
    name: str, adapt: str, tasks: list[dict[str, Any]]
) -> None:
    # Through the singularity itself, and 1e-5 rad beside it, with the target at the end.
    singularity = SINGULARITIES[name]
    made = singularity.controller(adapt, *tasks)
    path = crossing(singularity, made, seed=1)
    beside = singularity.at(made, 1e-5 * directed(made.problem.dofs.size, seed=2))
    beside -= singularity.at(made)
    aim(made, path[-1], np.zeros(3))
    for passed in (0.0, beside):
        steps = [made.step(q + passed) for q in path]
        assert_calm(np.array([step.v for step in steps]))


@each_way
def test_the_posture_of_a_redundant_arm_does_not_turn_with_the_lost_direction(adapt: str) -> None:
    # Next to the stretched arm the direction that the hand loses turns by 180° within 1e-5 rad.
    singularity = SINGULARITIES["planar_3r stretched"]
    rest = {**POSTURE, "target": [0.3, 0.5, -0.5]}
    made = singularity.controller(adapt, rest)
    direction = 0.5 * np.array([0.1, 1.0, -0.5])
    beside = 1e-5 * np.array([0.0, 0.5, 1.0])
    aim(made, singularity.at(made), np.zeros(3))
    steps = [
        made.step(singularity.at(made, t * direction + beside)) for t in np.arange(-50, 51) * DT
    ]
    v = np.array([step.v for step in steps])
    assert np.abs(np.diff(v, axis=0)).max() < TURNING


@each_way
@pytest.mark.parametrize("away", [1e-6, -1e-9])
def test_next_to_a_singularity_it_does_not_halt(adapt: str, away: float) -> None:
    # The target is straight inward, where the stretched arm can hardly move.
    for name, bend in (("planar_2r stretched", [0, 1]), ("planar_3r stretched", [0, 1, 1])):
        singularity = SINGULARITIES[name]
        made = singularity.controller(adapt, limits={"velocity": {"default": 2.0}})
        start = singularity.at(made, away * np.array(bend, dtype=float))
        made.reset(start)
        hand = made.problem.forward(start)["hand"][:3, 3]
        made.set_target("hand", 0.7 * hand)
        steps = [made.step() for _ in range(3000)]
        assert steps[-1].error["hand"][0] < REACHED
        assert Status.DAMPED not in steps[-1].flags


@each_way
def test_exactly_at_a_singularity_an_inward_target_moves_nothing(adapt: str) -> None:
    # The hand has no rate along the arm here, and a bend to either side is as good: v = 0 is the
    # optimum, and no damping can say otherwise.
    made = SINGULARITIES["planar_2r stretched"].controller(adapt)
    made.reset(np.zeros(2))
    made.set_target("hand", [1.4, 0.0, 0.0])
    for _ in range(10):
        step = made.step()
        assert np.abs(step.v).max() == 0.0
        assert (Status.DAMPED in step.flags) == (adapt != "off")


FOUR_HINGES = """
<mujoco><compiler angle="radian"/><worldbody><body pos="0 0 0.3">
  <joint name="yaw" axis="0 0 1"/><geom size="0.05"/>
  <body><joint name="pitch1" axis="0 1 0"/><geom type="capsule" size="0.02" fromto="0 0 0 0.4 0 0"/>
  <body pos="0.4 0 0"><joint name="pitch2" axis="0 1 0"/>
    <geom type="capsule" size="0.02" fromto="0 0 0 0.3 0 0"/>
  <body pos="0.3 0 0"><joint name="pitch3" axis="0 1 0"/>
    <geom type="capsule" size="0.02" fromto="0 0 0 0.2 0 0"/><site name="hand" pos="0.2 0 0"/>
</body></body></body></body></worldbody></mujoco>
"""


@pytest.mark.parametrize("adapt", ["sigma_min", "manipulability"])
@pytest.mark.parametrize("rows", [(0, 1, 2), (0, 1, 2, 3, 4, 5)], ids=["position", "pose"])
def test_fewer_dofs_than_a_pose_are_not_singular(
    adapt: str, rows: tuple[int, ...], tmp_path: Path
) -> None:
    scene = tmp_path / "four_hinges.xml"
    scene.write_text(FOUR_HINGES)
    weight = [float(row in rows) for row in range(6)]
    hand = {"name": "hand", "type": "frame", "frame": {"site": "hand"}, "B": weight}
    damping = {"adapt": adapt, "threshold": 0.05 if adapt == "sigma_min" else 0.005}
    made = rmrc.Controller(rmrc.compile(config(str(scene), [hand], damping=damping)))
    rng = np.random.default_rng(0)
    for _ in range(50):
        # Bent at the elbow and the wrist, and not above the base: away from all singularities.
        q = np.array([rng.uniform(-3, 3), *rng.uniform([-0.3, 0.6, 0.4], [0.0, 0.9, 0.8])])
        step = made.step(q)
        assert Status.DAMPED not in step.flags
        assert made.engine.assembly.sigma_min() > 0.05
    assert Status.DAMPED in made.step(np.zeros(4)).flags


def test_the_damping_rises_and_falls_without_a_jump() -> None:
    for name, singularity in SINGULARITIES.items():
        for adapt in WAYS[1:3]:
            made = singularity.controller(adapt)
            damping = []
            for q in crossing(singularity, made, seed=0):
                made.step(q)
                damping.append(made.engine.assembly.damping)
            square = np.square(damping)
            assert np.abs(np.diff(square)).max() < 0.1 * LARGEST**2, name
