//! The laws of a physics applied to a block of particles. A law knows one particle, so its lanes are
//! taken out of their registers here and put back.

use super::block_material::columns_times;
use super::blocks::{Blocks, Body, Extra};
use super::lanes::{Instructions, Laned, Lanes, MOST_LANES};
use super::material::add_stress_laws;
use super::physics::ForcePoint;
use super::real::Real;
use super::rope::RopeLayout;
use super::step::StepContext;
use super::tensor::{Mat3, Vec3, det, scaled, zero3};

/// What evaluating the laws needs besides the particles.
pub struct Laws {
    members: usize,
    spacing_m: f64,
    /// Length of rope of a particle of each slice, m.
    lengths_m: Vec<f64>,
}

/// The lanes of one member, channel by channel: deformation gradient, rate, position, velocity, mass.
struct Unpacked<B> {
    numbers: Vec<[[B; MOST_LANES]; NUMBERS]>,
}

const NUMBERS: usize = 25;

impl Laws {
    /// For a layout, or nothing where there is no law.
    pub fn new<T: Real>(context: &StepContext<T>, layout: &RopeLayout, spacing_m: f64) -> Option<Self> {
        if context.physics.force_laws.is_empty() && context.physics.stress_laws.is_empty() {
            return None;
        }
        let members = layout.section_m.len();
        Some(Self {
            members,
            spacing_m,
            lengths_m: layout
                .slices
                .iter()
                .map(|s| s.length_m / members as f64)
                .collect(),
        })
    }

    /// Space for what the laws give.
    pub fn space<L: Lanes>(&self, channels: usize) -> Extra<L> {
        Extra {
            impulses: vec![zero3(); channels * self.members],
            stresses: vec![[zero3(); 3]; channels * self.members],
        }
    }

    /// Evaluates the laws for the particles of the block that was moved last, in its first `lanes` lanes.
    pub fn evaluate<T: Laned, I: Instructions>(
        &self,
        context: &StepContext<T>,
        block: usize,
        lanes: usize,
        blocks: &mut Blocks<T::Plain<I>>,
    ) {
        let mut impulses = [zero3(); MOST_LANES];
        let mut stresses = [[zero3(); 3]; MOST_LANES];
        let first_body = block * T::CHANNELS * self.members;
        let bodies = &blocks.bodies[first_body..first_body + T::CHANNELS * self.members];
        let Some(extra) = &mut blocks.extra else { return };
        // Only stresses ask for the shape at rest.
        let stresses_act = !context.physics.stress_laws.is_empty();
        let material = blocks.material.as_ref().filter(|_| stresses_act);
        let first = block * <T::Plain<I> as Lanes>::COUNT;
        for member in 0..self.members {
            let unpacked = Unpacked::<T::Base>::new::<T, I>(member, self.members, bodies, &blocks.rates);
            for lane in 0..lanes {
                let length_m = self.lengths_m[first + lane];
                impulses[lane] = unpacked.impulse(context, lane, length_m);
                let rest = material.and_then(|m| m.stretch_at_rest(block, member, lane));
                stresses[lane] = unpacked.stress(context, lane, self.spacing_m, rest);
            }
            for k in 0..T::CHANNELS {
                let at = k * self.members + member;
                for a in 0..3 {
                    extra.impulses[at][a] = T::Plain::<I>::from_lanes(|lane| impulses[lane][a].channel(k));
                    for b in 0..3 {
                        extra.stresses[at][a][b] =
                            T::Plain::<I>::from_lanes(|lane| stresses[lane][a][b].channel(k));
                    }
                }
            }
        }
    }
}

impl<B: Real> Unpacked<B> {
    fn new<T: Laned<Base = B>, I: Instructions>(
        member: usize,
        members: usize,
        bodies: &[Body<T::Plain<I>>],
        rates: &[Mat3<T::Plain<I>>],
    ) -> Self {
        let numbers = (0..T::CHANNELS)
            .map(|k| {
                let (body, rate) = (&bodies[k * members + member], &rates[k * members + member]);
                std::array::from_fn(|n| {
                    let register = match n {
                        0..9 => body.deformation_gradient[n / 3][n % 3],
                        9..18 => rate[n / 3 - 3][n % 3],
                        18..21 => body.position_m[n - 18],
                        21..24 => body.velocity_m_s[n - 21],
                        _ => body.mass_kg,
                    };
                    register.to_lanes()
                })
            })
            .collect();
        Self { numbers }
    }

    fn number<T: Laned<Base = B>>(&self, lane: usize, number: usize) -> T {
        T::from_channels(|k| self.numbers[k][number][lane])
    }

    fn vector<T: Laned<Base = B>>(&self, lane: usize, first: usize) -> Vec3<T> {
        std::array::from_fn(|a| self.number(lane, first + a))
    }

    fn matrix<T: Laned<Base = B>>(&self, lane: usize, first: usize) -> Mat3<T> {
        std::array::from_fn(|a| self.vector(lane, first + 3 * a))
    }

    fn impulse<T: Laned<Base = B>>(&self, context: &StepContext<T>, lane: usize, length_m: f64) -> Vec3<T> {
        if context.physics.force_laws.is_empty() {
            return zero3();
        }
        let point = ForcePoint {
            position_m: self.vector(lane, 18),
            velocity_m_s: self.vector(lane, 21),
            tangent: ForcePoint::tangent(&self.matrix(lane, 0)),
            length_m,
            diameter_m: context.diameter_m,
            mass_kg: self.number(lane, 24),
        };
        scaled(context.physics.force_n(&point), context.dt_s)
    }

    /// The Kirchhoff stresses τ of the laws as P = τ F⁻ᵀ; `rest` is the stretch at rest and one over it.
    fn stress<T: Laned<Base = B>>(
        &self,
        context: &StepContext<T>,
        lane: usize,
        spacing_m: f64,
        rest: Option<[T; 2]>,
    ) -> Mat3<T> {
        let mut sum = [zero3(); 3];
        if context.physics.stress_laws.is_empty() {
            return sum;
        }
        let mut f: Mat3<T> = self.matrix(lane, 0);
        let mut rate: Mat3<T> = self.matrix(lane, 9).map(|row| scaled(row, 1.0 / spacing_m));
        if let Some([_, inverse]) = rest {
            f = columns_times(&f, 0..1, inverse);
            rate = columns_times(&rate, 0..1, inverse);
        }
        add_stress_laws((&f, &rate), context.physics, &context.lame, det(&f), &mut sum);
        if let Some([stretch, _]) = rest {
            sum = columns_times(&sum, 1..3, stretch);
        }
        sum
    }
}
