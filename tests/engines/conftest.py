"""What the tests of solvers share: every backend, and a clock that a test turns."""

import pytest
from clocks import BUILDERS, Clock

from rmrc.qp.backends import Backend, base, osqp, proxqp, qpsolvers_adapter


@pytest.fixture(params=BUILDERS)
def backend(request: pytest.FixtureRequest) -> Backend:
    return BUILDERS[request.param]()


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """A clock in place of that of all backends."""
    clock = Clock()
    for module in (base, osqp, proxqp, qpsolvers_adapter):
        monkeypatch.setattr(module, "perf_counter", clock)
    return clock
