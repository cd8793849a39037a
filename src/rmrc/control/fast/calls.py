"""The two calls of a control loop, which the extension takes where all about them is plain."""

from typing import TypeVar

try:
    from rmrc._native import quick_step, quick_target
except ImportError:  # without it Python takes them all
    Method = TypeVar("Method")

    def quick_step(function: Method) -> Method:
        """Return `Controller.step` as it is."""
        return function

    def quick_target(function: Method) -> Method:
        """Return `Controller.set_target` as it is."""
        return function
