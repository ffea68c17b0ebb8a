"""Bridges the controller to a real xArm7: `python3 xarm_bridge.py 192.168.1.185`.

Needs `pip install xarm-python-sdk iceoryx2`. The arm is streamed to in mode 1 (servo motion), where only
the newest point counts. Before the first run: payload and tool set in UFACTORY Studio, the emergency stop
within reach, the arm in a posture from which the task is free of obstacles, `controller --dry-run` seen.
"""

import argparse
import queue
import sys
import threading

import arm_bridge
from arm_bridge import NO_ANSWER, ArmError
from genorm_ipc import JOINTS, NotConnected

SERVO_MODE = 1
READY = 0

# Pulses of the gripper G1; the SDK does not clip them.
GRIPPER_OPEN, GRIPPER_CLOSED = 850, 0
# Fingers nearer to each other than this may hold something.
GRIPPER_SURELY_OPEN = 800
# Its fastest, r/min.
GRIPPER_SPEED = 5000

# Reported when the gripper did not do what it was told, beside the code that it answers.
GRIPPER_FAILED = 900


class XArm:
    """An xArm7 behind the vendor's SDK; `api` is an XArmAPI, or something that looks like one."""

    def __init__(self, api):
        self.api = api
        self.wishes = queue.Queue()
        self.gripper_error = 0
        self.gripper_thread = threading.Thread(target=self._serve_gripper, daemon=True)
        self.recover()
        self._check("enable the gripper", api.set_gripper_enable(True))
        self._check("set the gripper's mode", api.set_gripper_mode(0))
        self._check("set the gripper's speed", api.set_gripper_speed(GRIPPER_SPEED))
        self.gripper_thread.start()

    @staticmethod
    def _check(what, code):
        if code != 0:
            raise ArmError(f"cannot {what}: the SDK answers {code}", code if code > 0 else NO_ANSWER)

    def read(self):
        """Joints as the encoders measure them, and the control box's error code."""
        code, states = self.api.get_joint_states(is_radian=True, num=2)
        if code != 0:
            # The last known joints with an error: never a pose made up as if it were measured now.
            return self.q_rad, [0.0] * JOINTS, self.api.error_code or NO_ANSWER
        self.q_rad = list(states[0][:JOINTS])
        return self.q_rad, list(states[1][:JOINTS]), self.api.error_code or self.gripper_error

    def command(self, q_rad):
        """One point of the stream."""
        code = self.api.set_servo_angle_j(q_rad, is_radian=True)
        if code != 0:
            raise ArmError(f"the arm refuses a point: the SDK answers {code}", self.api.error_code or NO_ANSWER)

    def grip(self, closed):
        """Leaves the gripper to its own thread: its bus is slow and must not hold up the stream."""
        self.wishes.put(closed)

    def gripped(self):
        """Whether the fingers may hold something; a gripper that does not answer may."""
        code, position = self.api.get_gripper_position()
        return code != 0 or position < GRIPPER_SURELY_OPEN

    def _serve_gripper(self):
        while (closed := self.wishes.get()) is not None:
            while not self.wishes.empty():
                newer = self.wishes.get()
                if newer is None:
                    return
                closed = newer
            code = self.api.set_gripper_position(GRIPPER_CLOSED if closed else GRIPPER_OPEN, wait=False)
            if code != 0:
                print(f"xarm_bridge: the gripper answers {code}")
                # An arm that goes on would pull at a rope that was not let go, or leave one that was not grasped.
                self.gripper_error = GRIPPER_FAILED + min(abs(code), 90)

    def recover(self):
        """After any error the arm is in state 4: clear, enable, mode 1, ready, and read the pose anew."""
        api = self.api
        api.clean_error()
        api.clean_warn()
        self._check("enable the motors", api.motion_enable(True))
        self._check("switch to servo mode", api.set_mode(SERVO_MODE))
        self._check("make the arm ready", api.set_state(READY))
        if api.error_code:
            raise ArmError(f"error {api.error_code} stays: look at the arm", api.error_code)
        if self.gripper_error:
            api.clean_gripper_error()
            self._check("enable the gripper", api.set_gripper_enable(True))
            self.gripper_error = 0
        code, states = api.get_joint_states(is_radian=True, num=2)
        self._check("read the joints", code)
        self.q_rad = list(states[0][:JOINTS])

    def close(self):
        """The arm stays at its last point."""
        self.wishes.put(None)
        if self.gripper_thread.is_alive():
            self.gripper_thread.join(timeout=2)
        self.api.disconnect()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("address", help="of the control box")
    parser.add_argument("--instance", default="genorm", help="name of the controller")
    parser.add_argument("--seconds", type=float, help="end after this time")
    arguments = parser.parse_args()
    try:
        from xarm.wrapper import XArmAPI
    except ImportError:
        print("xarm_bridge: the vendor's SDK is missing: pip install xarm-python-sdk", file=sys.stderr)
        return 1
    try:
        api = XArmAPI(arguments.address, is_radian=True)
    # The SDK raises plain exceptions.
    except Exception as error:
        print(
            f"xarm_bridge: no arm answers at {arguments.address} ({error}): is the control box on and reachable?",
            file=sys.stderr,
        )
        return 1
    try:
        arm_bridge.run(XArm(api), arguments.instance, arguments.seconds)
    except (ArmError, NotConnected) as error:
        print(f"xarm_bridge: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
