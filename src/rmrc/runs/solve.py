"""The solve loop: a configuration runs from its start to its end, and becomes a `Run`."""

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from rmrc.config.models import Config
from rmrc.control.controller import Controller
from rmrc.engine.closed_form import shortcomings
from rmrc.problem.compile import compile
from rmrc.problem.problem import Problem
from rmrc.record.run import Run
from rmrc.runs.execution import build_execution
from rmrc.runs.follow import FOLLOWERS
from rmrc.runs.log import Log
from rmrc.runs.target_paths import build_aims, build_obstacles, unfinished

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]
"""Called with the number of steps done and of all."""

PROGRESS_EVERY = 50
"""Steps between two calls of the progress."""


def solve(config: Config | Problem, progress: Progress | None = None) -> Run:
    """Run a configuration from its start to its end.

    Row k of the run is the state at t_k = k dt before the step that is taken there, k = 0 … N with
    N dt the duration. An interrupt (Ctrl-C), a simulation that fails or, by `method: mink`, a step
    without a solution ends the run; what was done so far is returned.

    Args:
        config: The configuration, or the problem compiled from it.
        progress: Called now and then with the number of steps done and of all.

    Raises:
        ConfigError: If the configuration does not fit its scene.
    """
    problem = config if isinstance(config, Problem) else compile(config)
    controller = Controller(problem)
    aims, obstacles = build_aims(problem), build_obstacles(problem)
    follower = FOLLOWERS[problem.config.follow](controller, aims)
    execution = build_execution(problem)
    targets = controller.engine.evaluation.target
    notices = [*controller.notices, *execution.notices, *shortcomings(problem)]
    log = Log(problem, controller, unfinished(aims, problem.config), notices)
    try:
        for k in range(log.count):
            if progress is not None and k % PROGRESS_EVERY == 0:
                progress(k, log.count)
            now = k * problem.dt
            for aim in aims:
                aim.sample(now)
            for obstacle in obstacles:
                obstacle.move(now, controller)
            execution.place_obstacles(controller.engine.evaluation.data)
            begin = time.perf_counter_ns()
            step = follower.step(now, execution.feedback())
            elapsed = time.perf_counter_ns() - begin
            log.add(k, now, step, execution.state(step, targets), elapsed)
            execution.carry_out(step)
            if fault := execution.fault or controller.engine.fault:
                log.unfinished.insert(0, fault)
                break
    except KeyboardInterrupt:
        log.interrupted = True
    if progress is not None:
        progress(log.done, log.count)
    return log.run(follower.solves)
