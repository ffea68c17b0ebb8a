//! The real-time controller: a pure step, the loop around it and the second thread that talks.
//!
//! ```text
//! client ─ Goal, Command ─► bridge ─ queues ─► loop: step(inputs, now) ─► guard ─► blackboard ─► arm
//! arm ──── RobotState ────►  thread ◄─ queues ─ (no lock, no allocation, no log)
//! client ◄ JointTarget, Status ─┘
//! ```
//!
//! One cycle of the loop: it wakes early, so that neither a late wake-up nor cold caches delay the turn.
//!
//! ```text
//! sleep ─► awake 150 us early: plans ahead for the goal that waits ─► due: turn, on time and warm ─► sleep
//! ```

pub mod allocations;
pub mod arguments;
pub mod bench;
pub mod bridge;
pub mod client;
pub mod clock;
pub mod constants;
pub mod cycle;
pub mod guard;
pub mod interface;
pub mod motion;
pub mod plan;
pub mod policy_file;
pub mod program;
pub mod promise;
pub mod readiness;
pub mod recorder;
pub mod ring;
pub mod rt;
pub mod sample;
pub mod serve;
pub mod services;
pub mod session;
pub mod step;
pub mod survey;
pub mod sweeper;
pub mod timing;
pub mod voice;
pub mod words;
