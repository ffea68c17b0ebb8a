//! The material of a block of particles in registers: what [`super::material`] does one particle after the other;
//! plastic flow is [`super::flow`]. Channel 0 holds values, the others their differentials; letters as there.
//!
//! A = diag(a, 1, 1) and det(A)⁻¹ = 1/a, so that P_e Aᵀ/a has the first column of P_e, and the others over a.

use super::axial::{Stretched, add_column, axis};
use super::blocks::Body;
use super::elastic::{Lame, Strained, Straining, StressDifferential, isotropic, times};
use super::flow::Flowed;
use super::lanes::{Instructions, Laned, Lanes, channel, channels};
use super::material::{Material, remembered};
use super::physics::Maxwell;
use super::step::StepContext;
use super::tensor::{Mat3, matadd, zero3};
use std::ops::Range;

/// The stress-free shape of a member.
#[derive(Clone, Copy)]
struct Rest<L> {
    /// a.
    inverse: L,
    /// 1/a.
    stretch: L,
}

/// A law with a memory. By channel where nothing else is said.
struct Element<L> {
    /// Share of what was remembered that stays in a step.
    keep: Vec<L>,
    /// What is taken of the rate of strain over the node spacing.
    take: Vec<L>,
    /// Viscosities, Pa s.
    viscosity: Vec<Lame<L>>,
    /// Twice the rate of strain as it is remembered, 1/s, by block, channel, member.
    memories: Vec<Mat3<L>>,
    /// The values before the step at hand, by member.
    before: Vec<Mat3<L>>,
}

impl<L: Lanes> Element<L> {
    fn new<T: Laned<Plain<I> = L, Base = L::Scalar>, I: Instructions>(
        law: &Maxwell<T>,
        context: &StepContext<T>,
        [blocks, members]: [usize; 2],
        spacing_m: f64,
    ) -> Self {
        let [keep, take] = remembered(law.time_s, context.dt_s);
        Self {
            keep: channels::<T, I>(keep),
            take: channels::<T, I>(take.scale(1.0 / spacing_m)),
            viscosity: moduli::<T, I>(&law.viscosity(&context.lame)),
            memories: vec![[zero3(); 3]; blocks * T::CHANNELS * members],
            before: vec![[zero3(); 3]; members],
        }
    }
}

/// Moduli by channel, in every lane.
pub fn moduli<T: Laned, I: Instructions>(lame: &Lame<T>) -> Vec<Lame<T::Plain<I>>> {
    (0..T::CHANNELS)
        .map(|k| Lame {
            mu: channel::<T, I>(lame.mu, k),
            lambda: channel::<T, I>(lame.lambda, k),
        })
        .collect()
}

/// Which member of a block, and of which channel.
#[derive(Clone, Copy)]
pub struct Place {
    /// Block.
    pub block: usize,
    /// Channel.
    pub channel: usize,
    /// Member.
    pub member: usize,
}

impl Place {
    /// The same member in channel 0.
    #[inline(always)]
    pub(super) fn value(self) -> Self {
        Self { channel: 0, ..self }
    }

    /// Where it lies in a list by block, channel, member.
    #[inline(always)]
    pub(super) fn index(self, channels: usize, members: usize) -> usize {
        (self.block * channels + self.channel) * members + self.member
    }
}

/// The material of all blocks, and what is taken down for the one at hand.
pub struct BlockMaterial<L> {
    channels: usize,
    members: usize,
    /// By block, channel, member; empty where the rope is straight at rest, or flows.
    rest: Vec<Rest<L>>,
    /// The shapes of a rope that flows.
    pub(super) flowed: Option<Flowed<L>>,
    /// c by block and channel; empty where no law changes it.
    bending: Vec<L>,
    elements: Vec<Element<L>>,
    /// Coefficient k of the stress along the axis by channel, Pa; empty where there is none.
    cubic_pa: Vec<L>,
    /// What channel 0 keeps of that stress for the others, by member.
    stretched: Vec<Stretched<L>>,
    /// (1 − c) P(F̄) by channel, Pa.
    common_pa: Vec<Mat3<L>>,
    /// P(F̄), Pa, and its differential.
    mean: Option<(Mat3<L>, StressDifferential<L>)>,
    /// P(F A) by member, Pa.
    stresses: Vec<Mat3<L>>,
}

impl<L: Lanes> BlockMaterial<L> {
    /// In so many blocks of so many members; none where no law changes the material.
    pub fn new<T: Laned<Plain<I> = L, Base = L::Scalar>, I: Instructions>(
        context: &StepContext<T>,
        material: &Material<T>,
        [blocks, members]: [usize; 2],
        spacing_m: f64,
    ) -> Option<Self> {
        let physics = context.physics;
        let cubic_pa = physics.cubic_pa(&context.lame);
        if !physics.changes_material() && cubic_pa.is_none() {
            return None;
        }
        let lanes = |k: usize, of_lane: &dyn Fn(usize) -> Option<T>| {
            L::from_lanes(|lane| of_lane(lane).unwrap_or(T::one()).channel(k))
        };
        let flows = !physics.flow_laws.is_empty();
        let bends_alone = !physics.shape_laws.is_empty() && !flows;
        let (mut rest, mut bending) = (Vec::new(), Vec::new());
        for block in 0..blocks {
            for k in 0..T::CHANNELS {
                let slice = |lane: usize| block * L::COUNT + lane;
                if !physics.bending_laws.is_empty() {
                    bending.push(lanes(k, &|lane| material.bending(slice(lane))));
                }
                for member in 0..members * usize::from(bends_alone) {
                    let inverse = |lane: usize| {
                        let own = material.natural_inverse(slice(lane) * members + member);
                        own.map(|a| a[0][0])
                    };
                    rest.push(Rest {
                        inverse: lanes(k, &inverse),
                        stretch: lanes(k, &|lane| Some(T::one() / inverse(lane)?)),
                    });
                }
            }
        }
        let elements = physics.memory_laws.iter();
        Some(Self {
            channels: T::CHANNELS,
            members,
            rest,
            flowed: flows.then(|| Flowed::new::<T, I>(&physics.flow_laws, material, [blocks, members])),
            bending,
            elements: elements
                .map(|law| Element::new::<T, I>(law, context, [blocks, members], spacing_m))
                .collect(),
            cubic_pa: cubic_pa.map_or_else(Vec::new, |k| channels::<T, I>(k)),
            stretched: vec![Stretched::new([L::one(), L::zero(), L::zero()]); members],
            common_pa: vec![[zero3(); 3]; T::CHANNELS],
            mean: None,
            stresses: vec![[zero3(); 3]; members],
        })
    }

    #[inline(always)]
    fn at(&self, place: Place) -> usize {
        place.index(self.channels, self.members)
    }

    /// F A, or its differential; `value` is that of the member's channel 0.
    #[inline(always)]
    fn elastic(&self, place: Place, f: &Mat3<L>, value: &Mat3<L>) -> Mat3<L> {
        if let Some(flowed) = &self.flowed {
            return if place.channel == 0 {
                flowed.elastic(place, f)
            } else {
                flowed.change_of_elastic(place, [value, f])
            };
        }
        if self.rest.is_empty() {
            return *f;
        }
        let own = &self.rest[self.at(place)];
        if place.channel == 0 {
            return columns_times(f, 0..1, own.inverse);
        }
        let mut elastic = *f;
        let first = &self.rest[self.at(place.value())];
        for a in 0..3 {
            elastic[a][0] = f[a][0].times_plus(first.inverse, value[a][0] * own.inverse);
        }
        elastic
    }

    /// Takes down what the members of each slice of a block have in common, in one channel; `values` are the block's
    /// bodies in channel 0.
    #[inline(always)]
    pub fn take_down(
        &mut self,
        block: usize,
        channel: usize,
        bodies: &[Body<L>],
        values: &[Body<L>],
        lame: &[Lame<L>],
    ) {
        if self.bending.is_empty() {
            return;
        }
        let mut mean: Mat3<L> = [zero3(); 3];
        for member in 0..self.members {
            let place = Place {
                block,
                channel,
                member,
            };
            let (f, value) = (
                &bodies[member].deformation_gradient,
                &values[member].deformation_gradient,
            );
            mean = matadd(&mean, &self.elastic(place, f, value));
        }
        for row in &mut mean {
            for x in row {
                *x = x.scale(1.0 / self.members as f64);
            }
        }
        let first = block * self.channels;
        let share = L::one() - self.bending[first];
        if channel == 0 {
            let strained = Strained::new(&mean);
            let stress = strained.piola_stress(&lame[0]);
            self.common_pa[0] = product(&stress, share);
            self.mean = Some((stress, StressDifferential::new(&strained, &lame[0])));
        } else if let Some((stress, differential)) = &self.mean {
            let change = product(&differential.of(&mean, &lame[channel]), share);
            self.common_pa[channel] = plus(&change, stress, -self.bending[first + channel]);
        }
    }

    /// Elasticity of the material at a member: what of its deformation gradient is elastic, made of it.
    #[inline(always)]
    pub fn strained(&self, place: Place, f: &Mat3<L>) -> Strained<L> {
        Strained::new(&self.elastic(place, f, f))
    }

    /// First Piola-Kirchhoff stress of elasticity and along the axis, Pa, in channel 0.
    #[inline(always)]
    pub fn stress(&mut self, place: Place, strained: &Strained<L>, lame: &Lame<L>) -> Mat3<L> {
        let own = strained.piola_stress(lame);
        self.stresses[place.member] = own;
        let mut stress = own;
        if !self.bending.is_empty() {
            stress = product(&own, self.bending[place.block * self.channels]);
        }
        if !self.cubic_pa.is_empty() {
            let stretched = Stretched::new(axis(strained.gradient()));
            add_column(&mut stress, stretched.column(self.cubic_pa[0]));
            self.stretched[place.member] = stretched;
        }
        if let Some(flowed) = &self.flowed {
            return flowed.stress(place, &stress, &self.common_pa[0]);
        }
        if !self.rest.is_empty() {
            stress = columns_times(&stress, 1..3, self.rest[self.at(place)].stretch);
        }
        if self.bending.is_empty() {
            return stress;
        }
        matadd(&stress, &self.common_value(place))
    }

    /// (1 − c) P(F̄) Aᵀ of a member.
    #[inline(always)]
    fn common_value(&self, place: Place) -> Mat3<L> {
        let common = &self.common_pa[0];
        if self.rest.is_empty() {
            return *common;
        }
        columns_times(common, 0..1, self.rest[self.at(place)].inverse)
    }

    /// The differential of that stress in another channel; `differential` is that of P(F A).
    #[inline(always)]
    pub fn change(
        &self,
        place: Place,
        differential: &StressDifferential<L>,
        [f, df]: [&Mat3<L>; 2],
        dlame: &Lame<L>,
    ) -> Mat3<L> {
        let elastic = self.elastic(place, df, f);
        let mut change = differential.of(&elastic, dlame);
        let mut value = self.stresses[place.member];
        let first = place.block * self.channels;
        if !self.bending.is_empty() {
            let c = self.bending[first];
            change = plus(&product(&change, c), &value, self.bending[first + place.channel]);
            value = product(&value, c);
        }
        if !self.cubic_pa.is_empty() {
            let stretched = &self.stretched[place.member];
            let cubic_pa = [self.cubic_pa[0], self.cubic_pa[place.channel]];
            add_column(&mut change, stretched.change(axis(&elastic), cubic_pa));
            add_column(&mut value, stretched.column(cubic_pa[0]));
        }
        if let Some(flowed) = &self.flowed {
            let commons = [&self.common_pa[0], &self.common_pa[place.channel]];
            return flowed.change_of_stress(place, [&value, &change], commons);
        }
        let mut common = self.common_pa[place.channel];
        if !self.rest.is_empty() {
            let own = &self.rest[self.at(place)];
            let rest = &self.rest[self.at(place.value())];
            for a in 0..3 {
                for b in 1..3 {
                    change[a][b] = change[a][b].times_plus(rest.stretch, value[a][b] * own.stretch);
                }
                common[a][0] = common[a][0].times_plus(rest.inverse, self.common_pa[0][a][0] * own.inverse);
            }
        }
        if self.bending.is_empty() {
            return change;
        }
        matadd(&change, &common)
    }

    /// Lets a member remember its rate of strain, and adds the stress that follows it, in channel 0.
    #[inline(always)]
    pub fn remember(&mut self, place: Place, straining: &Straining<L>, f: &Mat3<L>, pk1: &mut Mat3<L>) {
        let at = self.at(place);
        for element in &mut self.elements {
            let memory = element.memories[at];
            element.before[place.member] = memory;
            let kept = product(&memory, element.keep[0]);
            let memory = plus(&kept, &straining.twice, element.take[0]);
            element.memories[at] = memory;
            *pk1 = matadd(pk1, &times(f, &isotropic(&memory, &element.viscosity[0])));
        }
    }

    /// The same in another channel, after channel 0; `at_values` and `by` are a deformation gradient with its rate.
    #[inline(always)]
    pub fn remember_change(
        &mut self,
        place: Place,
        straining: &Straining<L>,
        [at_values, by]: [[&Mat3<L>; 2]; 2],
        pk1: &mut Mat3<L>,
    ) {
        let (at, first) = (self.at(place), self.at(place.value()));
        for element in &mut self.elements {
            let k = place.channel;
            let twice = Straining::change_of_twice(at_values, by);
            let kept = product(&element.memories[at], element.keep[0]);
            let mut change = plus(&kept, &twice, element.take[0]);
            change = plus(&change, &element.before[place.member], element.keep[k]);
            change = plus(&change, &straining.twice, element.take[k]);
            element.memories[at] = change;
            let value = &element.memories[first];
            let stress = isotropic(value, &element.viscosity[0]);
            let of_strain = isotropic(&change, &element.viscosity[0]);
            let of_moduli = isotropic(value, &element.viscosity[k]);
            *pk1 = matadd(pk1, &times(by[0], &stress));
            *pk1 = matadd(pk1, &times(at_values[0], &matadd(&of_strain, &of_moduli)));
        }
    }
}

// Loops, not closures: see `elastic.rs`.

/// M c.
#[inline(always)]
fn product<L: Lanes>(m: &Mat3<L>, c: L) -> Mat3<L> {
    columns_times(m, 0..3, c)
}

/// M with some of its columns times c.
#[inline(always)]
fn columns_times<L: Lanes>(m: &Mat3<L>, columns: Range<usize>, c: L) -> Mat3<L> {
    let mut product = *m;
    for row in &mut product {
        for x in &mut row[columns.clone()] {
            *x = *x * c;
        }
    }
    product
}

/// A + B c.
#[inline(always)]
pub(super) fn plus<L: Lanes>(a: &Mat3<L>, b: &Mat3<L>, c: L) -> Mat3<L> {
    let mut sum = *a;
    for i in 0..3 {
        for j in 0..3 {
            sum[i][j] = b[i][j].times_plus(c, sum[i][j]);
        }
    }
    sum
}
