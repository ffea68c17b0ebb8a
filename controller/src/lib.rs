//! The real-time controller: a pure step, the loop around it and the second thread that talks.
//!
//! ```text
//! client ─ Goal, Command ─► bridge ─ queues ─► loop: step(inputs, now) ─► guard ─► blackboard ─► arm
//! arm ──── RobotState ────►  thread ◄─ queues ─ (no lock, no allocation, no log)
//! client ◄ JointTarget, Status ─┘
//! ```

pub mod constants;
pub mod guard;
pub mod motion;
pub mod plan;
pub mod sample;
pub mod step;
