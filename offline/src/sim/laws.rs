//! The force laws of a physics applied to the slices of a block. A law knows one piece of rope, so the means of the
//! lanes are taken out of their registers here, and forces put back.

use super::blocks::Blocks;
use super::lanes::{Instructions, Laned, Lanes, MOST_LANES};
use super::physics::{ForcePoint, SliceMotion};
use super::real::Real;
use super::rope::RopeLayout;
use super::step::StepContext;
use super::tensor::{Vec3, scaled, zero3};

/// What evaluating the laws needs besides the particles.
pub struct Laws<B> {
    /// Length of rope of a particle of each slice, m.
    lengths_m: Vec<f64>,
    /// Mean motion of the slices of a block, by channel, lane by lane.
    motions: Vec<SliceMotion<[B; MOST_LANES]>>,
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
            motions: vec![SliceMotion::zero().map(|zero| [zero; MOST_LANES]); T::CHANNELS],
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
        for (motion, registers) in self.motions.iter_mut().zip(&blocks.motions) {
            *motion = registers.map(Lanes::to_lanes);
        }
        let first = block * <T::Plain<I> as Lanes>::COUNT;
        let mut impulses: [Vec3<T>; MOST_LANES] = [zero3(); MOST_LANES];
        for (lane, impulse) in impulses.iter_mut().enumerate().take(lanes) {
            let length_m = self.lengths_m[first + lane];
            let point = ForcePoint::new(&self.motion(lane), length_m, context.diameter_m);
            *impulse = scaled(context.physics.force_n(&point), context.dt_s);
        }
        for (k, pushed) in blocks.pushed.iter_mut().enumerate() {
            for a in 0..3 {
                pushed[a] = T::Plain::<I>::from_lanes(|lane| impulses[lane][a].channel(k));
            }
        }
    }

    /// Mean motion of one slice, with its derivatives.
    fn motion<T: Laned<Base = B>>(&self, lane: usize) -> SliceMotion<T> {
        SliceMotion {
            position_m: std::array::from_fn(|a| self.number(|motion| motion.position_m[a][lane])),
            velocity_m_s: std::array::from_fn(|a| self.number(|motion| motion.velocity_m_s[a][lane])),
            axis: std::array::from_fn(|a| self.number(|motion| motion.axis[a][lane])),
            mass_kg: self.number(|motion| motion.mass_kg[lane]),
        }
    }

    fn number<T: Laned<Base = B>>(&self, of: impl Fn(&SliceMotion<[B; MOST_LANES]>) -> B) -> T {
        T::from_channels(|k| of(&self.motions[k]))
    }
}
