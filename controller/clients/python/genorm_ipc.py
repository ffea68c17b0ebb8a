"""Talk to a running GenORM controller from Python: send goals, watch statuses and targets, play the arm.

    from genorm_ipc import Client, Reason
    client = Client.connect()
    goal_id = client.send_goal(x_m=0.33)
    status = client.wait_status(lambda s: s.judged_goal_id == goal_id)
    print(Reason(status.judged_reason).name)

`pip install iceoryx2` of the release line ICEORYX2 is needed to connect; the layouts below need CPython
alone. They mirror `shared/src/messages.rs`, and a test compares the two:
`cargo test -p tests --test controller_clients`. `../README.md` explains fields and codes.
"""

import ctypes
import enum
import fcntl
import json
import os
import struct
import sys
import time

PROTOCOL = 2
ICEORYX2 = "0.10"
JOINTS = 7
SILENCE_S = 1.0  # a live controller sends a status every 0.1 s

_u32, _u64, _f64 = ctypes.c_uint32, ctypes.c_uint64, ctypes.c_double
_joints = _f64 * JOINTS


def _magic(word):
    return int.from_bytes(word, "little")


class _Message(ctypes.Structure):
    """A message: C layout, a name that carries the version, a first word that tells it apart."""

    NAME = ""
    MAGIC = 0

    @classmethod
    def type_name(cls):
        """What iceoryx2 compares when two programs connect."""
        return cls.NAME

    def __init__(self, **fields):
        super().__init__(magic=self.MAGIC, **fields)


class Goal(_Message):
    """Client to controller: swing the tip of this rope to this x."""

    NAME = "genorm.Goal.v1"
    MAGIC = _magic(b"GENGOAL1")
    _fields_ = [
        ("magic", _u64),
        ("stamp_ns", _u64),
        ("id", _u64),
        ("x_m", _f64),
        ("rope", _u32),
        ("keep_alive_ms", _u32),
    ]


class Command(_Message):
    """Client to controller: stop, or go on after a stop."""

    NAME = "genorm.Command.v1"
    MAGIC = _magic(b"GENCMND1")
    _fields_ = [
        ("magic", _u64),
        ("stamp_ns", _u64),
        ("id", _u64),
        ("kind", _u32),
        ("reserved", _u32),
    ]


class RobotState(_Message):
    """The arm's driver to controller: what the arm measures."""

    NAME = "genorm.RobotState.v2"
    MAGIC = _magic(b"GENROBO2")
    _fields_ = [
        ("magic", _u64),
        ("seq", _u64),
        ("stamp_ns", _u64),
        ("target_seq", _u64),
        ("q_rad", _joints),
        ("dq_rad_s", _joints),
        ("error_code", _u32),
        ("gripper", _u32),
    ]


class JointTarget(_Message):
    """Controller to the arm's driver: where the joints shall be now. With `seq` 0 it is no target."""

    NAME = "genorm.JointTarget.v1"
    MAGIC = _magic(b"GENTARG1")
    _fields_ = [
        ("magic", _u64),
        ("seq", _u64),
        ("stamp_ns", _u64),
        ("goal_id", _u64),
        ("q_rad", _joints),
        ("dq_rad_s", _joints),
        ("stream", _u32),
        ("phase", _u32),
        ("gripper", _u32),
        ("reserved", _u32),
    ]


class Status(_Message):
    """Controller to everybody: on every change and every 100 ms."""

    NAME = "genorm.Status.v1"
    MAGIC = _magic(b"GENSTAT1")
    _fields_ = [
        ("magic", _u64),
        ("seq", _u64),
        ("stamp_ns", _u64),
        ("judged_goal_id", _u64),
        ("active_goal_id", _u64),
        ("finished_goal_id", _u64),
        ("command_id", _u64),
        ("cycles", _u64),
        ("missed_deadlines", _u64),
        ("goals_accepted", _u64),
        ("goals_refused", _u64),
        ("messages_ignored", _u64),
        ("messages_lost", _u64),
        ("targets_sent", _u64),
        ("state", _u32),
        ("judged_reason", _u32),
        ("finished_reason", _u32),
        ("command_reason", _u32),
        ("latch_reason", _u32),
        ("degraded", _u32),
        ("stream", _u32),
        ("gripper", _u32),
    ]


class CommandKind(enum.IntEnum):
    """What a command asks for."""

    EMERGENCY_STOP = 1
    RESET = 2
    CANCEL = 3
    KEEP_ALIVE = 4


class Gripper(enum.IntEnum):
    """What the gripper is told."""

    OPEN = 0
    CLOSED = 1


class Phase(enum.IntEnum):
    """What the controller is doing."""

    WAITING = 0
    IDLE = 1
    HOMING = 2
    APPROACH = 3
    GRASP = 4
    DRAG = 5
    DWELL = 6
    RELEASE = 7
    RETREAT = 8
    STOPPING = 9
    FAULT = 10
    ENDED = 11


class Reason(enum.IntEnum):
    """Why something happened: an accepted or refused goal or command, an ended goal, a latched fault."""

    ACCEPTED = 0
    DONE = 1
    MALFORMED = 10
    NON_FINITE = 11
    STALE = 12
    FROM_FUTURE = 13
    OUT_OF_ORDER = 14
    UNKNOWN_ROPE = 15
    OUT_OF_RANGE = 16
    RELEASE_OUT_OF_RANGE = 17
    UNREACHABLE = 18
    TOO_FAST = 19
    BUSY = 20
    NOT_READY = 21
    LATCHED = 22
    HOMING_TOO_LOW = 23
    JOINT_OUT_OF_RANGE = 24
    EMERGENCY_STOP = 40
    ROBOT_SILENT = 41
    FOLLOWING_ERROR = 42
    ROBOT_FAULT = 43
    GUARD_TRIPPED = 44
    CANCELLED = 45
    SHUTDOWN = 46
    GOAL_SOURCE_SILENT = 47
    TARGETS_UNREAD = 48
    NOTHING_TO_RESET = 60
    STILL_MOVING = 61
    ROBOT_NOT_AT_REST = 62


class Degraded(enum.IntFlag):
    """Bits of Status.degraded: what the machine did not permit."""

    NO_FIFO = 1
    NO_AFFINITY = 2
    NO_MEMLOCK = 4
    NO_FLUSH_TO_ZERO = 8
    DRY_RUN = 16
    MAY_SLEEP = 32


class NotConnected(Exception):
    """No controller to talk to, or one of another version; the text says what to do."""


def _lock_is_held(path):
    """Whether a process holds the controller's lock; asks without taking it."""
    whole_file = struct.pack("hhqqi4x", fcntl.F_WRLCK, os.SEEK_SET, 0, 0, 0)
    with open(path, "rb") as file:
        answer = fcntl.fcntl(file, fcntl.F_OFD_GETLK, whole_file)
    return struct.unpack("hhqqi4x", answer)[0] != fcntl.F_UNLCK


def session_of(instance):
    """The name of the session that the running controller announced, once versions are found equal."""
    base = f"/tmp/genorm-{os.getuid()}"
    not_running = NotConnected(
        f"no controller runs as instance '{instance}': start one with "
        f"`controller --policy FILE --instance {instance}`"
    )
    try:
        if not _lock_is_held(f"{base}/{instance}.lock"):
            raise not_running
        with open(f"{base}/{instance}/current", encoding="utf-8") as file:
            words = dict(line.split(maxsplit=1) for line in file.read().splitlines() if " " in line)
    except OSError:
        raise not_running from None
    ours = {"protocol": str(PROTOCOL), "iceoryx2": ICEORYX2}
    theirs = {key: words.get(key, "without a number") for key in ours}
    if theirs != ours:
        raise NotConnected(
            f"the controller of instance '{instance}' speaks protocol {theirs['protocol']} over iceoryx2 "
            f"{theirs['iceoryx2']}, this module speaks protocol {PROTOCOL} over iceoryx2 {ICEORYX2}: "
            "take both from one version"
        )
    return words["session"].strip()


def _iceoryx2():
    """The module iceoryx2, of the right release line."""
    try:
        import iceoryx2
        from importlib import metadata

        version = metadata.version("iceoryx2")
    except ImportError:
        raise NotConnected(f"the module iceoryx2 is missing: pip install 'iceoryx2=={ICEORYX2}.*'") from None
    if not version.startswith(ICEORYX2 + "."):
        raise NotConnected(f"iceoryx2 {version} cannot talk to {ICEORYX2}: pip install 'iceoryx2=={ICEORYX2}.*'")
    iceoryx2.set_log_level(iceoryx2.LogLevel.Error)
    return iceoryx2


def transport_errors():
    """What iceoryx2 raises, for instance when the controller is killed while a client connects; the classes
    have no base in common."""
    module = sys.modules.get("iceoryx2")
    values = vars(module).values() if module is not None else ()
    return tuple(value for value in values if isinstance(value, type) and issubclass(value, Exception))


class Client:
    """A connection to a running controller. When its statuses stop or a call raises one of
    `transport_errors()`, connect again: a restarted controller is another session."""

    def __init__(self, instance="genorm"):
        self._iox2 = iox2 = _iceoryx2()
        session = session_of(instance)
        config = iox2.config.default()
        uid = os.getuid()
        config.global_cfg.root_path = iox2.Path.new(f"/tmp/genorm-{uid}/{instance}/{session}")
        config.global_cfg.prefix = iox2.FileName.new(f"genorm.{uid}.{instance}.{session}.")
        self._node = (
            iox2.NodeBuilder.new()
            .config(config)
            .signal_handling_mode(iox2.SignalHandlingMode.Disabled)
            .create(iox2.ServiceType.Ipc)
        )
        self._goals = self._publisher("goals", Goal)
        self._commands = self._publisher("commands", Command)
        self._targets = self._subscriber("targets", JointTarget)
        self._status = self._subscriber("status", Status)
        self._last_id = 0

    @classmethod
    def connect(cls, instance="genorm", patience_s=2.0):
        """Connects, waiting for a controller that starts."""
        end = time.monotonic() + patience_s
        while True:
            try:
                return cls(instance)
            except Exception as error:
                waiting_helps = "speaks protocol" not in str(error) and "pip install" not in str(error)
                if time.monotonic() > end or not waiting_helps:
                    raise
                time.sleep(0.01)

    def _open(self, name, kind):
        return self._node.service_builder(self._iox2.ServiceName.new(name)).publish_subscribe(kind).open()

    def _publisher(self, name, kind):
        discard = self._iox2.BackpressureStrategy.DiscardData
        return self._open(name, kind).publisher_builder().backpressure_strategy(discard).create()

    def _subscriber(self, name, kind):
        return self._open(name, kind).subscriber_builder().create()

    def _next_id(self):
        self._last_id = max(time.monotonic_ns(), self._last_id + 1)
        return self._last_id

    @staticmethod
    def _next(port, kind):
        while (sample := port.receive()) is not None:
            # A copy, so that no sample stays borrowed.
            message = kind.from_buffer_copy(sample.payload().contents)
            sample.delete()
            if message.magic == kind.MAGIC:
                return message
        return None

    def send_goal(self, x_m, rope=0, keep_alive_ms=0):
        """Asks for a swing; returns the id that statuses name the goal by. With `keep_alive_ms` the arm stops
        when `keep_alive` is not called at least that often until the goal has ended."""
        goal = Goal(
            stamp_ns=time.monotonic_ns(),
            id=self._next_id(),
            x_m=x_m,
            rope=rope,
            keep_alive_ms=keep_alive_ms,
        )
        self._goals.send_copy(goal)
        return goal.id

    def send_command(self, kind, command_id=None):
        """Sends a CommandKind; returns the id that statuses name the command by."""
        command = Command(
            stamp_ns=time.monotonic_ns(),
            id=command_id or self._next_id(),
            kind=int(kind),
        )
        self._commands.send_copy(command)
        return command.id

    def keep_alive(self, goal_id):
        """Says that the goal is still wanted."""
        self.send_command(CommandKind.KEEP_ALIVE, goal_id)

    def next_status(self):
        """The next status, or None."""
        return self._next(self._status, Status)

    def next_target(self):
        """The next target of the stream, or None."""
        return self._next(self._targets, JointTarget)

    def wait_status(self, wanted=lambda status: True, patience_s=2.0):
        """The next status that `wanted` accepts; raises TimeoutError when none comes in time, or when the controller
        falls silent before."""
        heard = time.monotonic()
        end = heard + patience_s
        while (now := time.monotonic()) < end:
            status = self.next_status()
            if status is not None:
                heard = now
                if wanted(status):
                    return status
            elif now - heard > SILENCE_S:
                raise TimeoutError("the controller fell silent: is it still running?")
            else:
                time.sleep(0.001)
        raise TimeoutError(f"no such status came within {patience_s:g} s")

    def arm(self):
        """The arm's side of the connection, for drivers and simulated arms."""
        return ArmPort(self)


class ArmPort:
    """What an arm's driver needs: the newest target, and a way to report the joints."""

    def __init__(self, client):
        self._client = client
        self._states = client._publisher("robot", RobotState)
        iox2 = client._iox2
        board = client._node.service_builder(iox2.ServiceName.new("newest-target"))
        self._reader = board.blackboard_opener(_u32).open().reader_builder().create()
        self._newest = self._reader.entry(_u32(0), JointTarget)
        self._seq = 0
        self._target_seq = 0

    def newest_target(self):
        """The newest target, or None before the first and while the controller sends none. Follow only this:
        older ones are history."""
        target = self._newest.get().decode_as(JointTarget)
        if target.magic != JointTarget.MAGIC or target.seq == 0:
            return None
        self._target_seq = target.seq
        return target

    def send_state(self, q_rad, dq_rad_s, error_code=0, gripper=Gripper.OPEN, stamp_ns=None):
        """Reports what the arm measured at `stamp_ns` (time.monotonic_ns(); now where it is left out); without
        it the controller sends no targets."""
        self._seq += 1
        state = RobotState(
            seq=self._seq,
            stamp_ns=time.monotonic_ns() if stamp_ns is None else stamp_ns,
            target_seq=self._target_seq,
            q_rad=_joints(*q_rad),
            dq_rad_s=_joints(*dq_rad_s),
            error_code=error_code,
            gripper=int(gripper),
        )
        self._states.send_copy(state)


def layout():
    """Names, magic words, sizes and places of all messages, and all codes, for the test that compares them
    with the controller's."""
    messages = {
        kind.NAME: {
            "magic": kind.MAGIC,
            "size": ctypes.sizeof(kind),
            "align": ctypes.alignment(kind),
            "fields": {name: [getattr(kind, name).offset, getattr(kind, name).size] for name, _ in kind._fields_},
        }
        for kind in (Goal, Command, RobotState, JointTarget, Status)
    }
    codes = {
        kind.__name__: {value.name: int(value) for value in kind}
        for kind in (CommandKind, Gripper, Phase, Reason, Degraded)
    }
    return {"protocol": PROTOCOL, "iceoryx2": ICEORYX2, "messages": messages, "codes": codes}


def main():
    """Sends one goal and prints what becomes of it: `python3 genorm_ipc.py X_M [INSTANCE]`."""
    if sys.argv[1:] == ["--layout"]:
        print(json.dumps(layout()))
        return 0
    try:
        [x_m, *instance] = sys.argv[1:]
        x_m = float(x_m)
        if len(instance) > 1:
            raise ValueError
    except ValueError:
        print("use: python3 genorm_ipc.py X_M [INSTANCE]", file=sys.stderr)
        return 2
    try:
        client = Client.connect(*instance)
        goal_id = client.send_goal(x_m)
        status = client.wait_status(lambda s: s.judged_goal_id == goal_id)
        print(f"goal {goal_id}: {Reason(status.judged_reason).name}")
        if status.judged_reason != Reason.ACCEPTED:
            return 1
        status = client.wait_status(lambda s: s.finished_goal_id == goal_id, patience_s=60)
        print(f"goal {goal_id} ended: {Reason(status.finished_reason).name}")
        return 0 if status.finished_reason == Reason.DONE else 1
    except (NotConnected, TimeoutError) as error:
        print(f"genorm_ipc: {error}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
