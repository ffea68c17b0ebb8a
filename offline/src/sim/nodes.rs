//! The nodes of a rope as planes across it, one channel after the other, and their update.

use super::blocks::Blocks;
use super::contact::rub;
use super::lanes::{Channels, Instructions, Laned, Lanes};
use super::real::Arithmetic;
use super::step::clamp_node;
use super::tensor::{Vec3, add, mul, scaled};
use super::transfer::Transfer;

/// The table's push per node.
pub const CONTACT_ROWS: usize = 1;
/// Stiffness of the clamps and what change of velocity they ask for, per node.
pub const CLAMP_ROWS: usize = 4;

/// Numbers at the nodes: channel, plane, row, node. A row is one component of a vector.
#[derive(Clone, Debug)]
pub struct Rows<B> {
    values: Vec<B>,
    width: usize,
    rows: usize,
    planes: usize,
}

impl<B: Arithmetic> Rows<B> {
    /// Zeros.
    pub fn new(channels: usize, planes: usize, rows: usize, width: usize) -> Self {
        Self {
            values: vec![B::zero(); channels * planes * rows * width],
            width,
            rows,
            planes,
        }
    }

    /// All planes of a channel.
    #[inline(always)]
    pub fn channel(&self, channel: usize) -> &[B] {
        let length = self.planes * self.rows * self.width;
        &self.values[channel * length..(channel + 1) * length]
    }

    /// All planes of a channel.
    #[inline(always)]
    pub fn channel_mut(&mut self, channel: usize) -> &mut [B] {
        let length = self.planes * self.rows * self.width;
        &mut self.values[channel * length..(channel + 1) * length]
    }

    #[inline(always)]
    fn at(&self, channel: usize, plane: usize, row: usize, node: usize) -> usize {
        ((channel * self.planes + plane) * self.rows + row) * self.width + node
    }

    /// Sets a number at a plane, row and node.
    pub fn set(&mut self, channel: usize, [plane, row, node]: [usize; 3], value: B) {
        let at = self.at(channel, plane, row, node);
        self.values[at] = value;
    }

    /// As many nodes of a row as a register has lanes.
    #[inline(always)]
    pub fn read<T: Laned<Base = B>, I: Instructions>(
        &self,
        plane: usize,
        row: usize,
        node: usize,
    ) -> T::Wide<I> {
        let mut value = T::Wide::<I>::zero();
        for k in 0..T::CHANNELS {
            let from = &self.values[self.at(k, plane, row, node)..];
            value.set_channel(k, T::Plain::<I>::load(from));
        }
        value
    }

    /// Three rows: a vector.
    #[inline(always)]
    pub fn read_vector<T: Laned<Base = B>, I: Instructions>(
        &self,
        plane: usize,
        first: usize,
        node: usize,
    ) -> Vec3<T::Wide<I>> {
        [
            self.read::<T, I>(plane, first, node),
            self.read::<T, I>(plane, first + 1, node),
            self.read::<T, I>(plane, first + 2, node),
        ]
    }

    /// Writes them.
    #[inline(always)]
    pub fn write<T: Laned<Base = B>, I: Instructions>(
        &mut self,
        plane: usize,
        row: usize,
        node: usize,
        value: &T::Wide<I>,
    ) {
        for k in 0..T::CHANNELS {
            let at = self.at(k, plane, row, node);
            value.channel(k).store(&mut self.values[at..]);
        }
    }

    fn clear(&mut self) {
        self.values.fill(B::zero());
    }

    fn clear_plane(&mut self, channels: usize, plane: usize) {
        for k in 0..channels {
            let at = self.at(k, plane, 0, 0);
            self.values[at..at + self.rows * self.width].fill(B::zero());
        }
    }
}

/// Masses of the nodes, kg, and one over them, zero where there is no mass.
pub struct NodeMasses<T: Laned> {
    pub(super) mass: Rows<T::Base>,
    pub(super) inverse: Rows<T::Base>,
}

impl<T: Laned> NodeMasses<T> {
    /// From the particles' masses, slice by slice.
    pub fn new<L: Lanes<Scalar = T::Base>>(transfer: &Transfer<L>, slices: usize, masses_kg: &[T]) -> Self {
        let members = transfer.members.len();
        let mut mass = Rows::new(T::CHANNELS, transfer.planes, 1, transfer.width);
        let mut inverse = mass.clone();
        let mut total = vec![T::zero(); transfer.planes * transfer.width];
        for slice in 0..slices {
            transfer.weigh(
                slice,
                &masses_kg[slice * members..(slice + 1) * members],
                &mut total,
            );
        }
        for (node, &m) in total.iter().enumerate() {
            if m.value() == 0.0 {
                continue;
            }
            for k in 0..T::CHANNELS {
                mass.channel_mut(k)[node] = m.channel(k);
                inverse.channel_mut(k)[node] = (T::one() / m).channel(k);
            }
        }
        Self { mass, inverse }
    }
}

/// Forgets what was summed up at the nodes, without an update.
pub fn forget<L: Lanes>(blocks: &mut Blocks<L>) {
    blocks.impulse.clear();
    for plane in 0..blocks.constrained.len() {
        if std::mem::take(&mut blocks.constrained[plane]) {
            blocks.contact.clear_plane(blocks.channels, plane);
            blocks.clamps.clear_plane(blocks.channels, plane);
        }
    }
}

/// What an update of the nodes needs.
pub struct Update<T> {
    /// Acceleration of free fall times the time step, m/s.
    pub fall_m_s: Vec3<T>,
    /// Coulomb coefficient of the table.
    pub friction: T,
    /// Share of the velocity that stays; forces act in full, so that a settled rope is in equilibrium.
    pub kept: f64,
}

/// Turns impulses into a change of the velocities: settling, weight, table, clamps; and forgets what was
/// summed up.
#[inline(always)]
pub fn update<T: Laned, I: Instructions>(
    blocks: &mut Blocks<T::Plain<I>>,
    masses: &NodeMasses<T>,
    what: &Update<T>,
) {
    let wide = |x: T| T::Wide::<I>::from_channels(|k| T::Plain::<I>::splat(x.channel(k)));
    let (fall, friction) = (what.fall_m_s.map(wide), wide(what.friction));
    let count = <T::Plain<I> as Lanes>::COUNT;
    for plane in 0..blocks.constrained.len() {
        let constrained = blocks.constrained[plane];
        for node in (0..blocks.impulse.width).step_by(count) {
            let inverse = masses.inverse.read::<T, I>(plane, 0, node);
            let impulse = blocks.impulse.read_vector::<T, I>(plane, 0, node);
            let before = blocks.velocity.read_vector::<T, I>(plane, 0, node);
            let kept = scaled(before, what.kept);
            let mut velocity = add(add(kept, mul(impulse, inverse)), fall);
            if constrained {
                let mass = masses.mass.read::<T, I>(plane, 0, node);
                let push = blocks.contact.read::<T, I>(plane, 0, node) * inverse;
                let [x, y, z] = blocks.clamps.read_vector::<T, I>(plane, 1, node);
                let clamp = [blocks.clamps.read::<T, I>(plane, 0, node), x, y, z];
                velocity = rub(velocity, push, friction);
                velocity = clamp_node(velocity, before, mass, &clamp);
            }
            for a in 0..3 {
                blocks.velocity.write::<T, I>(plane, a, node, &velocity[a]);
            }
        }
        if constrained {
            blocks.contact.clear_plane(T::CHANNELS, plane);
            blocks.clamps.clear_plane(T::CHANNELS, plane);
            blocks.constrained[plane] = false;
        }
    }
    blocks.impulse.clear();
}
