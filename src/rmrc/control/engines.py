"""The choice of the engine: the one place that knows there is more than one."""

from importlib.util import find_spec
from typing import Literal

from rmrc.engine.closed_form import MethodEngine
from rmrc.engine.python import PythonEngine
from rmrc.errors import ModelError, SolverError, unknown_name
from rmrc.problem.problem import Problem
from rmrc.text.mistakes import Mistake, config_error

Choice = Literal["auto", "python", "native"]
Engine = PythonEngine | MethodEngine
ENGINES = ("auto", "python", "native")
NOT_BUILT = (
    "rmrc was installed without it; with a C++20 compiler `pip install -v` builds it, "
    "or shows what fails"
)
"""Why there is no extension to import: pip keeps what the compiler has said to itself."""


def build_engine(problem: Problem, choice: Choice) -> tuple[Engine, tuple[str, ...]]:
    """Return the engine of a problem, and what a user should know of the choice.

    `auto` takes what the configuration asks for; and where that is `auto` too, the native engine
    if it is there and has a place for all of the problem, else the Python engine.

    Raises:
        ModelError: If there is no engine of that name.
        ConfigError: If the native engine is asked for by name and cannot run the problem.
    """
    if choice not in ENGINES:
        raise ModelError(unknown_name("engine", choice, ENGINES))
    asked = problem.config.engine if choice == "auto" else choice
    reason = None if asked == "python" else _reason(problem)
    if asked == "native" and reason:
        message = f"native cannot run: {reason}. With `engine: auto` the Python engine runs"
        raise config_error([Mistake(("engine",), message)], problem.config)
    if asked != "python" and not reason:
        from rmrc.native.engine import NativeEngine  # which is there, for there is no reason

        return NativeEngine(problem), ()
    other = problem.config.method != "qp"
    engine = MethodEngine(problem) if other else PythonEngine(problem)
    # Another method is Python's alone: there is nothing to choose, and nothing to say.
    return engine, (f"the Python engine runs: {reason}",) if reason and not other else ()


def _reason(problem: Problem) -> str | None:
    """Return why the native engine cannot run a problem, or None."""
    if failure := missing():
        return f"the native engine is not there: {failure}"
    from rmrc.native.engine import lacking

    absent = lacking(problem)
    return f"the native engine has no {', no '.join(absent)}" if absent else None


def missing() -> str | None:
    """Return why the native engine is not there, or None."""
    if find_spec("rmrc._native") is None:
        return NOT_BUILT
    try:
        from rmrc.native.engine import addresses

        addresses()
    except (ImportError, SolverError) as failure:
        return str(failure)
    return None
