"""Arms beside cups and doors."""

from typing import Any

CUP = '<body name="cup" pos=".5 .35 .3"><freejoint name="cup_free"/>'
CUP += '<geom name="cup_geom" type="sphere" size=".04" mass="5"/></body>'
DOOR = """
<body name="door" pos="-.6 0 .3"><joint name="door_hinge" range="0 1" limited="true"/>
  <geom name="panel" type="box" size=".01 .2 .2" pos="0 .2 0"/>
  <body name="latch"><joint name="latch_slide" type="slide" axis="0 1 0"/>
    <geom name="bolt" size=".02" pos="0 .4 0"/></body></body>
"""
ARM = """
<body name="base" pos="0 0 .3">
  <joint name="j1" axis="0 0 1" range="-3 3" limited="true"/>
  <geom name="upper" type="capsule" fromto="0 0 0 .4 0 0" size=".03"/>
  <body name="fore" pos=".4 0 0"><joint name="j2" axis="0 0 1" range="-2.5 2.5" limited="true"/>
    <geom name="hand_geom" type="capsule" fromto="0 0 0 .4 0 0" size=".03"/>
    <site name="tcp" pos=".4 0 0"/></body></body>
"""
MOTORS = '<actuator><motor joint="j1"/><motor joint="j2"/></actuator>'
BENT = {"j1": -0.8, "j2": 1.6}


def scene(*parts: str, actuators: str = "") -> str:
    """Return a scene of parts on a floor."""
    return f"""<mujoco><compiler angle="radian"/><worldbody>
        <geom name="floor" type="plane" size="2 2 .1"/>{"".join(parts)}</worldbody>
        {actuators}</mujoco>"""


HAND: dict[str, Any] = {"name": "hand", "type": "frame", "frame": {"site": "tcp"},
                        "B": {"position": 1.0, "orientation": 0.0}}  # fmt: skip
POSTURE: dict[str, Any] = {"name": "posture", "type": "posture", "level": 1}
GRASP = {"name": "grasp", "type": "relative_frame", "frame": {"site": "tcp"},
         "root": {"body": "cup"}, "B": {"position": 1.0, "orientation": 0.0}}  # fmt: skip
DRIVEN = scene(ARM, CUP, DOOR, actuators=MOTORS)
