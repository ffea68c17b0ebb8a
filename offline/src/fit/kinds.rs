//! What kind of thing an effect changes, asked of the laws that it adds.

use crate::model::Structure;
use crate::sim::Physics;

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
pub fn opens_late(effect: usize) -> bool {
    let structure = Structure {
        effects: vec![effect],
    };
    let most: Vec<f64> = structure.parameters().iter().map(|p| p.high).collect();
    structure.physics(&most, 0.0).release_delay_s != 0.0
}

fn alone(effect: usize) -> Physics<f64> {
    let structure = Structure {
        effects: vec![effect],
    };
    structure.physics(&structure.start(1e6), 0.0)
}
