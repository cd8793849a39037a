"""Random configurations of a random tree: every task, every limit, and steps of any length."""

from dataclasses import dataclass
from typing import Any

import mujoco

from soaking.drawer import Array, Drawer
from soaking.trees import Tree

SHORTEST, LONGEST = 1e-6, 1.0
"""Lengths of a step, s."""
Data = dict[str, Any]


@dataclass
class Wishes:
    """Draws one configuration.

    Lengths are those of the tree; rates are so fast that something happens in the steps of an
    episode, however short they are.
    """

    tree: Tree
    drawer: Drawer
    path: str

    def __post_init__(self) -> None:
        drawer, tree = self.drawer, self.tree
        self.dt = drawer.between(SHORTEST, LONGEST)
        self.rate = 1.0 / drawer.among(1.0, *[self.dt * drawer.among(10.0, 50.0, 500.0)] * 4)
        """What rates are multiplied by, 1/s beside those of an arm."""
        self.length = tree.scale
        self._wild = drawer.chance(0.15)
        """Whether numbers are of any size."""
        self._model = tree.model
        self._data = mujoco.MjData(self._model)
        if self._model.nkey:
            self._data.qpos = self._model.key_qpos[0]
        mujoco.mj_kinematics(self._model, self._data)

    def _any(self, value: float) -> float:
        """Return a number, or one of another order of magnitude where things are wild."""
        drawer = self.drawer
        return value * drawer.between(1e-6, 1e6) if self._wild and drawer.chance(0.3) else value

    def config(self) -> Data:
        """Return a configuration as plain data."""
        drawer, tree = self.drawer, self.tree
        tasks = self._tasks()
        config: Data = {
            "scene": self.path,
            "dt": self.dt,
            "tasks": tasks,
            "limits": self._limits(tasks),
            "damping": {
                "lambda": self._any(
                    drawer.among(0.0, 1e-3, *[1e-2] * 4, 1e-2 * min(self.length, 1.0))
                ),
                "adapt": drawer.among(*["off"] * 4, "sigma_min", "manipulability", "error"),
            },
            "priority": drawer.among(*["soft"] * 5, "strict"),
            "previous": drawer.among(*["commanded"] * 5, "measured"),
            "solver": {},
        }
        if drawer.chance(0.05):
            config["solver"]["max_iter"] = drawer.among(1, 5, 20)
        if drawer.chance(0.05):
            config["solver"]["deadline"] = drawer.among(50.0, 300.0, 900.0)
        if drawer.chance(0.1):
            config["metric"] = drawer.among(self._any(0.01), "inertia")
        if drawer.chance(0.1):
            config["timeout"] = {
                key: self.dt * drawer.among(3.5, 50.0) for key in ("target", "measurement")
            }
        driven = [name for names in tree.joints.values() for name in names]
        if drawer.chance(0.1) and len(driven) > 1:
            left_out = drawer.among(*driven)
            config["dofs"] = [name for name in driven if name != left_out]
        if drawer.chance(0.02 if tree.equalities else 0.15) and tree.scalars:
            config["start"] = {drawer.among(*tree.scalars): drawer.among(-4.0, 0.0, 0.5, 40.0)}
        return config

    def _gain(self) -> Any:
        drawer = self.drawer
        if self._wild and drawer.chance(0.3):
            return self._any(self.rate)
        return drawer.among(1.0, self.rate, 10.0 * self.rate, 100.0 * self.rate, "deadbeat")

    def _tasks(self) -> list[Data]:
        drawer, frames = self.drawer, self.tree.frames
        count = drawer.among(0, 1, 1, 1, 2, 3)
        tasks = [self._frame_task(k, drawer.among(*frames[-6:], *frames)) for k in range(count)]
        extras = self._extras(drawer.among(*frames))
        wanted = [extra for extra in extras if drawer.chance(0.12)]
        if not tasks and not wanted:
            wanted = [drawer.among(*extras)]
        if self.tree.equalities:
            chosen = None if drawer.chance(0.7) else [drawer.among(*self.tree.equalities)]
            gain = drawer.among(1.0, 0.5 * self.rate, 5.0 * self.rate, "deadbeat")
            loop = {"type": "loop", "gain": gain, "equalities": chosen}
            wanted.append({key: value for key, value in loop.items() if value is not None})
        for extra in wanted:
            if "level" not in extra and extra["type"] not in ("loop", "coupling"):
                extra["level"] = drawer.among(0, 1, 1, 2)
        return tasks + [{"name": f"extra{k}", **extra} for k, extra in enumerate(wanted)]

    def _frame_task(self, k: int, frame: dict[str, str]) -> Data:
        drawer, tree = self.drawer, self.tree
        position = drawer.among(1.0, 100.0, 1.0 / self.length**2)
        task: Data = {
            "name": f"frame{k}",
            "type": "frame",
            "frame": frame,
            "gain": self._gain(),
            "B": {
                "position": self._any(position),
                "orientation": self._any(drawer.among(0.0, 0.1, 1.0)),
            },
            "level": drawer.among(0, 1, 2) if k else 0,
        }
        if drawer.chance(0.15):
            others = [{"body": name} for name in tree.objects] + tree.frames[:-1]
            root = drawer.among(*others, tree.frames[0])
            task |= {"type": "relative_frame", "root": root}
        else:
            task["axes"] = drawer.among("body", "body", "world")
        if drawer.chance(0.1):
            factor = drawer.rng.normal(size=(drawer.among(1, 4, 6), 6))
            task["B"] = (factor.T @ factor).tolist()
        if drawer.chance(0.3):
            task["clamp"] = {"position": 0.1 * self.length, "orientation": 0.3}
        if k == 0:
            task |= drawer.among(*[{}] * 14, {"preserve": "direction"}, {"hard": True})
        return task

    def _extras(self, frame: dict[str, str]) -> list[Data]:
        """Return tasks of all other types that this tree has a place for."""
        drawer, tree, rng = self.drawer, self.tree, self.drawer.rng
        scalars = tree.scalars
        posture: Data = {
            "type": "posture",
            "B": self._any(drawer.among(0.01, 1.0)),
            "gain": self._gain(),
        }
        found: list[Data] = [
            posture,
            posture | {"B": 1e-4},
            {"type": "smooth", "B": drawer.among(0.01, 1.0)},
            {"type": "com", "gain": self._gain()},
            {"type": "com", "body": drawer.among(*tree.bodies), "gain": self._gain()},
            {"type": "look_at", "frame": frame, "gain": self._gain()},
            {"type": "axis_align", "frame": frame, "axis": drawer.direction().tolist()},
            {"type": "kinetic_energy", "B": 0.01},
            {"type": "manipulability", "frame": frame, "B": 0.1},
        ]
        if self._model.jnt_limited.any():
            found.append({"type": "centering", "B": drawer.among(0.01, 1.0)})
        if scalars:
            driven = {drawer.among(*scalars): rng.uniform(-9.0, 9.0) * self.rate}
            found += [
                {"type": "velocity", "target": driven, "B": drawer.among(1.0, 100.0)},
                {"type": "freeze", "joints": [drawer.among(*scalars)]},
                {
                    "type": "posture",
                    "target": {drawer.among(*scalars): 0.5},
                    "hard": True,
                    "level": 0,
                },
            ]
        if len(scalars) > 1:
            first, second = rng.permutation(scalars)[:2].tolist()
            values = [self._data.joint(name).qpos[0] for name in (first, second)]
            coupling: Data = {"type": "coupling", "coefficients": {first: 1.0, second: -1.0}}
            coupling["offset"] = drawer.among(0.0, *[float(values[0] - values[1])] * 3)
            found.append(coupling | {"gain": drawer.among(1.0, self.rate, "deadbeat")})
        if tree.geoms and tree.surroundings:
            pair = [drawer.among(*tree.geoms), drawer.among(*tree.surroundings)]
            found.append({"type": "clearance", "pairs": [pair], "distance": 0.1 * self.length})
        return found

    def _limits(self, tasks: list[Data]) -> Data:
        drawer, tree, rate, length = self.drawer, self.tree, self.rate, self.length
        slides, free = tree.joints.get("slide", []), "free" in tree.joints
        limits: Data = {
            "position": self._ranges(),
            "velocity": self._rates(slides, 0.2 * rate, 6.0 * rate),
        }
        for name in ("position", "velocity"):
            if drawer.chance(0.05):
                limits[name] = "off"
        if drawer.chance(0.5):
            limits["acceleration"] = self._rates(slides, rate**2, 60.0 * rate**2)
        if drawer.chance(0.2):
            limits["jerk"] = self._rates(slides, 50.0 * rate**3, 1e4 * rate**3)
        if free and drawer.chance(0.8):
            linear = drawer.between(0.1, 2.0) * length * rate
            limits["base"] = {"linear": linear, "angular": drawer.between(0.1, 2.0) * rate}
        if tasks[0]["type"] == "frame" and drawer.chance(0.2):
            linear = drawer.between(0.05, 1.0) * length * rate
            limits["speed"] = {tasks[0]["name"]: {"linear": linear, "angular": rate}}
        if drawer.chance(0.2):
            limits["workspace"] = [self._plane() for _ in range(drawer.among(1, 1, 2))]
        if drawer.chance(0.65) and tree.geoms:
            limits["collision"] = self._collision()
        return limits

    def _rates(self, slides: list[str], low: float, high: float) -> Data:
        """Return limits of rates, those of slides in the lengths of the tree."""
        value = self._any(self.drawer.between(low, high))
        return {"default": value, **dict.fromkeys(slides, value * self.length)}

    def _ranges(self) -> Data:
        """Return the limit of positions, with ranges of its own for some joints."""
        drawer, tree = self.drawer, self.tree
        limit: Data = {"gain": drawer.among(0.5, 0.95, 1.0)}
        if drawer.chance(0.15):
            limit["margin"] = 0.01 * min(self.length, 1.0)
        for name in tree.scalars:
            if drawer.chance(0.1):
                unit = 0.3 * self.length if name.startswith("slide") else 1.0
                low, high = drawer.among(
                    (-1.0, 1.0), (0.5, 0.5), (-20.0, 30.0), (0.3, 0.31), (-0.2, 9.0)
                )
                limit[name] = [low * unit, high * unit]
        for name in tree.joints.get("ball", []):
            if drawer.chance(0.1):
                limit[name] = [0.0, drawer.among(0.2, 1.0, 3.0)]
        return limit

    def _plane(self) -> Data:
        drawer = self.drawer
        frame = drawer.among(*self.tree.frames)
        ((kind, name),) = frame.items()
        place: Array = (self._data.site if kind == "site" else self._data.body)(name).xpos
        normal = drawer.direction()
        offset = float(normal @ place) - self.length * drawer.among(0.01, 0.1, 0.3)
        return {"frame": frame, "normal": normal.tolist(), "offset": offset}

    def _collision(self) -> Data:
        drawer, tree, length = self.drawer, self.tree, self.length
        d_min = self._any(length * drawer.among(0.0, 0.005, 0.02))
        limit: Data = {
            "d_min": d_min,
            "detect": d_min + self._any(length * drawer.among(0.02, 0.1, 1.0)),
            "gain": drawer.among(0.5, 0.9, 1.0),
            "push": 0.1 * length * self.rate,
        }
        if drawer.chance(0.6):
            shapes = [*tree.geoms, *tree.surroundings * 2]
            ends = [*tree.geoms[-3:], *tree.geoms]  # which get about most
            pairs = {
                tuple(drawer.rng.permutation([drawer.among(*ends), drawer.among(*shapes)]))
                for _ in range(drawer.among(1, 3, 10))
            }
            limit["pairs"] = [[str(a), str(b)] for a, b in sorted(pairs) if a != b]
        if drawer.chance(0.1) and len(tree.geoms) > 1:
            limit["exclude"] = [[tree.geoms[0], tree.geoms[1]]]
        return limit
