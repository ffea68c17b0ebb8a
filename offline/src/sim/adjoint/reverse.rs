//! The way back over a rollout, step by step, from its end to its start.

use super::laws::{LawCotangent, pull_back_laws};
use super::nodes::{NodeForces, pull_back_fall};
use super::paths::{MotionCotangent, PathGradients};
use super::seeds::Seeds;
use super::stress::pull_back_piola;
use super::var::{Session, Var};
use super::{Family, Float, Gradient, Record, State, keep_nodes};
use crate::sim::clamp::{RigidMotion, STIFFNESS};
use crate::sim::error::SimError;
use crate::sim::grid::{Grid, STENCIL};
use crate::sim::rollout::{Setup, kick_m_s};
use crate::sim::step::{
    MomentumField, Particle, asked_of_slice, clamp_target, field_of_nodes, scatter, scatter_clamp,
    scatter_contact,
};
use crate::sim::tensor::{Vec3, add, dot, mul, scaled, sub, zero3};

/// Runs back over a rollout. `grid` and `particles` are as the last step left them.
#[inline(always)]
pub(super) fn gradient<F: Float, M: Family>(
    setup: &Setup<F>,
    (grid, particles): (Grid<F>, Vec<Particle<F>>),
    mut record: Record<F>,
    mut seeds: Seeds,
    family: &M,
    theta: &[f64],
) -> Result<Gradient, SimError> {
    let session = Session::open();
    let inputs: Vec<Var> = theta.iter().map(|&x| session.input(x)).collect();
    let physics = family.physics(&inputs);
    let vars = Setup::new(setup.scene, &physics)?;
    let mut back = WayBack::new(setup, &vars, &session, grid, particles);
    seeds.add(setup.steps, setup.context.section, &mut back.bars);
    for segment in (0..record.plan.segments).rev() {
        let range = record.plan.range(segment, setup.steps);
        let checkpoint = record.checkpoints.pop().expect("every segment has a checkpoint");
        let nodes = match record.nodes.pop() {
            Some(nodes) => nodes,
            None => back.repeat(&checkpoint, range.clone())?,
        };
        let count = back.grid.nodes.len();
        let of_step = |number: usize| &nodes[(number - range.start) * count..][..count];
        for number in range.clone().rev() {
            let before = (number > range.start).then(|| of_step(number - 1));
            back.undo(before, &checkpoint);
            back.step(number, of_step(number));
            seeds.add(number, setup.context.section, &mut back.bars);
        }
    }
    Ok(back.finish(&inputs))
}

/// Derivatives with respect to coefficients, summed over particles and steps.
#[derive(Default)]
struct Totals {
    mu: f64,
    lambda: f64,
    friction: f64,
    gravity: [f64; 3],
}

struct WayBack<'a, F: Float> {
    setup: &'a Setup<'a, F>,
    vars: &'a Setup<'a, Var>,
    session: &'a Session,
    grid: Grid<F>,
    /// The state before the step at hand.
    particles: Vec<Particle<F>>,
    /// Derivatives with respect to that state.
    bars: Vec<State<F>>,
    /// Derivatives with respect to the nodes: velocity, then momentum; clamps; contact.
    node_bars: Vec<F::Packed>,
    clamp_bars: Vec<[F; 4]>,
    contact_bars: Vec<[F; 2]>,
    /// Derivatives with respect to masses; only filled where masses depend on parameters.
    node_mass_bars: Vec<f64>,
    mass_bars: Vec<f64>,
    weighed: bool,
    totals: Totals,
    paths: PathGradients,
    force_field: Vec<Vec<Vec3<f64>>>,
}

impl<'a, F: Float> WayBack<'a, F> {
    fn new(
        setup: &'a Setup<'a, F>,
        vars: &'a Setup<'a, Var>,
        session: &'a Session,
        grid: Grid<F>,
        particles: Vec<Particle<F>>,
    ) -> Self {
        let zero = F::zero();
        let count = grid.nodes.len();
        let field = setup.context.physics.force_field.as_ref();
        let zeros = |block: &Vec<Vec3<F>>| vec![[0.0; 3]; block.len()];
        Self {
            bars: vec![State::zero(); particles.len()],
            node_bars: vec![F::pack([zero; 3]); count],
            clamp_bars: vec![[zero; 4]; count],
            contact_bars: vec![[zero; 2]; count],
            node_mass_bars: vec![0.0; count],
            mass_bars: vec![0.0; particles.len()],
            weighed: !setup.context.physics.mass_laws.is_empty(),
            totals: Totals::default(),
            paths: PathGradients::new(vars),
            force_field: field.map_or(Vec::new(), |f| f.force_n_m.iter().map(zeros).collect()),
            setup,
            vars,
            session,
            grid,
            particles,
        }
    }

    /// Simulates the steps of a segment again from its checkpoint; returns their node velocities.
    fn repeat(
        &mut self,
        checkpoint: &[State<F>],
        range: std::ops::Range<usize>,
    ) -> Result<Vec<Vec3<F>>, SimError> {
        self.restore(checkpoint);
        let mut nodes = Vec::with_capacity(range.len() * self.grid.nodes.len());
        for number in range {
            self.setup.advance(&mut self.particles, &mut self.grid, number)?;
            keep_nodes(&self.grid, &mut nodes);
        }
        Ok(nodes)
    }

    fn restore(&mut self, checkpoint: &[State<F>]) {
        for (particle, state) in self.particles.iter_mut().zip(checkpoint) {
            state.restore(particle);
        }
    }

    /// Takes the particles back by one step. `before` holds the velocities of the nodes after the step
    /// before; at the start of a segment the checkpoint says it all.
    #[inline(always)]
    fn undo(&mut self, before: Option<&[Vec3<F>]>, checkpoint: &[State<F>]) {
        let Some(before) = before else {
            return self.restore(checkpoint);
        };
        for (node, &velocity) in self.grid.nodes.iter_mut().zip(before) {
            *node = F::pack(velocity);
        }
        let dt_s = self.setup.context.dt_s;
        for (p, link) in self.particles.iter_mut().zip(&self.grid.links) {
            p.position_m = sub(p.position_m, scaled(p.velocity_m_s, dt_s));
            for a in 0..3 {
                let row = &mut p.deformation_gradient[a];
                *row = sub(*row, scaled(p.deformation_rate[a], dt_s));
            }
            (p.velocity_m_s, p.deformation_rate) =
                field_of_nodes(link, self.grid.spacing_m, &self.grid.nodes);
        }
    }

    /// Carries the derivatives over one step. `after` holds the nodes' velocities after it.
    #[inline(always)]
    fn step(&mut self, number: usize, after: &[Vec3<F>]) {
        let motions = self.setup.motions(number);
        self.gather_springs(&motions);
        self.spread();
        self.nodes(after, self.setup.decay(number));
        self.particles(number);
        self.kicks(number);
        if self.grid.constrained {
            self.clamps(&motions, number);
            self.contact();
        }
    }

    /// The springs of clamps and table at the nodes, as the step had them.
    fn gather_springs(&mut self, motions: &[Option<RigidMotion<F>>]) {
        let context = &self.setup.context;
        self.grid.clear();
        for (index, p) in self.particles.iter().enumerate() {
            if let Some((stiffness, velocity)) = clamp_target(p, motions, context.dt_s) {
                scatter_clamp(index, stiffness, velocity, &mut self.grid);
            }
        }
        if let Some(table_m) = context.table_m {
            scatter_contact(&self.particles, table_m, context, &mut self.grid);
        }
    }

    /// Transpose of the transfer from the grid.
    #[inline(always)]
    fn spread(&mut self) {
        let (dt_s, dx) = (self.setup.context.dt_s, self.grid.spacing_m);
        self.node_bars.fill(F::pack([F::zero(); 3]));
        for (bar, link) in self.bars.iter().zip(&self.grid.links) {
            let mut slope = bar.deformation_rate;
            for a in 0..3 {
                let row = add(slope[a], scaled(bar.deformation_gradient[a], dt_s));
                slope[a] = scaled(row, 4.0 / (dx * dx));
            }
            let field = MomentumField {
                at_particle: add(bar.velocity_m_s, scaled(bar.position_m, dt_s)),
                slope,
            };
            scatter(link, dx, &field, &mut self.node_bars);
        }
    }

    #[inline(always)]
    fn nodes(&mut self, after: &[Vec3<F>], decay: f64) {
        let context = &self.setup.context;
        let fall = scaled(context.physics.gravity_m_s2, context.dt_s);
        let mut gravity = zero3::<F>();
        for (index, &velocity) in after.iter().enumerate() {
            let forces = NodeForces {
                mass: self.grid.mass_kg[index],
                clamp: &self.grid.clamps[index],
                contact: &self.grid.contact[index],
                friction: context.physics.friction,
            };
            let bar = forces.pull_back(velocity, F::unpack(self.node_bars[index]));
            let (momentum, mass) = pull_back_fall(&bar, self.grid.inverse_mass[index], fall, decay);
            self.node_bars[index] = F::pack(momentum);
            gravity = add(gravity, bar.velocity);
            if self.grid.constrained {
                self.clamp_bars[index] = bar.clamp;
                self.contact_bars[index] = bar.contact;
                self.totals.friction += bar.friction.value();
            }
            if self.weighed {
                self.node_mass_bars[index] += (mass + bar.mass).value();
            }
        }
        for k in 0..3 {
            self.totals.gravity[k] += gravity[k].value() * context.dt_s;
        }
    }

    /// Transpose of the transfer to the grid, then what made the momenta.
    #[inline(always)]
    fn particles(&mut self, number: usize) {
        let context = &self.setup.context;
        let dx = self.grid.spacing_m;
        let forces = self.setup.block_of_forces(number);
        let laws = self.vars.context.physics;
        let lawful = !(laws.stress_laws.is_empty() && laws.force_laws.is_empty());
        let (mut mu, mut lambda) = (0.0, 0.0);
        for (index, p) in self.particles.iter().enumerate() {
            let (momentum, rate) = field_of_nodes(&self.grid.links[index], dx, &self.node_bars);
            let stress = rate.map(|row| scaled(row, -context.dt_s * p.volume_m3));
            let slope = rate.map(|row| scaled(row, 0.25 * dx * dx));
            let elastic = pull_back_piola(&p.deformation_gradient, &context.lame, &stress);
            mu += elastic.lame[0].value();
            lambda += elastic.lame[1].value();
            let bar = &mut self.bars[index];
            bar.velocity_m_s = mul(momentum, p.mass_kg);
            for a in 0..3 {
                bar.deformation_rate[a] = mul(slope[a], p.mass_kg);
                let row = &mut bar.deformation_gradient[a];
                *row = add(*row, elastic.deformation_gradient[a]);
            }
            let mut kicked = *p;
            if let Some(forces) = forces {
                let kick = kick_m_s(p, forces[index / context.section], context.dt_s);
                kicked.velocity_m_s = add(kicked.velocity_m_s, kick);
            }
            if lawful {
                let wanted = LawCotangent {
                    force: scaled(momentum, context.dt_s),
                    stress,
                };
                pull_back_laws(self.session, self.vars, index, &kicked, &wanted, bar);
            }
            if self.weighed {
                let affine: F = (0..3).fold(F::zero(), |sum, a| sum + dot(slope[a], p.deformation_rate[a]));
                self.mass_bars[index] += (dot(momentum, kicked.velocity_m_s) + affine).value();
            }
        }
        self.totals.mu += mu;
        self.totals.lambda += lambda;
    }

    /// Derivatives with respect to the forces of a step, and to the masses that they kicked.
    fn kicks(&mut self, number: usize) {
        let context = &self.setup.context;
        let field = context.physics.force_field.as_ref();
        let block = field.and_then(|f| f.block(self.setup.time_s(number)));
        let (Some(field), Some(block)) = (field, block) else {
            return;
        };
        for (index, p) in self.particles.iter().enumerate() {
            let slice = index / context.section;
            let bar = self.bars[index].velocity_m_s;
            let per_force = context.dt_s * p.length_m / p.mass_kg.value();
            for k in 0..3 {
                self.force_field[block][slice][k] += per_force * bar[k].value();
            }
            let along = dot(bar, field.force_n_m[block][slice]).value();
            self.mass_bars[index] -= per_force / p.mass_kg.value() * along;
        }
    }

    fn clamps(&mut self, motions: &[Option<RigidMotion<F>>], number: usize) {
        let dt_s = self.setup.context.dt_s;
        let mut of_motions = vec![MotionCotangent::default(); motions.len()];
        for (index, p) in self.particles.iter().enumerate() {
            let Some((stiffness, asked)) = clamp_target(p, motions, dt_s) else {
                continue;
            };
            let link = &self.grid.links[index];
            let mut at_particle = [F::zero(); 4];
            for entry in 0..STENCIL {
                let node = &self.clamp_bars[link.slots[entry] as usize];
                for k in 0..4 {
                    at_particle[k] += node[k].times(link.weights[entry]);
                }
            }
            let [bar_stiffness, x, y, z] = at_particle;
            let bar_place = scaled(mul([x, y, z], stiffness), 1.0 / dt_s);
            let bar = &mut self.bars[index];
            bar.position_m = sub(bar.position_m, bar_place);
            self.mass_bars[index] += STIFFNESS * (bar_stiffness + dot(asked, [x, y, z])).value();
            if let Some((grip, offset_m)) = p.grip {
                of_motions[grip].add(bar_place, offset_m);
            }
        }
        for (grip, bar) in of_motions.iter().enumerate() {
            if motions[grip].is_some() {
                self.paths.pull_back(self.session, self.vars, grip, number, bar);
            }
        }
    }

    fn contact(&mut self) {
        let context = &self.setup.context;
        let Some(table_m) = context.table_m else { return };
        for (slice, members) in self.particles.chunks(context.section).enumerate() {
            let Some(asked) = asked_of_slice(members, table_m, context, self.grid.spacing_m) else {
                continue;
            };
            let mut bar_asked = F::zero();
            for (member, p) in members.iter().enumerate() {
                let index = slice * context.section + member;
                let link = &self.grid.links[index];
                let (mut bar_stiffness, mut bar_push) = (F::zero(), F::zero());
                for entry in 0..STENCIL {
                    let [of_stiffness, of_push] = self.contact_bars[link.slots[entry] as usize];
                    bar_stiffness += of_stiffness.times(link.weights[entry]);
                    bar_push += of_push.times(link.weights[entry]);
                }
                bar_asked += bar_push * p.mass_kg.scale(STIFFNESS);
                self.mass_bars[index] += STIFFNESS * (bar_stiffness + asked * bar_push).value();
            }
            // The slice asks for −(mean height − lowest)/dt.
            let bar_height = bar_asked.scale(1.0 / (context.dt_s * members.len() as f64));
            for bar in &mut self.bars[slice * context.section..][..members.len()] {
                bar.position_m[2] -= bar_height;
            }
        }
    }

    /// Hands all sums to the parameters.
    fn finish(mut self, inputs: &[Var]) -> Gradient {
        let (session, context) = (self.session, &self.vars.context);
        session.seed(context.lame.mu, self.totals.mu);
        session.seed(context.lame.lambda, self.totals.lambda);
        session.seed(context.physics.friction, self.totals.friction);
        for k in 0..3 {
            session.seed(context.physics.gravity_m_s2[k], self.totals.gravity[k]);
        }
        for (index, link) in self.grid.links.iter().enumerate() {
            for entry in 0..STENCIL {
                let weight = F::one().times(link.weights[entry]).value();
                self.mass_bars[index] += weight * self.node_mass_bars[link.slots[entry] as usize];
            }
            session.seed(self.vars.masses_kg[index], self.mass_bars[index]);
        }
        self.paths.seed_shifts(session, context.physics);
        if let Some(field) = &context.physics.force_field {
            for (var, bar) in field
                .force_n_m
                .iter()
                .flatten()
                .zip(self.force_field.iter().flatten())
            {
                for k in 0..3 {
                    session.seed(var[k], bar[k]);
                }
            }
        }
        session.sweep(0);
        Gradient {
            theta: inputs.iter().map(|&x| session.adjoint(x)).collect(),
            paths: self.paths.grips,
            force_field: self.force_field,
        }
    }
}
