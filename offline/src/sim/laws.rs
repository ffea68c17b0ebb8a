//! The laws of a physics applied to a block of particles. A law knows one particle, so its lanes are
//! taken out of their registers here and put back.

use super::lanes::{Instructions, Laned, Lanes, MOST_LANES};
use super::physics::{ForcePoint, StressPoint};
use super::real::{Arithmetic, Real};
use super::rope::RopeLayout;
use super::step::StepContext;
use super::sweep::Body;
use super::tensor::{Mat3, Vec3, add, dot, matmul, matmul_transposed, mul, scaled, transpose_inverse, zero3};

/// What the laws give to the members of a block.
pub struct LawForces<T: Laned, I: Instructions> {
    /// Channel, member: force times time step, N s.
    pub impulses: Vec<Vec3<T::Plain<I>>>,
    /// Channel, member: first Piola-Kirchhoff stress, Pa.
    pub stresses: Vec<Mat3<T::Plain<I>>>,
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

impl<T: Laned, I: Instructions> LawForces<T, I> {
    /// Space for the results, or nothing where there is no law.
    pub fn new(context: &StepContext<T>, layout: &RopeLayout, spacing_m: f64) -> Option<Self> {
        if context.physics.force_laws.is_empty() && context.physics.stress_laws.is_empty() {
            return None;
        }
        let members = layout.section_m.len();
        let zero = T::Plain::<I>::zero();
        Some(Self {
            impulses: vec![[zero; 3]; T::CHANNELS * members],
            stresses: vec![[[zero; 3]; 3]; T::CHANNELS * members],
            members,
            spacing_m,
            lengths_m: layout
                .slices
                .iter()
                .map(|s| s.length_m / members as f64)
                .collect(),
        })
    }

    /// Evaluates the laws for the particles of a block. `bodies` and `rates` (dx Ḟ) are ordered by
    /// channel, then member.
    pub fn evaluate(
        &mut self,
        context: &StepContext<T>,
        block: usize,
        lanes: usize,
        bodies: &[Body<T::Plain<I>>],
        rates: &[Mat3<T::Plain<I>>],
    ) {
        let mut impulses = [zero3(); MOST_LANES];
        let mut stresses = [[zero3(); 3]; MOST_LANES];
        let first = block * <T::Plain<I> as Lanes>::COUNT;
        for member in 0..self.members {
            let unpacked = Unpacked::<T::Base>::new::<T, I>(member, self.members, bodies, rates);
            for lane in 0..lanes {
                let length_m = self.lengths_m[first + lane];
                impulses[lane] = unpacked.impulse(context, lane, length_m);
                stresses[lane] = unpacked.stress(context, lane, self.spacing_m);
            }
            for k in 0..T::CHANNELS {
                let at = k * self.members + member;
                for a in 0..3 {
                    let pack = |number: &dyn Fn(usize) -> T| {
                        T::Plain::<I>::from_lanes(|lane| number(lane).channel(k))
                    };
                    self.impulses[at][a] = pack(&|lane| impulses[lane][a]);
                    for b in 0..3 {
                        self.stresses[at][a][b] = pack(&|lane| stresses[lane][a][b]);
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
        let mut sum = zero3();
        if context.physics.force_laws.is_empty() {
            return sum;
        }
        let axis: Vec3<T> = std::array::from_fn(|a| self.number(lane, 3 * a));
        let point = ForcePoint {
            position_m: self.vector(lane, 18),
            velocity_m_s: self.vector(lane, 21),
            tangent: mul(axis, T::one() / dot(axis, axis).sqrt()),
            length_m,
            diameter_m: context.diameter_m,
            mass_kg: self.number(lane, 24),
        };
        for law in &context.physics.force_laws {
            sum = add(sum, scaled(law.force_n(&point), context.dt_s));
        }
        sum
    }

    /// The Kirchhoff stresses τ of the laws as P = τ F⁻ᵀ.
    fn stress<T: Laned<Base = B>>(&self, context: &StepContext<T>, lane: usize, spacing_m: f64) -> Mat3<T> {
        let mut sum = [zero3(); 3];
        if context.physics.stress_laws.is_empty() {
            return sum;
        }
        let f: Mat3<T> = self.matrix(lane, 0);
        let rate: Mat3<T> = self.matrix(lane, 9).map(|row| scaled(row, 1.0 / spacing_m));
        let inverse_transposed = transpose_inverse(&f);
        let point = StressPoint {
            deformation_gradient: &f,
            velocity_gradient: &matmul_transposed(&rate, &inverse_transposed),
            volume_ratio: super::tensor::det(&f),
            lame: &context.lame,
        };
        for law in &context.physics.stress_laws {
            let extra = matmul(&law.kirchhoff_pa(&point), &inverse_transposed);
            sum = std::array::from_fn(|a| add(sum[a], extra[a]));
        }
        sum
    }
}
