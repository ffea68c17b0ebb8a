//! The nodes of a rope as planes across it, one channel after the other, and their update.

use super::lanes::{Channels, Instructions, Laned, Lanes};
use super::real::Arithmetic;
use super::step::{clamp_node, table_contact};
use super::tensor::{Vec3, add, mul};
use super::transfer::Transfer;

/// Stiffness of the table and what it asks for, per node.
pub const CONTACT_ROWS: usize = 2;
/// Stiffness of the clamps and what they ask for, per node.
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

    /// As many nodes of a row as a register has lanes.
    #[inline(always)]
    pub fn read<T: Laned<Base = B>, I: Instructions>(
        &self,
        plane: usize,
        row: usize,
        node: usize,
    ) -> T::Wide<I> {
        T::Wide::<I>::from_channels(|k| T::Plain::<I>::load(&self.values[self.at(k, plane, row, node)..]))
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

    fn clear_plane(&mut self, channels: usize, plane: usize) {
        for k in 0..channels {
            let at = self.at(k, plane, 0, 0);
            self.values[at..at + self.rows * self.width].fill(B::zero());
        }
    }
}

/// The nodes of a rope.
pub struct Nodes<T: Laned> {
    /// Momentum, kg m/s, summed up in a sweep.
    pub momentum: Rows<T::Base>,
    /// Velocity after the last update, m/s.
    pub velocity: Rows<T::Base>,
    /// Stiffness of the table as a mass, kg, and that times the velocity it asks for.
    pub contact: Rows<T::Base>,
    /// Stiffness of the clamps as a mass, kg, and that times the velocity they ask for.
    pub clamps: Rows<T::Base>,
    /// Whether the table or a clamp acts on a plane in this step.
    pub constrained: Vec<bool>,
    /// Mass, kg.
    pub mass: Rows<T::Base>,
    /// One over the mass, 1/kg; zero where no particle is near.
    pub inverse_mass: Rows<T::Base>,
}

/// What an update of the nodes needs.
pub struct Update<T> {
    /// Acceleration of free fall times the time step, m/s.
    pub fall_m_s: Vec3<T>,
    /// Coulomb coefficient of the table.
    pub friction: T,
    /// Factor of every velocity.
    pub decay: f64,
}

impl<T: Laned> Nodes<T> {
    /// Nodes at rest; `masses_kg` are the particles', slice by slice.
    pub fn new<L: Lanes<Scalar = T::Base>>(transfer: &Transfer<L>, slices: usize, masses_kg: &[T]) -> Self {
        let rows = |count| Rows::new(T::CHANNELS, transfer.planes, count, transfer.width);
        let members = transfer.members.len();
        let (mut mass, mut inverse_mass) = (rows(1), rows(1));
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
                inverse_mass.channel_mut(k)[node] = (T::one() / m).channel(k);
            }
        }
        Self {
            momentum: rows(3),
            velocity: rows(3),
            contact: rows(CONTACT_ROWS),
            clamps: rows(CLAMP_ROWS),
            constrained: vec![false; transfer.planes],
            mass,
            inverse_mass,
        }
    }

    /// Forgets what was summed up, without an update.
    pub fn forget(&mut self) {
        self.momentum.values.fill(T::Base::zero());
        for plane in 0..self.constrained.len() {
            if std::mem::take(&mut self.constrained[plane]) {
                self.contact.clear_plane(T::CHANNELS, plane);
                self.clamps.clear_plane(T::CHANNELS, plane);
            }
        }
    }

    /// Turns momenta into velocities: weight, settling, table, clamps; and forgets what was summed up.
    #[inline(always)]
    pub fn update<I: Instructions>(&mut self, update: &Update<T>) {
        let wide = |x: T| T::Wide::<I>::from_channels(|k| T::Plain::<I>::splat(x.channel(k)));
        let (fall, friction) = (update.fall_m_s.map(wide), wide(update.friction));
        let count = <T::Plain<I> as Lanes>::COUNT;
        for plane in 0..self.constrained.len() {
            let constrained = self.constrained[plane];
            for node in (0..self.momentum.width).step_by(count) {
                let inverse = self.inverse_mass.read::<T, I>(plane, 0, node).scale(update.decay);
                let momentum = std::array::from_fn(|a| self.momentum.read::<T, I>(plane, a, node));
                let mut velocity = add(mul(momentum, inverse), fall);
                if constrained {
                    let mass = self.mass.read::<T, I>(plane, 0, node);
                    let contact = std::array::from_fn(|row| self.contact.read::<T, I>(plane, row, node));
                    let clamp = std::array::from_fn(|row| self.clamps.read::<T, I>(plane, row, node));
                    velocity = table_contact(velocity, mass, &contact, friction);
                    velocity = clamp_node(velocity, mass, &clamp);
                }
                for a in 0..3 {
                    self.velocity.write::<T, I>(plane, a, node, &velocity[a]);
                }
            }
            if constrained {
                self.contact.clear_plane(T::CHANNELS, plane);
                self.clamps.clear_plane(T::CHANNELS, plane);
                self.constrained[plane] = false;
            }
        }
        self.momentum.values.fill(T::Base::zero());
    }
}
