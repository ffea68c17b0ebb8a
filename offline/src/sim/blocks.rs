//! The particles of a rope in registers, block by block and channel by channel, and what a step does to
//! them. A block is as many slices as a register has lanes.
//!
//! Nothing here depends on how many channels a number has except as a count, so it is compiled once per
//! kind of register ([`Stepped`]), not once per number type.

use super::axial::axis;
use super::block_material::{BlockMaterial, Place};
use super::clamp::KEPT;
use super::contact::{Footing, Push, push};
use super::elastic::{Lame, Strained, Straining, StressDifferential};
use super::lanes::Lanes;
use super::nodes::{CLAMP_ROWS, CONTACT_ROWS, Rows};
use super::physics::SliceMotion;
use super::real::Real;
use super::tensor::{Mat3, Vec3, matadd, mul, zero3};
use super::transfer::{Given, Transfer};

/// One channel of the same member of as many slices as a register has lanes.
#[derive(Clone, Copy, Debug)]
pub struct Body<L> {
    /// Deformation gradient.
    pub deformation_gradient: Mat3<L>,
    /// Position, m.
    pub position_m: Vec3<L>,
    /// What rounding has left out of the position so far, m.
    pub lost_m: Vec3<L>,
    /// Velocity, m/s.
    pub velocity_m_s: Vec3<L>,
    /// Mass, kg.
    pub mass_kg: L,
}

impl<L: Lanes> Body<L> {
    /// What it brings to the mean motion of its slices.
    #[inline(always)]
    fn motion(&self) -> SliceMotion<L> {
        SliceMotion {
            position_m: self.position_m,
            velocity_m_s: self.velocity_m_s,
            axis: axis(&self.deformation_gradient),
            mass_kg: self.mass_kg,
        }
    }

    /// Mean motion of the members of a block's slices.
    #[inline(always)]
    pub fn mean_motion(members: &[Self]) -> SliceMotion<L> {
        SliceMotion::mean(members.iter().map(Self::motion))
    }
}

/// A grip's share in a block.
pub struct Held<L> {
    /// The block.
    pub block: usize,
    /// The grip.
    pub grip: usize,
    /// One in the lanes that the grip holds, zero in the others.
    pub mask: L,
    /// Offsets of the members from the grip's first pose, m.
    pub offsets_m: Vec<Vec3<L>>,
}

/// One channel of the motion of a grip: its position, m, and its rotation.
#[derive(Clone, Copy, Debug)]
pub struct GripMotion<B> {
    /// Position, m.
    pub position_m: Vec3<B>,
    /// Rotation.
    pub rotation: Mat3<B>,
}

/// The particles in registers, and the nodes' sums.
pub struct Blocks<L: Lanes> {
    /// How particles and nodes meet.
    pub transfer: Transfer<L>,
    /// Number of channels.
    pub channels: usize,
    /// By block, channel, member.
    pub bodies: Vec<Body<L>>,
    /// By channel, member: dx Ḟ of the block that was moved last.
    pub rates: Vec<Mat3<L>>,
    /// Force of the laws on each member in that block times the time step, N s, by channel; empty where there is none.
    pub pushed: Vec<Vec3<L>>,
    /// Mean motion of the slices of that block, by channel; empty where no law asks for it.
    pub motions: Vec<SliceMotion<L>>,
    /// What laws make of the material.
    pub material: Option<BlockMaterial<L>>,
    /// Shares of grips.
    pub held: Vec<Held<L>>,
    /// 4 dt V/dx of a particle of each block, m² s.
    pub stress_scales: Vec<L>,
    /// Elastic moduli by channel, Pa.
    pub lame: Vec<Lame<L>>,
    /// Viscosities by channel over the node spacing, Pa s/m.
    pub viscosity: Vec<Lame<L>>,
    /// As [`super::step::StepContext`] has it, by channel.
    pub clamp_stiffness: Vec<L>,
    /// Share of the particles' momenta that they give to the nodes in the step at hand.
    pub carried: f64,
    /// Whether any particle's mass has tangents.
    pub masses_vary: bool,
    /// Impulse, N s, summed up in a sweep.
    pub impulse: Rows<L::Scalar>,
    /// Velocity, m/s.
    pub velocity: Rows<L::Scalar>,
    /// Push of the table, N s.
    pub contact: Rows<L::Scalar>,
    /// Stiffness of the clamps as a mass, kg, and that times the change of velocity they ask for.
    pub clamps: Rows<L::Scalar>,
    /// Whether the table or a clamp acts on a plane in this step.
    pub constrained: Vec<bool>,
    /// Time step, s.
    pub dt_s: f64,
    /// Node spacing, m.
    pub spacing_m: f64,
    /// Height of a slice that lies on the table, m.
    pub lowest_m: Option<f64>,
    /// What stands under the slices of each block.
    pub footings: Vec<Footing<L>>,
    /// Space for the nodes of each slice of a block.
    pub nodes: Vec<L>,
    /// Space for what the members of a block give them.
    pub given: Vec<Given<L>>,
    /// Space for the members of a block.
    pub differentials: Vec<(StressDifferential<L>, Straining<L>)>,
}

/// One part of a step.
pub enum Part<'a, L: Lanes> {
    /// Brings a block the velocities of the nodes and moves it.
    Move(usize),
    /// Sums up at the nodes what a block gives: stress, laws, and the table's push.
    Give(usize),
    /// Sums up the table's push on a block alone.
    Press(usize),
    /// Sums up the springs of a share of a grip; its motion by channel.
    Clamp(usize, &'a [GripMotion<L::Scalar>]),
}

/// A block that cannot go on: member, lane and determinant of the deformation gradient.
pub struct Stop {
    /// Member of the slice.
    pub member: usize,
    /// Lane, which is the slice of the block.
    pub lane: usize,
    /// Not positive, or not a number.
    pub det: f64,
}

/// Registers whose instructions a part of a step can be compiled for.
pub trait Stepped: Lanes {
    /// Does one part of a step.
    ///
    /// # Errors
    /// A particle is inverted or not finite.
    fn step(blocks: &mut Blocks<Self>, part: &Part<Self>) -> Result<(), Stop>;
}

impl<L: Lanes> Blocks<L> {
    /// Does one part of a step, compiled into its caller.
    #[inline(always)]
    pub fn step(&mut self, part: &Part<L>) -> Result<(), Stop> {
        match *part {
            Part::Move(block) => {
                for channel in 0..self.channels {
                    self.move_bodies(block, channel);
                }
                self.measure(block);
                for channel in 0..self.motions.len() {
                    let first = self.first(block, channel);
                    let bodies = &self.bodies[first..first + self.transfer.members.len()];
                    self.motions[channel] = Body::mean_motion(bodies);
                }
            }
            Part::Give(block) => {
                for channel in 0..self.channels {
                    // Compiled apart, so that a plain material does not pay for the other.
                    if self.material.is_some() {
                        self.take_down(block, channel);
                        self.give_impulse::<true>(block, channel)?;
                    } else {
                        self.give_impulse::<false>(block, channel)?;
                    }
                }
                self.press(block);
            }
            Part::Press(block) => self.press(block),
            Part::Clamp(share, motion) => self.clamp(share, motion),
        }
        Ok(())
    }

    #[inline(always)]
    fn first(&self, block: usize, channel: usize) -> usize {
        (block * self.channels + channel) * self.transfer.members.len()
    }

    #[inline(always)]
    fn move_bodies(&mut self, block: usize, channel: usize) {
        let members = self.transfer.members.len();
        self.transfer
            .read_planes(block, 3, self.velocity.channel(channel), &mut self.nodes);
        let dt = L::of(self.dt_s);
        let dt_per_cell = L::of(self.dt_s / self.spacing_m);
        let first = self.first(block, channel);
        let bodies = &mut self.bodies[first..first + members];
        let rates = &mut self.rates[channel * members..(channel + 1) * members];
        for (member, (body, stored)) in bodies.iter_mut().zip(rates).enumerate() {
            let (velocity, rate) = self.transfer.gather(block, member, &self.nodes);
            for a in 0..3 {
                for b in 0..3 {
                    let f = &mut body.deformation_gradient[a][b];
                    *f = rate[a][b].times_plus(dt_per_cell, *f);
                }
                velocity[a].carry_to(dt, &mut body.position_m[a], &mut body.lost_m[a]);
            }
            body.velocity_m_s = velocity;
            *stored = rate;
        }
    }

    /// Stress in channel 0, its differential in the others; keeps what the others need.
    #[inline(always)]
    fn stress<const MATERIAL: bool>(
        &mut self,
        block: usize,
        channel: usize,
        member: usize,
    ) -> Result<Mat3<L>, Stop> {
        let place = Place {
            block,
            channel,
            member,
        };
        let members = self.transfer.members.len();
        let (own, first) = (self.first(block, channel) + member, self.first(block, 0) + member);
        let mut material = if MATERIAL { self.material.as_mut() } else { None };
        let f = &self.bodies[own].deformation_gradient;
        let rate = &self.rates[channel * members + member];
        if channel > 0 {
            let at = [&self.bodies[first].deformation_gradient, &self.rates[member]];
            let (elastic, straining) = &self.differentials[member];
            let viscosities = [&self.viscosity[0], &self.viscosity[channel]];
            let viscous = straining.differential(at, [f, rate], viscosities);
            let change = match &material {
                Some(material) => material.change(place, elastic, [at[0], f], &self.lame[channel]),
                None => elastic.of(f, &self.lame[channel]),
            };
            let mut pk1 = matadd(&change, &viscous);
            if let Some(material) = &mut material {
                material.remember_change(place, straining, [at, [f, rate]], &mut pk1);
            }
            return Ok(pk1);
        }
        let strained = match &material {
            Some(material) => material.strained(place, f),
            None => Strained::new(f),
        };
        if !L::everywhere(strained.j.exceeds(L::zero())) {
            return Err(worst(member, strained.j));
        }
        let straining = Straining::new(f, rate, &self.viscosity[0]);
        if self.channels > 1 {
            self.differentials.truncate(member);
            let elastic = StressDifferential::new(&strained, &self.lame[0]);
            self.differentials.push((elastic, straining));
        }
        let elastic = match &mut material {
            Some(material) => material.stress(place, &strained, &self.lame[0]),
            None => strained.piola_stress(&self.lame[0]),
        };
        let mut pk1 = matadd(&elastic, &straining.piola_stress(f));
        if let Some(material) = &mut material {
            material.remember(place, &straining, f, &mut pk1);
        }
        Ok(pk1)
    }

    /// Takes down how far the members of a block are strained, where they may flow.
    #[inline(always)]
    fn measure(&mut self, block: usize) {
        let first = self.first(block, 0);
        if let Some(flowed) = self
            .material
            .as_mut()
            .and_then(|material| material.flowed.as_mut())
        {
            flowed.measure(block, &self.bodies[first..first + self.transfer.members.len()]);
        }
    }

    /// Takes down what the members of the slices of a block have in common.
    #[inline(always)]
    fn take_down(&mut self, block: usize, channel: usize) {
        let members = self.transfer.members.len();
        let (own, first) = (self.first(block, channel), self.first(block, 0));
        if let Some(material) = &mut self.material {
            let (bodies, values) = (
                &self.bodies[own..own + members],
                &self.bodies[first..first + members],
            );
            material.take_down(block, channel, bodies, values, &self.lame);
        }
    }

    /// Impulse of stress and of the laws' forces and a share of the momentum, for one channel of a block.
    #[inline(always)]
    fn give_impulse<const MATERIAL: bool>(&mut self, block: usize, channel: usize) -> Result<(), Stop> {
        let members = self.transfer.members.len();
        let (scale, carried) = (-self.stress_scales[block], L::of(self.carried));
        for member in 0..members {
            let pk1 = self.stress::<MATERIAL>(block, channel, member)?;
            let mut at_particle = self.pushed.get(channel).copied().unwrap_or(zero3());
            let value = &self.bodies[self.first(block, 0) + member];
            let body = &self.bodies[self.first(block, channel) + member];
            let (rate, rate_value) = (&self.rates[channel * members + member], &self.rates[member]);
            let mass = value.mass_kg * carried;
            let mut slope = pk1;
            for a in 0..3 {
                at_particle[a] = body.velocity_m_s[a].times_plus(mass, at_particle[a]);
                for b in 0..3 {
                    slope[a][b] = pk1[a][b].times_plus(scale, rate[a][b] * mass);
                }
                if channel > 0 && self.masses_vary {
                    let change = body.mass_kg * carried;
                    at_particle[a] = value.velocity_m_s[a].times_plus(change, at_particle[a]);
                    for b in 0..3 {
                        slope[a][b] = rate_value[a][b].times_plus(change, slope[a][b]);
                    }
                }
            }
            self.given[member] = Given {
                value: at_particle,
                slope,
            };
        }
        self.nodes.fill(L::zero());
        self.transfer.scatter(block, &self.given, &mut self.nodes);
        let planes = self.impulse.channel_mut(channel);
        self.transfer
            .add_to_planes(block, 3, true, &mut self.nodes, planes);
        Ok(())
    }

    /// The table's push on every slice of a block that touches it.
    #[inline(always)]
    fn press(&mut self, block: usize) {
        let Some(push) = self.push_of_table(block) else {
            return;
        };
        for channel in 0..self.channels {
            let impulse = if channel == 0 {
                push.impulse
            } else {
                let gap = self.mean(block, channel, |body| body.position_m[2]);
                let rise = self.mean(block, channel, |body| body.velocity_m_s[2]);
                let mut impulse = gap.times_plus(push.by_gap, rise * push.by_rise);
                if self.masses_vary {
                    // All particles of a slice have the mass of the first.
                    impulse += self.bodies[self.first(block, channel)].mass_kg * push.by_mass;
                }
                impulse
            };
            self.transfer.spread(impulse, &mut self.nodes);
            let contact = self.contact.channel_mut(channel);
            self.transfer
                .add_to_planes(block, CONTACT_ROWS, false, &mut self.nodes, contact);
        }
        self.mark(block, push.impulse);
    }

    /// What the table gives the particles of a block's slices; none if it touches none of them.
    #[inline(always)]
    pub fn push_of_table(&self, block: usize) -> Option<Push<L>> {
        let gap = self.mean(block, 0, |body| body.position_m[2]) - L::of(self.lowest_m?);
        let rise = self.mean(block, 0, |body| body.velocity_m_s[2]);
        let far = rise.times_plus(L::of(self.dt_s), gap).exceeds(L::zero());
        (!L::everywhere(far)).then(|| push(gap, rise, &self.footings[block], self.dt_s))
    }

    /// One channel of the mean of something over each slice of a block.
    #[inline(always)]
    fn mean(&self, block: usize, channel: usize, of: impl Fn(&Body<L>) -> L) -> L {
        let members = self.transfer.members.len();
        let first = self.first(block, channel);
        let mut sum = L::zero();
        for body in &self.bodies[first..first + members] {
            sum += of(body);
        }
        sum.scale(1.0 / members as f64)
    }

    /// A grip's springs on its share of a block.
    #[inline(always)]
    fn clamp(&mut self, share: usize, motion: &[GripMotion<L::Scalar>]) {
        let held = &self.held[share];
        let (block, mask) = (held.block, held.mask);
        let (width, first) = (self.transfer.width, self.first(block, 0));
        let per_step = L::of(1.0 / self.dt_s);
        let springs = mask * self.clamp_stiffness[0];
        for channel in 0..self.channels {
            let own = self.first(block, channel);
            let slope = mask * self.clamp_stiffness[channel];
            // All particles of a slice have the mass of the first.
            let (mass, mass_change) = (self.bodies[first].mass_kg, self.bodies[own].mass_kg);
            let stiffness = mass * springs;
            let change = if channel == 0 {
                stiffness
            } else {
                mass_change.times_plus(springs, mass * slope)
            };
            for member in 0..self.transfer.members.len() {
                let (value, body) = (&self.bodies[first + member], &self.bodies[own + member]);
                let offset = &held.offsets_m[member];
                let asked = asked_change(&motion[channel], offset, body, per_step);
                let mut product = mul(asked, stiffness);
                if channel > 0 {
                    let asked_value = asked_change(&motion[0], offset, value, per_step);
                    for a in 0..3 {
                        product[a] = change.times_plus(asked_value[a], product[a]);
                    }
                }
                self.given[member].value = product;
            }
            self.nodes.fill(L::zero());
            self.transfer.spread(change, &mut self.nodes[..width]);
            for a in 0..3 {
                let row = &mut self.nodes[(a + 1) * width..(a + 2) * width];
                self.transfer.scatter_values(a, &self.given, row);
            }
            let clamps = self.clamps.channel_mut(channel);
            self.transfer
                .add_to_planes(block, CLAMP_ROWS, false, &mut self.nodes, clamps);
        }
        self.mark(block, mask);
    }

    /// Marks the planes that the slices with a number other than zero meet as constrained.
    #[inline(always)]
    fn mark(&mut self, block: usize, marked: L) {
        let lanes = marked.to_lanes();
        for (lane, mark) in lanes.iter().enumerate().take(L::COUNT) {
            if mark.value() != 0.0 {
                let plane = self.transfer.slices[block * L::COUNT + lane].plane;
                self.constrained[plane..plane + 3].fill(true);
            }
        }
    }
}

/// One channel of how much a gripped particle's velocity must change to bring it to its place within a step.
#[inline(always)]
fn asked_change<L: Lanes>(
    motion: &GripMotion<L::Scalar>,
    offset_m: &Vec3<L>,
    body: &Body<L>,
    per_step: L,
) -> Vec3<L> {
    let mut change = body.velocity_m_s;
    for a in 0..3 {
        let mut gap = L::splat(motion.position_m[a]) - body.position_m[a];
        for b in 0..3 {
            gap = L::splat(motion.rotation[a][b]).times_plus(offset_m[b], gap);
        }
        change[a] = gap * per_step - body.velocity_m_s[a].scale(KEPT);
    }
    change
}

/// The first lane whose determinant is not positive.
#[cold]
fn worst<L: Lanes>(member: usize, j: L) -> Stop {
    let lanes = j.to_lanes();
    let bad = |lane: &usize| lanes[*lane].value() <= 0.0 || lanes[*lane].value().is_nan();
    let lane = (0..L::COUNT).find(bad).unwrap_or(0);
    Stop {
        member,
        lane,
        det: lanes[lane].value(),
    }
}
