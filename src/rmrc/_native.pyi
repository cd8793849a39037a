from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc.control.step import Step
from rmrc.native.engine import NativeEngine
from rmrc.qp.program import Array

Method = TypeVar("Method")

class QPSolver:
    """A dual active-set solver of quadratic programs, which starts warm."""

    def __init__(
        self, size: int, rows: int = 0, equalities: int = 0, max_iter: int = 1000
    ) -> None: ...
    def solve(
        self,
        H: Array,
        g: Array,
        lb: Array,
        ub: Array,
        C: Array,
        lo: Array,
        hi: Array,
        E: Array,
        f: Array,
        seconds: float = ...,
    ) -> tuple[Array, Array, Array, Array, int, str]: ...
    def forget(self) -> None: ...
    @property
    def shape(self) -> tuple[int, int, int]: ...

class TermRows:
    """What all terms of an engine have."""

    def __init__(
        self,
        first: int,
        count: int,
        gain: float,
        root: list[float],
        target: Array,
        twist: Array,
        moving: NDArray[np.uint8],
        clamps: list[tuple[int, int, float]] = ...,
        way: list[tuple[int, int, bool, float]] = ...,
        exact_root: list[float] = ...,
    ) -> None: ...

class Frame:
    """Where the pose of a frame stands, and what moves it."""

    def __init__(
        self,
        position: Array,
        rotation: Array,
        reference: Array,
        dofs: list[int],
        carrier: Array | None,
    ) -> None: ...

_Anchorage = tuple[Frame, Array, list[float], list[float]]
_Combination = tuple[list[tuple[int, int, float]], float]

class Engine:
    """The whole step, in the arrays that it is given."""

    def __init__(
        self,
        *,
        functions: Sequence[int],
        model: mujoco.MjModel,
        data: mujoco.MjData,
        qpos: Array,
        cdof: Array,
        error: Array,
        feedforward: Array,
        rate: Array,
        jacobian: Array,
        v_previous: Array,
        a_previous: Array,
        dofs: list[int],
        hessian: list[float],
        unit: float,
        share_of_inertia: float,
        floor: float,
        least_curvature: float,
        brakes: bool,
        soft_ratio: float,
        limits: tuple[
            list[int],
            list[float],
            list[float],
            float,
            list[float],
            list[float],
            list[float],
            list[float],
        ],
        H: Array,
        g: Array,
        added_damping: Array,
        inertia: Array,
        lb: Array,
        ub: Array,
        max_iter: int,
    ) -> None: ...
    def add_frame(self, rows: TermRows, frame: Frame) -> None: ...
    def add_world_frame(self, rows: TermRows, frame: Frame) -> None: ...
    def add_relative(self, rows: TermRows, frame: Frame, root: Frame) -> None: ...
    def add_axis(self, rows: TermRows, frame: Frame, axis: list[float], at_point: bool) -> None: ...
    def add_com(
        self,
        rows: TermRows,
        moved: list[tuple[int, float, Array, Array]],
        parts: list[tuple[float, Array, Array, Array | None]],
    ) -> None: ...
    def add_coupling(
        self, rows: TermRows, by_coordinate: list[float], by_dof: list[float], offset: float
    ) -> None: ...
    def add_loop(
        self,
        rows: TermRows,
        pairs: list[tuple[int, bool, float, _Anchorage, _Anchorage]],
        polynomials: list[tuple[int, _Combination, _Combination, list[float]]],
        scale: list[float],
        angular: list[bool],
    ) -> None: ...
    def add_foreign(self, rows: TermRows) -> None: ...
    def add_joint_task(self, rows: TermRows, kind: str, wrapped: list[int]) -> None: ...
    def adapt(
        self,
        rule: str,
        threshold: float,
        largest: float,
        rank: int,
        scale: float,
        rows: list[tuple[int, int]],
    ) -> None: ...
    def evaluate(self, q: Array) -> None: ...
    def assemble(self, dt: float) -> bool: ...
    def solve(
        self, q: Array | None, dt: float, seconds: float, solution: Array
    ) -> tuple[str, int, float, float, float, bool, float, bool]: ...
    @property
    def moved(self) -> tuple[list[float], list[float], list[float]] | None: ...
    @property
    def boxed(self) -> bool: ...
    def limit(self, rows: Rows, shortening: Shortening | None) -> None: ...
    def follow(self, kinematics: ForwardKinematics) -> None: ...
    def forget(self) -> None: ...

class ForwardKinematics:
    """Places what a step looks at."""

    def __init__(
        self,
        *,
        arrays: Mapping[str, Array],
        bodies: Sequence[tuple[Any, ...]],
        geoms: Sequence[tuple[Any, ...]],
        sites: Sequence[tuple[Any, ...]],
        masses: Sequence[tuple[Any, ...]],
    ) -> None: ...
    def update(self, q: Array) -> None: ...

def hold(
    engine: Engine,
    tasks: list[tuple[int, int, list[float], bool, list[float]]],
    still: list[bool],
    matrix: Array,
    right: Array,
    multiplier: Array,
) -> None: ...
def equalities(engine: Engine) -> int: ...
def descend(
    engine: Engine,
    levels: list[tuple[list[tuple[int, list[int]]], list[tuple[int, list[float]]]]],
    metric: list[float],
    inertia: float,
) -> None: ...
def scaled(engine: Engine) -> bool: ...

class Kinematics:
    """Where the arrays of an mjData stand."""

    def __init__(self, data: mujoco.MjData, arrays: Mapping[str, Array]) -> None: ...

class Rows:
    """The rows of a step, in the arrays that it is given."""

    def __init__(
        self,
        *,
        engine: Engine,
        now: Kinematics,
        matrix: Array,
        lower: Array,
        upper: Array,
        multiplier: Array,
        ids: NDArray[np.intp],
        distance: Array,
        slope: Array,
        drift: Array,
    ) -> None: ...
    def know(
        self,
        *,
        resolution: float,
        turning: list[bool],
        slides: list[tuple[int, int, float, float, int, list[int]]],
        twist: Array,
    ) -> None: ...
    def add_speed(
        self,
        *,
        position: Array,
        rotation: Array,
        reference: Array,
        dofs: list[int],
        turned: bool,
        linear: float,
        angular: float,
        rate: Array,
    ) -> None: ...
    def add_collision(
        self,
        *,
        d_min: float,
        detect: float,
        gain: float,
        push: float,
        twist: Array,
        arrays: Mapping[str, NDArray[Any]],
    ) -> None: ...
    def add_workspace(
        self,
        planes: list[tuple[str, int, int, int, list[float], float, list[int], list[float]]],
        gain: float,
        push: float,
        twist: Array,
    ) -> None: ...
    def add_balls(self, balls: list[tuple[int, int, float]], gain: float, push: float) -> None: ...
    def add_tendons(
        self,
        ends: list[tuple[float, float, list[int], list[int], list[float]]],
        gain: float,
        push: float,
    ) -> None: ...
    def update(self, lb: Array, ub: Array, dt: float) -> None: ...
    @property
    def blocks(self) -> list[tuple[int, int]]: ...
    @property
    def kept_blocks(self) -> list[tuple[int, int]]: ...
    @property
    def count(self) -> int: ...
    @property
    def passed(self) -> bool: ...

class Shortening:
    """How much of a command may be carried out."""

    def __init__(
        self,
        *,
        rows: Rows,
        own: Kinematics,
        twist: Array,
    ) -> None: ...
    def follow(self, kinematics: ForwardKinematics) -> None: ...
    def share(self, v: Array, brake: Array, dt: float, seconds: float) -> tuple[float, bool]: ...

class Record:
    """A step as it was taken."""

    @property
    def numbers(self) -> Array: ...
    @property
    def ending(self) -> str: ...
    @property
    def iterations(self) -> int: ...
    @property
    def engine(self) -> NativeEngine: ...

def set_step_type(base: type[Step], source: Callable[[Record], object]) -> None: ...
def quick_step(function: Method) -> Method: ...
def quick_target(function: Method) -> Method: ...

class Stepper:
    """A controller's steps where nothing rare happens."""

    def __init__(
        self,
        *,
        engine: Engine,
        owner: NativeEngine,
        q: Array,
        v: Array,
        v_previous: Array,
        dt: float,
        quaternions: list[int],
        frozen: list[bool],
        budget: float,
        kept: list[Array],
        moving: NDArray[np.uint8],
        watched: list[tuple[int, list[float], float, float]],
        tolerance: float,
    ) -> None: ...
    def add_target(
        self,
        name: str,
        pose: bool,
        target: Array,
        twist: Array,
        feedforward: Array,
        moving: NDArray[np.uint8],
    ) -> None: ...
    def reset(self) -> None: ...
    def update(self, v: Array, dt: float) -> None: ...
    @property
    def stuck(self) -> bool: ...

class Batch:
    """Many controllers that take turns on a few steppers."""

    def __init__(
        self,
        *,
        count: int,
        workers: list[tuple[Stepper | None, Array, Array, NDArray[np.uint8]]],
        start: list[float],
    ) -> None: ...
    def reset(self, q: Array, v: Array) -> None: ...
    def aim(
        self,
        task: int,
        first: int,
        pose: bool,
        values: Array,
        velocities: Array | None,
        accepted: NDArray[np.uint8],
    ) -> None: ...
    def step(
        self, q: Array | None, dt: float, v: Array, following: Array, flags: NDArray[np.int32]
    ) -> None: ...
    def read(self, q: Array) -> None: ...
