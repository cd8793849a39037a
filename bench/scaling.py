"""How the step grows with the degrees of freedom, with the tasks, and with the collision pairs.

Chains of hinges are made for it: 2 m long, their axes y and z in turn, without geoms but where
pairs are asked for. Spheres then stand around the chain, none nearer than the least distance, a few
near enough to be rows. Both engines take turns where both are there; medians in µs go into the file
of `--json FILE` under `scaling`, and into the plot that `--plot FILE` names.
"""

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import rmrc
from cases import offsets
from peers.side import timed
from plot import Panel, draw
from timing import COLD, RUN, StepsOf, alternating, figures, machine, parser, turns, write

WARM_UP, STEPS = 60, 300
LENGTH = 2.0  # m
BEND = 0.8  # rad, of the whole chain, either way
D_MIN, DETECT = 0.02, 0.1  # m
LINK_RADIUS, RADIUS = 0.02, 0.03  # m, of the chain's spheres and of those around it
DOFS = (7, 14, 28, 50, 100)
TASKS = (1, 2, 4, 8, 16, 32)
LINKS = 10
AROUND = (0, 1, 3, 10, 30, 100)
"""Spheres around a chain of ten links: each is a pair with each link."""


def chain(joints: int, around: np.ndarray | None = None) -> str:
    """Return the MJCF of a chain, and of spheres around it (n, 3) to keep away from."""
    step = LENGTH / joints
    spheres = "" if around is None else f'<geom size="{LINK_RADIUS}" pos="{step} 0 0"/>'
    links = "".join(
        f'<body name="link{k}" pos="{step if k else 0} 0 0"><joint name="joint{k}"'
        f' axis="0 {(k + 1) % 2} {k % 2}" range="-2.5 2.5"/>{spheres}'
        f'<inertial pos="{step / 2} 0 0" mass="1" diaginertia=".01 .01 .01"/>'
        f'<site name="site{k}" pos="{step} 0 0"/>'
        for k in range(joints)
    )
    still = "".join(
        f'<geom size="{RADIUS}" pos="{x} {y} {z}"/>'
        for x, y, z in (around if around is not None else ())
    )
    return (
        '<mujoco><compiler angle="radian" autolimits="true"/><worldbody>'
        f'<body name="around">{still}</body>{links}{"</body>" * joints}</worldbody></mujoco>'
    )


def bent(joints: int) -> dict[str, float]:
    """Return a configuration that is far from straight."""
    return {f"joint{k}": BEND * (-1) ** (k // 2) * 7 / joints for k in range(joints)}


def place(count: int) -> np.ndarray:
    """Return places (count, 3) for spheres around the chain of ten links as it is bent."""
    config = {"scene": "", "tasks": [], "start": bent(LINKS)}
    problem = build(chain(LINKS), config | frames(range(LINKS)))
    links = np.array([problem.term[f"site{k}"].target[4:] for k in range(LINKS)])
    generator, found = np.random.default_rng(0), []
    while len(found) < count:
        point = generator.uniform(links.min(axis=0) - 0.4, links.max(axis=0) + 0.4)
        gap = np.linalg.norm(links - point, axis=1).min() - LINK_RADIUS - RADIUS
        if gap > 2 * D_MIN:
            found.append(point)
    return np.array(found).reshape(-1, 3)


def frames(sites: Sequence[int]) -> dict[str, Any]:
    """Return the part of a configuration that has a task on each of some sites, and a posture."""
    return {
        "tasks": [
            *(
                {"name": f"site{k}", "type": "frame", "frame": {"site": f"site{k}"}, "gain": 10.0}
                for k in sites
            ),
            {"name": "posture", "type": "posture", "B": 1e-2, "gain": 1.0},
        ]
    }


def build(mjcf: str, config: dict[str, Any]) -> rmrc.Problem:
    """Return the problem of a model given as text."""
    with tempfile.TemporaryDirectory() as folder:
        scene = Path(folder) / "chain.xml"
        scene.write_text(mjcf)
        return rmrc.compile(rmrc.Config.model_validate(config | {"scene": str(scene)}))


def dofs_problem(joints: int) -> rmrc.Problem:
    """Return a chain of so many joints with a task on its tip."""
    return build(chain(joints), {"start": bent(joints)} | frames([joints - 1]))


def tasks_problem(count: int) -> rmrc.Problem:
    """Return a chain of 32 joints with so many tasks, on the links from the tip inwards."""
    joints = max(TASKS)
    sites = range(joints - count, joints)
    return build(chain(joints), {"start": bent(joints)} | frames(sites))


def pairs_problem(count: int) -> rmrc.Problem:
    """Return a chain of ten joints with so many pairs."""
    pairs = [[f"link{k}", "around"] for k in range(LINKS)]
    collision = {"pairs": pairs, "d_min": D_MIN, "detect": DETECT}
    limits = {"collision": collision} if count else {}
    mjcf = chain(LINKS, place(count // LINKS))
    return build(mjcf, {"start": bent(LINKS), "limits": limits} | frames([LINKS - 1]))


def measure(problem: rmrc.Problem) -> dict[str, float]:
    """Return each engine's median in µs."""
    moves = offsets(turns(WARM_UP, STEPS) * (COLD + RUN))
    automatic = rmrc.Controller(problem)
    controllers = [automatic, rmrc.Controller(problem, engine="python")]
    sides = {c.engine.name: steps_of(c, moves) for c in controllers}
    times = alternating(sides, WARM_UP, STEPS)
    return {name: figures(taken)["median_us"] for name, taken in times.items()}


def steps_of(controller: rmrc.Controller, moves: np.ndarray) -> StepsOf:
    """Return what takes steps with a controller and times them."""
    terms = [term for term in controller.problem.terms if term.target_kind == "pose"]
    poses = [(t.name, list(t.target[4:] + moves), t.target[:4].copy()) for t in terms]

    def step(k: int) -> np.ndarray:
        for name, positions, quaternion in poses:
            controller.set_target(name, positions[k], quaternion)
        return controller.step().q

    return lambda begin, end: [timed(step, k) for k in range(begin, end)]


SWEEPS: dict[str, tuple[str, Sequence[int], Callable[[int], rmrc.Problem]]] = {
    "nv": ("degrees of freedom, one frame", DOFS, dofs_problem),
    "tasks": (f"frames, {max(TASKS)} degrees of freedom", TASKS, tasks_problem),
    "pairs": ("collision pairs, 10 degrees of freedom", [LINKS * n for n in AROUND], pairs_problem),
}


def main() -> None:
    """Run the sweeps, print a row for each point, and draw them."""
    command = parser(__doc__)
    command.add_argument("--plot", type=Path, help="draw the figures into this SVG file")
    arguments = command.parse_args()
    print(f"machine: {machine()}; {WARM_UP} + {STEPS} steps in turns of {RUN}")
    found: dict[str, Any] = {}
    panels = []
    for name, (label, sizes, problem_of) in SWEEPS.items():
        found[name] = [{"size": size, **measure(problem_of(size))} for size in sizes]
        for row in found[name]:
            times = ", ".join(f"{row[side]:.1f} µs {side}" for side in row if side != "size")
            print(f"{name:6} {row['size']:5} {times}")
        panels.append(Panel(label, found[name]))
    write(arguments.json, "scaling", found)
    if arguments.plot:
        arguments.plot.write_text(draw(panels))


if __name__ == "__main__":
    main()
