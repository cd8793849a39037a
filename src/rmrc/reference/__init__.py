"""The closed forms of differential inverse kinematics, each from the paper that gave it.

Pure numpy, independent of the rest of the package. J is a Jacobian (m, n), ẋ a task velocity (m,)
and v the joint velocity (n,), all in float64. An error e in m or rad may take the place of ẋ in
m/s or rad/s; the result is then a step in q, in rad. A singular or mis-shaped argument raises a
ValueError that says which.
"""

from rmrc.reference import planar_2r
from rmrc.reference.adaptive import (
    damping_error,
    damping_manipulability,
    damping_sigma_min,
    numerically_filtered,
    selectively_damped,
)
from rmrc.reference.damped import dls, step_bound, weighted_dls
from rmrc.reference.gradient import Descent, clamp, descent
from rmrc.reference.inverses import inverse, pinv, task_metric, transpose, weighted
from rmrc.reference.nullspace import nullspace_projector, prioritized
from rmrc.reference.saturation import Saturation, bounded_dls, saturate, saturated

__all__ = [
    "Descent",
    "Saturation",
    "bounded_dls",
    "clamp",
    "damping_error",
    "damping_manipulability",
    "damping_sigma_min",
    "descent",
    "dls",
    "inverse",
    "nullspace_projector",
    "numerically_filtered",
    "pinv",
    "planar_2r",
    "prioritized",
    "saturate",
    "saturated",
    "selectively_damped",
    "step_bound",
    "task_metric",
    "transpose",
    "weighted",
    "weighted_dls",
]
