/* Messages between a GenORM controller, its clients and the arm, for C11 and C++11.
 *
 * The layouts mirror shared/src/messages.rs; `cargo test -p tests --test controller_clients` compiles this
 * file and compares every place and every code with the controller's. README.md beside this folder explains
 * fields, codes and how to connect. The C binding of iceoryx2 is built from its repository (iceoryx2-ffi-c,
 * release line GENORM_ICEORYX2); the type names below are what it compares when two programs connect.
 *
 * Times are CLOCK_MONOTONIC in ns; angles rad, lengths m.
 */
#ifndef GENORM_IPC_H
#define GENORM_IPC_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
#define GENORM_STATIC_ASSERT static_assert
extern "C" {
#else
#define GENORM_STATIC_ASSERT _Static_assert
#endif

#define GENORM_PROTOCOL 2u
#define GENORM_ICEORYX2 "0.10"
#define GENORM_JOINTS 7

/* Client to controller: swing the tip of this rope to this x. */
#define GENORM_GOAL_TYPE "genorm.Goal.v1"
#define GENORM_GOAL_MAGIC UINT64_C(0x314c414f474e4547)

struct genorm_goal {
    uint64_t magic;
    uint64_t stamp_ns;
    uint64_t id;
    double x_m;
    uint32_t rope;
    uint32_t keep_alive_ms;
};

GENORM_STATIC_ASSERT(sizeof(struct genorm_goal) == 40, "size of genorm_goal");
GENORM_STATIC_ASSERT(offsetof(struct genorm_goal, stamp_ns) == 8, "stamp_ns of genorm_goal");
GENORM_STATIC_ASSERT(offsetof(struct genorm_goal, id) == 16, "id of genorm_goal");
GENORM_STATIC_ASSERT(offsetof(struct genorm_goal, x_m) == 24, "x_m of genorm_goal");
GENORM_STATIC_ASSERT(offsetof(struct genorm_goal, rope) == 32, "rope of genorm_goal");
GENORM_STATIC_ASSERT(offsetof(struct genorm_goal, keep_alive_ms) == 36, "keep_alive_ms of genorm_goal");

/* Client to controller: stop, or go on after a stop. */
#define GENORM_COMMAND_TYPE "genorm.Command.v1"
#define GENORM_COMMAND_MAGIC UINT64_C(0x31444e4d434e4547)

struct genorm_command {
    uint64_t magic;
    uint64_t stamp_ns;
    uint64_t id;
    uint32_t kind;
    uint32_t reserved;
};

GENORM_STATIC_ASSERT(sizeof(struct genorm_command) == 32, "size of genorm_command");
GENORM_STATIC_ASSERT(offsetof(struct genorm_command, stamp_ns) == 8, "stamp_ns of genorm_command");
GENORM_STATIC_ASSERT(offsetof(struct genorm_command, id) == 16, "id of genorm_command");
GENORM_STATIC_ASSERT(offsetof(struct genorm_command, kind) == 24, "kind of genorm_command");
GENORM_STATIC_ASSERT(offsetof(struct genorm_command, reserved) == 28, "reserved of genorm_command");

/* The arm's driver to controller: what the arm measures. */
#define GENORM_ROBOT_STATE_TYPE "genorm.RobotState.v2"
#define GENORM_ROBOT_STATE_MAGIC UINT64_C(0x324f424f524e4547)

struct genorm_robot_state {
    uint64_t magic;
    uint64_t seq;
    uint64_t stamp_ns;
    uint64_t target_seq;
    double q_rad[GENORM_JOINTS];
    double dq_rad_s[GENORM_JOINTS];
    uint32_t error_code;
    uint32_t gripper;
};

GENORM_STATIC_ASSERT(sizeof(struct genorm_robot_state) == 152, "size of genorm_robot_state");
GENORM_STATIC_ASSERT(offsetof(struct genorm_robot_state, seq) == 8, "seq of genorm_robot_state");
GENORM_STATIC_ASSERT(offsetof(struct genorm_robot_state, stamp_ns) == 16, "stamp_ns of genorm_robot_state");
GENORM_STATIC_ASSERT(offsetof(struct genorm_robot_state, target_seq) == 24, "target_seq of genorm_robot_state");
GENORM_STATIC_ASSERT(offsetof(struct genorm_robot_state, q_rad) == 32, "q_rad of genorm_robot_state");
GENORM_STATIC_ASSERT(offsetof(struct genorm_robot_state, dq_rad_s) == 88, "dq_rad_s of genorm_robot_state");
GENORM_STATIC_ASSERT(offsetof(struct genorm_robot_state, error_code) == 144, "error_code of genorm_robot_state");
GENORM_STATIC_ASSERT(offsetof(struct genorm_robot_state, gripper) == 148, "gripper of genorm_robot_state");

/* Controller to the arm's driver: where the joints shall be now. With another magic word, or with seq 0, it is
 * no target; README.md says which targets a driver sends to the arm. */
#define GENORM_JOINT_TARGET_TYPE "genorm.JointTarget.v1"
#define GENORM_JOINT_TARGET_MAGIC UINT64_C(0x31475241544e4547)

struct genorm_joint_target {
    uint64_t magic;
    uint64_t seq;
    uint64_t stamp_ns;
    uint64_t goal_id;
    double q_rad[GENORM_JOINTS];
    double dq_rad_s[GENORM_JOINTS];
    uint32_t stream;
    uint32_t phase;
    uint32_t gripper;
    uint32_t reserved;
};

GENORM_STATIC_ASSERT(sizeof(struct genorm_joint_target) == 160, "size of genorm_joint_target");
GENORM_STATIC_ASSERT(offsetof(struct genorm_joint_target, seq) == 8, "seq of genorm_joint_target");
GENORM_STATIC_ASSERT(offsetof(struct genorm_joint_target, stamp_ns) == 16, "stamp_ns of genorm_joint_target");
GENORM_STATIC_ASSERT(offsetof(struct genorm_joint_target, goal_id) == 24, "goal_id of genorm_joint_target");
GENORM_STATIC_ASSERT(offsetof(struct genorm_joint_target, q_rad) == 32, "q_rad of genorm_joint_target");
GENORM_STATIC_ASSERT(offsetof(struct genorm_joint_target, dq_rad_s) == 88, "dq_rad_s of genorm_joint_target");
GENORM_STATIC_ASSERT(offsetof(struct genorm_joint_target, stream) == 144, "stream of genorm_joint_target");
GENORM_STATIC_ASSERT(offsetof(struct genorm_joint_target, phase) == 148, "phase of genorm_joint_target");
GENORM_STATIC_ASSERT(offsetof(struct genorm_joint_target, gripper) == 152, "gripper of genorm_joint_target");
GENORM_STATIC_ASSERT(offsetof(struct genorm_joint_target, reserved) == 156, "reserved of genorm_joint_target");

/* Controller to everybody: on every change and every 100 ms. */
#define GENORM_STATUS_TYPE "genorm.Status.v1"
#define GENORM_STATUS_MAGIC UINT64_C(0x31544154534e4547)

struct genorm_status {
    uint64_t magic;
    uint64_t seq;
    uint64_t stamp_ns;
    uint64_t judged_goal_id;
    uint64_t active_goal_id;
    uint64_t finished_goal_id;
    uint64_t command_id;
    uint64_t cycles;
    uint64_t missed_deadlines;
    uint64_t goals_accepted;
    uint64_t goals_refused;
    uint64_t messages_ignored;
    uint64_t messages_lost;
    uint64_t targets_sent;
    uint32_t state;
    uint32_t judged_reason;
    uint32_t finished_reason;
    uint32_t command_reason;
    uint32_t latch_reason;
    uint32_t degraded;
    uint32_t stream;
    uint32_t gripper;
};

GENORM_STATIC_ASSERT(sizeof(struct genorm_status) == 144, "size of genorm_status");
GENORM_STATIC_ASSERT(offsetof(struct genorm_status, seq) == 8, "seq of genorm_status");
GENORM_STATIC_ASSERT(offsetof(struct genorm_status, stamp_ns) == 16, "stamp_ns of genorm_status");
GENORM_STATIC_ASSERT(offsetof(struct genorm_status, judged_goal_id) == 24, "judged_goal_id of genorm_status");
GENORM_STATIC_ASSERT(offsetof(struct genorm_status, active_goal_id) == 32, "active_goal_id of genorm_status");
GENORM_STATIC_ASSERT(offsetof(struct genorm_status, finished_goal_id) == 40, "finished_goal_id of genorm_status");
GENORM_STATIC_ASSERT(offsetof(struct genorm_status, command_id) == 48, "command_id of genorm_status");
GENORM_STATIC_ASSERT(offsetof(struct genorm_status, cycles) == 56, "cycles of genorm_status");
GENORM_STATIC_ASSERT(offsetof(struct genorm_status, missed_deadlines) == 64, "missed_deadlines of genorm_status");
GENORM_STATIC_ASSERT(offsetof(struct genorm_status, goals_accepted) == 72, "goals_accepted of genorm_status");
GENORM_STATIC_ASSERT(offsetof(struct genorm_status, goals_refused) == 80, "goals_refused of genorm_status");
GENORM_STATIC_ASSERT(offsetof(struct genorm_status, messages_ignored) == 88, "messages_ignored of genorm_status");
GENORM_STATIC_ASSERT(offsetof(struct genorm_status, messages_lost) == 96, "messages_lost of genorm_status");
GENORM_STATIC_ASSERT(offsetof(struct genorm_status, targets_sent) == 104, "targets_sent of genorm_status");
GENORM_STATIC_ASSERT(offsetof(struct genorm_status, state) == 112, "state of genorm_status");
GENORM_STATIC_ASSERT(offsetof(struct genorm_status, judged_reason) == 116, "judged_reason of genorm_status");
GENORM_STATIC_ASSERT(offsetof(struct genorm_status, finished_reason) == 120, "finished_reason of genorm_status");
GENORM_STATIC_ASSERT(offsetof(struct genorm_status, command_reason) == 124, "command_reason of genorm_status");
GENORM_STATIC_ASSERT(offsetof(struct genorm_status, latch_reason) == 128, "latch_reason of genorm_status");
GENORM_STATIC_ASSERT(offsetof(struct genorm_status, degraded) == 132, "degraded of genorm_status");
GENORM_STATIC_ASSERT(offsetof(struct genorm_status, stream) == 136, "stream of genorm_status");
GENORM_STATIC_ASSERT(offsetof(struct genorm_status, gripper) == 140, "gripper of genorm_status");

/* What a command asks for. */
enum genorm_command_kind {
    GENORM_COMMAND_KIND_EMERGENCY_STOP = 1,
    GENORM_COMMAND_KIND_RESET = 2,
    GENORM_COMMAND_KIND_CANCEL = 3,
    GENORM_COMMAND_KIND_KEEP_ALIVE = 4,
};

/* What the gripper is told. */
enum genorm_gripper {
    GENORM_GRIPPER_OPEN = 0,
    GENORM_GRIPPER_CLOSED = 1,
};

/* What the controller is doing. */
enum genorm_phase {
    GENORM_PHASE_WAITING = 0,
    GENORM_PHASE_IDLE = 1,
    GENORM_PHASE_HOMING = 2,
    GENORM_PHASE_APPROACH = 3,
    GENORM_PHASE_GRASP = 4,
    GENORM_PHASE_DRAG = 5,
    GENORM_PHASE_DWELL = 6,
    GENORM_PHASE_RELEASE = 7,
    GENORM_PHASE_RETREAT = 8,
    GENORM_PHASE_STOPPING = 9,
    GENORM_PHASE_FAULT = 10,
    GENORM_PHASE_ENDED = 11,
};

/* Why something happened; README.md says more about each. */
enum genorm_reason {
    GENORM_REASON_ACCEPTED = 0,
    GENORM_REASON_DONE = 1,
    GENORM_REASON_MALFORMED = 10,
    GENORM_REASON_NON_FINITE = 11,
    GENORM_REASON_STALE = 12,
    GENORM_REASON_FROM_FUTURE = 13,
    GENORM_REASON_OUT_OF_ORDER = 14,
    GENORM_REASON_UNKNOWN_ROPE = 15,
    GENORM_REASON_OUT_OF_RANGE = 16,
    GENORM_REASON_RELEASE_OUT_OF_RANGE = 17,
    GENORM_REASON_UNREACHABLE = 18,
    GENORM_REASON_TOO_FAST = 19,
    GENORM_REASON_BUSY = 20,
    GENORM_REASON_NOT_READY = 21,
    GENORM_REASON_LATCHED = 22,
    GENORM_REASON_HOMING_TOO_LOW = 23,
    GENORM_REASON_JOINT_OUT_OF_RANGE = 24,
    GENORM_REASON_EMERGENCY_STOP = 40,
    GENORM_REASON_ROBOT_SILENT = 41,
    GENORM_REASON_FOLLOWING_ERROR = 42,
    GENORM_REASON_ROBOT_FAULT = 43,
    GENORM_REASON_GUARD_TRIPPED = 44,
    GENORM_REASON_CANCELLED = 45,
    GENORM_REASON_SHUTDOWN = 46,
    GENORM_REASON_GOAL_SOURCE_SILENT = 47,
    GENORM_REASON_TARGETS_UNREAD = 48,
    GENORM_REASON_NOTHING_TO_RESET = 60,
    GENORM_REASON_STILL_MOVING = 61,
    GENORM_REASON_ROBOT_NOT_AT_REST = 62,
};

/* Bits of genorm_status.degraded: what the machine did not permit. */
enum genorm_degraded {
    GENORM_DEGRADED_NO_FIFO = 1,
    GENORM_DEGRADED_NO_AFFINITY = 2,
    GENORM_DEGRADED_NO_MEMLOCK = 4,
    GENORM_DEGRADED_NO_FLUSH_TO_ZERO = 8,
    GENORM_DEGRADED_DRY_RUN = 16,
    GENORM_DEGRADED_MAY_SLEEP = 32,
};

#ifdef __cplusplus
}
#endif

#endif
