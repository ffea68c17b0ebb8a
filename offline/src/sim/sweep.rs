//! A rope stepped many particles at a time: what [`super::step`] does one particle after the other.
//!
//! A sweep goes once over the particles. It brings them the velocities of the last update of the nodes,
//! moves them, and at once sums up at the nodes what they give in the next step, so that a particle is
//! read and written once per step. Transfers act on each channel of a number alone
//! ([`super::lanes::Channels`]); the stress is computed on the values, and its differential applied to
//! every tangent.

use super::block_material::{BlockMaterial, moduli};
use super::blocks::{Blocks, Body, GripMotion, Held, Part, Stepped};
use super::clamp::RigidMotion;
use super::contact::Footing;
use super::elastic::{Lame, fused_dot};
use super::engine::Engine;
use super::error::Cause;
use super::flow::flow;
use super::grid::GridSpec;
use super::lanes::{Instructions, Laned, Lanes, channels};
use super::laws::Laws;
use super::legs::Placed;
use super::material::Material;
use super::nodes::{CLAMP_ROWS, CONTACT_ROWS, NodeMasses, Rows, Update, update};
use super::physics::SliceMotion;
use super::real::{Arithmetic, Real};
use super::rope::RopeLayout;
use super::step::{Particle, StepContext, inverted_or_not_finite};
use super::tensor::{Vec3, zero3};
use super::transfer::{Given, Transfer};

/// Reads a vector of a body.
type VectorOf<L> = fn(&Body<L>) -> &Vec3<L>;
/// Reads a number of a body by index.
type NumberOf<L> = fn(&Body<L>, usize) -> L;

/// The particles and nodes of a rope, in registers.
pub struct Sweep<T: Laned, I: Instructions> {
    pub(super) blocks: Blocks<T::Plain<I>>,
    pub(super) masses: NodeMasses<T>,
    laws: Option<Laws<T::Base>>,
    slices: usize,
    /// Space for a grip's motion by channel.
    motion: Vec<GripMotion<T::Base>>,
}

impl<T: Laned, I: Instructions> Sweep<T, I> {
    const COUNT: usize = <T::Plain<I> as Lanes>::COUNT;

    /// The springs of table and clamps on the nodes, without what the particles give.
    pub(super) fn springs(&mut self, motions: &[Option<RigidMotion<T>>]) -> Result<(), Cause> {
        for block in 0..self.blocks.transfer.blocks() {
            self.part(block, &Part::Press(block))?;
        }
        self.clamp(motions)
    }

    /// One component of the mean of a vector over a slice.
    fn mean_of(&self, slice: usize, vector: VectorOf<T::Plain<I>>, axis: usize) -> T {
        let members = self.blocks.transfer.members.len();
        let (block, lane) = (slice / Self::COUNT, slice % Self::COUNT);
        let sum = T::from_channels(|k| {
            let first = (block * T::CHANNELS + k) * members;
            let bodies = &self.blocks.bodies[first..first + members];
            let mut sum = T::base(0.0);
            for body in bodies {
                sum += vector(body)[axis].lane(lane);
            }
            sum
        });
        sum.scale(1.0 / members as f64)
    }

    /// Does a part of a step for a block.
    fn part(&mut self, block: usize, part: &Part<T::Plain<I>>) -> Result<(), Cause> {
        let members = self.blocks.transfer.members.len();
        <T::Plain<I> as Stepped>::step(&mut self.blocks, part).map_err(|stop| {
            let particle = (block * Self::COUNT + stop.lane) * members + stop.member;
            inverted_or_not_finite(particle, stop.det)
        })
    }

    fn clamp(&mut self, motions: &[Option<RigidMotion<T>>]) -> Result<(), Cause> {
        for share in 0..self.blocks.held.len() {
            let (block, grip) = (self.blocks.held[share].block, self.blocks.held[share].grip);
            if let Some(motion) = &motions[grip] {
                let mut channels = std::mem::take(&mut self.motion);
                channels.clear();
                channels.extend((0..T::CHANNELS).map(|k| one_channel(motion, k)));
                let done = self.part(block, &Part::Clamp(share, &channels));
                self.motion = channels;
                done?;
            }
        }
        Ok(())
    }
}

/// What the table has under the slices of a block, of which `of_lane` gives a particle each.
fn footing<'a, T: Laned, I: Instructions>(
    context: &StepContext<T>,
    of_lane: impl Fn(usize) -> Option<&'a Particle<T>>,
) -> Footing<T::Plain<I>> {
    let of = |value: fn(Footing<f64>) -> f64| {
        T::Plain::<I>::from_lanes(|lane| {
            let footing = of_lane(lane).zip(context.table.as_ref());
            T::base(footing.map_or(0.0, |(p, table)| {
                value(table.footing(p.length_m, p.volume_m3, p.mass_kg.value()))
            }))
        })
    };
    Footing {
        mass_kg: of(|footing| footing.mass_kg),
        own: of(|footing| footing.own),
        ratio: of(|footing| footing.ratio),
    }
}

impl<T: Laned, I: Instructions> Engine<T> for Sweep<T, I> {
    fn new(
        context: &StepContext<T>,
        layout: &RopeLayout,
        grid: GridSpec,
        particles: Vec<Particle<T>>,
        material: Material<T>,
    ) -> Self {
        let transfer = Transfer::<T::Plain<I>>::new(layout, grid);
        let masses: Vec<T> = particles.iter().map(|p| p.mass_kg).collect();
        let (members, dx) = (transfer.members.len(), grid.spacing_m);
        let of_lane = |block: usize, member: usize, lane: usize| {
            particles.get((block * Self::COUNT + lane) * members + member)
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
        let tangents = |m: &T| (1..T::CHANNELS).any(|k| m.channel(k).value() != 0.0);
        let per_cell = Lame {
            mu: context.viscosity.mu.scale(1.0 / dx),
            lambda: context.viscosity.lambda.scale(1.0 / dx),
        };
        let rows = |count| Rows::new(T::CHANNELS, transfer.planes, count, transfer.width);
        let zero = T::Plain::<I>::zero();
        let laws = Laws::new(context, layout);
        let channels_of_laws = laws.as_ref().map_or(0, |_| T::CHANNELS);
        Self {
            masses: NodeMasses::new(&transfer, layout.slices.len(), &masses),
            slices: layout.slices.len(),
            blocks: Blocks {
                channels: T::CHANNELS,
                bodies,
                rates: vec![[[zero; 3]; 3]; T::CHANNELS * members],
                pushed: vec![zero3(); channels_of_laws],
                motions: vec![SliceMotion::zero(); channels_of_laws],
                material: BlockMaterial::new::<T, I>(context, &material, [transfer.blocks(), members], dx),
                held: held_blocks::<T, I>(transfer.blocks(), members, &of_lane),
                stress_scales,
                lame: moduli::<T, I>(&context.lame),
                viscosity: moduli::<T, I>(&per_cell),
                clamp_stiffness: channels::<T, I>(context.clamp_stiffness),
                carried: 0.0,
                masses_vary: masses.iter().any(tangents),
                impulse: rows(3),
                velocity: rows(3),
                contact: rows(CONTACT_ROWS),
                clamps: rows(CLAMP_ROWS),
                constrained: vec![false; transfer.planes],
                dt_s: context.dt_s,
                spacing_m: dx,
                lowest_m: context.table.map(|table| table.lowest_m),
                footings: (0..transfer.blocks())
                    .map(|block| footing::<T, I>(context, |lane| of_lane(block, 0, lane)))
                    .collect(),
                nodes: vec![zero; 6 * transfer.width],
                given: vec![Given::zero(); members],
                differentials: Vec::with_capacity(members),
                transfer,
            },
            laws,
            motion: Vec::new(),
        }
    }

    fn sweep(
        &mut self,
        context: &StepContext<T>,
        motions: &mut [Option<RigidMotion<T>>],
        decay: f64,
    ) -> Result<(), Cause> {
        self.blocks.carried = decay * context.forgotten;
        for block in 0..self.blocks.transfer.blocks() {
            self.part(block, &Part::Move(block))?;
            let lanes = (self.slices - block * Self::COUNT).min(Self::COUNT);
            flow::<T, I>(context, block, lanes, &mut self.blocks);
            if let Some(laws) = &mut self.laws {
                laws.evaluate::<T, I>(context, block, lanes, &mut self.blocks);
            }
            self.part(block, &Part::Give(block))?;
        }
        self.turn(context, motions);
        self.clamp(motions)
    }

    fn push(&mut self, context: &StepContext<T>, force_n_m: &[Vec3<T>], lengths_m: &[f64]) {
        let blocks = &mut self.blocks;
        for block in 0..blocks.transfer.blocks() {
            let real = (self.slices - block * Self::COUNT).min(Self::COUNT);
            for channel in 0..T::CHANNELS {
                let impulse: Vec3<T::Plain<I>> = std::array::from_fn(|a| {
                    T::Plain::<I>::from_lanes(|lane| {
                        if lane >= real {
                            return T::base(0.0);
                        }
                        let slice = block * Self::COUNT + lane;
                        let share = context.dt_s * lengths_m[slice];
                        force_n_m[slice][a].scale(share).channel(channel)
                    })
                });
                let width = blocks.transfer.width;
                for (a, component) in impulse.into_iter().enumerate() {
                    let row = &mut blocks.nodes[a * width..(a + 1) * width];
                    blocks.transfer.spread(component, row);
                }
                let sum = blocks.impulse.channel_mut(channel);
                blocks
                    .transfer
                    .add_to_planes(block, 3, false, &mut blocks.nodes, sum);
            }
        }
    }

    #[inline(always)]
    fn update_nodes(&mut self, context: &StepContext<T>, decay: f64) {
        let physics = context.physics;
        let what = Update {
            fall_m_s: physics.gravity_m_s2.map(|g| g.scale(context.dt_s)),
            friction: physics.friction,
            kept: decay * (1.0 - context.forgotten),
        };
        update::<T, I>(&mut self.blocks, &self.masses, &what);
    }

    fn set_node_velocities(&mut self, velocities_m_s: &[Vec3<T>]) {
        let blocks = &mut self.blocks;
        let nodes = blocks.transfer.nodes_as_met(self.slices);
        for ((plane, node), velocity) in nodes.into_iter().zip(velocities_m_s) {
            for (a, component) in velocity.iter().enumerate() {
                for k in 0..T::CHANNELS {
                    blocks.velocity.set(k, [plane, a, node], component.channel(k));
                }
            }
        }
    }

    #[inline(always)]
    fn fastest(&self) -> (usize, f64) {
        let members = self.blocks.transfer.members.len();
        let (mut fastest, mut most) = ((0, 0.0), T::Plain::<I>::zero());
        for block in 0..self.blocks.transfer.blocks() {
            let first = block * T::CHANNELS * members;
            for (member, body) in self.blocks.bodies[first..first + members].iter().enumerate() {
                let ([x, y, z], v) = (body.position_m, body.velocity_m_s);
                // A place that is not finite makes it NaN, which nothing exceeds.
                let unplaced = (x + y + z) * T::Plain::<I>::zero();
                let square = fused_dot(v, v) + unplaced;
                if T::Plain::<I>::everywhere(most.exceeds(square)) {
                    continue;
                }
                for lane in 0..Self::COUNT {
                    let speed = square.lane(lane).value().sqrt();
                    if speed > fastest.1 || speed.is_nan() {
                        fastest = ((block * Self::COUNT + lane) * members + member, speed);
                        most = T::Plain::<I>::splat(square.lane(lane));
                    }
                }
            }
        }
        fastest
    }

    fn grip_forces_n(&self, motions: &[Option<RigidMotion<T>>], clamp_per_kg: T) -> Vec<Vec3<T>> {
        let members = self.blocks.transfer.members.len();
        let mut forces = vec![zero3(); motions.len()];
        for held in &self.blocks.held {
            let Some(motion) = &motions[held.grip] else {
                continue;
            };
            for (member, offset) in held.offsets_m.iter().enumerate() {
                let body = |channel: usize| {
                    &self.blocks.bodies[(held.block * T::CHANNELS + channel) * members + member]
                };
                let number = |read: NumberOf<T::Plain<I>>, a: usize, lane: usize| -> T {
                    T::from_channels(|k| read(body(k), a).to_lanes()[lane])
                };
                let (mask, offset) = (held.mask.to_lanes(), offset.map(Lanes::to_lanes));
                for lane in (0..Self::COUNT).filter(|&lane| mask[lane].value() != 0.0) {
                    let place = motion.place(offset.map(|lanes| lanes[lane].value()));
                    let mass: T = number(|body, _| body.mass_kg, 0, lane);
                    let stiffness = mass * clamp_per_kg;
                    for a in 0..3 {
                        let gap = place[a] - number(|body, a| body.position_m[a], a, lane);
                        forces[held.grip][a] += gap * stiffness;
                    }
                }
            }
        }
        forces
    }

    fn slices(&self) -> usize {
        self.slices
    }

    fn slice_mean(&self, slice: usize) -> (Vec3<T>, Vec3<T>) {
        let mean = |vector: VectorOf<T::Plain<I>>| std::array::from_fn(|a| self.mean_of(slice, vector, a));
        (mean(|body| &body.position_m), mean(|body| &body.velocity_m_s))
    }

    fn slice_x(&self, slice: usize) -> T {
        self.mean_of(slice, |body| &body.position_m, 0)
    }

    fn member(&self, slice: usize, member: usize) -> (Vec3<T>, Vec3<T>) {
        let members = self.blocks.transfer.members.len();
        let (block, lane) = (slice / Self::COUNT, slice % Self::COUNT);
        let body = |k: usize| &self.blocks.bodies[(block * T::CHANNELS + k) * members + member];
        (
            std::array::from_fn(|a| T::from_channels(|k| body(k).position_m[a].lane(lane))),
            std::array::from_fn(|a| T::from_channels(|k| body(k).velocity_m_s[a].lane(lane))),
        )
    }

    fn placed(&self, slice: usize, member: usize) -> Placed {
        let members = self.blocks.transfer.members.len();
        let (block, lane) = (slice / Self::COUNT, slice % Self::COUNT);
        let body = &self.blocks.bodies[block * T::CHANNELS * members + member];
        let values = |v: &Vec3<T::Plain<I>>| v.map(|x| x.lane(lane).value());
        Placed {
            position_m: values(&body.position_m),
            deformation_gradient: [0, 1, 2].map(|a| values(&body.deformation_gradient[a])),
        }
    }
}

/// One channel of a grip's motion.
fn one_channel<T: Laned>(motion: &RigidMotion<T>, k: usize) -> GripMotion<T::Base> {
    GripMotion {
        position_m: motion.position_m.map(|c| c.channel(k)),
        rotation: motion.rotation.map(|row| row.map(|c| c.channel(k))),
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
        lost_m: vector(|p| &p.lost_m),
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
