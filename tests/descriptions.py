"""Small files of our own: one for each kind of thing that a robot's file can have."""

INERTIAL = (
    '<inertial><mass value="1"/><inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/>'
    "</inertial>"
)


def link(name: str, inside: str = INERTIAL) -> str:
    return f'<link name="{name}">{inside}</link>'


def joint(
    name: str, kind: str, parent: str, child: str, inside: str = "", at: str = "0 0 0"
) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{at}"/>{inside}</joint>'
    )


TURN = '<axis xyz="0 0 1"/><limit lower="-2" upper="2" velocity="0.5" effort="10"/>'
"""About z, at no more than 0.5 rad/s."""

LINKS = link("base_link", "") + link("l1") + link("l2") + link("tool0", "")
JOINTS = (
    joint("j1", "revolute", "base_link", "l1", TURN)
    + joint("j2", "revolute", "l1", "l2", TURN, "0.5 0 0")
    + joint("tool", "fixed", "l2", "tool0", at="0.6 0 0")
)
ARM = LINKS + JOINTS
"""A planar arm with a tool that is fixed to it."""
SLIDE = '<axis xyz="0 {} 0"/><limit lower="0" upper="0.04" velocity="0.1" effort="5"/>'
FINGERS = (
    link("left")
    + link("right")
    + joint("f1", "prismatic", "l2", "left", SLIDE.format(1), "0.5 0.05 0")
    + joint(
        "f2",
        "prismatic",
        "l2",
        "right",
        SLIDE.format(-1) + '<mimic joint="f1" multiplier="1"/>',
        "0.5 -0.05 0",
    )
)
