//! Back over what the clamps' springs do in a step, and over how pads turn them.

use super::super::Precision;
use super::super::paths::MotionCotangent;
use super::super::state::total;
use super::super::var::Var;
use super::WayBack;
use crate::sim::clamp::{KEPT, RigidMotion};
use crate::sim::engine::Engine;
use crate::sim::lanes::{Instructions, Lanes};
use crate::sim::nodes::CLAMP_ROWS;
use crate::sim::real::Arithmetic;
use crate::sim::tensor::{Vec3, zero3};
use std::cell::RefCell;

impl<F: Precision, I: Instructions> WayBack<'_, F, I> {
    /// From the turned motions to the recorded ones, to the particles in the grips, and to what pads follow from.
    fn pads(&mut self, recorded: &[Option<RigidMotion<F>>], bars: &mut [MotionCotangent]) {
        let Some(pads) = &self.vars.context.pads else {
            return;
        };
        let (session, dt_s) = (self.session, self.setup.context.dt_s);
        let mark = session.mark();
        let input = |value: F| session.input(value.value());
        let inputs: Vec<Option<RigidMotion<Var>>> = recorded
            .iter()
            .map(|motion| {
                motion.as_ref().map(|motion| RigidMotion {
                    position_m: motion.position_m.map(input),
                    rotation: motion.rotation.map(|row| row.map(input)),
                })
            })
            .collect();
        let mut turned = inputs.clone();
        let places: RefCell<Vec<([usize; 2], Vec3<Var>)>> = RefCell::default();
        pads.turn(&mut turned, |place| {
            let at = self.engine.place_after(place, dt_s).map(input);
            places.borrow_mut().push((place, at));
            at
        });
        for (bar, turned) in bars.iter().zip(&turned) {
            if let Some(turned) = turned {
                bar.seed(session, turned);
            }
        }
        session.sweep(mark);
        for (bar, input) in bars.iter_mut().zip(&inputs) {
            if let Some(input) = input {
                *bar = MotionCotangent::of(session, input);
            }
        }
        for (place, at) in places.into_inner() {
            self.place_after(place, at.map(|x| session.adjoint(x)), dt_s);
        }
        session.rewind(mark);
    }

    /// From where a member of a slice goes on to within a time to where it is and how fast.
    fn place_after(&mut self, [slice, member]: [usize; 2], bar: [f64; 3], dt_s: f64) {
        let (block, of_slice) = (slice / Self::count(), slice % Self::count());
        let state = &mut self.bars[block * self.setup.context.section + member];
        for a in 0..3 {
            let only = |value: f64| {
                F::Plain::<I>::from_lanes(|lane| F::of(if lane == of_slice { value } else { 0.0 }))
            };
            state.position[a] += only(bar[a]);
            state.velocity[a] += only(dt_s * bar[a]);
        }
    }

    /// From the clamps' springs to the particles and to the motion of the clamps.
    #[inline(always)]
    pub(super) fn clamps(&mut self, [recorded, motions]: [&[Option<RigidMotion<F>>]; 2], number: usize) {
        let mut of_motions = vec![MotionCotangent::default(); motions.len()];
        for held in 0..self.engine.blocks.held.len() {
            let grip = self.engine.blocks.held[held].grip;
            if let Some(motion) = &motions[grip] {
                self.clamp(held, motion, &mut of_motions[grip]);
            }
        }
        self.pads(recorded, &mut of_motions);
        for (grip, bar) in of_motions.iter().enumerate() {
            if motions[grip].is_some() {
                self.paths.pull_back(self.session, self.vars, grip, number, bar);
            }
        }
    }

    /// The same for a share of a grip. No closures here either.
    #[inline(always)]
    fn clamp(&mut self, held: usize, motion: &RigidMotion<F>, of_motion: &mut MotionCotangent) {
        let (members, width) = (self.members(), self.engine.blocks.transfer.width);
        let per_step = F::Plain::<I>::of(1.0 / self.setup.context.dt_s);
        let held = &self.engine.blocks.held[held];
        let block = held.block;
        let transfer = &self.engine.blocks.transfer;
        transfer.read_planes(block, CLAMP_ROWS, &self.clamp_bars, &mut self.scratch);
        let springs = held.mask * F::Plain::<I>::splat(self.setup.context.clamp_stiffness);
        let (mut position, mut rotation) = (zero3(), [zero3(); 3]);
        let mut by_stiffness = F::Plain::<I>::zero();
        for member in 0..members {
            let index = block * members + member;
            let (body, offset) = (&self.engine.blocks.bodies[index], &held.offsets_m[member]);
            let stiffness = body.mass_kg * springs;
            let mut by_mass = transfer.gather_value(member, &self.scratch[..width]);
            let state = &mut self.bars[index];
            for a in 0..3 {
                let row = (a + 1) * width..(a + 2) * width;
                let bar = transfer.gather_value(member, &self.scratch[row]);
                let mut gap = F::Plain::<I>::splat(motion.position_m[a]) - body.position_m[a];
                for b in 0..3 {
                    gap = F::Plain::<I>::splat(motion.rotation[a][b]).times_plus(offset[b], gap);
                }
                by_mass += bar * (gap * per_step - body.velocity_m_s[a].scale(KEPT));
                let place = bar * stiffness * per_step;
                state.position[a] -= place;
                state.velocity[a] -= (bar * stiffness).scale(KEPT);
                position[a] += place;
                for b in 0..3 {
                    rotation[a][b] = place.times_plus(offset[b], rotation[a][b]);
                }
            }
            by_stiffness = by_mass.times_plus(body.mass_kg * held.mask, by_stiffness);
            if self.weighed {
                self.mass_bars.add(block, member, by_mass * springs);
            }
        }
        of_motion.add(position, &rotation);
        self.totals.clamp_stiffness += total(by_stiffness);
    }
}
