"""The bridges without an arm: an XArmAPI that only pretends, and a controller's port that only notes.

Needs CPython alone: `python3 test_bridges.py`.
"""

import contextlib
import io
import math
import sys
import time
import types
import unittest
import xml.etree.ElementTree as ElementTree
from unittest import mock

import arm_bridge
import genorm_ipc
import xarm7_mjcf
import xarm_bridge
from arm_bridge import NO_ANSWER, RECOVERY_PAUSE_S, STEP_MAX_RAD, STREAM_TORN, TARGET_AGE_MAX_S, ArmError, Bridge
from genorm_ipc import JOINTS, Gripper, JointTarget, NotConnected, Phase
from xarm_bridge import GRIPPER_CLOSED, GRIPPER_FAILED, GRIPPER_OPEN, XArm


class FakeXArmAPI:
    """Answers like the vendor's SDK and notes what it was asked."""

    def __init__(self):
        self.calls = []
        self.q_rad = list(xarm7_mjcf.LEVEL_POSTURE_RAD)
        self.error_code = 0
        self.clearable = True
        self.answers = True
        self.gripper_answer = (0, GRIPPER_OPEN)
        self.gripper_obeys = True

    def __getattr__(self, name):
        def call(*arguments, **options):
            self.calls.append((name, arguments, options))
            return 0

        return call

    def get_joint_states(self, is_radian=None, num=3):
        return (0 if self.answers else -1), [self.q_rad + [], [0.0] * JOINTS]

    def get_gripper_position(self):
        return self.gripper_answer

    def set_gripper_position(self, position, wait=True):
        self.calls.append(("set_gripper_position", (position,), {"wait": wait}))
        return 0 if self.gripper_obeys else 19

    def set_servo_angle_j(self, angles, is_radian=None):
        self.calls.append(("set_servo_angle_j", tuple(angles), {"is_radian": is_radian}))
        if self.error_code:
            return 1
        self.q_rad = list(angles)
        return 0

    def clean_error(self):
        self.calls.append(("clean_error", (), {}))
        if self.clearable:
            self.error_code = 0
        return 0

    def asked(self, name):
        return [call for call in self.calls if call[0] == name]


class FakePort:
    """The controller's side, with a clock of its own."""

    def __init__(self):
        self.now_s = 100.0
        self.target = None
        self.seq = 0
        self.states = []
        self.stamps_ns = []

    def newest_target(self):
        return self.target

    def send_state(self, q_rad, dq_rad_s, error_code, gripper, stamp_ns):
        self.states.append((list(q_rad), error_code, gripper))
        self.stamps_ns.append(stamp_ns)

    def next(self, q_rad, gripper=Gripper.OPEN, stream=1):
        self.seq += 1
        stamp_ns = round(self.now_s * 1e9)
        self.target = JointTarget(seq=self.seq, stamp_ns=stamp_ns, gripper=gripper, stream=stream)
        self.target.q_rad[:] = q_rad

    def clear(self):
        """No targets are sent now: zeros, though new. (The real ones lack the magic word too.)"""
        self.target = JointTarget(stamp_ns=round(self.now_s * 1e9))


class WithFakes(unittest.TestCase):
    def setUp(self):
        self.api = FakeXArmAPI()
        self.port = FakePort()
        self.arm = XArm(self.api)
        self.bridge = self.start()
        self.addCleanup(self.arm.close)
        silent = contextlib.redirect_stdout(io.StringIO())
        silent.__enter__()
        self.addCleanup(silent.__exit__, None, None, None)

    def start(self):
        """A bridge as after a start or a new connection."""
        return Bridge(self.arm, self.port, clock=lambda: self.port.now_s)

    def near(self, by_rad):
        return [angle + by_rad for angle in self.api.q_rad]


class Streaming(WithFakes):
    def test_the_arm_is_made_ready_in_the_vendors_order(self):
        names = [name for name, _, _ in self.api.calls]
        order = ["clean_error", "clean_warn", "motion_enable", "set_mode", "set_state"]
        self.assertEqual([name for name in names if name in order], order)
        self.assertEqual(self.api.asked("set_mode")[0][1], (1,))

    def test_each_target_is_sent_once_in_radians(self):
        goal = self.near(0.01)
        self.port.next(goal)
        self.bridge.turn(Phase.IDLE)
        self.bridge.turn(Phase.IDLE)
        sent = self.api.asked("set_servo_angle_j")
        self.assertEqual([(list(angles), options["is_radian"]) for _, angles, options in sent], [(goal, True)])
        self.assertEqual(self.port.states[-1][0], goal)

    def test_a_point_far_from_the_arm_is_never_sent(self):
        self.port.next(self.near(0.5))
        self.bridge.turn(Phase.IDLE)
        self.assertEqual(self.api.asked("set_servo_angle_j"), [])

    def test_targets_that_were_left_out_are_not_made_up_for_in_one_step(self):
        self.port.next(self.near(0.01))
        self.bridge.turn(Phase.HOMING)
        for _ in range(8):
            # This program is held up in a fast motion.
            self.port.next(self.near(1.1 * STEP_MAX_RAD))
        self.bridge.turn(Phase.HOMING)
        self.assertEqual(len(self.api.asked("set_servo_angle_j")), 1)
        self.bridge.turn(Phase.HOMING)
        self.assertEqual(self.port.states[-1][1], STREAM_TORN)
        self.bridge.turn(Phase.FAULT)
        self.port.next(self.near(0.0))
        self.bridge.turn(Phase.IDLE)
        self.assertEqual(len(self.api.asked("set_servo_angle_j")), 2)

    def test_a_new_stream_begins_where_a_person_has_guided_the_arm(self):
        self.port.next(self.near(0.0))
        self.bridge.turn(Phase.IDLE)
        self.api.q_rad = self.near(2 * STEP_MAX_RAD)
        self.port.next(self.near(0.0), stream=2)
        self.bridge.turn(Phase.IDLE)
        self.assertEqual(len(self.api.asked("set_servo_angle_j")), 2)
        self.bridge.turn(Phase.IDLE)
        self.assertEqual(self.port.states[-1][1], 0)

    def test_the_gripper_is_told_once_per_change_without_waiting(self):
        for gripper in (Gripper.CLOSED, Gripper.CLOSED, Gripper.OPEN, Gripper.CLOSED):
            self.port.next(self.near(0.001), gripper)
            self.bridge.turn(Phase.GRASP)
            deadline = time.monotonic() + 5
            while not self.arm.wishes.empty() and time.monotonic() < deadline:
                time.sleep(0.001)
        self.arm.close()
        told = self.api.asked("set_gripper_position")
        self.assertEqual([arguments[0] for _, arguments, _ in told], [GRIPPER_CLOSED, GRIPPER_OPEN, GRIPPER_CLOSED])
        self.assertTrue(all(options == {"wait": False} for _, _, options in told))

    def test_a_gripper_that_holds_something_is_reported_and_left_closed(self):
        for answer in ((0, 140), (0, 0), (3, 850)):
            self.api.gripper_answer = answer
            bridge = self.start()
            bridge.turn(Phase.WAITING)
            self.assertEqual(self.port.states[-1][2], Gripper.CLOSED, answer)
            self.port.next(self.near(0.0), Gripper.CLOSED)
            bridge.turn(Phase.IDLE)
        self.assertEqual(self.api.asked("set_gripper_position"), [])

    def test_a_reading_that_takes_long_is_as_old_as_when_it_was_asked_for(self):
        read = self.arm.read

        def slow():
            time.sleep(0.05)
            return read()

        self.arm.read = slow
        self.bridge.turn(Phase.IDLE)
        self.assertGreaterEqual(time.monotonic_ns() - self.port.stamps_ns[-1], 50_000_000)


class Old(WithFakes):
    """Targets that were made before the arm may have been moved by hand."""

    def sent(self):
        return [list(angles) for _, angles, _ in self.api.asked("set_servo_angle_j")]

    def test_a_restarted_bridge_does_not_send_what_it_finds(self):
        self.port.next(self.near(0.1))
        bridge = self.start()
        bridge.turn(Phase.WAITING)
        bridge.turn(Phase.WAITING)
        self.assertEqual(self.sent(), [])
        goal = self.near(0.0)
        self.port.next(goal)
        bridge.turn(Phase.IDLE)
        self.assertEqual(self.sent(), [goal])

    def test_an_old_target_is_not_sent(self):
        goal = self.near(0.04)
        self.port.next(goal)
        self.port.now_s += TARGET_AGE_MAX_S + 0.001
        self.bridge.turn(Phase.IDLE)
        self.assertEqual(self.sent(), [])
        self.port.next(goal)
        self.port.now_s += TARGET_AGE_MAX_S - 0.001
        self.bridge.turn(Phase.IDLE)
        self.assertEqual(self.sent(), [goal])

    def test_zeros_are_no_target(self):
        self.api.q_rad = [0.01] * JOINTS
        for bridge in (self.bridge, self.start()):
            self.port.clear()
            bridge.turn(Phase.WAITING)
            self.port.next(self.near(0.0))
            bridge.turn(Phase.IDLE)
            self.port.clear()
            bridge.turn(Phase.FAULT)
        self.assertEqual(self.sent(), [[0.01] * JOINTS] * 2)

    def test_the_port_takes_zeros_for_none_and_reports_what_it_read(self):
        board = JointTarget()
        client = mock.Mock()
        port = genorm_ipc.ArmPort(client)
        port._newest.get.return_value.decode_as.side_effect = lambda kind: board
        states = client._publisher.return_value.send_copy
        for magic, seq, read in ((0, 0, 0), (board.magic, 0, 0), (board.magic, 7, 7), (0, 0, 7)):
            board.magic, board.seq = magic, seq
            self.assertEqual(port.newest_target(), board if magic and seq else None)
            port.send_state([0.0] * JOINTS, [0.0] * JOINTS)
            self.assertEqual(states.call_args.args[0].target_seq, read)


class SendError(Exception):
    """One of iceoryx2's own, for want of it."""


class Reconnecting(WithFakes):
    """What `run` does when the controller is gone in the middle of something."""

    def run_bridge(self, *connections):
        """Runs the bridge on these connections, until a Ctrl-C after the last; returns what it printed."""
        said = io.StringIO()
        iceoryx2 = types.ModuleType("iceoryx2")
        iceoryx2.SendError = SendError
        with (
            mock.patch.dict(sys.modules, {"iceoryx2": iceoryx2}),
            mock.patch.object(arm_bridge.Client, "connect", side_effect=[*connections, KeyboardInterrupt]),
            mock.patch.object(arm_bridge, "RECONNECT_PAUSE_S", 0.0),
            contextlib.redirect_stdout(said),
        ):
            arm_bridge.run(self.arm)
        return said.getvalue()

    def connection(self, port):
        client = mock.Mock()
        client.arm.return_value = port
        client.next_status.return_value = None
        return client

    def test_a_controller_killed_at_any_point_is_waited_for(self):
        unreachable = self.connection(self.port)
        unreachable.arm.side_effect = SendError("while the arm's ports are made")
        unheard = self.connection(mock.Mock(wraps=self.port))
        unheard.arm.return_value.send_state.side_effect = SendError("while a state is sent")
        silent = self.connection(self.port)
        silent.next_status.side_effect = SendError("while a status is read")
        gone = SendError("while connecting"), NotConnected("no controller runs as instance 'genorm'")
        said = self.run_bridge(unreachable, unheard, silent, *gone)
        for point in ("the arm's ports are made", "a state is sent", "a status is read", "connecting"):
            self.assertIn(f"bridge: SendError: while {point}; connecting again\n", said)
        self.assertEqual(len(said.splitlines()), 4, "who waits for a controller says nothing")
        self.assertEqual(len(self.api.asked("disconnect")), 1, "the arm is left at rest, once, at the end")

    def test_a_new_connection_begins_without_what_it_finds(self):
        self.port.next(self.near(0.1))
        self.port.target.stamp_ns = time.monotonic_ns()
        client = self.connection(self.port)
        with mock.patch.object(arm_bridge, "SILENCE_S", 0.02):
            said = self.run_bridge(client, client)
        self.assertEqual(said.count("the controller fell silent"), 2)
        self.assertGreater(len(self.port.states), 2)
        self.assertEqual(self.api.asked("set_servo_angle_j"), [])

    def test_a_failure_that_is_not_the_transports_ends_the_bridge(self):
        for error in (ValueError("a bug"), NotConnected("speaks protocol 99")):
            with self.assertRaises(type(error)):
                self.run_bridge(error)


class Errors(WithFakes):
    def fail(self, code):
        self.api.error_code = code
        self.port.next(self.near(0.001))
        self.bridge.turn(Phase.DRAG)

    def test_an_error_is_reported_until_the_controller_has_latched_it(self):
        self.fail(31)
        for _ in range(5):
            self.bridge.turn(Phase.STOPPING)
        self.assertEqual({state[1] for state in self.port.states}, {31})
        self.assertEqual(self.api.error_code, 31)
        self.bridge.turn(Phase.FAULT)
        self.assertEqual(self.api.error_code, 0)
        self.bridge.turn(Phase.FAULT)
        self.assertEqual(self.port.states[-1][1], 0)

    def test_nothing_is_sent_from_an_error_until_a_new_target_comes(self):
        self.fail(24)
        sent = len(self.api.asked("set_servo_angle_j"))
        self.port.next(self.near(0.002))
        self.bridge.turn(Phase.STOPPING)
        self.bridge.turn(Phase.FAULT)
        self.bridge.turn(Phase.FAULT)
        self.assertEqual(len(self.api.asked("set_servo_angle_j")), sent)
        self.port.clear()
        self.bridge.turn(Phase.WAITING)
        self.port.next(self.near(0.0))
        self.bridge.turn(Phase.IDLE)
        self.assertEqual(len(self.api.asked("set_servo_angle_j")), sent + 1)

    def test_an_error_that_stays_is_tried_again_after_a_pause(self):
        self.api.clearable = False
        self.fail(2)
        before = len(self.api.asked("clean_error"))
        self.bridge.turn(Phase.FAULT)
        self.bridge.turn(Phase.FAULT)
        self.assertEqual(len(self.api.asked("clean_error")), before + 1)
        self.port.now_s += RECOVERY_PAUSE_S
        self.api.clearable = True
        self.bridge.turn(Phase.FAULT)
        self.bridge.turn(Phase.FAULT)
        self.assertEqual(self.port.states[-1][1], 0)

    def test_an_arm_that_could_not_be_asked_is_slowed_down_by_the_targets(self):
        self.api.answers = False
        for _ in range(3):
            self.port.next(self.near(0.01))
            self.bridge.turn(Phase.STOPPING)
        self.assertEqual(len(self.api.asked("set_servo_angle_j")), 3)
        self.assertEqual({state[1] for state in self.port.states}, {NO_ANSWER})
        self.api.answers = True
        self.port.next(self.near(0.01))
        self.bridge.turn(Phase.FAULT)
        self.assertEqual(len(self.api.asked("set_servo_angle_j")), 3)
        self.bridge.turn(Phase.FAULT)
        self.assertEqual(self.port.states[-1][1], 0)

    def let_the_gripper_fail(self, gripper, state):
        """The gripper does not do what a target tells it, which is reported."""
        self.api.gripper_obeys = False
        self.port.next(self.near(0.0), gripper)
        self.bridge.turn(state)
        deadline = time.monotonic() + 5
        while self.arm.gripper_error == 0 and time.monotonic() < deadline:
            time.sleep(0.001)
        self.bridge.turn(state)
        self.assertEqual(self.port.states[-1][1], GRIPPER_FAILED + 19)

    def test_a_gripper_that_fails_stops_the_arm(self):
        self.let_the_gripper_fail(Gripper.CLOSED, Phase.GRASP)
        self.bridge.turn(Phase.FAULT)
        self.bridge.turn(Phase.FAULT)
        self.assertEqual(self.port.states[-1][1], 0)

    def test_a_gripper_that_did_not_open_is_not_reported_open_once_the_arm_is_clear(self):
        self.api.gripper_answer = (0, GRIPPER_CLOSED)
        self.bridge = self.start()
        self.let_the_gripper_fail(Gripper.OPEN, Phase.RELEASE)
        self.bridge.turn(Phase.FAULT)
        self.bridge.turn(Phase.FAULT)
        self.assertEqual(self.port.states[-1][1:], (0, Gripper.CLOSED))

    def test_no_pose_is_made_up_when_the_arm_does_not_answer(self):
        self.api.answers = False
        self.bridge.turn(Phase.IDLE)
        self.assertNotEqual(self.port.states[-1][1], 0)

    def test_an_arm_that_cannot_be_made_ready_is_refused(self):
        self.api.clearable = False
        self.api.error_code = 2
        with self.assertRaises(ArmError):
            XArm(self.api)


class NoArm(unittest.TestCase):
    def test_an_address_without_an_arm_is_said_in_one_line(self):
        def connect(*arguments, **options):
            raise Exception("connect socket failed")

        errors = io.StringIO()
        sdk = {"xarm": types.ModuleType("xarm"), "xarm.wrapper": types.ModuleType("xarm.wrapper")}
        sdk["xarm.wrapper"].XArmAPI = connect
        with (
            mock.patch.dict(sys.modules, sdk),
            mock.patch.object(sys, "argv", ["xarm_bridge.py", "192.0.2.1"]),
            contextlib.redirect_stderr(errors),
        ):
            self.assertEqual(xarm_bridge.main(), 1)
        self.assertIn("192.0.2.1", errors.getvalue())
        self.assertEqual(len(errors.getvalue().splitlines()), 1)


class Model(unittest.TestCase):
    def test_the_model_has_the_joints_and_ranges_of_the_table(self):
        root = ElementTree.fromstring(xarm7_mjcf.mjcf())
        joints = [joint for joint in root.iter("joint") if joint.get("type") is None]
        self.assertEqual(len(joints), JOINTS)
        ranges = [tuple(float(word) for word in joint.get("range").split()) for joint in joints]
        self.assertEqual(ranges, xarm7_mjcf.RANGES_RAD)
        self.assertTrue(all(body.get("gravcomp") == "1" for body in root.iter("body")))

    def test_the_posture_lies_in_the_ranges(self):
        for angle, (low, high) in zip(xarm7_mjcf.LEVEL_POSTURE_RAD, xarm7_mjcf.RANGES_RAD):
            self.assertTrue(low < angle < high or math.isclose(angle, high))


if __name__ == "__main__":
    unittest.main()
