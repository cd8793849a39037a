"""Random trees of joints with all that MuJoCo hangs on them, and random stacks of tasks."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import rmrc
from fuzzing.numbers import Generator, among
from rmrc.errors import RmrcError

GEOMS = ("sphere", "capsule", "box", "ellipsoid", "cylinder")


@dataclass
class Scene:
    """A model as text, and the names in it."""

    xml: str = ""
    bodies: list[str] = field(default_factory=list)
    sites: list[str] = field(default_factory=list)
    geoms: list[str] = field(default_factory=list)
    mocaps: list[str] = field(default_factory=list)
    scalars: list[str] = field(default_factory=list)
    """Hinges and slides."""
    joints: list[str] = field(default_factory=list)
    free: bool = False
    equalities: int = 0

    def frame(self, rng: Generator) -> dict[str, str]:
        """Return a frame, as a task names it."""
        kind = among(rng, "site", "site", "body", "geom")
        return {kind: among(rng, *getattr(self, {"body": "bodies"}.get(kind, f"{kind}s")))}


def vector(rng: Generator, size: float = 0.3) -> str:
    """Return a random vector as MuJoCo reads it."""
    return " ".join(f"{x:.4g}" for x in rng.uniform(-size, size, 3))


def geom(rng: Generator, name: str) -> str:
    """Return a random geom."""
    size = " ".join(f"{x:.3g}" for x in rng.uniform(0.02, 0.08, 3))
    kind = among(rng, *GEOMS)
    return f'<geom name="{name}" type="{kind}" size="{size}" pos="{vector(rng, 0.1)}" mass="1"/>'


def scene(rng: Generator) -> Scene:
    """Return a random tree: hinges, slides, ball and free joints, mocap bodies, and equalities."""
    made = Scene()
    count = int(among(rng, 1, 2, 4, 8, 15))
    texts, children = [], {k: [] for k in range(-1, count)}
    for k in range(count):
        parent = int(rng.integers(-1, k)) if k and rng.random() < 0.3 else k - 1
        children[parent].append(k)
        joints = ""
        kinds = ["hinge", "hinge", "slide", "ball"] + ["free"] * (parent == -1)
        for j in range(int(among(rng, 1, 1, 1, 2))):
            kind = among(rng, *kinds) if j == 0 else among(rng, "hinge", "slide")
            joints += joint(rng, made, f"j{k}_{j}", kind)
            if kind in ("ball", "free"):
                break
        texts.append(
            f'<body name="b{k}" pos="{vector(rng)}" euler="{vector(rng, 90)}">{joints}'
            f'{geom(rng, f"g{k}")}<site name="s{k}" pos="{vector(rng)}"/>'
        )
        for names, letter in ((made.bodies, "b"), (made.sites, "s"), (made.geoms, "g")):
            names.append(f"{letter}{k}")

    def tree(k: int) -> str:
        return texts[k] + "".join(tree(child) for child in children[k]) + "</body>"

    world = "".join(tree(k) for k in children[-1])
    for k in range(int(among(rng, 0, 0, 1, 2))):
        made.mocaps.append(f"m{k}")
        made.geoms.append(f"o{k}")
        place = vector(rng, 1.0)
        world += f'<body name="m{k}" mocap="true" pos="{place}">{geom(rng, f"o{k}")}</body>'
    tendons, constraints = equalities(rng, made)
    made.xml = (
        f"<mujoco><worldbody>{world}</worldbody>"
        f"<tendon>{tendons}</tendon><equality>{constraints}</equality></mujoco>"
    )
    return made


def joint(rng: Generator, made: Scene, name: str, kind: str) -> str:
    """Return a random joint."""
    made.joints.append(name)
    if kind == "free":
        made.free = True
        return f'<freejoint name="{name}"/>'
    if kind == "ball":
        limited = among(rng, "", 'range="0 60"')
        return f'<joint name="{name}" type="ball" {limited}/>'
    made.scalars.append(name)
    limited = among(rng, "", 'range="-1 1.5"', 'range="-0.5 0.5"')
    axis = among(rng, "1 0 0", "0 1 0", "0 0 1", "0.5 -1 0.3")
    return f'<joint name="{name}" type="{kind}" axis="{axis}" pos="{vector(rng, 0.1)}" {limited}/>'


def equalities(rng: Generator, made: Scene) -> tuple[str, str]:
    """Return tendons and equality constraints, from none to some 60 rows."""
    tendons, constraints = "", ""
    for k in range(int(among(rng, 0, 0, 0, 1, 2, 12))):
        kind = among(rng, "connect", "weld", "joint", "joint", "tendon", "spatial")
        if kind in ("connect", "weld") and len(made.bodies) > 1:
            one, other = rng.choice(made.bodies, 2, replace=False)
            anchor = f'anchor="{vector(rng)}"' if kind == "connect" else ""
            constraints += f'<{kind} name="e{k}" body1="{one}" body2="{other}" {anchor}/>'
        elif kind == "joint" and len(made.scalars) > 1:
            one, other = rng.choice(made.scalars, 2, replace=False)
            constraints += f'<joint name="e{k}" joint1="{one}" joint2="{other}"/>'
        elif kind == "tendon" and made.scalars:
            parts = "".join(f'<joint joint="{name}" coef="0.7"/>' for name in made.scalars)
            tendons += f'<fixed name="t{k}">{parts}</fixed>'
            constraints += f'<tendon name="e{k}" tendon1="t{k}"/>'
        elif kind == "spatial" and len(made.sites) > 1:
            ends = rng.choice(made.sites, 2, replace=False)
            parts = "".join(f'<site site="{name}"/>' for name in ends)
            tendons += f'<spatial name="t{k}">{parts}</spatial>'
            constraints += f'<tendon name="e{k}" tendon1="t{k}"/>'
        else:
            continue
        made.equalities += 1
    return tendons, constraints


TASKS = (
    *("frame", "frame", "relative_frame", "com", "posture", "velocity", "smooth"),
    *("kinetic_energy", "look_at", "axis_align", "coupling", "loop", "manipulability"),
    *("centering", "clearance", "freeze"),
)


def task(rng: Generator, made: Scene, name: str) -> dict[str, Any]:
    """Return a random task of any type; it need not fit the scene."""
    kind = among(rng, *TASKS)
    found: dict[str, Any] = {"name": name, "type": kind}
    hard = rng.random() < 0.2
    if kind not in ("freeze", "loop", "coupling") and not hard and rng.random() < 0.4:
        found["level"] = int(rng.integers(3))
    if hard and kind in ("frame", "relative_frame", "com", "posture", "look_at", "axis_align"):
        found["hard"] = True
    weight = float(10.0 ** rng.uniform(-3, 2))
    if kind in ("frame", "relative_frame"):
        found["B"] = among(rng, weight, {"position": weight, "orientation": 0.0}, [weight] * 6)
        found["frame"] = made.frame(rng)
        if rng.random() < 0.2:
            found["clamp"] = {"position": 0.1}
        if not hard and rng.random() < 0.2:
            found["preserve"] = "direction"
    match kind:
        case "frame":
            found["axes"] = among(rng, "body", "world")
        case "relative_frame":
            found["root"] = made.frame(rng)
        case "look_at" | "axis_align" | "manipulability":
            found["frame"] = made.frame(rng)
        case "velocity":
            found["target"] = dict.fromkeys(made.scalars[:2], 0.3)
        case "coupling":
            found["coefficients"] = dict.fromkeys(made.scalars[:3], 1.0)
            found["hard"] = bool(rng.random() < 0.5)
        case "loop":
            found["hard"] = bool(rng.random() < 0.7)
        case "clearance":
            found["pairs"] = [[made.geoms[0], made.geoms[-1]]]
            found["distance"] = 0.5
        case "freeze":
            found["joints"] = [among(rng, *made.joints)]
        case _:
            pass
    return found


def limits(rng: Generator, made: Scene, tasks: list[dict[str, Any]]) -> dict[str, Any]:
    """Return random limits of every kind."""
    found: dict[str, Any] = {}
    if rng.random() < 0.8:
        found["velocity"] = {"default": float(10.0 ** rng.uniform(-1, 1))}
    if rng.random() < 0.5:
        found["acceleration"] = {"default": float(10.0 ** rng.uniform(-1, 2))}
        if rng.random() < 0.3:
            found["jerk"] = {"default": float(10.0 ** rng.uniform(1, 4))}
    if made.free and rng.random() < 0.7:
        found["base"] = {"linear": 1.0, "angular": 2.0}
    if rng.random() < 0.4:
        d_min = float(among(rng, 0.0, 0.01, 0.05))
        found["collision"] = {"pairs": "all", "d_min": d_min, "detect": d_min + 0.1}
    if rng.random() < 0.3:
        planes = int(among(rng, 1, 3))
        found["workspace"] = [
            {"frame": made.frame(rng), "normal": rng.normal(size=3).tolist(), "offset": -0.3}
            for _ in range(planes)
        ]
    moved = [t["name"] for t in tasks if t["type"] == "frame"]
    if moved and rng.random() < 0.3:
        found["speed"] = {moved[0]: among(rng, {"linear": 0.2}, {"linear": 0.5, "angular": 1.0})}
    return found


def config(rng: Generator, folder: Path) -> rmrc.Config | None:
    """Return a random configuration; None for one that does not fit together."""
    made = scene(rng)
    path = folder / "scene.xml"
    path.write_text(made.xml)
    tasks = [task(rng, made, f"task{k}") for k in range(1 + int(rng.integers(5)))]
    if made.equalities and rng.random() < 0.8:
        tasks.append({"name": "chains", "type": "loop", "hard": bool(rng.random() < 0.7)})
    data: dict[str, Any] = {
        "scene": str(path),
        "dt": float(among(rng, 1e-5, 0.002, 0.01, 0.1)),
        "tasks": tasks,
        "limits": limits(rng, made, tasks),
        "priority": among(rng, "soft", "soft", "strict"),
        "damping": {"adapt": among(rng, "off", "off", "sigma_min", "manipulability", "error")},
        "metric": among(rng, 0.0, 0.0, 0.1, "inertia"),
    }
    if rng.random() < 0.2:
        data["dofs"] = list(rng.choice(made.joints, 1 + len(made.joints) // 2, replace=False))
    if rng.random() < 0.2:
        data["solver"] = {"deadline": float(among(rng, 50.0, 500.0, 5000.0))}
    if rng.random() < 0.1:
        data["previous"] = "measured"
    try:
        return rmrc.Config.model_validate(data)
    except (RmrcError, ValueError):
        return None
