"""From the names in a `collision` limit to pairs of geoms, and what was left out."""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc.errors import ModelError, unknown_name
from rmrc.limits.always_near import Whereabouts, always_near, anywhere
from rmrc.limits.models import CollisionLimit, Part
from rmrc.model.extents import dofs_of_bodies
from rmrc.model.frames import OBJECTS, in_subtree, names
from rmrc.model.objects import Objects
from rmrc.tasks.base import FieldError
from rmrc.text.base import Subtree

Mask = NDArray[np.bool_]

_T = mujoco.mjtGeom
# MuJoCo gives wrong distances from a height field and from a signed distance function.
_UNMEASURED = (_T.mjGEOM_HFIELD, _T.mjGEOM_SDF)
_DISABLE = mujoco.mjtDisableBit

MESHES_RIGHT = 4
"""Major version of MuJoCo from which on distances of meshes are right (its issue 3383)."""
SHOWN = 4
"""Pairs that a notice names."""

BETWEEN = " – "
"""Stands between the names of two geoms."""


def resolve_pairs(
    model: mujoco.MjModel,
    limit: CollisionLimit,
    where: Whereabouts | None = None,
    objects: Objects | None = None,
) -> tuple[NDArray[np.intp], list[str]]:
    """Return the pairs of geoms that a limit keeps apart, and notices on those it leaves out.

    `all` is what MuJoCo would let collide: not the geoms of a body and its parent, nor what the
    scene excludes or `contype` and `conaffinity` filter out, but its `<pair>`s in any case. Of the
    pairs that are named, those of `groups` are filtered by parent and exclusion too; those of
    geoms and bodies are all meant. The geoms of a body are those that collide with anything, where
    there are any. What no joint of the robot moves relative to each other is never a pair, as two
    objects are not, nor is what is nearer than `d_min` wherever the joints may be, the start
    included: it could only hold the robot back.

    Args:
        model: The model.
        limit: The limit.
        where: Where the joints may be; by default in the model's ranges.
        objects: What is not the robot; by default what the model itself says.

    Returns:
        Pairs (p, 2), the geom of the lower type first, as MuJoCo orders them; the notices.

    Raises:
        FieldError: If a name is unknown, or an entry of `pairs` comes to nothing.
        ModelError: If the scene disables MuJoCo's own convex collision detection.
    """
    if model.opt.disableflags & _DISABLE.mjDSBL_NATIVECCD:
        raise ModelError(
            "the scene disables nativeccd, without which MuJoCo's distances are wrong by "
            'centimetres: take <flag nativeccd="disable"/> out of it'
        )
    return _Resolver(model, limit, where or anywhere(model), objects or Objects(model)).pairs()


def geom_name(model: mujoco.MjModel, geom: int) -> str:
    """Return the name of a geom, or its number in its body."""
    body = int(model.geom_bodyid[geom])
    number = geom - int(model.body_geomadr[body])
    return model.geom(geom).name or f"geom {number} of {model.body(body).name or f'body {body}'}"


def pair_name(model: mujoco.MjModel, first: int, second: int) -> str:
    """Return what a message calls a pair of geoms."""
    return f"{geom_name(model, first)}{BETWEEN}{geom_name(model, second)}"


@dataclass(frozen=True)
class _Meaning:
    """The geoms that a name stands for."""

    geoms: Mask
    group: bool


class _Resolver:
    """Pairs are symmetric flags (ngeom, ngeom), which one filter after another thins."""

    def __init__(
        self, model: mujoco.MjModel, limit: CollisionLimit, where: Whereabouts, objects: Objects
    ):
        self._model, self._limit, self._where = model, limit, where
        self._notices: list[str] = []
        self._silent: set[int] = set()
        body = model.geom_bodyid
        moves = dofs_of_bodies(model)
        self._moved = _moved(moves[:, ~objects.dofs])[np.ix_(body, body)]
        self._pushed = _moved(moves)[np.ix_(body, body)] & ~self._moved
        self._measured = _measured(model)
        self._collides = (model.geom_contype | model.geom_conaffinity) != 0

    def pairs(self) -> tuple[NDArray[np.intp], list[str]]:
        if self._limit.pairs == "all":
            wanted, meant = self._all()
        else:
            wanted, meant = self._named(self._limit.pairs)
        wanted = self._without("that MuJoCo cannot measure", wanted, ~self._measured)
        body = self._model.geom_bodyid
        filters = {
            "of a body and its parent": _parents(self._model)[np.ix_(body, body)],
            "that the scene excludes": _excluded(self._model)[np.ix_(body, body)],
        }
        for reason, mask in filters.items():
            wanted = self._without(reason, wanted, mask & ~meant)
        wanted = self._without("that `exclude` names", wanted, self._excepted(wanted))
        if self._silent:
            self._leave_out(
                "geoms of the named bodies that collide with nothing",
                [geom_name(self._model, g) for g in sorted(self._silent)],
            )
        pairs = np.argwhere(np.triu(wanted))
        swapped = np.diff(self._model.geom_type[pairs], axis=1)[:, 0] < 0
        pairs[swapped] = pairs[swapped, ::-1]
        pairs = self._separable(pairs)
        if not len(pairs):
            raise FieldError("pairs", "there is no pair left to keep apart; " + self._reasons())
        kept = [f"pairs of geoms that collision keeps apart: {len(pairs)}"]
        meshes = (self._model.geom_type[pairs] == _T.mjGEOM_MESH).any()
        if meshes and int(mujoco.__version__.split(".")[0]) < MESHES_RIGHT:
            kept.append(
                f"MuJoCo {mujoco.__version__} may take meshes that are apart for touching: "
                f"take {MESHES_RIGHT}.0 or later"
            )
        return pairs, [*kept, *self._notices]

    def _separable(self, pairs: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return the pairs that can keep their distance."""
        near = always_near(self._model, pairs, self._limit.d_min, self._where)
        if near.any():
            shown = [pair_name(self._model, a, b) for a, b in pairs[near].tolist()]
            # What the user has named is named in full.
            most = SHOWN if self._limit.pairs == "all" else len(shown)
            self._leave_out("pairs that are nearer than d_min wherever the joints are", shown, most)
        return pairs[~near]

    def _reasons(self) -> str:
        return "; ".join(self._notices) or "no joint moves two geoms that may collide"

    def _all(self) -> tuple[Mask, Mask]:
        """Return the pairs that move and those that the scene asks for one by one."""
        model = self._model
        meant = np.zeros_like(self._moved)
        meant[model.pair_geom1, model.pair_geom2] = meant[model.pair_geom2, model.pair_geom1] = True
        masks = (model.geom_contype[:, None] & model.geom_conaffinity[None, :]) != 0
        silent = np.flatnonzero(~self._collides & ~meant.any(axis=1))
        if silent.size:
            self._leave_out(
                "geoms whose contype and conaffinity are 0",
                [geom_name(model, g) for g in silent.tolist()],
            )
        both = self._collides[:, None] & self._collides[None, :]
        filtered = both & ~(masks | masks.T) & ~meant
        wanted = self._moved & (both | meant)
        return self._without("by contype and conaffinity", wanted, filtered), meant

    def _named(self, entries: tuple[tuple[Part, Part], ...]) -> tuple[Mask, Mask]:
        """Return the pairs that the names stand for and those of them that no filter takes out."""
        wanted, meant = np.zeros_like(self._moved), np.zeros_like(self._moved)
        for entry in entries:
            first, second = (self._meaning("pairs", name) for name in entry)
            pairs = _product(first.geoms, second.geoms)
            between = f"'{entry[0]}' and '{entry[1]}'"
            moved = self._without("that the robot does not move", pairs, self._pushed) & self._moved
            if not moved.any():
                if (pairs & self._pushed).any():
                    continue
                raise FieldError("pairs", f"no joint moves {between} relative to each other")
            if not (moved & self._measured).any():
                raise FieldError("pairs", f"MuJoCo cannot measure the distance of {between}")
            wanted |= moved
            if not (first.group or second.group):
                meant |= pairs
        return wanted, meant

    def _excepted(self, wanted: Mask) -> Mask:
        """Return the pairs that `exclude` names."""
        excepted = np.zeros_like(wanted)
        for entry in self._limit.exclude:
            first, second = (self._meaning("exclude", name, whole=True) for name in entry)
            pairs = _product(first.geoms, second.geoms)
            if not (pairs & wanted).any():
                self._notices.append(
                    f"collision: '{entry[0]}' and '{entry[1]}' in `exclude` are no pair anyway"
                )
            excepted |= pairs
        return excepted

    def _meaning(self, key: str, name: Part, whole: bool = False) -> _Meaning:
        """Return what a name stands for: a subtree, a group, else a body, else a geom."""
        if isinstance(name, Subtree):
            return _Meaning(self._geoms(key, name, whole), True)
        if name in self._limit.groups:
            members = self._limit.groups[name]
            geoms = [self._geoms("groups", member, whole) for member in members]
            return _Meaning(np.logical_or.reduce(geoms), True)
        return _Meaning(self._geoms(key, name, whole), False)

    def _geoms(self, key: str, name: Part, whole: bool) -> Mask:
        """Return the one geom, or the geoms of a body or a subtree: all, or what collides."""
        model, found = self._model, np.zeros(self._model.ngeom, dtype=np.bool_)
        if isinstance(name, Subtree):
            found = in_subtree(model, name)[model.geom_bodyid]
            return self._colliding(key, str(name), found, whole)
        body = mujoco.mj_name2id(model, OBJECTS["body"], name)
        if body < 0:
            geom = mujoco.mj_name2id(model, OBJECTS["geom"], name)
            if geom < 0:
                known = [*names(model, "geom"), *names(model, "body"), *self._limit.groups]
                kind = "geom or body" if key == "groups" else "geom, body or group"
                raise FieldError(key, unknown_name(kind, name, dict.fromkeys(known)))
            found[geom] = True
            return found
        return self._colliding(key, f"the body '{name}'", model.geom_bodyid == body, whole)

    def _colliding(self, key: str, what: str, found: Mask, whole: bool) -> Mask:
        """Return geoms, without those that collide with nothing unless the whole is meant."""
        if not found.any():
            raise FieldError(key, f"{what} has no geoms")
        if not whole and (found & self._collides).any():
            self._silent.update(np.flatnonzero(found & ~self._collides).tolist())
            found &= self._collides
        return found

    def _without(self, reason: str, wanted: Mask, mask: Mask) -> Mask:
        """Return what a mask leaves of the pairs, with a notice on what it takes out."""
        out = np.argwhere(np.triu(wanted & mask))
        if len(out):
            shown = [pair_name(self._model, a, b) for a, b in out.tolist()]
            self._leave_out(f"pairs {reason}", shown)
        return wanted & ~mask

    def _leave_out(self, what: str, shown: list[str], most: int = SHOWN) -> None:
        more = ", …" if len(shown) > most else ""
        listed = ", ".join(shown[:most]) + more
        self._notices.append(f"collision leaves out {what} ({len(shown)}): {listed}")


def _product(first: Mask, second: Mask) -> Mask:
    """Return the pairs of the geoms of one set with those of another."""
    pairs = first[:, None] & second[None, :]
    return pairs | pairs.T


def _moved(moves: Mask) -> Mask:
    """Return which bodies are moved relative to each other by what moves each (nbody, dofs)."""
    return (moves[:, None, :] != moves[None, :, :]).any(axis=2)


def _parents(model: mujoco.MjModel) -> Mask:
    """Return which bodies MuJoCo takes for parent and child (nbody, nbody).

    Bodies without a joint count with the body they are welded to; what is welded to the world is
    nobody's parent.
    """
    weld = model.body_weldid
    if model.opt.disableflags & _DISABLE.mjDSBL_FILTERPARENT:
        return np.zeros((model.nbody, model.nbody), dtype=np.bool_)
    parent = weld[model.body_parentid[weld]]
    child_of = (parent[:, None] == weld[None, :]) & (weld[:, None] != 0) & (weld[None, :] != 0)
    return child_of | child_of.T


def _excluded(model: mujoco.MjModel) -> Mask:
    """Return the pairs of bodies that the scene's <exclude> names (nbody, nbody)."""
    excluded = np.zeros((model.nbody, model.nbody), dtype=np.bool_)
    first, second = model.exclude_signature >> 16, model.exclude_signature & 0xFFFF
    excluded[first, second] = excluded[second, first] = True
    return excluded


def _measured(model: mujoco.MjModel) -> Mask:
    """Return which geoms MuJoCo can tell the distance of (ngeom, ngeom)."""
    known = ~np.isin(model.geom_type, _UNMEASURED)
    plane = model.geom_type == _T.mjGEOM_PLANE
    return known[:, None] & known[None, :] & ~(plane[:, None] & plane[None, :])
