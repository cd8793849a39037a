"""`Recorder`: one's own control loop as a `Run`."""

from collections import deque
from time import perf_counter_ns
from types import TracebackType
from typing import Any

from rmrc.control.controller import Controller
from rmrc.control.step import Step
from rmrc.errors import RmrcError
from rmrc.record.run import Run
from rmrc.runs.execution import State
from rmrc.runs.log import Log


class Recorder:
    """Keeps the steps that a controller takes inside a `with`, and makes a `Run` of them.

    Steps are kept as they are; what a run says of them is worked out when `run` is asked for, so
    that the loop waits for nothing. The configuration of the run is that of the controller when the
    recorder was made.
    """

    def __init__(self, controller: Controller, every: int = 1, size: int | None = None):
        """Make a recorder.

        Args:
            controller: Whose steps.
            every: Each of so many steps is kept (≥ 1).
            size: Most steps that are kept, the last ones; by default all.

        Raises:
            RmrcError: If `every` or `size` is below 1.
        """
        if every < 1 or (size is not None and size < 1):
            raise RmrcError(f"a recorder keeps at least one step: every={every}, size={size}")
        self._controller, self._problem, self._every = controller, controller.problem, every
        self._kept: deque[tuple[float, Step, int]] = deque(maxlen=size)
        self._count, self._clock = 0, 0.0

    def __enter__(self) -> "Recorder":
        take = self._controller.step

        def step(*inputs: Any, **named: Any) -> Step:
            begin = perf_counter_ns()
            taken = take(*inputs, **named)
            self.add(taken, perf_counter_ns() - begin)
            return taken

        self._controller.__dict__["step"] = step
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._controller.__dict__.pop("step", None)

    def add(self, step: Step, nanoseconds: int = 0) -> None:
        """Take note of a step that took so long; inside the `with` this is done of itself."""
        if self._count % self._every == 0:
            self._kept.append((self._clock, step, nanoseconds))
        self._count += 1
        self._clock += step.moment.dt

    def __len__(self) -> int:
        return len(self._kept)

    @property
    def run(self) -> Run:
        """What was recorded so far, to save, to report and to ask why.

        Raises:
            RmrcError: If that is nothing.
        """
        kept = list(self._kept)
        if not kept:
            raise RmrcError("nothing was recorded: step the controller inside the `with`")
        log = Log(self._problem, self._controller, [], self._controller.notices, len(kept))
        for k, (now, step, nanoseconds) in enumerate(kept):
            moment = step.moment
            with moment.restored():
                state = State(moment.q, moment.v_previous, step.error, None)
                log.add(k, now, step, state, nanoseconds)
        return log.run(len(kept))
