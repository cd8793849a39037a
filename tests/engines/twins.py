"""Both engines side by side: the Python one leads, and a native one is fed what it starts from."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

import rmrc
from rmrc import Problem, Step
from rmrc.control.engines import Engine
from rmrc.control.status import ACTIVE_MULTIPLIER
from rmrc.engine.python import CERTIFIED
from rmrc.limits.box import braked
from rmrc.qp.program import Solution, SolveStatus

Array = NDArray[np.float64]

SAME = 1e-8
"""Of v, relative to its largest element: two solvers, and kinematics that round differently."""
LEAST_RATE = 1e-3
"""rad/s or m/s: a v below it is compared as it is, for 1e-8 of it is below the rounding of q/dt."""
TIE = 1e-6
"""A multiplier this small may be that of a limit that is only just active."""
NESTED = 1e-6
"""Relative, of levels: the weight 1e-10 of ‖v‖² beside (α − 1)² leaves this much of v to DAQP's own
tolerance, and so do programs of nearly singular levels, one inside another."""
MEASURED = 1e-3
"""Relative, of commands that were shortened or corrected: MuJoCo's distances of meshes jump by 1e-7
from one configuration to the next, and so does the share that is found by measuring them."""
SLACK = 0.01
"""Relative, of what rows give way: where a row hardly depends on the joints, 1e-10 m/s of it decide
about 1e-5 m/s of others, and DAQP passes it by that."""
ROUNDING = 1e-13
"""Of merits, relative to the largest of 1 and themselves."""
MOST_APART = 0.1
"""Share of the steps that tolerances may decide."""
MET = 1e-8
"""rad/s or m/s: a limit that v is this near to may be active."""
DEPENDENT = 1e-6
"""Share of the largest singular value up to which limits depend on one another: a multiplier's
error is that of v divided by it."""
SAME_ERROR = 1e-9
NEW_TARGETS = 100


def twins(problem: Problem, steps: int, moving: bool = False) -> Iterator[tuple[Step, Step]]:
    """Run a controller with the Python engine, and yield its steps beside those of a native one."""
    leader, twin = (rmrc.Controller(problem, engine=engine) for engine in ("python", "native"))
    evaluation, other = leader.engine.evaluation, twin.engine.evaluation
    rng = np.random.default_rng(0)
    for k in range(steps):
        if k % NEW_TARGETS == 0:
            scatter_targets(leader, rng, moving)
        other.targets[:], other.twists[:] = evaluation.targets, evaluation.twists
        other.moving[:] = evaluation.moving
        # The very same bits: the nearest points of two meshes jump with the last of them.
        twin._q[:], twin._v[:], twin._a[:] = leader._q, leader._v, leader._a
        yield leader.step(), twin.step()


def scatter_targets(controller: rmrc.Controller, rng: np.random.Generator, moving: bool) -> None:
    """Move every target by up to 0.3 m and about 0.3 rad, with a velocity or at rest."""
    for name, term in controller.problem.term.items():
        twist = rng.normal(size=6) * 0.1
        if term.target_kind == "pose":
            turned = term.target[:4] + 0.15 * rng.normal(size=4)
            place = term.target[4:] + rng.uniform(-0.3, 0.3, 3)
            velocity = twist if moving else None
            assert controller.set_target(name, place, turned, velocity)
        elif term.target_kind == "point":
            place = term.target + rng.uniform(-0.3, 0.3, 3)
            assert controller.set_target(name, place, velocity=twist[:3] if moving else None)
        elif term.target_kind == "direction":
            velocity = twist[3:] if moving else None
            direction = term.target + 0.3 * rng.normal(size=3)
            assert controller.set_target(name, direction=direction, velocity=velocity)


def assert_equal(problem: Problem, steps: int, moving: bool = False) -> None:
    """Hold the native engine to the Python one over a run.

    Now and then the limits leave so little that DAQP's own tolerance decides about v: hard tasks
    that cannot be met, or levels at a singularity in a corner of the box. Of such a step the native
    engine has to have the better command. So has it to let rows give way by no more, where they are
    given slack: that leaves no more room than tolerances are wide. What is left of a command by the
    check of the distances at its end depends on how they are measured there (see `MEASURED`).
    """
    apart, same = 0, NESTED if problem.cascaded else SAME
    for python, native in twins(problem, steps, moving):
        np.testing.assert_allclose(native.moment.error, python.moment.error, atol=SAME_ERROR)
        assert native.moment.engine.relaxed == python.moment.engine.relaxed
        if difference(native.v, python.v) > same:
            if is_slack(native) and is_slack(python):
                assert beyond_brake(native) <= MET
                whole = native.moment.share == python.moment.share == 1.0
                if whole and beyond_brake(python) <= MET:
                    assert way_given(native) <= (1.0 + SLACK) * way_given(python) + MET
                continue
            apart += 1
            if is_corrected(native, python):
                assert difference(native.v, python.v) < MEASURED
            else:
                assert_better(native, python)
            continue
        given_up = python.solution.status is SolveStatus.MAX_ITER
        if given_up and native.solution.status is SolveStatus.SOLVED:
            continue  # with the same command, of which only one engine has the certificate
        assert native.flags == python.flags
        assert native.solution.status is python.solution.status
        assert_same_active(native.solution, python.solution, native.moment.engine)
    assert apart <= MOST_APART * steps


def difference(v: Array, expected: Array) -> float:
    """Return the largest difference of two velocities, relative to the largest element."""
    return float(np.abs(v - expected).max() / max(np.abs(expected).max(), LEAST_RATE))


def is_slack(step: Step) -> bool:
    """Return whether rows were given slack."""
    engine = step.moment.engine
    asked, lower = engine.rows.lower, engine.assembly.qp.lo
    return asked.size == lower.size and bool((lower < asked).any())


def way_given(step: Step) -> float:
    """Return by how much rows give way in all to the command, rad/s or m/s."""
    rows, dofs = step.moment.engine.rows, step.moment.engine.problem.dofs
    return float(np.linalg.norm(np.maximum(rows.lower - rows.matrix @ step.v[dofs], 0.0)))


def beyond_brake(step: Step) -> float:
    """Return by how much more a row gives way to the command than to the brake, at most.

    DAQP passes that limit by its tolerance, and 1e-7 of it is worth a hundredth of the violation
    where rows are nearly insensitive: what is gained so does not count.
    """
    engine = step.moment.engine
    rows, dofs, qp = engine.rows, engine.problem.dofs, engine.assembly.qp
    moment, box = step.moment, engine.problem.box
    brake = braked(box, moment.v_previous[dofs], moment.dt, moment.q).clip(qp.lb, qp.ub)
    given = np.maximum(rows.lower - rows.matrix @ step.v[dofs], 0.0)
    allowed = np.maximum(rows.lower - rows.matrix @ brake, 0.0)
    return float((given - allowed).max(initial=0.0))


def is_corrected(native: Step, python: Step) -> bool:
    """Return whether distances at the end of the step had a say in a command."""
    for engine in (native.moment.engine, python.moment.engine):
        asked, lower = engine.rows.lower, engine.assembly.qp.lo
        if asked.size == lower.size and (lower > asked).any():
            return True
    return native.moment.share < 1.0


def assert_better(native: Step, python: Step) -> None:
    """Hold the native command to be the better one in the first thing that tells the two apart."""
    engine = native.moment.engine
    ours, theirs = (merits(engine, step.solution.v) for step in (native, python))
    apart = np.abs(ours - theirs) > ROUNDING * np.maximum(1.0, np.abs(theirs))
    first = int(apart.argmax())
    assert apart[first]
    assert ours[first] < theirs[first]


def merits(engine: Engine, v: Array) -> Array:
    """Return what v is judged by, the most important first and less the better.

    That is by how much it passes rows and misses equalities, and then the cost; or of each level
    what it falls short of its directions, and its cost.
    """
    qp = engine.assembly.qp
    activity = qp.C @ v
    missed = np.concatenate([qp.lo - activity, activity - qp.hi, np.abs(qp.E @ v - qp.f)])
    at_rest = np.concatenate([qp.lo, -qp.hi, np.abs(qp.f)])
    # What rest misses by less than a certificate can tell is nobody's merit.
    missed[(missed <= at_rest) & (at_rest <= CERTIFIED)] = 0.0
    found = [max(missed.max(initial=0.0), 0.0)]
    if not engine.problem.cascaded:
        return np.array([*found, 0.5 * v @ qp.H @ v + qp.g @ v])
    levels = engine.assembly.levels()
    for level in levels:
        if level.direction is not None:
            jacobian, rate = level.direction
            alpha = float(rate @ jacobian @ v / (rate @ rate))
            found += [float(np.linalg.norm(jacobian @ v - alpha * rate)), -alpha]
        residual = level.rows @ v - level.rate
        found.append(0.5 * float(residual @ residual))
    return np.array([*found, float(v @ levels[-1].metric @ v)])


def assert_same_active(solution: Solution, expected: Solution, engine: Engine) -> None:
    """Hold the active limits to those of the Python engine, ties aside.

    A tie is a multiplier near 0, or limits that depend on one another where v is: they can share
    their multipliers in more than one way.
    """
    ours = np.concatenate([solution.bound_multiplier, solution.row_multiplier])
    others = np.concatenate([expected.bound_multiplier, expected.row_multiplier])
    differs = (np.abs(ours) > ACTIVE_MULTIPLIER) != (np.abs(others) > ACTIVE_MULTIPLIER)
    if np.abs(ours - others)[differs].max(initial=0.0) >= TIE:
        assert are_dependent(engine, solution.v)


def are_dependent(engine: Engine, v: Array) -> bool:
    """Return whether the limits that v meets, with what levels fix, depend on one another."""
    qp = engine.assembly.qp
    activity = qp.C @ v
    bounds = (v <= qp.lb + MET) | (v >= qp.ub - MET)
    rows = (activity <= qp.lo + MET) | (activity >= qp.hi - MET)
    fixed = [np.eye(v.size)[bounds], qp.C[rows], qp.E]
    if engine.problem.cascaded:
        fixed += [level.rows for level in engine.assembly.levels()]
    stacked = np.concatenate(fixed)
    sigma = np.linalg.svd(stacked, compute_uv=False)
    return len(stacked) > v.size or bool(sigma[-1] <= DEPENDENT * sigma[0])
