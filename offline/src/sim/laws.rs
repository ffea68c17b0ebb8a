//! The force laws of a physics applied to the slices of a block. A law knows one piece of rope, so the means of the
//! lanes are taken out of their registers here, and forces put back.

use super::blocks::{Blocks, MEANS};
use super::lanes::{Instructions, Laned, Lanes, MOST_LANES};
use super::physics::{ForcePoint, direction};
use super::real::Real;
use super::rope::RopeLayout;
use super::step::StepContext;
use super::tensor::{Vec3, scaled, zero3};

/// What evaluating the laws needs besides the particles.
pub struct Laws<B> {
    /// Length of rope of a particle of each slice, m.
    lengths_m: Vec<f64>,
    /// What the laws know of a block, by channel, lane by lane.
    means: Vec<[[B; MOST_LANES]; MEANS]>,
}

impl<B: Real> Laws<B> {
    /// For a layout, or nothing where there is no law.
    pub fn new<T: Laned<Base = B>>(context: &StepContext<T>, layout: &RopeLayout) -> Option<Self> {
        if context.physics.force_laws.is_empty() {
            return None;
        }
        let members = layout.section_m.len();
        let slices = layout.slices.iter();
        Some(Self {
            lengths_m: slices.map(|s| s.length_m / members as f64).collect(),
            means: vec![[[B::zero(); MOST_LANES]; MEANS]; T::CHANNELS],
        })
    }

    /// Evaluates the laws for the slices of the block that was moved last, in its first `lanes` lanes.
    pub fn evaluate<T: Laned<Base = B>, I: Instructions>(
        &mut self,
        context: &StepContext<T>,
        block: usize,
        lanes: usize,
        blocks: &mut Blocks<T::Plain<I>>,
    ) {
        for (means, registers) in self.means.iter_mut().zip(&blocks.means) {
            *means = registers.map(Lanes::to_lanes);
        }
        let first = block * <T::Plain<I> as Lanes>::COUNT;
        let mut impulses: [Vec3<T>; MOST_LANES] = [zero3(); MOST_LANES];
        for (lane, impulse) in impulses.iter_mut().enumerate().take(lanes) {
            let point = ForcePoint {
                position_m: self.vector(lane, 0),
                velocity_m_s: self.vector(lane, 3),
                tangent: direction(self.vector(lane, 6)),
                length_m: self.lengths_m[first + lane],
                diameter_m: context.diameter_m,
                mass_kg: self.number(lane, 9),
            };
            *impulse = scaled(context.physics.force_n(&point), context.dt_s);
        }
        for (k, pushed) in blocks.pushed.iter_mut().enumerate() {
            for a in 0..3 {
                pushed[a] = T::Plain::<I>::from_lanes(|lane| impulses[lane][a].channel(k));
            }
        }
    }

    fn number<T: Laned<Base = B>>(&self, lane: usize, number: usize) -> T {
        T::from_channels(|k| self.means[k][number][lane])
    }

    fn vector<T: Laned<Base = B>>(&self, lane: usize, first: usize) -> Vec3<T> {
        std::array::from_fn(|a| self.number(lane, first + a))
    }
}
