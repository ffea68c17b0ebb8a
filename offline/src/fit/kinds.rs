//! What kind of thing an effect changes, asked of the laws that it adds.

use super::problem::Problem;
use crate::model::Structure;
use crate::sim::start::Start;
use crate::sim::{Physics, Scene};

/// Whether every step of a rollout with an effect costs more.
pub(super) fn changes_material(effect: usize) -> bool {
    alone(effect).changes_material()
}

/// Whether an effect changes the shape at rest for good.
pub fn flows(effect: usize) -> bool {
    !alone(effect).flow_laws.is_empty()
}

/// Whether an effect turns the rope in its grip.
pub fn turns_in_grip(effect: usize) -> bool {
    alone(effect).grip_tilt.is_some()
}

/// Whether an effect changes when clamps let go.
fn opens_late(effect: usize) -> bool {
    alone_with(effect, largest).release_delay_s != 0.0
}

/// Whether an effect is an offset of clocks.
fn offsets_clocks(effect: usize) -> bool {
    alone_with(effect, largest).clock_offset_s() != 0.0
}

/// The physics of an effect that is there but does nothing.
fn alone(effect: usize) -> Physics<f64> {
    alone_with(effect, |structure| structure.start(1e6))
}

fn alone_with(effect: usize, theta: impl Fn(&Structure) -> Vec<f64>) -> Physics<f64> {
    let structure = Structure::default().with(effect);
    structure.physics(&theta(&structure), 0.0)
}

fn largest(structure: &Structure) -> Vec<f64> {
    structure.parameters().iter().map(|p| p.high).collect()
}

impl Problem<'_> {
    /// Why an effect cannot be told by these demonstrations, if it cannot.
    pub fn untold(&self, effect: usize) -> Option<&'static str> {
        let some_hang = self.scenes.iter().any(|scene| scene.start.hang().is_some());
        let starts = || self.scenes.iter().map(|scene| &scene.start);
        if some_hang && flows(effect) {
            Some("where a rope hangs that gives way depends on how it got there")
        } else if !some_hang && turns_in_grip(effect) {
            Some("a rope that lies straight was gripped as it lay")
        } else if opens_late(effect) && self.scenes.iter().all(Scene::holds_throughout) {
            Some("no clamp lets go in these demonstrations")
        } else if offsets_clocks(effect)
            && starts().all(|start| matches!(start, Start::Moving(_) | Start::Poses(_)))
        {
            Some("a rope that is first seen in motion begins by the cameras' clock")
        } else {
            None
        }
    }
}
