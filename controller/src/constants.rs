//! Every period, capacity, timeout and margin of the controller, each with its reason.

/// The arm's control box takes at most 250 points a second and only the newest counts.
pub const TARGET_RATE_MAX_HZ: u32 = 250;

/// Slowest loop that still counts as streaming.
pub const LOOP_RATE_MIN_HZ: u32 = 100;

/// Fastest loop: four cycles to a target.
pub const LOOP_RATE_MAX_HZ: u32 = 1000;

/// A goal older than this was meant for another situation.
pub const GOAL_AGE_MAX_NS: u64 = 500_000_000;

/// Stamps and cycles come from one clock, so only scheduling may put a stamp ahead of its cycle.
pub const GOAL_AHEAD_MAX_NS: u64 = 20_000_000;

/// Default silence of the arm's state after which a motion is stopped: 50 periods of its 250 Hz report.
pub const ROBOT_TIMEOUT_DEFAULT_MS: u64 = 200;

/// Shortest and longest silence that can be asked for; there is no "never".
pub const ROBOT_TIMEOUT_RANGE_MS: std::ops::RangeInclusive<u64> = 20..=2000;

/// Longest time that a gripper may take to let go, ms; the dwell of the task bounds it too.
pub const GRIPPER_LATENCY_MAX_MS: u64 = 2000;

/// Largest distance between a measured joint and its target, rad. At the fastest motion this program
/// plans (1.57 rad/s, on a line) it allows 0.095 s of lag.
pub const FOLLOWING_ERROR_MAX_RAD: f64 = 0.15;

/// Periods without a target after which an arm stands at the newest one, for it gets no others: 20 ms at 250 Hz. An arm of
/// Franka's stops after as long (20 lost packets at 1 kHz, libfranka's docs/overview.rst).
pub const STALL_PERIODS: u64 = 5;

/// Below this joint speed the arm counts as still, rad/s.
pub const STILL_RAD_S: f64 = 0.05;

/// Share of the arm's joint limits that joint motions are planned with, so that a stop on top of the
/// motion stays within the limits.
pub const HOMING_SHARE: [f64; 3] = [0.4, 0.25, 0.2];

/// Flange speed that joint motions are planned with, m/s.
pub const HOMING_FLANGE_SPEED_M_S: f64 = 0.4;

/// How far a joint motion may bring the flange below where it starts or touches the table, m.
pub const HOMING_DIP_M: f64 = 0.005;

/// Share of the limits that a straight line of the task may use; the rest is for stopping.
pub const LINE_SHARE: f64 = 0.5;

/// Poses at which a planned line is checked.
pub const LINE_SAMPLES: usize = 17;

/// Share of the jerk and acceleration limits that a stop uses; the rest absorbs the discrete steps.
pub const BRAKE_SHARE: f64 = 0.7;

/// Time for the gripper to open or close, s: full stroke 0.4 s (UFACTORY G2) and the tool bus.
pub const GRIPPER_S: f64 = 0.8;

/// A status goes out at least this often, ns.
pub const STATUS_EVERY_NS: u64 = 100_000_000;

/// Messages that wait between the threads. The bridge empties and fills them several times a
/// millisecond, so these hold a stall of a second.
pub const TARGET_QUEUE: usize = 1024;
/// Goals and commands that wait for the loop.
pub const REQUEST_QUEUE: usize = 64;
/// Arm states that wait for the loop; only the newest is used.
pub const ROBOT_QUEUE: usize = 64;
/// Statuses that wait for the bridge.
pub const STATUS_QUEUE: usize = 256;
/// Records of cycles that wait for the file: two seconds at 1 kHz.
pub const RECORD_QUEUE: usize = 2048;

/// Silence of an arm's driver after which another one is heard in its place, ms.
pub const DRIVER_SILENCE_MS: u64 = 250;

/// Pause of the bridge between two rounds, µs: short beside the loop's period, so that few goals come too
/// late for the next cycle, and long beside a round (2 µs).
pub const BRIDGE_PAUSE_US: u64 = 250;

/// How long before a cycle the loop wakes, µs: longer than an idle machine takes to wake it (p99 about 50)
/// and a cold plan takes (40), so that the cycle begins on time and warm.
pub const EARLY_US: u64 = 150;

/// What a plan takes more with cold caches, µs: the loop plans ahead where a plan and this fit in before the
/// cycle.
pub const COLD_US: u64 = 40;

/// How long before a cycle the bridge begins to carry without a pause, µs, so that hardly any goal is late
/// for it: what the bridge takes to wake. Not longer, for meanwhile a small machine has no processor left for
/// clients.
pub const BRIDGE_LEAD_US: u64 = 50;

/// How long after the start of a cycle the bridge waits for its target without a pause, µs: longer than a
/// cycle takes.
pub const BRIDGE_LAG_US: u64 = 50;

/// Priority of the loop: above ordinary programs, below the kernel's own threads.
pub const FIFO_PRIORITY: i32 = 80;

/// Priority of the bridge: above ordinary programs, below the loop.
pub const BRIDGE_PRIORITY: i32 = 40;

const _: () = assert!(2 * EARLY_US * (LOOP_RATE_MAX_HZ as u64) < 1_000_000);
const _: () = assert!(LOOP_RATE_MIN_HZ <= TARGET_RATE_MAX_HZ);
const _: () = assert!(GOAL_AHEAD_MAX_NS < GOAL_AGE_MAX_NS);
