"""Frames with an offset: a site each, so that all engines see a plain site."""

from collections.abc import Iterable
from typing import Any

import mujoco
import numpy as np

from rmrc.text.source import Offset

_OBJECTS = {
    "site": mujoco.mjtObj.mjOBJ_SITE,
    "body": mujoco.mjtObj.mjOBJ_BODY,
    "geom": mujoco.mjtObj.mjOBJ_GEOM,
}

GROUP = 5
"""Of sites that nobody draws."""


def add_sites(spec: mujoco.MjSpec, offsets: Iterable[Offset]) -> None:
    """Add a site for each offset, to be placed when the model is compiled.

    One of a frame that the model does not have is left out; who resolves it says so.
    """
    for offset in dict.fromkeys(offsets):
        kinds = [offset.kind] if offset.kind else ["site", "body", "geom"]
        holders: list[Any] = [getattr(spec, kind)(offset.frame) for kind in kinds]
        kind, holder = next(
            ((k, h) for k, h in zip(kinds, holders, strict=True) if h is not None), (None, None)
        )
        if holder is not None:
            body = holder if kind == "body" else holder.parent
            body.add_site(name=offset.name, group=GROUP)


def place_sites(model: mujoco.MjModel, offsets: Iterable[Offset]) -> None:
    """Place the sites where their frames are, displaced: p + R(q) o, and q times the offset's."""
    for offset in dict.fromkeys(offsets):
        site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, offset.name)
        if site < 0:
            continue
        origin, turn = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
        kinds = [offset.kind] if offset.kind else ["site", "body", "geom"]
        kind = next(k for k in kinds if mujoco.mj_name2id(model, _OBJECTS[k], offset.frame) >= 0)
        if kind != "body":
            frame = getattr(model, kind)(offset.frame)
            origin, turn = frame.pos, frame.quat
        mujoco.mju_rotVecQuat(model.site_pos[site], np.array(offset.position), turn)
        model.site_pos[site] += origin
        mujoco.mju_mulQuat(model.site_quat[site], turn, np.array(offset.quaternion))
        model.site_sameframe[site] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
