"""Why a recorded step is what it is: it is taken again from what the run holds, and explained."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from rmrc.config.models import Config
from rmrc.control.controller import Controller
from rmrc.control.explain import Explanation, explain
from rmrc.control.status import Status
from rmrc.errors import RmrcError
from rmrc.problem.compile import compile
from rmrc.record.run import Run
from rmrc.runs.target_paths import build_aims, build_obstacles
from rmrc.text.explain import explain as explain_mistakes
from rmrc.text.mistakes import config_error


def why(run: Run, step: int | None = None) -> tuple[int, Explanation]:
    """Return the number of a step, by default the first of the most severe status, and its account.

    The run's configuration is compiled anew, so that its scene must still be there.

    Raises:
        RmrcError: If there is no such step, or its command is no solution of a program.
        ConfigError: If the configuration does not fit its scene any more.
    """
    count = len(run.time)
    if not count:
        raise RmrcError("the run has no steps, so there is nothing to explain")
    k = int(run.status.argmax()) if step is None else step
    if not 0 <= k < count:
        raise RmrcError(f"the run has the steps 0 to {count - 1}, and no step {k}")
    try:
        config = Config.model_validate(run.manifest["config"]).rooted(Path(run.manifest["root"]))
    except ValidationError as error:
        mistakes = config_error(explain_mistakes(Config, run.manifest["config"], error))
        raise RmrcError(f"the run's configuration is none: {mistakes}") from None
    if config.method != "qp" or config.follow != "rate":
        raise RmrcError(
            "only steps of `method: qp` with `follow: rate` are solutions of a program; this run "
            f"has method {config.method} and follow {config.follow}"
        )
    problem = compile(config)
    controller = Controller(problem)
    before = np.vstack([np.zeros((2, problem.model.nv)), run.v[:k]])
    controller.reset(run.q[k], before[-1], (before[-1] - before[-2]) / problem.dt)
    now = float(run.time[k])
    for aim in build_aims(problem):
        aim.sample(now)
        aim.set_on(controller)
    for obstacle in build_obstacles(problem):
        obstacle.move(now, controller)
    name = run.manifest["statuses"][run.status[k]]
    if name not in Status.__members__:
        raise RmrcError(f"the run's status {name!r} is none that this version knows")
    recorded = Status[name]
    explanation = explain(controller.step(run.q[k]), recorded is Status.STUCK)
    if recorded in explanation.flags:
        return k, explanation
    # Some statuses, as STUCK, are of the steps before.
    flags = (recorded, *(flag for flag in explanation.flags if flag is not Status.OK))
    return k, replace(explanation, status=recorded, flags=flags)
