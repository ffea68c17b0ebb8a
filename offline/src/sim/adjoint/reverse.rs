//! The way back over a rollout, step by step, from its end to its start.

mod clamps;

use super::laws::Tape;
use super::nodes::{NodeForces, pull_back_free};
use super::paths::PathGradients;
use super::seeds::Seeds;
use super::state::{MassBars, StateCotangent, total};
use super::stress::pull_back_piola;
use super::var::{Session, Var};
use super::{Checkpoint, Family, Gradient, Precision, Record};
use crate::sim::blocks::{Blocks, Part, Stepped};
use crate::sim::elastic::Straining;
use crate::sim::engine::Engine;
use crate::sim::error::SimError;
use crate::sim::lanes::{Instructions, Lanes};
use crate::sim::nodes::{CLAMP_ROWS, CONTACT_ROWS, forget};
use crate::sim::real::Arithmetic;
use crate::sim::rollout::Setup;
use crate::sim::sweep::Sweep;
use crate::sim::tensor::{Mat3, Vec3, zero3};
use crate::sim::transfer::Given;

/// Runs back over a rollout. `engine` is as the last step left it.
#[inline(always)]
pub(super) fn gradient<F: Precision, I: Instructions, M: Family>(
    setup: &Setup<F>,
    engine: Sweep<F, I>,
    mut record: Record<F, I>,
    mut seeds: Seeds,
    family: &M,
    theta: &[f64],
) -> Result<Gradient, SimError> {
    let session = Session::open();
    let inputs: Vec<Var> = theta.iter().map(|&x| session.input(x)).collect();
    let physics = family.physics(&inputs);
    let vars = Setup::new(setup.scene, &physics)?;
    let shape = (setup.layout.slices.len(), setup.layout.section_m.len());
    let mut back = WayBack::new(setup, &vars, &session, engine);
    seeds.add(setup.steps, shape, &mut back.bars);
    for segment in (0..record.plan.segments).rev() {
        let range = record.plan.range(segment, setup.steps);
        let checkpoint = record.checkpoints.pop().expect("every segment has a checkpoint");
        let nodes = match record.nodes.pop() {
            Some(nodes) => nodes,
            None => back.repeat(&checkpoint, range.clone())?,
        };
        let count = back.node_bars.len();
        let of_step = |number: usize| &nodes[(number - range.start) * count..][..count];
        for number in range.clone().rev() {
            let before = if number > range.start {
                back.undo(of_step(number - 1));
                of_step(number - 1)
            } else {
                back.restore(&checkpoint);
                &checkpoint.nodes
            };
            back.step(number, [before, of_step(number)])?;
            seeds.add(number, shape, &mut back.bars);
        }
    }
    Ok(back.finish(&inputs))
}

/// Derivatives with respect to coefficients, summed over particles and steps.
#[derive(Default)]
struct Totals {
    lame: [f64; 2],
    /// With respect to the viscosities over the node spacing.
    viscosity: [f64; 2],
    friction: f64,
    gravity: [f64; 3],
    clamp_stiffness: f64,
}

/// Those of them that are summed over the nodes of a step, in registers.
struct NodeSums<L> {
    gravity: Vec3<L>,
    friction: L,
}

struct WayBack<'a, F: Precision, I: Instructions> {
    setup: &'a Setup<'a, F>,
    vars: &'a Setup<'a, Var>,
    session: &'a Session,
    /// The rope before the step at hand.
    engine: Sweep<F, I>,
    /// Its dx Ḟ, by block and member.
    rates: Vec<Mat3<F::Plain<I>>>,
    /// Derivatives with respect to that state.
    bars: Vec<StateCotangent<F::Plain<I>>>,
    /// Derivatives with respect to the nodes: velocity, carried on from step to step; impulse; clamps;
    /// contact.
    node_bars: Vec<F>,
    impulse_bars: Vec<F>,
    clamp_bars: Vec<F>,
    contact_bars: Vec<F>,
    /// Derivatives with respect to masses, by node and by particle; only filled where masses depend on
    /// parameters.
    node_mass_bars: Vec<f64>,
    mass_bars: MassBars,
    weighed: bool,
    totals: Totals,
    paths: PathGradients,
    force_field: Vec<Vec<Vec3<f64>>>,
    scratch: Vec<F::Plain<I>>,
}

impl<'a, F: Precision, I: Instructions> WayBack<'a, F, I> {
    fn new(
        setup: &'a Setup<'a, F>,
        vars: &'a Setup<'a, Var>,
        session: &'a Session,
        engine: Sweep<F, I>,
    ) -> Self {
        let nodes = engine.blocks.transfer.planes * engine.blocks.transfer.width;
        let field = setup.context.physics.force_field.as_ref();
        let zeros = |block: &Vec<Vec3<F>>| vec![[0.0; 3]; block.len()];
        let zero = F::Plain::<I>::zero();
        let mut back = Self {
            rates: vec![[[zero; 3]; 3]; engine.blocks.bodies.len()],
            bars: vec![StateCotangent::zero(); engine.blocks.bodies.len()],
            node_bars: vec![F::zero(); 3 * nodes],
            impulse_bars: vec![F::zero(); 3 * nodes],
            clamp_bars: vec![F::zero(); CLAMP_ROWS * nodes],
            contact_bars: vec![F::zero(); CONTACT_ROWS * nodes],
            node_mass_bars: vec![0.0; nodes],
            mass_bars: MassBars {
                by_particle: vec![0.0; setup.masses_kg.len()],
                section: setup.context.section,
                slices: setup.layout.slices.len(),
            },
            weighed: !setup.context.physics.mass_laws.is_empty(),
            totals: Totals::default(),
            paths: PathGradients::new(vars),
            force_field: field.map_or(Vec::new(), |f| f.force_n_m.iter().map(zeros).collect()),
            scratch: vec![zero; 2 * CLAMP_ROWS * engine.blocks.transfer.width],
            setup,
            vars,
            session,
            engine,
        };
        // The last velocities of the nodes are still there.
        let last = back.engine.blocks.velocity.channel(0).to_vec();
        back.look_up(&last);
        back
    }

    fn members(&self) -> usize {
        self.setup.context.section
    }

    fn count() -> usize {
        <F::Plain<I> as Lanes>::COUNT
    }

    /// Simulates the steps of a segment again from its checkpoint; returns their node velocities.
    fn repeat(
        &mut self,
        checkpoint: &Checkpoint<F, I>,
        range: std::ops::Range<usize>,
    ) -> Result<Vec<F>, SimError> {
        let end = std::mem::replace(&mut self.engine.blocks.bodies, checkpoint.bodies.clone());
        let velocities = self.engine.blocks.velocity.channel_mut(0);
        velocities.copy_from_slice(&checkpoint.nodes);
        let mut nodes = Vec::with_capacity(range.len() * velocities.len());
        forget(&mut self.engine.blocks);
        for number in range {
            let mut motions = self.setup.motions(number);
            self.setup.sweep(&mut self.engine, number, &mut motions)?;
            self.setup.update_nodes(&mut self.engine, number);
            nodes.extend_from_slice(self.engine.blocks.velocity.channel(0));
        }
        self.engine.blocks.bodies = end;
        Ok(nodes)
    }

    /// Takes the particles to the state that follows a checkpoint.
    fn restore(&mut self, checkpoint: &Checkpoint<F, I>) {
        let members = self.members();
        self.engine.blocks.bodies.copy_from_slice(&checkpoint.bodies);
        let velocities = self.engine.blocks.velocity.channel_mut(0);
        velocities.copy_from_slice(&checkpoint.nodes);
        for block in 0..self.engine.blocks.transfer.blocks() {
            // Moving cannot stop.
            let _ = <F::Plain<I> as Stepped>::step(&mut self.engine.blocks, &Part::Move(block));
            let rates = &mut self.rates[block * members..(block + 1) * members];
            rates.copy_from_slice(&self.engine.blocks.rates);
        }
    }

    /// Velocities and rates of the particles from those of the nodes.
    #[inline(always)]
    fn look_up(&mut self, nodes: &[F]) {
        let members = self.members();
        for block in 0..self.engine.blocks.transfer.blocks() {
            let transfer = &self.engine.blocks.transfer;
            transfer.read_planes(block, 3, nodes, &mut self.scratch);
            for member in 0..members {
                let index = block * members + member;
                let (velocity, rate) = transfer.gather(block, member, &self.scratch);
                self.engine.blocks.bodies[index].velocity_m_s = velocity;
                self.rates[index] = rate;
            }
        }
    }

    /// Takes the particles back by one step. `before` holds the velocities of the nodes after the step
    /// before.
    #[inline(always)]
    fn undo(&mut self, before: &[F]) {
        let dt_s = self.setup.context.dt_s;
        let back = F::Plain::<I>::of(-dt_s);
        let back_per_cell = F::Plain::<I>::of(-dt_s / self.setup.scene.grid.spacing_m);
        for (body, rate) in self.engine.blocks.bodies.iter_mut().zip(&self.rates) {
            for a in 0..3 {
                body.velocity_m_s[a].carry_to(back, &mut body.position_m[a], &mut body.lost_m[a]);
                for b in 0..3 {
                    let f = &mut body.deformation_gradient[a][b];
                    *f = rate[a][b].times_plus(back_per_cell, *f);
                }
            }
        }
        self.look_up(before);
    }

    /// Carries the derivatives over one step; given are the nodes' velocities before and after it.
    #[inline(always)]
    fn step(&mut self, number: usize, velocities: [&[F]; 2]) -> Result<(), SimError> {
        let recorded = self.setup.motions(number);
        let mut motions = recorded.clone();
        self.engine.turn(&self.setup.context, &mut motions);
        forget(&mut self.engine.blocks);
        self.engine
            .springs(&motions)
            .map_err(|cause| self.setup.stop(number, cause))?;
        self.spread();
        let (decay, forgotten) = (self.setup.decay(number), self.setup.context.forgotten);
        self.nodes(velocities, decay * (1.0 - forgotten));
        self.particles(number, decay * forgotten);
        if self.engine.blocks.constrained.iter().any(|&c| c) {
            self.clamps([&recorded, &motions], number);
            self.contact();
        }
        Ok(())
    }

    /// Transpose of the transfer from the grid, added to what the nodes' velocities did in the step after.
    #[inline(always)]
    fn spread(&mut self) {
        let members = self.members();
        let dt_s = self.setup.context.dt_s;
        let dt = F::Plain::<I>::of(dt_s);
        let dt_per_cell = F::Plain::<I>::of(dt_s / self.setup.scene.grid.spacing_m);
        let four = F::Plain::<I>::of(4.0);
        let Blocks { transfer, given, .. } = &mut self.engine.blocks;
        for (block, bars) in self.bars.chunks(members).enumerate() {
            for (Given { value, slope }, bar) in given.iter_mut().zip(bars) {
                (*value, *slope) = (bar.velocity, bar.rate);
                for a in 0..3 {
                    value[a] = bar.position[a].times_plus(dt, value[a]);
                    for b in 0..3 {
                        let through_f = bar.deformation_gradient[a][b];
                        slope[a][b] = through_f.times_plus(dt_per_cell, slope[a][b]) * four;
                    }
                }
            }
            let nodes = &mut self.scratch[..6 * transfer.width];
            nodes.fill(F::Plain::<I>::zero());
            transfer.scatter(block, given, nodes);
            transfer.add_to_planes(block, 3, true, nodes, &mut self.node_bars);
        }
    }

    /// Derivatives with respect to velocities after the update of the nodes become those with respect to
    /// velocities before it, of which the share `kept` stays, and to impulses.
    #[inline(always)]
    fn nodes(&mut self, velocities: [&[F]; 2], kept: f64) {
        let width = self.engine.blocks.transfer.width;
        let mut sums = NodeSums {
            gravity: [F::Plain::<I>::zero(); 3],
            friction: F::Plain::<I>::zero(),
        };
        let constrained = self.engine.blocks.constrained.iter().any(|&c| c);
        if constrained {
            self.clamp_bars.fill(F::zero());
            self.contact_bars.fill(F::zero());
        }
        for plane in 0..self.engine.blocks.transfer.planes {
            if self.engine.blocks.constrained[plane] || self.weighed {
                for node in (0..width).step_by(Self::count()) {
                    self.under_springs(plane, node, velocities, kept, &mut sums);
                }
                continue;
            }
            let inverse = &self.engine.masses.inverse.channel(0)[plane * width..];
            for (a, gravity) in sums.gravity.iter_mut().enumerate() {
                let first = (3 * plane + a) * width;
                let row = &mut self.node_bars[first..first + width];
                let impulses = &mut self.impulse_bars[first..first + width];
                for node in (0..width).step_by(Self::count()) {
                    let bar = F::Plain::<I>::load(&row[node..]);
                    *gravity += bar;
                    bar.scale(kept).store(&mut row[node..]);
                    (bar * F::Plain::<I>::load(&inverse[node..])).store(&mut impulses[node..]);
                }
            }
        }
        for a in 0..3 {
            self.totals.gravity[a] += total(sums.gravity[a]) * self.setup.context.dt_s;
        }
        self.totals.friction += total(sums.friction);
    }

    /// The same for as many nodes as a register has lanes, with all that may act on them.
    #[inline(always)]
    fn under_springs(
        &mut self,
        plane: usize,
        node: usize,
        [before, after]: [&[F]; 2],
        kept: f64,
        sums: &mut NodeSums<F::Plain<I>>,
    ) {
        let (context, width) = (&self.setup.context, self.engine.blocks.transfer.width);
        let row = |rows: usize, row: usize| (plane * rows + row) * width + node;
        let (nodes, masses) = (&self.engine.blocks, &self.engine.masses);
        let load = F::Plain::<I>::load;
        let mut clamp = [F::Plain::<I>::zero(); 4];
        for (k, value) in clamp.iter_mut().enumerate() {
            *value = load(&nodes.clamps.channel(0)[row(CLAMP_ROWS, k)..]);
        }
        let zero: Vec3<F::Plain<I>> = zero3();
        let (mut fall, mut bar, mut start, mut now) = (zero, zero, zero, zero);
        for a in 0..3 {
            fall[a] = F::Plain::<I>::splat(context.physics.gravity_m_s2[a].scale(context.dt_s));
            bar[a] = load(&self.node_bars[row(3, a)..]);
            start[a] = load(&before[row(3, a)..]);
            now[a] = load(&after[row(3, a)..]);
        }
        let forces = NodeForces {
            mass: load(&masses.mass.channel(0)[row(1, 0)..]),
            clamp,
            start,
            contact: load(&nodes.contact.channel(0)[row(CONTACT_ROWS, 0)..]),
            friction: F::Plain::<I>::splat(context.physics.friction),
        };
        let bar = forces.pull_back(now, bar);
        let inverse = load(&masses.inverse.channel(0)[row(1, 0)..]);
        let free = pull_back_free(&bar, inverse, start, fall, kept);
        for a in 0..3 {
            free.velocity[a].store(&mut self.node_bars[row(3, a)..]);
            free.impulse[a].store(&mut self.impulse_bars[row(3, a)..]);
            sums.gravity[a] += bar.velocity[a];
        }
        for (k, value) in bar.clamp.iter().enumerate() {
            value.store(&mut self.clamp_bars[row(CLAMP_ROWS, k)..]);
        }
        bar.contact.store(&mut self.contact_bars[row(CONTACT_ROWS, 0)..]);
        sums.friction += bar.friction;
        if self.weighed {
            let lanes = (free.mass + bar.mass).to_lanes();
            let sums = &mut self.node_mass_bars[row(1, 0)..row(1, 0) + Self::count()];
            for (sum, lane) in sums.iter_mut().zip(lanes) {
                *sum += lane.value();
            }
        }
    }

    /// Transpose of the transfer to the grid, then what made the impulses; `carried` is the share of the
    /// particles' momenta in them.
    #[inline(always)]
    fn particles(&mut self, number: usize, carried: f64) {
        let (members, context) = (self.members(), &self.setup.context);
        let (quarter, dt) = (F::Plain::<I>::of(0.25), F::Plain::<I>::of(context.dt_s));
        let physics = self.vars.context.physics;
        let tape = Tape {
            session: self.session,
            vars: self.vars,
        };
        let pushed = self.setup.forces(number).is_some();
        let (mut lame, mut viscosity) = ([F::Plain::<I>::zero(); 2], [F::Plain::<I>::zero(); 2]);
        for block in 0..self.engine.blocks.transfer.blocks() {
            let stress_scale = -(self.engine.blocks.stress_scales[block] * quarter);
            let transfer = &self.engine.blocks.transfer;
            transfer.read_planes(block, 3, &self.impulse_bars, &mut self.scratch);
            let mut force = [F::Plain::<I>::zero(); 3];
            for member in 0..members {
                let index = block * members + member;
                let body = &self.engine.blocks.bodies[index];
                let (impulse, change) = self.engine.blocks.transfer.gather(block, member, &self.scratch);
                // No closures here: they would not be compiled for the registers' instructions.
                let mut stress = change;
                for a in 0..3 {
                    for b in 0..3 {
                        stress[a][b] = change[a][b] * stress_scale;
                    }
                }
                let (f, rate) = (&body.deformation_gradient, &self.rates[index]);
                let elastic = pull_back_piola(f, &self.engine.blocks.lame[0], &stress);
                let eta = &self.engine.blocks.viscosity[0];
                let viscous = Straining::new(f, rate, eta).pull_back(f, rate, eta, &stress);
                let bar = &mut self.bars[index];
                for k in 0..2 {
                    lame[k] += elastic.lame[k];
                    viscosity[k] += viscous.viscosity[k];
                }
                let mass = body.mass_kg.scale(carried);
                let lever = mass * quarter;
                for a in 0..3 {
                    force[a] += impulse[a];
                    bar.velocity[a] = impulse[a] * mass;
                    for b in 0..3 {
                        bar.rate[a][b] = change[a][b].times_plus(lever, viscous.rate[a][b]);
                        bar.deformation_gradient[a][b] +=
                            elastic.deformation_gradient[a][b] + viscous.deformation_gradient[a][b];
                    }
                }
                if !physics.axial_laws.is_empty() {
                    tape.pull_back_axial::<F, I>(block, f, &stress, bar);
                }
                if self.weighed {
                    self.weigh((block, member), &impulse, &change, carried);
                }
            }
            if !physics.force_laws.is_empty() {
                let range = block * members..(block + 1) * members;
                let bodies = &self.engine.blocks.bodies[range.clone()];
                tape.pull_back_force::<F, I>(block, bodies, force.map(|x| x * dt), &mut self.bars[range]);
            }
            if pushed {
                self.push(number, block, force);
            }
        }
        for k in 0..2 {
            self.totals.lame[k] += total(lame[k]);
            self.totals.viscosity[k] += total(viscosity[k]);
        }
    }

    /// Derivative with respect to the masses whose momentum is `carried` over.
    fn weigh(
        &mut self,
        (block, member): (usize, usize),
        impulse: &Vec3<F::Plain<I>>,
        change: &Mat3<F::Plain<I>>,
        carried: f64,
    ) {
        let index = block * self.members() + member;
        let (velocity, rate) = (self.engine.blocks.bodies[index].velocity_m_s, self.rates[index]);
        let mut sum = F::Plain::<I>::zero();
        for a in 0..3 {
            sum = impulse[a].times_plus(velocity[a], sum);
            for b in 0..3 {
                sum = change[a][b].times_plus(rate[a][b].scale(0.25), sum);
            }
        }
        self.mass_bars.add(block, member, sum.scale(carried));
    }

    /// Derivative with respect to the force field; `impulse` is summed over the members of the slices.
    fn push(&mut self, number: usize, block: usize, impulse: Vec3<F::Plain<I>>) {
        let field = self.setup.context.physics.force_field.as_ref();
        let Some(at) = field.and_then(|f| f.block(self.setup.time_s(number))) else {
            return;
        };
        let slices = &self.setup.layout.slices;
        let first = block * Self::count();
        let share = self.setup.context.dt_s / self.members() as f64;
        for a in 0..3 {
            let lanes = impulse[a].to_lanes();
            for lane in 0..Self::count().min(slices.len() - first) {
                let length_m = slices[first + lane].length_m;
                self.force_field[at][first + lane][a] += share * length_m * lanes[lane].value();
            }
        }
    }

    /// From the table's push to heights and velocities of the slices.
    #[inline(always)]
    fn contact(&mut self) {
        let members = self.members();
        let width = self.engine.blocks.transfer.width;
        for block in 0..self.engine.blocks.transfer.blocks() {
            let Some(push) = self.engine.blocks.push_of_table(block) else {
                continue;
            };
            let transfer = &self.engine.blocks.transfer;
            transfer.read_planes(block, CONTACT_ROWS, &self.contact_bars, &mut self.scratch);
            let mut bar_push = F::Plain::<I>::zero();
            for member in 0..members {
                let transfer = &self.engine.blocks.transfer;
                bar_push += transfer.gather_value(member, &self.scratch[..width]);
            }
            if self.weighed {
                self.mass_bars.add(block, 0, bar_push * push.by_mass);
            }
            // Height and velocity of a slice are means over its members.
            let bar_mean = bar_push.scale(1.0 / members as f64);
            for bar in &mut self.bars[block * members..(block + 1) * members] {
                bar.position[2] += bar_mean * push.by_gap;
                bar.velocity[2] += bar_mean * push.by_rise;
            }
        }
    }

    /// Hands all sums to the parameters.
    fn finish(mut self, inputs: &[Var]) -> Gradient {
        let (session, context) = (self.session, &self.vars.context);
        let [mu, lambda] = self.totals.lame;
        session.seed(context.lame.mu, mu);
        session.seed(context.lame.lambda, lambda);
        let per_cell = 1.0 / self.setup.scene.grid.spacing_m;
        session.seed(context.viscosity.mu, self.totals.viscosity[0] * per_cell);
        session.seed(context.viscosity.lambda, self.totals.viscosity[1] * per_cell);
        session.seed(context.physics.friction, self.totals.friction);
        session.seed(context.clamp_stiffness, self.totals.clamp_stiffness);
        for k in 0..3 {
            session.seed(context.physics.gravity_m_s2[k], self.totals.gravity[k]);
        }
        for (index, mass) in self.vars.masses_kg.iter().enumerate() {
            let (slice, member) = (index / context.section, index % context.section);
            let transfer = &self.engine.blocks.transfer;
            self.mass_bars.by_particle[index] += transfer.weigh_back(slice, member, &self.node_mass_bars);
            session.seed(*mass, self.mass_bars.by_particle[index]);
        }
        self.paths.seed_shifts(session, context.physics);
        if let Some(field) = &context.physics.force_field {
            let vars = field.force_n_m.iter().flatten();
            for (var, bar) in vars.zip(self.force_field.iter().flatten()) {
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
