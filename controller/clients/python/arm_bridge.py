"""The loop between the controller and an arm, the same for the real one and a simulated one.

An arm is an object with these methods; `xarm_bridge.py` and `mujoco_bridge.py` have one each:

    read()              -> (q_rad, dq_rad_s, error_code), measured joints; called every period. NO_ANSWER is the
                        code where the arm may be well and only could not be asked
    command(q_rad)      sends joints to the arm; may raise ArmError
    grip(closed)        tells the gripper; must not wait for it
    gripped()           -> whether the gripper is closed on something now; asked at the start and after an error,
                        which may be that of a gripper that did not do what it was told
    recover()           clears an error so that the arm can stream again; raises ArmError when it cannot
    close()             leaves the arm at rest
"""

import time

from genorm_ipc import Client, Gripper, NotConnected, Phase, transport_errors

PERIOD_S = 0.004

# A live controller sends a status every 100 ms.
SILENCE_S = 1.0

# A target older than this is not sent: nobody streams any more, and the arm may have been moved since.
TARGET_AGE_MAX_S = 0.1

# A target farther than this from the measured joints is not sent: the arm would jump to it. The
# controller's own limit for an arm that does not follow is 0.15 rad.
JUMP_MAX_RAD = 0.2

# A step of the stream longer than this is not sent: the fastest joint moves 0.013 rad from one target to the next at
# 250 Hz. One that is longer has left targets out, because somebody was held up, and the arm would make up for them at
# once.
STEP_MAX_RAD = 0.05

# Reported where targets were left out.
STREAM_TORN = 998

# Reported when the connection, not the arm, says no.
NO_ANSWER = 999

# Before connecting again where iceoryx2 refused.
RECONNECT_PAUSE_S = 0.1

# Between two attempts to clear an error, so that a person can act.
RECOVERY_PAUSE_S = 1.0


class ArmError(Exception):
    """The arm did not do what it was told."""

    def __init__(self, text, code=1):
        super().__init__(text)
        self.code = code or 1


class Bridge:
    """One connection between a controller's port and an arm, period by period. `clock` reads CLOCK_MONOTONIC
    in s, as the stamps of targets do."""

    def __init__(self, arm, port, clock=time.monotonic):
        self.arm = arm
        self.port = port
        self.clock = clock
        # Told to the controller, whose first target then leaves the gripper as it is.
        self.closed = arm.gripped()
        self.error = 0
        self.last_recovery_s = float("-inf")
        self.sent_seq = 0
        self.sent_q_rad = None
        self.sent_stream = None
        self._skip_newest()

    def turn(self, state):
        """One period; `state` is the newest Phase of the controller, or None."""
        # Before the reading, which may take long: an old pose must not look new.
        stamp_ns = time.monotonic_ns()
        q_rad, dq_rad_s, error_code = self.arm.read()
        self.error = error_code or self.error
        target = self.port.newest_target()
        # An arm that could not be asked is still slowed down by the targets: without them it would stop dead.
        if self.error and (self.error != NO_ANSWER or state is Phase.FAULT):
            self._recover_when_stopped(state)
        elif target is not None and self._is_new(target):
            self._follow(target, q_rad)
        gripper = Gripper.CLOSED if self.closed else Gripper.OPEN
        self.port.send_state(q_rad, dq_rad_s, self.error, gripper, stamp_ns)

    def _skip_newest(self):
        """The target that is there now is never sent: the arm may have been moved since it was made."""
        target = self.port.newest_target()
        self.sent_q_rad = None
        if target is not None:
            self.sent_seq = target.seq

    def _is_new(self, target):
        age_s = self.clock() - target.stamp_ns * 1e-9
        return target.seq not in (0, self.sent_seq) and age_s <= TARGET_AGE_MAX_S

    def _follow(self, target, q_rad):
        self.sent_seq = target.seq
        if target.stream != self.sent_stream:
            # A new stream begins where the arm was measured, to where a person may have guided it.
            self.sent_stream, self.sent_q_rad = target.stream, None
        if farthest(target.q_rad, q_rad) > JUMP_MAX_RAD:
            # The arm is not where the stream has it, which the controller latches.
            return
        if farthest(target.q_rad, self.sent_q_rad or q_rad) > STEP_MAX_RAD:
            print("bridge: targets were left out, and the arm would jump: something holds up this program")
            self.error = STREAM_TORN
            return
        try:
            self.arm.command(list(target.q_rad))
            self.sent_q_rad = list(target.q_rad)
            closed = target.gripper == Gripper.CLOSED
            if closed != self.closed:
                self.closed = closed
                self.arm.grip(closed)
        except ArmError as error:
            print(f"bridge: {error}")
            self.error = error.code

    def _recover_when_stopped(self, state):
        """An error is reported until the controller has latched it; only then is it cleared. Nothing moves
        until a person resets the controller."""
        now_s = self.clock()
        if state is not Phase.FAULT or now_s - self.last_recovery_s < RECOVERY_PAUSE_S:
            return
        self.last_recovery_s = now_s
        try:
            self.arm.recover()
        except ArmError as error:
            print(f"bridge: {error}")
            return
        self.error = 0
        self.closed = self.arm.gripped()
        self._skip_newest()
        print("bridge: the arm is clear again; reset the controller to go on")


def farthest(q_rad, other_rad):
    """The largest difference of any joint, rad."""
    return max(abs(a - b) for a, b in zip(q_rad, other_rad))


def play(arm, client, seconds):
    """Until the time is over or the controller falls silent; returns whether time is left."""
    bridge = Bridge(arm, client.arm())
    state, heard_s = None, time.monotonic()
    start_s = next_s = time.monotonic()
    while seconds is None or next_s - start_s < seconds:
        while (status := client.next_status()) is not None:
            state, heard_s = Phase(status.state), time.monotonic()
        if time.monotonic() - heard_s > SILENCE_S:
            return True
        bridge.turn(state)
        next_s = max(next_s + PERIOD_S, time.monotonic())
        time.sleep(max(0.0, next_s - time.monotonic()))
    return False


def run(arm, instance="genorm", seconds=None):
    """Bridges the arm to the controller; waits for one that is not there yet, was killed or was restarted."""
    end_s = None if seconds is None else time.monotonic() + seconds
    try:
        while end_s is None or time.monotonic() < end_s:
            try:
                connect_and_play(arm, instance, end_s)
            except NotConnected as error:
                if "no controller runs" not in str(error):
                    raise
            except transport_errors() as error:
                print(f"bridge: {type(error).__name__}: {error}; connecting again")
                time.sleep(RECONNECT_PAUSE_S)
    except KeyboardInterrupt:
        pass
    finally:
        arm.close()


def connect_and_play(arm, instance, end_s):
    """One connection, from its start to its end."""
    client = Client.connect(instance, patience_s=1.0)
    if play(arm, client, None if end_s is None else end_s - time.monotonic()):
        print("bridge: the controller fell silent; connecting again")
