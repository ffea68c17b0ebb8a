//! Derivative of the grid update: settling, weight, table with friction, clamps.
//!
//! Only the velocities after the update are kept. What a node had before them follows from them: the
//! springs of clamps and table are linear, and friction takes a known amount along a known direction.

use crate::sim::clamp::KEPT;
use crate::sim::lanes::Lanes;
use crate::sim::real::Float;
use crate::sim::tensor::{Vec3, add, dot, mul, scaled, select3, sub, zero3};

/// What acts on as many nodes as a register has lanes.
pub(super) struct NodeForces<L> {
    /// Mass, zero where there is no node.
    pub(super) mass: L,
    /// Stiffness of the clamps as a mass, and that times the change of velocity they ask for.
    pub(super) clamp: [L; 4],
    /// Velocity of the node before the step.
    pub(super) start: Vec3<L>,
    /// The table's push upward, N s.
    pub(super) contact: L,
    pub(super) friction: L,
}

/// Derivatives of the result with respect to what entered a node.
pub(super) struct NodeCotangent<L> {
    /// The velocity before table and clamps, and what it was.
    pub(super) velocity: Vec3<L>,
    pub(super) before: Vec3<L>,
    /// The velocity before the step, as far as the clamps hold on to it.
    pub(super) start: Vec3<L>,
    pub(super) mass: L,
    pub(super) clamp: [L; 4],
    pub(super) contact: L,
    pub(super) friction: L,
}

// No closures: they would not be compiled for the registers' instructions.

/// |x|.
#[inline(always)]
fn size<L: Lanes>(x: L) -> L {
    L::select(x.exceeds(L::zero()), x, -x)
}

impl<L: Lanes> NodeForces<L> {
    /// Pulls `bar` back, the derivative with respect to the velocity `after` the update.
    #[inline(always)]
    pub(super) fn pull_back(&self, after: Vec3<L>, bar: Vec3<L>) -> NodeCotangent<L> {
        let mut out = NodeCotangent {
            velocity: bar,
            before: after,
            start: zero3(),
            mass: L::zero(),
            clamp: [L::zero(); 4],
            contact: L::zero(),
            friction: L::zero(),
        };
        self.pull_back_clamp(&mut out);
        self.pull_back_table(&mut out);
        out
    }

    /// The mass, one where there is no node.
    #[inline(always)]
    fn divisor(&self) -> L {
        L::select(self.mass.exceeds(L::zero()), self.mass, L::one())
    }

    /// v' = (m v + q K u + p)/(m + K), undone and differentiated; u is the velocity before the step.
    #[inline(always)]
    fn pull_back_clamp(&self, out: &mut NodeCotangent<L>) {
        let (zero, inverse) = (L::zero(), L::one() / self.divisor());
        let [stiffness, px, py, pz] = self.clamp;
        let held = stiffness.exceeds(zero);
        let after = out.before;
        let total = self.divisor() + stiffness;
        let start = scaled(self.start, KEPT);
        let asked = add([px, py, pz], mul(start, stiffness));
        let mut before = mul(sub(mul(after, total), asked), inverse);
        let bar = mul(out.velocity, L::one() / total);
        let by_stiffness = dot(bar, sub(start, after));
        out.clamp = [by_stiffness, bar[0], bar[1], bar[2]];
        for row in &mut out.clamp {
            *row = L::select(held, *row, zero);
        }
        out.start = select3(held, scaled(mul(bar, stiffness), KEPT), zero3());
        out.mass = L::select(held, dot(bar, sub(before, after)), zero);
        out.velocity = select3(held, mul(bar, self.mass), out.velocity);
        // A node that sticks has no tangential velocity; undoing the clamp leaves rounding in place
        // of that zero: what the clamps ask for is a sum over up to some hundred particles.
        let rounding = inverse.scale(64.0 * L::Scalar::EPSILON);
        for k in 0..2 {
            let least = rounding * (size(after[k] * total) + size(asked[k]));
            before[k] = L::select(size(before[k]).exceeds(least), before[k], zero);
        }
        out.before = select3(held, before, after);
    }

    /// v_z + n/M, and friction by this push.
    #[inline(always)]
    fn pull_back_table(&self, out: &mut NodeCotangent<L>) {
        let zero = L::zero();
        let touches = self.contact.exceeds(zero);
        let inverse = L::one() / self.divisor();
        let [x, y, held] = out.before;
        let [bar_x, bar_y, bar_z] = out.velocity;
        let push = self.contact * inverse;
        let square = x * x + y * y;
        let slips = square.exceeds(zero);
        let speed = L::select(slips, square, L::one()).sqrt();
        // Slip: the speed before is the speed after and what friction took.
        let before = speed + self.friction * push;
        let grown = before / speed;
        let kept = speed / before;
        let along = [x / speed, y / speed];
        let bar_speed = bar_x * along[0] + bar_y * along[1];
        // Across the motion the velocity keeps its share, along it a change is kept whole.
        let whole = bar_speed * (L::one() - kept);
        let slipped = [bar_x * kept + along[0] * whole, bar_y * kept + along[1] * whole];
        // Stick: nothing before makes a difference.
        let bar_speed = L::select(slips, bar_speed, zero);
        let bar_push = bar_z - bar_speed * self.friction;
        let contact = L::select(touches, bar_push * inverse, zero);
        let velocity = [
            L::select(slips, slipped[0], zero),
            L::select(slips, slipped[1], zero),
            bar_z,
        ];
        let undone = [
            L::select(slips, x * grown, x),
            L::select(slips, y * grown, y),
            held - push,
        ];
        out.friction = L::select(touches, -(bar_speed * push), zero);
        out.contact = contact;
        out.mass -= contact * push;
        out.velocity = select3(touches, velocity, out.velocity);
        out.before = select3(touches, undone, out.before);
    }
}

/// Derivatives of the result with respect to what a node's free motion is made of.
pub(super) struct FreeCotangent<L> {
    pub(super) velocity: Vec3<L>,
    pub(super) impulse: Vec3<L>,
    pub(super) mass: L,
}

/// Pulls back v = kept u + n/M + g dt to the velocity u `before` the step, the impulse n and the mass M.
#[inline(always)]
pub(super) fn pull_back_free<L: Lanes>(
    cotangent: &NodeCotangent<L>,
    inverse_mass: L,
    before: Vec3<L>,
    fall: Vec3<L>,
    kept: f64,
) -> FreeCotangent<L> {
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
