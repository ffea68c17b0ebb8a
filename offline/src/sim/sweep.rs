//! A rope stepped many particles at a time: what [`super::step`] does one particle after the other.
//!
//! A sweep goes once over the particles. It brings them the velocities of the last update of the nodes,
//! moves them, and at once sums up at the nodes what they give in the next step, so that a particle is
//! read and written once per step. Transfers act on each channel of a number alone ([`Channels`]); the
//! stress is computed on the values, and its differential applied to every tangent.

use super::clamp::{RigidMotion, STIFFNESS};
use super::elastic::{Lame, Strained, StressDifferential};
use super::error::Cause;
use super::lanes::{Instructions, Laned, Lanes};
use super::laws::LawForces;
use super::nodes::{CLAMP_ROWS, Nodes, Update};
use super::real::{Arithmetic, Real};
use super::rope::RopeLayout;
use super::step::{CONTACT_NEAR_CELLS, Particle, StepContext, inverted_or_not_finite};
use super::tensor::{Mat3, Vec3, add, zero3};
use super::transfer::Transfer;

/// One channel of the same member of as many slices as a register has lanes.
#[derive(Clone, Copy, Debug)]
pub struct Body<L> {
    /// Deformation gradient.
    pub deformation_gradient: Mat3<L>,
    /// Position, m.
    pub position_m: Vec3<L>,
    /// Velocity, m/s.
    pub velocity_m_s: Vec3<L>,
    /// Mass, kg.
    pub mass_kg: L,
}

/// A grip's share in a block.
pub(super) struct Held<L> {
    pub(super) block: usize,
    pub(super) grip: usize,
    /// One in the lanes that the grip holds, zero in the others.
    pub(super) mask: L,
    /// Offsets of the members from the grip's first pose, m.
    pub(super) offsets_m: Vec<Vec3<L>>,
}

/// The particles and nodes of a rope, in registers.
pub struct Sweep<T: Laned, I: Instructions> {
    pub(super) transfer: Transfer<T::Plain<I>>,
    pub(super) nodes: Nodes<T>,
    slices: usize,
    spacing_m: f64,
    /// Block, channel, member.
    pub(super) bodies: Vec<Body<T::Plain<I>>>,
    /// 4 dt V/dx of a particle of each block, m² s.
    pub(super) stress_scales: Vec<T::Plain<I>>,
    pub(super) held: Vec<Held<T::Plain<I>>>,
    laws: Option<LawForces<T, I>>,
    pub(super) lame: Vec<Lame<T::Plain<I>>>,
    /// Whether any particle's mass has tangents.
    masses_vary: bool,
    pub(super) scratch: Scratch<T::Plain<I>>,
}

pub(super) struct Scratch<L> {
    nodes: Vec<L>,
    /// Channel, member: dx Ḟ.
    pub(super) rates: Vec<Mat3<L>>,
    /// Per member.
    differentials: Vec<StressDifferential<L>>,
}

impl<T: Laned, I: Instructions> Sweep<T, I> {
    /// A rope at rest in the state of `particles`, which lie slice by slice.
    #[inline(always)]
    pub fn new(
        context: &StepContext<T>,
        layout: &RopeLayout,
        grid: super::grid::GridSpec,
        particles: &[Particle<T>],
    ) -> Self {
        let transfer = Transfer::<T::Plain<I>>::new(layout, grid);
        let masses: Vec<T> = particles.iter().map(|p| p.mass_kg).collect();
        let members = transfer.members.len();
        let nodes = Nodes::new(&transfer, layout.slices.len(), &masses);
        let dx = grid.spacing_m;
        let count = <T::Plain<I> as Lanes>::COUNT;
        let of_lane = |block: usize, member: usize, lane: usize| {
            particles.get((block * count + lane) * members + member)
        };
        let mut bodies = Vec::new();
        let mut stress_scales = Vec::new();
        for block in 0..transfer.blocks() {
            for k in 0..T::CHANNELS {
                bodies.extend((0..members).map(|m| pack::<T, I>(k, |lane| of_lane(block, m, lane))));
            }
            stress_scales.push(T::Plain::<I>::from_lanes(|lane| {
                let volume_m3 = of_lane(block, 0, lane).map_or(0.0, |p| p.volume_m3);
                T::base(4.0 * context.dt_s * volume_m3 / dx)
            }));
        }
        let held = held_blocks::<T, I>(transfer.blocks(), members, &of_lane);
        let lame = (0..T::CHANNELS)
            .map(|k| Lame {
                mu: T::Plain::<I>::splat(context.lame.mu.channel(k)),
                lambda: T::Plain::<I>::splat(context.lame.lambda.channel(k)),
            })
            .collect();
        let tangents = |m: &T| (1..T::CHANNELS).any(|k| m.channel(k).value() != 0.0);
        let zero = T::Plain::<I>::zero();
        Self {
            scratch: Scratch {
                nodes: vec![zero; 6 * transfer.width],
                rates: vec![[[zero; 3]; 3]; T::CHANNELS * members],
                differentials: Vec::with_capacity(members),
            },
            laws: LawForces::new(context, layout, dx),
            transfer,
            nodes,
            slices: layout.slices.len(),
            spacing_m: dx,
            bodies,
            stress_scales,
            held,
            lame,
            masses_vary: masses.iter().any(tangents),
        }
    }

    /// Completes the last step and sums up the next at the nodes. `motions` holds the motion of each
    /// closed grip at the end of the next step.
    #[inline(always)]
    pub fn sweep(
        &mut self,
        context: &StepContext<T>,
        motions: &[Option<RigidMotion<T>>],
    ) -> Result<(), Cause> {
        for block in 0..self.transfer.blocks() {
            for channel in 0..T::CHANNELS {
                self.move_bodies(context, block, channel);
            }
            if let Some(laws) = &mut self.laws {
                let members = self.transfer.members.len();
                let bodies = block * T::CHANNELS * members..(block + 1) * T::CHANNELS * members;
                let lanes = self.transfer.real_lanes(block, self.slices);
                laws.evaluate(context, block, lanes, &self.bodies[bodies], &self.scratch.rates);
            }
            self.give_momentum(block)?;
        }
        self.springs(context, motions);
        Ok(())
    }

    /// The springs of table and clamps on the nodes.
    #[inline(always)]
    pub(super) fn springs(&mut self, context: &StepContext<T>, motions: &[Option<RigidMotion<T>>]) {
        if let Some(table_m) = context.table_m {
            for block in 0..self.transfer.blocks() {
                self.press(context, block, table_m);
            }
        }
        for index in 0..self.held.len() {
            if let Some(motion) = &motions[self.held[index].grip] {
                self.clamp(context, index, motion);
            }
        }
    }

    /// Adds the momentum that forces per length of the slices, N/m, give in the step at hand.
    pub(super) fn push(&mut self, context: &StepContext<T>, force_n_m: &[Vec3<T>], lengths_m: &[f64]) {
        let count = <T::Plain<I> as Lanes>::COUNT;
        for block in 0..self.transfer.blocks() {
            let real = self.transfer.real_lanes(block, self.slices);
            for channel in 0..T::CHANNELS {
                let impulse: Vec3<T::Plain<I>> = std::array::from_fn(|a| {
                    T::Plain::<I>::from_lanes(|lane| {
                        if lane >= real {
                            return T::base(0.0);
                        }
                        let slice = block * count + lane;
                        let share = context.dt_s * lengths_m[slice];
                        force_n_m[slice][a].scale(share).channel(channel)
                    })
                });
                let nodes = &mut self.scratch.nodes;
                nodes.fill(T::Plain::<I>::zero());
                let still = [zero3(); 3];
                for member in 0..self.transfer.members.len() {
                    self.transfer.scatter(block, member, &impulse, &still, nodes);
                }
                let momentum = self.nodes.momentum.channel_mut(channel);
                self.transfer.add_to_planes(block, 3, true, nodes, momentum);
            }
        }
    }

    /// Updates the nodes; `decay` multiplies every velocity (1 outside settling).
    #[inline(always)]
    pub fn update_nodes(&mut self, context: &StepContext<T>, decay: f64) {
        let physics = context.physics;
        self.nodes.update::<I>(&Update {
            fall_m_s: physics.gravity_m_s2.map(|g| g.scale(context.dt_s)),
            friction: physics.friction,
            decay,
        });
    }

    /// Nodes to particles, for one channel of a block.
    #[inline(always)]
    pub(super) fn move_bodies(&mut self, context: &StepContext<T>, block: usize, channel: usize) {
        let members = self.transfer.members.len();
        let velocity = self.nodes.velocity.channel(channel);
        self.transfer
            .read_planes(block, 3, velocity, &mut self.scratch.nodes);
        let dt = T::Plain::<I>::of(context.dt_s);
        let dt_per_cell = T::Plain::<I>::of(context.dt_s / self.spacing_m);
        let first = (block * T::CHANNELS + channel) * members;
        let bodies = &mut self.bodies[first..first + members];
        let rates = &mut self.scratch.rates[channel * members..(channel + 1) * members];
        for (member, (body, stored)) in bodies.iter_mut().zip(rates).enumerate() {
            let (velocity, rate) = self.transfer.gather(block, member, &self.scratch.nodes);
            for a in 0..3 {
                for b in 0..3 {
                    let f = &mut body.deformation_gradient[a][b];
                    *f = rate[a][b].times_plus(dt_per_cell, *f);
                }
                body.position_m[a] = velocity[a].times_plus(dt, body.position_m[a]);
            }
            body.velocity_m_s = velocity;
            *stored = rate;
        }
    }

    /// Particles to nodes: inertia, stress and the laws' forces.
    #[inline(always)]
    fn give_momentum(&mut self, block: usize) -> Result<(), Cause> {
        let members = self.transfer.members.len();
        let first = block * T::CHANNELS * members;
        let scale = -self.stress_scales[block];
        for channel in 0..T::CHANNELS {
            self.scratch.nodes.fill(T::Plain::<I>::zero());
            for member in 0..members {
                let value = &self.bodies[first + member];
                let body = &self.bodies[first + channel * members + member];
                let mut pk1 = if channel == 0 {
                    let strained = Strained::new(&value.deformation_gradient);
                    self.check(block, member, strained.j)?;
                    if T::CHANNELS > 1 {
                        self.scratch.differentials.truncate(member);
                        let differential = StressDifferential::new(&strained, &self.lame[0]);
                        self.scratch.differentials.push(differential);
                    }
                    strained.piola_stress(&self.lame[0])
                } else {
                    let differential = &self.scratch.differentials[member];
                    differential.of(&body.deformation_gradient, &self.lame[channel])
                };
                let mut at_particle = zero3();
                if let Some(laws) = &self.laws {
                    at_particle = laws.impulses[channel * members + member];
                    let extra = &laws.stresses[channel * members + member];
                    pk1 = std::array::from_fn(|a| add(pk1[a], extra[a]));
                }
                let rates = &self.scratch.rates;
                let (rate, rate_value) = (&rates[channel * members + member], &rates[member]);
                let vary = channel > 0 && self.masses_vary;
                let mut slope = [zero3(); 3];
                for a in 0..3 {
                    at_particle[a] = body.velocity_m_s[a].times_plus(value.mass_kg, at_particle[a]);
                    for b in 0..3 {
                        slope[a][b] = pk1[a][b].times_plus(scale, rate[a][b] * value.mass_kg);
                    }
                    if vary {
                        at_particle[a] = value.velocity_m_s[a].times_plus(body.mass_kg, at_particle[a]);
                        for b in 0..3 {
                            slope[a][b] = rate_value[a][b].times_plus(body.mass_kg, slope[a][b]);
                        }
                    }
                }
                self.transfer
                    .scatter(block, member, &at_particle, &slope, &mut self.scratch.nodes);
            }
            let momentum = self.nodes.momentum.channel_mut(channel);
            self.transfer
                .add_to_planes(block, 3, true, &self.scratch.nodes, momentum);
        }
        Ok(())
    }

    #[inline(always)]
    fn check(&self, block: usize, member: usize, j: T::Plain<I>) -> Result<(), Cause> {
        if T::Plain::<I>::everywhere(j.exceeds(T::Plain::<I>::zero())) {
            return Ok(());
        }
        let lanes = j.to_lanes();
        let bad = |lane: &usize| lanes[*lane].value() <= 0.0 || lanes[*lane].value().is_nan();
        let lane = (0..<T::Plain<I> as Lanes>::COUNT).find(bad).unwrap_or(0);
        let slice = block * <T::Plain<I> as Lanes>::COUNT + lane;
        let particle = slice * self.transfer.members.len() + member;
        Err(inverted_or_not_finite(particle, lanes[lane].value()))
    }

    /// The table's springs under every slice near the table, as [`super::step`] has them.
    #[inline(always)]
    fn press(&mut self, context: &StepContext<T>, block: usize, table_m: f64) {
        let members = self.transfer.members.len();
        let first = block * T::CHANNELS * members;
        let lowest = T::Plain::<I>::of(table_m + 0.5 * context.diameter_m);
        let mean = |channel: usize| {
            let mut height = T::Plain::<I>::zero();
            for body in &self.bodies[first + channel * members..first + (channel + 1) * members] {
                height += body.position_m[2];
            }
            height.scale(1.0 / members as f64)
        };
        let gap = mean(0) - lowest;
        let Some(near) = self.near(gap) else { return };
        let zero = T::Plain::<I>::zero();
        let pull = T::Plain::<I>::of(-1.0 / context.dt_s);
        for channel in 0..T::CHANNELS {
            let gap_of = if channel == 0 { gap } else { mean(channel) };
            let asked = gap * pull;
            let asked_of = gap_of * pull;
            let nodes = &mut self.scratch.nodes;
            nodes.fill(zero);
            for member in 0..members {
                let stiffness = self.bodies[first + member].mass_kg * near;
                let change = self.bodies[first + channel * members + member].mass_kg * near;
                let (rows, push) = nodes.split_at_mut(self.transfer.width);
                self.transfer.scatter_value(member, change, rows);
                let product = if channel == 0 {
                    stiffness * asked
                } else {
                    stiffness.times_plus(asked_of, change * asked)
                };
                self.transfer.scatter_value(member, product, push);
            }
            let contact = self.nodes.contact.channel_mut(channel);
            self.transfer.add_to_planes(block, 2, false, nodes, contact);
        }
        self.mark(block, &near.to_lanes().map(|n| n.value() != 0.0));
    }

    /// κ in the lanes whose slice is near the table, by its gap, zero in the others; none if all are far.
    #[inline(always)]
    pub(super) fn near(&self, gap: T::Plain<I>) -> Option<T::Plain<I>> {
        let near_m = T::Plain::<I>::of(CONTACT_NEAR_CELLS * self.spacing_m);
        let far = gap.exceeds(near_m);
        let stiffness = T::Plain::<I>::of(STIFFNESS);
        (!T::Plain::<I>::everywhere(far))
            .then(|| T::Plain::<I>::select(far, T::Plain::<I>::zero(), stiffness))
    }

    /// A grip's springs on its share of a block.
    #[inline(always)]
    fn clamp(&mut self, context: &StepContext<T>, index: usize, motion: &RigidMotion<T>) {
        let held = &self.held[index];
        let members = self.transfer.members.len();
        let first = held.block * T::CHANNELS * members;
        let per_step = T::Plain::<I>::of(1.0 / context.dt_s);
        let springs = held.mask.scale(STIFFNESS);
        let asked = |channel: usize, member: usize| -> Vec3<T::Plain<I>> {
            let body = &self.bodies[first + channel * members + member];
            let offset = &held.offsets_m[member];
            std::array::from_fn(|a| {
                let mut gap =
                    T::Plain::<I>::splat(motion.position_m[a].channel(channel)) - body.position_m[a];
                for b in 0..3 {
                    let entry = T::Plain::<I>::splat(motion.rotation[a][b].channel(channel));
                    gap = entry.times_plus(offset[b], gap);
                }
                gap * per_step
            })
        };
        for channel in 0..T::CHANNELS {
            let nodes = &mut self.scratch.nodes;
            nodes.fill(T::Plain::<I>::zero());
            for member in 0..members {
                let stiffness = self.bodies[first + member].mass_kg * springs;
                let change = self.bodies[first + channel * members + member].mass_kg * springs;
                let velocity = asked(channel, member);
                let velocity_value = asked(0, member);
                let width = self.transfer.width;
                self.transfer.scatter_value(member, change, &mut nodes[..width]);
                for a in 0..3 {
                    let mut product = stiffness * velocity[a];
                    if channel > 0 {
                        product = change.times_plus(velocity_value[a], product);
                    }
                    let row = &mut nodes[(a + 1) * width..(a + 2) * width];
                    self.transfer.scatter_value(member, product, row);
                }
            }
            let clamps = self.nodes.clamps.channel_mut(channel);
            self.transfer
                .add_to_planes(held.block, CLAMP_ROWS, false, nodes, clamps);
        }
        let (block, lanes) = (held.block, held.mask.to_lanes().map(|m| m.value() != 0.0));
        self.mark(block, &lanes);
    }

    /// Marks the planes that some slices of a block meet as constrained.
    fn mark(&mut self, block: usize, lanes: &[bool]) {
        let count = <T::Plain<I> as Lanes>::COUNT;
        for (slice, _) in self.transfer.slices[block * count..(block + 1) * count]
            .iter()
            .zip(lanes)
            .filter(|(_, marked)| **marked)
        {
            self.nodes.constrained[slice.plane..slice.plane + 3].fill(true);
        }
    }

    /// Largest speed, m/s, and its particle; NaN counts as largest.
    pub fn fastest(&self) -> (usize, f64) {
        let (members, count) = (self.transfer.members.len(), <T::Plain<I> as Lanes>::COUNT);
        let mut fastest = (0, 0.0);
        for (index, body) in self.bodies.iter().enumerate() {
            let (block, member) = (index / (members * T::CHANNELS), index % (members * T::CHANNELS));
            if member >= members {
                continue;
            }
            let square_of = |[x, y, z]: Vec3<T::Plain<I>>| z.times_plus(z, y.times_plus(y, x * x));
            let place = square_of(body.position_m);
            // Zero where the position is finite, and NaN where it is not.
            let square = square_of(body.velocity_m_s) + (place - place);
            for (lane, square) in square.to_lanes().into_iter().enumerate().take(count) {
                let speed = square.value().sqrt();
                if speed > fastest.1 || speed.is_nan() {
                    fastest = ((block * count + lane) * members + member, speed);
                }
            }
        }
        fastest
    }

    /// Middle of a slice and its velocity: means over its members, m and m/s.
    pub fn slice_mean(&self, slice: usize) -> (Vec3<T>, Vec3<T>) {
        let (members, count) = (self.transfer.members.len(), <T::Plain<I> as Lanes>::COUNT);
        let (block, lane) = (slice / count, slice % count);
        let mean = |vector: fn(&Body<T::Plain<I>>) -> &Vec3<T::Plain<I>>| -> Vec3<T> {
            std::array::from_fn(|a| {
                T::from_channels(|k| {
                    let first = (block * T::CHANNELS + k) * members;
                    let mut sum = T::Plain::<I>::zero();
                    for body in &self.bodies[first..first + members] {
                        sum += vector(body)[a];
                    }
                    sum.to_lanes()[lane]
                })
                .scale(1.0 / members as f64)
            })
        };
        (mean(|body| &body.position_m), mean(|body| &body.velocity_m_s))
    }

    /// Force of every grip on the rope in the step that ended in this state, N, as
    /// [`super::clamp::grip_forces_n`] has it.
    pub fn grip_forces_n(&self, motions: &[Option<RigidMotion<T>>], dt_s: f64) -> Vec<Vec3<T>> {
        let (members, count) = (self.transfer.members.len(), <T::Plain<I> as Lanes>::COUNT);
        let mut forces = vec![zero3(); motions.len()];
        for held in &self.held {
            let Some(motion) = &motions[held.grip] else {
                continue;
            };
            for (member, offset) in held.offsets_m.iter().enumerate() {
                let body =
                    |channel: usize| &self.bodies[(held.block * T::CHANNELS + channel) * members + member];
                let number =
                    |read: fn(&Body<T::Plain<I>>, usize) -> T::Plain<I>, a: usize, lane: usize| -> T {
                        T::from_channels(|k| read(body(k), a).to_lanes()[lane])
                    };
                let (mask, offset) = (held.mask.to_lanes(), offset.map(Lanes::to_lanes));
                for lane in (0..count).filter(|&lane| mask[lane].value() != 0.0) {
                    let place = motion.place(offset.map(|lanes| lanes[lane].value()));
                    let mass: T = number(|body, _| body.mass_kg, 0, lane);
                    let stiffness = mass.scale(STIFFNESS / (dt_s * dt_s));
                    for a in 0..3 {
                        let gap = place[a] - number(|body, a| body.position_m[a], a, lane);
                        forces[held.grip][a] += gap * stiffness;
                    }
                }
            }
        }
        forces
    }

    /// Number of slices.
    pub fn slices(&self) -> usize {
        self.slices
    }
}

/// One channel of a body from the particles in its lanes; a lane beyond the rope's end is undeformed.
fn pack<'p, T: Laned, I: Instructions>(
    channel: usize,
    particle: impl Fn(usize) -> Option<&'p Particle<T>>,
) -> Body<T::Plain<I>> {
    let lanes = |read: &dyn Fn(&Particle<T>) -> T, beyond: f64| {
        let absent = T::of(beyond);
        T::Plain::<I>::from_lanes(|lane| particle(lane).map_or(absent, read).channel(channel))
    };
    let vector = |read: fn(&Particle<T>) -> &Vec3<T>| std::array::from_fn(|a| lanes(&|p| read(p)[a], 0.0));
    Body {
        deformation_gradient: std::array::from_fn(|a| {
            std::array::from_fn(|b| {
                let unit = if a == b { 1.0 } else { 0.0 };
                lanes(&|p| p.deformation_gradient[a][b], unit)
            })
        }),
        position_m: vector(|p| &p.position_m),
        velocity_m_s: vector(|p| &p.velocity_m_s),
        mass_kg: lanes(&|p| p.mass_kg, 0.0),
    }
}

fn held_blocks<'p, T: Laned, I: Instructions>(
    blocks: usize,
    members: usize,
    particle: &dyn Fn(usize, usize, usize) -> Option<&'p Particle<T>>,
) -> Vec<Held<T::Plain<I>>> {
    let count = <T::Plain<I> as Lanes>::COUNT;
    let grip_of = |block, lane| particle(block, 0, lane).and_then(|p| p.grip);
    let mut held = Vec::new();
    for block in 0..blocks {
        let mut grips: Vec<usize> = (0..count)
            .filter_map(|lane| grip_of(block, lane))
            .map(|g| g.0)
            .collect();
        grips.dedup();
        held.extend(grips.into_iter().map(|grip| {
            let holds = |lane| grip_of(block, lane).is_some_and(|g| g.0 == grip);
            let offset = |member, lane, a: usize| {
                let own = particle(block, member, lane).and_then(|p| p.grip);
                own.filter(|g| g.0 == grip).map_or(0.0, |g| g.1[a])
            };
            Held {
                block,
                grip,
                mask: T::Plain::<I>::from_lanes(|lane| T::base(if holds(lane) { 1.0 } else { 0.0 })),
                offsets_m: (0..members)
                    .map(|m| {
                        std::array::from_fn(|a| T::Plain::<I>::from_lanes(|lane| T::base(offset(m, lane, a))))
                    })
                    .collect(),
            }
        }));
    }
    held
}
