"""The limits that are rows of the program: of distances, and of the speeds of frames."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rmrc.errors import ModelError, unknown_name
from rmrc.limits.always_near import Whereabouts
from rmrc.limits.ball import compile_balls
from rmrc.limits.barrier import BarrierLimit
from rmrc.limits.collision import collision_pairs
from rmrc.limits.joints import held_ranges
from rmrc.limits.models import LimitsModel
from rmrc.limits.speed import FrameSpeed
from rmrc.limits.tendon import compile_tendons
from rmrc.limits.workspace import compile_workspace
from rmrc.model.objects import Objects
from rmrc.tasks.base import FieldError, Term
from rmrc.tasks.frame import FrameTerm
from rmrc.text.mistakes import Mistake


def compile_barriers(
    objects: Objects,
    limits: LimitsModel,
    start: NDArray[np.float64],
    dofs: NDArray[np.intp],
    mistakes: list[Mistake],
    notices: list[str],
) -> tuple[BarrierLimit, ...]:
    """Return the limits on distances; what is wrong goes to `mistakes`, the rest to `notices`."""
    model = objects.model
    found: list[BarrierLimit] = [
        *compile_balls(model, limits, dofs),
        *compile_tendons(model, limits, dofs),
        *compile_workspace(model, limits.workspace, dofs, mistakes),
    ]
    if limits.collision != "off":
        where = ("limits", "collision")
        try:
            where_joints = Whereabouts(start, held_ranges(model, limits), dofs)
            pairs, left_out = collision_pairs(model, limits.collision, where_joints, objects)
        except FieldError as mistake:
            mistakes.append(Mistake((*where, mistake.key), str(mistake)))
        except ModelError as mistake:
            mistakes.append(Mistake(where, str(mistake)))
        else:
            found.append(pairs)
            notices.extend(left_out)
    return tuple(found)


def compile_speeds(
    limits: LimitsModel, terms: Sequence[Term], mistakes: list[Mistake]
) -> tuple[FrameSpeed, ...]:
    """Return the largest speeds of the frames of tasks; what is wrong goes to `mistakes`."""
    frames = {term.name: term for term in terms if isinstance(term, FrameTerm)}
    found = []
    for name, speed in limits.speed.items():
        if name not in frames:
            message = unknown_name("frame task", name, frames)
            mistakes.append(Mistake(("limits", "speed", name), message, key=True))
            continue
        term = frames[name]
        linear, angular = speed.linear or math.inf, speed.angular or math.inf
        found.append(FrameSpeed(name, term.frame, term.axes == "body", linear, angular))
    return tuple(found)
