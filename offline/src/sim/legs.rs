//! A scene in legs: the rope as one rollout leaves it is where the next begins, at rest.
//!
//! A swing falls into what ends at rest, where neither velocities nor the way count, and what follows
//! ([`crate::swing`]); the rest itself is found by [`super::rest`].

use super::clamp::{ClampPath, Knot};
use super::engine::Engine;
use super::scene::{Grip, Scene, Settling};
use super::start::Start;
use super::tensor::{Mat3, Vec3};

/// Where a particle is, and how it is deformed there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placed {
    /// Position, m.
    pub position_m: Vec3<f64>,
    /// Deformation gradient.
    pub deformation_gradient: Mat3<f64>,
}

/// Every particle of a rope, slice by slice.
#[inline(always)]
pub(super) fn placed<T>(engine: &impl Engine<T>, members: usize) -> Vec<Placed> {
    let of_slice = |slice| (0..members).map(move |member| engine.placed(slice, member));
    (0..engine.slices()).flat_map(of_slice).collect()
}

impl Scene {
    /// What this scene does from `from_s` to `to_s`, with its clock at zero then; the rope starts at rest as
    /// `placed` says. Frames are left out.
    pub fn leg(&self, placed: Vec<Placed>, from_s: f64, to_s: f64) -> Self {
        let grip = |grip: &Grip| Grip {
            path: since(&grip.path, from_s),
            ..grip.clone()
        };
        let settling = self.settling.map(|settling| Settling {
            until_s: settling.until_s.min(to_s) - from_s,
            ..settling
        });
        Self {
            start: Start::Placed(placed),
            grips: self.grips.iter().map(grip).collect(),
            settling,
            score_from_s: self.score_from_s - from_s,
            duration_s: to_s - from_s,
            frame_times_s: Vec::new(),
            ..self.clone()
        }
    }
}

/// The same path by a clock that shows zero at `from_s`.
fn since(path: &ClampPath, from_s: f64) -> ClampPath {
    let knot = |knot: &Knot| Knot {
        t_s: knot.t_s - from_s,
        ..*knot
    };
    ClampPath::new(path.knots().iter().map(knot).collect())
}
