//! The table under the rope: a spring and a damper under every slice, which only push, and Coulomb's friction.
//!
//! A slice's centre comes no nearer to the table than the rope's radius but for the little that the spring
//! gives way: this is the contact of a row of spheres. A lying rope touches as it should, and its end counts
//! as round. The damper grows with the depth, so that the force begins at zero (Hunt and Crossley 1975);
//! spring and damper are linearly implicit, hence stable for every time step.
//!
//! The force is a smooth function of depth and speed while it lasts, and springs and steps are apart. Both
//! matter for derivatives. Tried before, in this order:
//!
//! - *A spring that brings a slice to the table within one step*, from above and below: near slices that rise
//!   press those with which they share nodes into the table. A lifted rope's end sank by 2 mm and left late.
//! - *The same for slices alone that would be below after the step*: the shorter the step, the harder it threw
//!   the rope up; a free end flew 8 mm high at a quarter of the step.
//! - *The same, brought back in 2 ms*: slices began and ceased to count from step to step, which grew
//!   differences of rounding until tangents of a lift reached 1e20.

use super::real::Arithmetic;
use super::tensor::Vec3;

/// Angular frequency of a slice alone on the table, 1/s: at rest it sinks in by g/ω² = 0.4 µm, and on landing
/// at 1 m/s by less than 0.1 mm.
const RATE_PER_S: f64 = 5000.0;
/// Damping of a deep slice as a multiple of critical: it leaves at a tenth of the speed at which it landed.
const DAMPING_RATIO: f64 = 3.0;
/// Depth at which half of that damping acts, m: a step at 0.5 m/s crosses about twice of it, so that landing
/// takes more than one step.
const DAMPED_AT_M: f64 = 2e-5;

/// Velocity that the table adds to a slice within a step, m/s, and its slopes.
#[derive(Clone, Copy, Debug)]
pub struct Push<A> {
    /// Velocity added, not negative, m/s.
    pub velocity_m_s: A,
    /// Its derivative with respect to the gap below the slice, 1/s.
    pub by_gap: A,
    /// Its derivative with respect to the slice's velocity upward.
    pub by_rise: A,
}

/// The push q on a slice at the height `gap` over the place where it just touches, m, that rises at `rise`, m/s:
/// q = dt (ω² p − d r)/(1 + dt d + dt² ω²), d = 6 ω p/(p + p₀), with the depth p that it would have after the step.
#[inline(always)]
pub fn push<A: Arithmetic>(gap: A, rise: A, dt_s: f64) -> Push<A> {
    let (zero, spring) = (A::zero(), RATE_PER_S * RATE_PER_S);
    let depth = -rise.scale(dt_s) - gap;
    let depth = A::select(depth.exceeds(zero), depth, zero);
    let share = A::one() / (depth + A::of(DAMPED_AT_M));
    let most = 2.0 * DAMPING_RATIO * RATE_PER_S;
    let damper = (depth * share).scale(most);
    let damper_by_depth = (share * share).scale(most * DAMPED_AT_M);
    let per = A::of(dt_s) / (damper.scale(dt_s) + A::of(1.0 + dt_s * dt_s * spring));
    let velocity = (depth.scale(spring) - damper * rise) * per;
    let by_depth = (A::of(spring) - damper_by_depth * (rise + velocity)) * per;
    let pushes = velocity.exceeds(zero);
    let only = |slope: A| A::select(pushes, slope, zero);
    Push {
        velocity_m_s: only(velocity),
        by_gap: only(-by_depth),
        by_rise: only(-by_depth.scale(dt_s) - damper * per),
    }
}

/// A node that the table pushes up by `push`, m/s. Friction takes from the tangential velocity at most μ times
/// the push. In stick the tangential velocity is zero, and so is its derivative with respect to μ.
#[inline(always)]
pub fn rub<A: Arithmetic>(velocity: Vec3<A>, push: A, friction: A) -> Vec3<A> {
    let [vx, vy, vz] = velocity;
    let (zero, one) = (A::zero(), A::one());
    let square = vx * vx + vy * vy;
    let moves = square.exceeds(A::of(f64::from(f32::MIN_POSITIVE)));
    let speed = A::select(moves, square, one).sqrt();
    let kept = A::select(moves, one - friction * push / speed, zero);
    let kept = A::select(kept.exceeds(zero), kept, zero);
    let touches = push.exceeds(zero);
    [
        A::select(touches, vx * kept, vx),
        A::select(touches, vy * kept, vy),
        vz + push,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lands at 0.5 m/s under gravity and returns the deepest place, m, the fastest rise, m/s, and where the
    /// slice lies after 50 ms, m.
    fn land(dt_s: f64) -> [f64; 3] {
        let (mut gap, mut rise) = (1e-4, -0.5);
        let (mut deepest, mut fastest) = (0.0f64, 0.0f64);
        for _ in 0..(0.05 / dt_s) as usize {
            rise += push(gap, rise, dt_s).velocity_m_s - 9.81 * dt_s;
            gap += rise * dt_s;
            deepest = deepest.min(gap);
            fastest = fastest.max(rise);
        }
        [deepest, fastest, gap]
    }

    #[test]
    fn a_slice_lands_without_leaping_and_comes_to_rest() {
        for dt_s in [1e-6, 1e-5, 1e-4, 4e-4] {
            let [deepest, fastest, rest] = land(dt_s);
            assert!(deepest > -1e-4, "dt {dt_s}: sank by {deepest} m");
            assert!(fastest < 0.05, "dt {dt_s}: leapt at {fastest} m/s");
            assert!(rest.abs() < 5e-6, "dt {dt_s}: rests at {rest} m");
        }
    }

    #[test]
    fn slopes_are_those_of_the_push() {
        for (gap, rise) in [
            (-3e-5, -0.2),
            (-1e-4, 0.1),
            (1e-5, -0.4),
            (-2e-6, 0.0),
            (1e-4, 0.3),
        ] {
            let h = 1e-9;
            let at = |g: f64, r: f64| push(g, r, 1e-4).velocity_m_s;
            let own = push(gap, rise, 1e-4);
            let by_gap = (at(gap + h, rise) - at(gap - h, rise)) / (2.0 * h);
            let by_rise = (at(gap, rise + h) - at(gap, rise - h)) / (2.0 * h);
            assert!(
                (own.by_gap - by_gap).abs() < 1e-4 * (1.0 + by_gap.abs()),
                "{gap} {rise}"
            );
            assert!((own.by_rise - by_rise).abs() < 1e-6, "{gap} {rise}");
        }
    }
}
