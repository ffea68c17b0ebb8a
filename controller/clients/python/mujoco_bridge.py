"""Bridges the controller to a simulated xArm7 in MuJoCo, so that anyone sees it move.

    pip install mujoco iceoryx2
    controller --policy runs/sample-rope/policy.blob     (in another terminal)
    python3 mujoco_bridge.py --viewer                    (without --viewer it runs headless)
    python3 genorm_ipc.py 0.33                           (in a third terminal)
"""

import argparse
import sys

import arm_bridge
from genorm_ipc import JOINTS, NotConnected
from xarm7_mjcf import LEVEL_POSTURE_RAD, mjcf

STEPS_PER_PERIOD = 4


class MujocoArm:
    """An xArm7 with position servos in every joint."""

    def __init__(self, viewer=False):
        import mujoco

        self.mujoco = mujoco
        self.model = mujoco.MjModel.from_xml_string(mjcf(arm_bridge.PERIOD_S / STEPS_PER_PERIOD))
        self.data = mujoco.MjData(self.model)
        self.data.qpos[:JOINTS] = LEVEL_POSTURE_RAD
        self.data.ctrl[:JOINTS] = LEVEL_POSTURE_RAD
        self.grip(False)
        mujoco.mj_forward(self.model, self.data)
        self.viewer = None
        if viewer:
            import mujoco.viewer

            self.viewer = mujoco.viewer.launch_passive(self.model, self.data)
        self.period = 0

    def read(self):
        """Joints of the simulation, which goes on by one period."""
        for _ in range(STEPS_PER_PERIOD):
            self.mujoco.mj_step(self.model, self.data)
        self.period += 1
        if self.viewer is not None and self.period % 5 == 0:
            self.viewer.sync()
        return list(self.data.qpos[:JOINTS]), list(self.data.qvel[:JOINTS]), 0

    def command(self, q_rad):
        """Moves the servos' set points."""
        self.data.ctrl[:JOINTS] = q_rad

    def grip(self, closed):
        """Moves the fingers' set points."""
        self.data.ctrl[JOINTS:] = 0.0 if closed else 0.04

    def gripped(self):
        """Whether the fingers' set points are closed."""
        return not self.data.ctrl[JOINTS:].any()

    def recover(self):
        """A simulated arm has no errors."""

    def flange_m(self):
        """Where the flange is, m."""
        return self.data.site("flange").xpos.copy()

    def close(self):
        """Closes the window."""
        if self.viewer is not None:
            self.viewer.close()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--instance", default="genorm", help="name of the controller")
    parser.add_argument("--seconds", type=float, help="end after this time")
    parser.add_argument("--viewer", action="store_true", help="show a window")
    arguments = parser.parse_args()
    try:
        arm = MujocoArm(arguments.viewer)
    except ImportError:
        print("mujoco_bridge: MuJoCo is missing: pip install mujoco", file=sys.stderr)
        return 1
    try:
        arm_bridge.run(arm, arguments.instance, arguments.seconds)
    except NotConnected as error:
        print(f"mujoco_bridge: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
