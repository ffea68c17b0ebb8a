//! Derivative of the grid update: settling, weight, table with friction, clamps.
//!
//! Only the velocities after the update are kept. What a node had before them follows from them: the
//! springs of clamps and table are linear, and friction takes a known amount along a known direction.

use super::Precision;
use crate::sim::clamp::KEPT;
use crate::sim::tensor::{Vec3, add, dot, mul, scaled, sub};

/// What acts on a node.
pub(super) struct NodeForces<'a, F> {
    pub(super) mass: F,
    /// Stiffness of the clamps as a mass, and that times the change of velocity they ask for.
    pub(super) clamp: &'a [F; 4],
    /// Velocity of the node before the step.
    pub(super) start: Vec3<F>,
    /// The table's push upward, N s.
    pub(super) contact: F,
    pub(super) friction: F,
}

/// Derivatives of the result with respect to what entered a node.
pub(super) struct NodeCotangent<F> {
    /// The velocity before table and clamps, and what it was.
    pub(super) velocity: Vec3<F>,
    pub(super) before: Vec3<F>,
    /// The velocity before the step, as far as the clamps hold on to it.
    pub(super) start: Vec3<F>,
    pub(super) mass: F,
    pub(super) clamp: [F; 4],
    pub(super) contact: F,
    pub(super) friction: F,
}

impl<F: Precision> NodeForces<'_, F> {
    /// Pulls `bar` back, the derivative with respect to the velocity `after` the update.
    #[inline(always)]
    pub(super) fn pull_back(&self, after: Vec3<F>, bar: Vec3<F>) -> NodeCotangent<F> {
        let zero = F::zero();
        let mut out = NodeCotangent {
            velocity: bar,
            before: after,
            start: [zero; 3],
            mass: zero,
            clamp: [zero; 4],
            contact: zero,
            friction: zero,
        };
        if self.clamp[0] > zero {
            self.pull_back_clamp(&mut out);
        }
        if self.contact > zero {
            self.pull_back_table(&mut out);
        }
        out
    }

    /// v' = (m v + q K u + p)/(m + K), undone and differentiated; u is the velocity before the step.
    fn pull_back_clamp(&self, out: &mut NodeCotangent<F>) {
        let [stiffness, px, py, pz] = *self.clamp;
        let after = out.before;
        let total = self.mass + stiffness;
        let start = scaled(self.start, KEPT);
        let asked = add([px, py, pz], mul(start, stiffness));
        let before = mul(sub(mul(after, total), asked), F::one() / self.mass);
        let bar = mul(out.velocity, F::one() / total);
        out.clamp = [dot(bar, sub(start, after)), bar[0], bar[1], bar[2]];
        out.start = scaled(mul(bar, stiffness), KEPT);
        out.mass += dot(bar, sub(before, after));
        out.velocity = mul(bar, self.mass);
        out.before = before;
        // A node that sticks has no tangential velocity; undoing the clamp leaves rounding in place
        // of that zero: what the clamps ask for is a sum over up to some hundred particles.
        let rounding = 64.0 * F::EPSILON / self.mass.value();
        for k in 0..2 {
            let size = (after[k] * total).value().abs() + asked[k].value().abs();
            if before[k].value().abs() <= rounding * size {
                out.before[k] = F::zero();
            }
        }
    }

    /// v_z + n/M, and friction by this push.
    fn pull_back_table(&self, out: &mut NodeCotangent<F>) {
        let [x, y, held] = out.before;
        let [bar_x, bar_y, mut bar_push] = out.velocity;
        let push = self.contact / self.mass;
        let speed = (x * x + y * y).sqrt();
        if speed > F::zero() {
            // Slip: the speed before is the speed after and what friction took.
            let taken = self.friction * push;
            let before = speed + taken;
            let grown = before / speed;
            out.before[0] = x * grown;
            out.before[1] = y * grown;
            let kept = speed / before;
            let along = [x / speed, y / speed];
            let bar_speed = bar_x * along[0] + bar_y * along[1];
            // Across the motion the velocity keeps its share, along it a change is kept whole.
            let whole = bar_speed * (F::one() - kept);
            out.velocity[0] = bar_x * kept + along[0] * whole;
            out.velocity[1] = bar_y * kept + along[1] * whole;
            out.friction = -(bar_speed * push);
            bar_push -= bar_speed * self.friction;
        } else {
            // Stick: nothing before makes a difference.
            out.velocity[0] = F::zero();
            out.velocity[1] = F::zero();
        }
        out.contact = bar_push / self.mass;
        out.mass -= out.contact * push;
        out.before[2] = held - push;
    }
}

/// Derivatives of the result with respect to what a node's free motion is made of.
pub(super) struct FreeCotangent<F> {
    pub(super) velocity: Vec3<F>,
    pub(super) impulse: Vec3<F>,
    pub(super) mass: F,
}

/// Pulls back v = kept u + n/M + g dt to the velocity u `before` the step, the impulse n and the mass M.
#[inline(always)]
pub(super) fn pull_back_free<F: Precision>(
    cotangent: &NodeCotangent<F>,
    inverse_mass: F,
    before: Vec3<F>,
    fall: Vec3<F>,
    kept: f64,
) -> FreeCotangent<F> {
    let velocity = add(scaled(cotangent.velocity, kept), cotangent.start);
    let impulse = mul(cotangent.velocity, inverse_mass);
    // What the impulse did, n/M.
    let pushed = sub(sub(cotangent.before, fall), scaled(before, kept));
    FreeCotangent {
        velocity,
        impulse,
        mass: -dot(impulse, pushed),
    }
}
