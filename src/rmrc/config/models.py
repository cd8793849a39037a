"""`Config`: everything that a run is made of, as the YAML file says it."""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    BeforeValidator,
    ConfigDict,
    Field,
    PrivateAttr,
    model_validator,
)

from rmrc.config.names import disagreements
from rmrc.config.scene import SceneValue
from rmrc.limits.models import LimitsModel, Off, PerJoint
from rmrc.paths import PathConfig
from rmrc.tasks import Task
from rmrc.text.annotations import NameOf
from rmrc.text.base import (
    JointName,
    KeyframeName,
    MocapName,
    Model,
    Name,
    NonNegative,
    Number,
    Positive,
    Share,
    Vector,
    Vector3,
    Weight,
)
from rmrc.text.document import NOWHERE, Document, Location, Place
from rmrc.text.mistakes import Disagreement

Method = Literal[
    "qp",
    "inverse",
    "transpose",
    "pinv",
    "weighted",
    "dls",
    "sdls",
    "nullspace",
    "saturated",
    "descent",
    "mink",
]


class SolverModel(Model):
    """Which QP backend solves, and how."""

    backend: str = "auto"
    """`auto`: the native engine's own solver, or daqp in the Python engine. Or daqp, proxqp, osqp,
    or any other solver that qpsolvers offers: it then solves, whichever engine evaluates."""
    max_iter: Annotated[int, Field(strict=True, ge=1, le=2**31 - 1)] | None = None
    """Most iterations a step may use; by default the backend's own."""
    deadline: Positive | None = None
    """Time budget of a step in µs; by default none."""
    tolerance: Positive | None = None
    """Tolerance handed to the backend; by default one well inside the certificate's."""


def _switched(value: object) -> object:
    return {"on": True, "off": False}.get(value, value) if isinstance(value, str) else value


Switch = Annotated[
    bool,
    Field(strict=True),
    BeforeValidator(_switched, json_schema_input_type=bool | Literal["on", "off"]),
]
"""true or on, false or off."""


class DampingModel(Model):
    """The damping term ½ λ² ‖v‖²."""

    model_config = ConfigDict(populate_by_name=True)

    lambda_: Annotated[NonNegative, Field(alias="lambda")] = 0.01
    """λ, in the units of √B·m/rad; with `adapt` the least that it can be."""
    curvature: Switch = True
    """Whether the curvature of the tasks is in the program, so that the robot rests where it cannot
    go, and brakes in time for where it can."""
    adapt: Literal["off", "sigma_min", "manipulability", "error"] = "off"
    """What raises λ: a small singular value σ of the tasks' weighted Jacobian (Chiaverini), a small
    manipulability w (Nakamura and Hanafusa), or a large error (Sugihara)."""
    threshold: Positive = 0.05
    """σ or w below which λ rises, in the units of λ and of their product."""
    largest: Positive = 0.1
    """The most that is added to λ: at σ = 0, at w = 0, or for a large error."""


class ToleranceModel(Model):
    """What `converged` means: within it for the last 0.1 s of the run, and the last 10 steps."""

    position: Positive = 1e-3
    """m."""
    orientation: Positive = 1e-2
    """rad."""


class TimeoutModel(Model):
    """Ages, s, beyond which what comes in is stale, and the robot brakes."""

    target: Positive | None = None
    """Of a target that has been set; by default never."""
    measurement: Positive | None = None
    """Of the measured configuration; by default never."""


class PushModel(Model):
    """A wrench on a body for a while, in the world's axes, at the body's centre of mass."""

    body: Annotated[str, NameOf("body")]
    """Name of the body."""
    force: Vector3 = (0.0, 0.0, 0.0)
    """N."""
    torque: Vector3 = (0.0, 0.0, 0.0)
    """N·m."""
    start: NonNegative = 0.0
    """When it begins, s."""
    duration: Positive
    """How long it lasts, s."""


class ActuationModel(Model):
    """The joint controllers and what comes back from the joints, for `execute: actuated`."""

    joint_control: Literal["torque", "position"] = "torque"
    """`position`: the model's own position actuators; `torque`: computed torques."""
    bandwidth: Positive = 50.0
    """Bandwidth ω of the torque control, rad/s."""
    damping_ratio: Positive = 1.0
    """Damping ratio ζ of the torque control."""
    feedback: Literal["measured", "commanded"] = "measured"
    """The configuration that a step starts from."""
    noise: NonNegative = 0.0
    """Standard deviation of a measured coordinate, rad or m."""
    latency: Annotated[int, Field(strict=True, ge=0, le=10_000)] = 0
    """Age of the measurement that a step gets, in steps; so many are kept."""
    seed: Annotated[int, Field(strict=True, ge=0)] = 0
    """Seed of the noise."""
    push: PushModel | None = None
    """An external wrench on a body; by default none."""


class Config(Model):
    """One run: a scene, a start, tasks with their targets, limits, a solver."""

    scene: SceneValue
    """A MJCF, URDF or xacro file, menagerie:NAME[/ENTRY], robot_descriptions:NAME, or a mapping
    that says more; from Python also a MjModel, a MjSpec or an XML text."""
    start: KeyframeName | Vector | dict[JointName, Number] | None = None
    """Start configuration; by default the keyframe `home`, else the only keyframe, else qpos0 moved
    inside the ranges. Mocap bodies start where that keyframe, or the one that is named, has them.
    """
    dt: Positive = 0.002
    """Length of a step, s."""
    duration: Positive = 5.0
    """Length of the run, s."""
    method: Method = "qp"
    """How a step is solved: `qp`, one of the closed forms that it generalises, or `mink`, by mink's
    own `solve_ik`."""
    follow: Literal["rate", "waypoints", "joint"] = "rate"
    """How a path is followed: `rate` resolves rates, `waypoints` solves every pose on the way to
    convergence, `joint` solves both ends and interpolates the joints."""
    execute: Literal["kinematic", "actuated"] = "kinematic"
    """What carries the command out: plain integration, or joint controllers in the physics."""
    actuation: ActuationModel = ActuationModel()
    """The joint controllers and the measurement; only `execute: actuated` reads it."""
    engine: Literal["auto", "python", "native"] = "auto"
    """What evaluates and solves a step: `native`, in C++, has no place for another method or for
    programs that nothing damps; `auto` takes it where it can."""
    solver: SolverModel = SolverModel()
    """The QP backend."""
    damping: DampingModel = DampingModel()
    """The damping term."""
    metric: Weight | Literal["inertia"] = 0.0
    """Whitney's A: a number, a diagonal, a matrix, or `inertia`, the model's M(q)."""
    priority: Literal["soft", "strict"] = "soft"
    """Between levels: `soft` multiplies each level's B by `soft_ratio` once more; `strict` lets a
    level move only in the null space that the levels above leave inside the limits."""
    soft_ratio: Share = 1e-3
    """Ratio of the weights of a level and the one above it."""
    tolerance: ToleranceModel = ToleranceModel()
    """What `converged` means."""
    equalities: Literal["hold", "off"] = "hold"
    """The model's own active equality constraints that no `loop` task names, such as the `mimic` of
    a URDF: `hold` keeps them as such a task would, `off` leaves them open."""
    dofs: Annotated[tuple[JointName, ...], Field(min_length=1)] | None = None
    """The joints that may move; by default all of the robot. A tree of joints is not the robot but
    an object where no actuator drives it, no task names a joint of it or has its frame on it, and
    `dofs` does not name one either: it stays where it is, as an obstacle."""
    timeout: TimeoutModel = TimeoutModel()
    """When targets and measurements are stale."""
    previous: Literal["commanded", "measured"] = "commanded"
    """The velocity that acceleration, jerk and `smooth` count from: the last command, or what was
    measured, unless the last command is nearer to rest: what is slowed down already goes on."""
    lag: PerJoint | Off = "off"
    """Time constant in s of each joint's drive, of first order, the delay of the measurement
    included: steps are taken from where the joints would come to rest, q ⊕ lag·v."""
    tasks: Annotated[tuple[Task, ...], Field(min_length=1, max_length=1000)]
    """The tasks."""
    limits: LimitsModel = LimitsModel()
    """The limits."""
    targets: dict[Name, PathConfig] = Field(default={})
    """Paths of the tasks' targets, by task; a task without one holds its target of the start."""
    obstacles: dict[MocapName, PathConfig] = Field(default={})
    """Paths of mocap bodies, by body; one without a path stands still."""

    _root: Path = PrivateAttr(default_factory=Path.cwd)
    _document: Document = PrivateAttr(default=NOWHERE)

    @property
    def root(self) -> Path:
        """The folder that relative paths refer to."""
        return self._root

    @property
    def steps(self) -> int:
        """Number of steps of a run, those at its start and at its end included."""
        return round(self.duration / self.dt) + 1

    @property
    def name(self) -> str:
        """The file's name without its ending; `run` if the configuration was built in Python."""
        place = self._document.place(())
        return Path(place.file).stem if place is not None else "run"

    @property
    def document(self) -> Document:
        """Where the values were written; nowhere if the configuration was built in Python."""
        return self._document

    def place(self, location: Location, key: bool = False) -> Place | None:
        """Return the place of a value, or of its key, if it was read from a file."""
        return self._document.place(location, key)

    def rooted(self, root: Path, document: Document = NOWHERE) -> "Config":
        """Return the same configuration, as `document` says it in the folder `root`."""
        copy = self.model_copy()
        copy._root, copy._document = root, document
        return copy

    def resolved(self) -> dict[str, Any]:
        """Return every value, defaults included, as plain YAML would hold it."""
        return self.model_dump(mode="json", by_alias=True)

    @model_validator(mode="after")
    def _names_agree(self) -> "Config":
        named = ((i, task.name, task.target_kind) for i, task in enumerate(self.tasks))
        if mistakes := disagreements(named, self.targets):
            raise Disagreement(mistakes)
        return self
