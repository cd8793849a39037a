"""The QP solvers behind one interface, by their names."""

from importlib import import_module

from rmrc.config.solvers import BACKENDS, require
from rmrc.errors import SolverError
from rmrc.qp.backends.base import HEALTHY, Backend

__all__ = ["BACKENDS", "HEALTHY", "Backend", "create"]


def create(name: str, *, max_iter: int | None = None, tolerance: float | None = None) -> Backend:
    """Return the backend of that name, one of `BACKENDS` or any solver qpsolvers has installed.

    `max_iter` (≥ 1) bounds the iterations of a solve and `tolerance` (> 0) is the solver's own
    absolute tolerance; None is what the backend needs for KKT residuals of 1e-8. Raises
    SolverError for an unknown name, a solver that is not installed, or a setting out of range.
    """
    require(name, max_iter, tolerance)
    if name not in BACKENDS:
        from rmrc.qp.backends.qpsolvers_adapter import QpsolversAdapter

        return QpsolversAdapter(name, max_iter, tolerance)
    module, backend = BACKENDS[name]
    try:
        return getattr(import_module(module), backend)(max_iter, tolerance)
    except ImportError as error:
        raise SolverError(f"the QP backend '{name}' cannot be imported: {error}") from error
