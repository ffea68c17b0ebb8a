//! What the offline program and the controller must agree on: messages, xArm7 kinematics, motion
//! profile, policy network, formats of policy files and recordings, task geometry, messages on one line. No `std`, no
//! `alloc`, no clock, no file.
#![no_std]

pub mod arm;
pub mod blob;
#[cfg(test)]
mod fixtures;
pub mod ik;
pub mod messages;
pub mod one_line;
pub mod policy;
pub mod profile;
pub mod reach;
pub mod recording;
pub mod task;
