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
use super::scene::Scene;
use super::tensor::Vec3;

/// Angular frequency of a usual slice alone on the table, 1/s: at rest it sinks in by g/ω² = 0.07 µm, on landing
/// at 1 m/s by less than 0.05 mm. The last slices of a rope that is lifted carry half its weight and sink by some
/// tenths of a millimetre; at 3,000 they sank by 0.7 mm.
const RATE_PER_S: f64 = 12000.0;
/// Damping of a slice deep in the table as a multiple of critical: landed at 1 m/s it leaves at less than 0.3 m/s
/// for the shortest steps, at less than 0.1 m/s for usual ones.
const DAMPING_RATIO: f64 = 5.0;
/// Depth at which half of that damping acts, m: what a slice of 1 m/s crosses in two steps of a usual rope. At
/// 5e-5 rounding in single precision grew ten times as much in a rope that is dropped.
const DAMPED_AT_M: f64 = 2e-4;

/// Share by which single precision may round a mass.
const ROUNDING: f64 = 1e-6;

/// Where the table is, and what stands under a usual slice.
#[derive(Clone, Copy, Debug)]
pub struct Contact {
    /// Height of the centre of a slice that just touches, m.
    pub lowest_m: f64,
    /// Length of rope that a particle of a usual slice stands for, m.
    usual_length_m: f64,
    /// Density of the rope as declared, kg/m³.
    density_kg_m3: f64,
}

impl Contact {
    /// That of a scene whose slices have `section` particles; none where it has no table.
    pub fn of(scene: &Scene, section: usize) -> Option<Self> {
        Some(Self {
            lowest_m: scene.table?.height_m + 0.5 * scene.rope.diameter_m,
            usual_length_m: scene.sampling.slice_cells * scene.grid.spacing_m / section as f64,
            density_kg_m3: scene.rope.density_kg_m3(),
        })
    }

    /// What stands under a slice whose particles stand for this length and volume and have this mass. It pushes as
    /// if they had the mass as declared, but a lighter slice with its own: twice the push that stops it would
    /// throw it off as fast as it came.
    pub fn footing(&self, length_m: f64, volume_m3: f64, mass_kg: f64) -> Footing<f64> {
        let declared_kg = volume_m3 * self.density_kg_m3;
        // Rounding of the declared mass makes no slice lighter.
        let lighter = mass_kg < (1.0 - ROUNDING) * declared_kg;
        Footing {
            mass_kg: if lighter { mass_kg } else { declared_kg },
            own: f64::from(lighter),
            ratio: self.usual_length_m / length_m,
        }
    }
}

/// The spring and the damper under every particle of a slice: the same under each slice, however thin it is.
#[derive(Clone, Copy, Debug)]
pub struct Footing<A> {
    /// Mass of the particle as declared, or its own where that is less, kg.
    pub mass_kg: A,
    /// One where it is its own, zero where it is as declared.
    pub own: A,
    /// Stiffness for this mass over that for the mass of a usual slice.
    pub ratio: A,
}

/// What the table gives each particle of a slice within a step, N s, and its slopes.
#[derive(Clone, Copy, Debug)]
pub struct Push<A> {
    /// Impulse upward, not negative, N s.
    pub impulse: A,
    /// Its derivative with respect to the gap below the slice, N s/m.
    pub by_gap: A,
    /// Its derivative with respect to the slice's velocity upward, kg.
    pub by_rise: A,
    /// Its derivative with respect to the particle's own mass, m/s.
    pub by_mass: A,
}

/// The push on a slice at the height `gap` over the place where it just touches, m, that rises at `rise`, m/s:
/// m dt (k p − c r)/(1 + dt c + dt² k) with k = ρ ω², c = ρ 2ζω p/(p + p₀), the footing's ratio ρ, and the depth p
/// that the slice would have after the step.
#[inline(always)]
pub fn push<A: Arithmetic>(gap: A, rise: A, footing: &Footing<A>, dt_s: f64) -> Push<A> {
    let zero = A::zero();
    let depth = -rise.scale(dt_s) - gap;
    let depth = A::select(depth.exceeds(zero), depth, zero);
    let spring = footing.ratio.scale(RATE_PER_S * RATE_PER_S);
    let most = footing.ratio.scale(2.0 * DAMPING_RATIO * RATE_PER_S);
    let share = A::one() / (depth + A::of(DAMPED_AT_M));
    let damper = most * depth * share;
    let damper_by_depth = most * (share * share).scale(DAMPED_AT_M);
    let per = A::of(dt_s) / (A::one() + (damper + spring.scale(dt_s)).scale(dt_s));
    let velocity = (depth * spring - damper * rise) * per;
    let by_depth = (spring - damper_by_depth * (rise + velocity)) * per;
    let mass = A::select(velocity.exceeds(zero), footing.mass_kg, zero);
    Push {
        impulse: mass * velocity,
        by_gap: -(mass * by_depth),
        by_rise: -(mass * (by_depth.scale(dt_s) + damper * per)),
        by_mass: A::select(velocity.exceeds(zero), footing.own * velocity, zero),
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

    const TABLE: Contact = Contact {
        lowest_m: 0.0,
        usual_length_m: 1.0,
        density_kg_m3: 1.0,
    };

    /// Drops a slice of this share of its declared mass at a speed under gravity and returns the deepest place, m, the
    /// fastest rise, m/s, and where it lies after half a second, m.
    fn land(share: f64, speed_m_s: f64, dt_s: f64) -> [f64; 3] {
        let footing = TABLE.footing(1.0, 1.0, share);
        let (mut gap, mut rise) = (1e-4, -speed_m_s);
        let (mut deepest, mut fastest) = (0.0f64, 0.0f64);
        for _ in 0..(0.5 / dt_s) as usize {
            rise += push(gap, rise, &footing, dt_s).impulse / share - 9.81 * dt_s;
            gap += rise * dt_s;
            deepest = deepest.min(gap);
            fastest = fastest.max(rise);
        }
        [deepest, fastest, gap]
    }

    #[test]
    fn a_slice_lands_without_leaping_high_and_comes_to_rest() {
        for dt_s in [1e-6, 1e-5, 1e-4, 4e-4] {
            comes_to_rest(1.0, dt_s);
        }
    }

    /// Seen: the end of a rope with a density gradient of -1 was thrown up and down on the table by less than can be
    /// seen, and every derivative grew beyond all numbers.
    #[test]
    fn so_does_a_slice_that_is_lighter_than_declared() {
        for share in [0.5, 0.25] {
            for dt_s in [1e-6, 1e-5, 1e-4, 4e-4] {
                comes_to_rest(share, dt_s);
            }
        }
    }

    fn comes_to_rest(share: f64, dt_s: f64) {
        let [deepest, fastest, rest] = land(share, 1.0, dt_s);
        assert!(deepest > -5e-5, "{share}, dt {dt_s}: sank by {deepest} m");
        assert!(fastest < 0.3, "{share}, dt {dt_s}: leapt at {fastest} m/s");
        assert!(rest.abs() < 1e-5, "{share}, dt {dt_s}: rests at {rest} m");
    }

    #[test]
    fn slopes_are_those_of_the_push() {
        let footing = Footing {
            mass_kg: 1.0,
            own: 1.0,
            ratio: 3.0,
        };
        for (gap, rise) in [
            (-3e-5, -0.2),
            (-1e-4, 0.1),
            (1e-5, -0.4),
            (-2e-6, 0.0),
            (1e-4, 0.3),
        ] {
            let h = 1e-9;
            let at = |g: f64, r: f64| push(g, r, &footing, 1e-4).impulse;
            let own = push(gap, rise, &footing, 1e-4);
            let by_gap = (at(gap + h, rise) - at(gap - h, rise)) / (2.0 * h);
            let by_rise = (at(gap, rise + h) - at(gap, rise - h)) / (2.0 * h);
            assert!(
                (own.by_gap - by_gap).abs() < 1e-4 * (1.0 + by_gap.abs()),
                "{gap} {rise}"
            );
            assert!((own.by_rise - by_rise).abs() < 1e-6, "{gap} {rise}");
            // The push is proportional to the mass.
            assert_eq!(own.by_mass, own.impulse, "{gap} {rise}");
        }
    }
}
