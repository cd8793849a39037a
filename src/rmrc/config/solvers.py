"""Which QP solvers there are, and what they call their settings."""

from importlib.metadata import metadata
from importlib.util import find_spec
from math import inf
from typing import NamedTuple

from rmrc.errors import SolverError, unknown_name

BACKENDS = {
    "daqp": ("rmrc.qp.backends.daqp", "DAQP"),
    "proxqp": ("rmrc.qp.backends.proxqp", "ProxQP"),
    "osqp": ("rmrc.qp.backends.osqp", "OSQP"),
}
"""Module and class of each first-class backend: to add one, write its file and its line here."""
AUTO, DEFAULT = "auto", "daqp"
"""The name of what an engine takes by itself, and what that is in the Python engine."""
_PACKAGES = {"proxqp": "proxsuite"}
"""The packages that are not called as the backend is."""


class Settings(NamedTuple):
    """What a solver calls its settings; it has none for what is empty."""

    iterations: str = ""
    tolerances: tuple[str, ...] = ()
    seconds: str = ""


SETTINGS = {
    "clarabel": Settings("max_iter", ("tol_gap_abs", "tol_gap_rel", "tol_feas"), "time_limit"),
    "copt": Settings(seconds="TimeLimit"),
    "cvxopt": Settings("maxiters", ("abstol", "reltol", "feastol")),
    "daqp": Settings("iter_limit", ("primal_tol",), "time_limit"),
    "ecos": Settings("max_iters", ("abstol", "reltol", "feastol")),
    "gurobi": Settings(seconds="TimeLimit"),
    "highs": Settings(seconds="time_limit"),
    "osqp": Settings("max_iter", ("eps_abs",), "time_limit"),
    "pdhcg": Settings(seconds="TimeLimit"),
    "piqp": Settings("max_iter", ("eps_abs",)),
    "qpalm": Settings("max_iter", ("eps_abs",), "time_limit"),
    "qpoases": Settings(seconds="time_limit"),
    "scs": Settings("max_iters", ("eps_abs",), "time_limit_secs"),
    "sip": Settings(seconds="time_limit"),
}
"""The settings of the solvers; one that is not here has none."""


def backend_of(name: str) -> str:
    """Return the backend of the Python engine that a configuration asks for."""
    return DEFAULT if name == AUTO else name


def require(name: str, max_iter: int | None, tolerance: float | None) -> None:
    """Raise SolverError unless there is a solver of that name that takes these settings."""
    if max_iter is not None and max_iter < 1:
        raise SolverError(f"max_iter must be at least 1, not {max_iter}")
    if tolerance is not None and not 0.0 < tolerance < inf:
        raise SolverError(f"tolerance must be positive and finite, not {tolerance}")
    if name == AUTO:
        return
    if name in BACKENDS:
        package = _PACKAGES.get(name, name)
        if find_spec(package) is None:
            raise SolverError(f"the QP backend '{name}' is not installed: pip install {package}")
        return
    _require_installed(name)
    settings = SETTINGS.get(name, Settings())
    if max_iter is not None and not settings.iterations:
        raise SolverError(f"the QP backend '{name}' takes no max_iter")
    if tolerance is not None and not settings.tolerances:
        raise SolverError(f"the QP backend '{name}' takes no tolerance")


def _require_installed(name: str) -> None:
    import qpsolvers  # which looks at every solver there is

    if name in qpsolvers.available_solvers:
        return
    others = [other for other in qpsolvers.available_solvers if other not in BACKENDS]
    if not hasattr(qpsolvers.solvers, f"{name}_solve_problem"):
        raise SolverError(unknown_name("QP backend", name, [*BACKENDS, *others]))
    if name in (metadata("qpsolvers").get_all("Provides-Extra") or ()):
        advice = f"pip install 'qpsolvers[{name}]'"
    else:
        advice = "the documentation of qpsolvers says where it comes from"
    raise SolverError(f"the QP backend '{name}' is not installed: {advice}")
