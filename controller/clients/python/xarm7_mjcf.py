"""A minimal xArm7 for MuJoCo, made from the manufacturer's kinematic table: capsules for links, position
servos for motors. Masses are plausible shares of the arm's 13.7 kg, not the manufacturer's figures; the
kinematics are exact (a test compares them with `controller fk`).

Table (modified Denavit-Hartenberg): ufactory_docs, kinematic-and-dynamic-parameters, xarm-7.
"""

import math

# alpha(i-1) in quarter turns, a(i-1) in m, d(i) in m.
TABLE = [
    (0, 0.0, 0.267),
    (-1, 0.0, 0.0),
    (1, 0.0, 0.293),
    (1, 0.0525, 0.0),
    (1, 0.0775, 0.3425),
    (1, 0.0, 0.0),
    (-1, 0.076, 0.097),
]

# The narrower range of both hardware revisions, rad.
RANGES_RAD = [
    (-2 * math.pi, 2 * math.pi),
    (-2.042035, 2.024581),
    (-2 * math.pi, 2 * math.pi),
    (-0.10472, 3.92699),
    (-2 * math.pi, 2 * math.pi),
    (-1.692969, math.pi),
    (-2 * math.pi, 2 * math.pi),
]

# Where the controller's tests begin: the tool about level.
LEVEL_POSTURE_RAD = [0.0, 0.2, 0.0, 1.0, math.pi, 1.3, 0.0]

LINK_KG = [2.6, 2.2, 2.0, 1.8, 1.5, 1.2, 0.5]
STIFFNESS = [4000, 4000, 3000, 3000, 1500, 1500, 800]


def _quaternion_about_x(quarter_turns):
    angle = quarter_turns * math.pi / 2
    return f"{math.cos(angle / 2)!r} {math.sin(angle / 2)!r} 0 0"


def _body(index):
    """Body of joint `index` and everything after it: T(i) = Rx(alpha) Tx(a) Rz(theta) Tz(d)."""
    if index == len(TABLE):
        return (
            '<site name="flange" size="0.01"/>'
            '<geom type="cylinder" size="0.03 0.01" pos="0 0 0.01" rgba="0.3 0.3 0.3 1"/>'
            + _finger("left", 1)
            + _finger("right", -1)
        )
    quarter_turns, a_m, d_m = TABLE[index]
    # Rx(alpha) takes the offset along the joint's own z axis to the parent's frame.
    y_m, z_m = (-quarter_turns * d_m, 0.0) if quarter_turns else (0.0, d_m)
    low, high = RANGES_RAD[index]
    ahead = TABLE[index + 1] if index + 1 < len(TABLE) else (0, 0.0, 0.05)
    turns, next_a, next_d = ahead
    end = (next_a, -turns * next_d if turns else 0.0, 0.0 if turns else next_d)
    length = math.hypot(*end)
    shape = (
        f'<geom type="capsule" size="0.04" fromto="0 0 0 {end[0]!r} {end[1]!r} {end[2]!r}" mass="{LINK_KG[index]}"/>'
        if length > 0.01
        else f'<geom type="sphere" size="0.05" mass="{LINK_KG[index]}"/>'
    )
    return (
        f'<body name="link{index + 1}" gravcomp="1" pos="{a_m!r} {y_m!r} {z_m!r}" quat="{_quaternion_about_x(quarter_turns)}">'
        f'<joint name="joint{index + 1}" axis="0 0 1" range="{low!r} {high!r}" damping="10" armature="0.5"/>'
        f"{shape}{_body(index + 1)}</body>"
    )


def _finger(name, side):
    return (
        f'<body name="{name}" gravcomp="1" pos="0 0 0.06"><joint name="{name}" type="slide" axis="0 {side} 0" '
        'range="0 0.04" damping="5"/>'
        f'<geom type="box" size="0.01 0.005 0.04" pos="0 {0.006 * side} 0" mass="0.1" rgba="0.2 0.2 0.6 1"/></body>'
    )


def mjcf(step_s=0.001):
    """The model as MJCF text."""
    servos = "".join(
        f'<position joint="joint{i + 1}" kp="{stiffness}" kv="{stiffness // 20}"/>'
        for i, stiffness in enumerate(STIFFNESS)
    )
    fingers = "".join(f'<position joint="{name}" kp="200" kv="5"/>' for name in ("left", "right"))
    return (
        '<mujoco model="xarm7"><compiler angle="radian"/>'
        f'<option timestep="{step_s!r}" integrator="implicitfast"/>'
        '<default><geom contype="0" conaffinity="0" rgba="0.85 0.85 0.85 1"/></default>'
        '<worldbody><light pos="0 0 3"/><geom type="plane" size="2 2 0.1" rgba="0.6 0.7 0.6 1"/>'
        f"{_body(0)}</worldbody><actuator>{servos}{fingers}</actuator></mujoco>"
    )


if __name__ == "__main__":
    print(mjcf())
