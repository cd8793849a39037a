"""Files of robots, written from parts."""

from collections.abc import Callable
from pathlib import Path

import pytest


@pytest.fixture
def urdf(tmp_path: Path) -> Callable[..., Path]:
    """Write a URDF of parts, and return its file."""

    def written(*parts: str, name: str = "robot.urdf") -> Path:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f'<robot name="robot">{"".join(parts)}</robot>')
        return path

    return written
