//! Plastic flow in registers. Which particles of a block may flow is told there; the few that do are taken out of
//! their lanes, because the laws know one particle, and put back.
//!
//! Letters as in [`super::material`]: A is the inverse of the stress-free shape, which flow multiplies.

use super::block_material::{Place, plus};
use super::blocks::{Blocks, Body};
use super::lanes::{Instructions, Laned, Lanes};
use super::material::Material;
use super::physics::FlowLaw;
use super::real::Real;
use super::step::StepContext;
use super::tensor::{Mat3, det, identity, matadd, matmul, matmul_transposed};

/// The stress-free shapes of a rope that may flow, by block, channel and member where nothing else is said.
pub struct Flowed<L> {
    channels: usize,
    members: usize,
    /// A.
    inverse: Vec<Mat3<L>>,
    /// 1/det A.
    volume: Vec<L>,
    /// Square of the distance of an elastic strain from which on it may flow.
    onset: L,
    /// The squares of these distances, by member of the block that was moved last.
    distances: Vec<L>,
}

/// A value and its differential.
type Pair<'a, L> = [&'a Mat3<L>; 2];

impl<L: Lanes> Flowed<L> {
    /// The shapes before the first step.
    pub fn new<T: Laned<Plain<I> = L, Base = L::Scalar>, I: Instructions>(
        laws: &[Box<dyn FlowLaw<T>>],
        material: &Material<T>,
        [blocks, members]: [usize; 2],
    ) -> Self {
        let onset = laws.iter().map(|law| law.onset()).fold(f64::INFINITY, f64::min);
        let mut flowed = Self {
            channels: T::CHANNELS,
            members,
            inverse: Vec::new(),
            volume: Vec::new(),
            onset: L::of(onset * onset),
            distances: vec![L::zero(); members],
        };
        for block in 0..blocks {
            for k in 0..T::CHANNELS {
                for member in 0..members {
                    let inverse = |lane: usize| {
                        let slice = block * L::COUNT + lane;
                        let own = material.natural_inverse(slice * members + member);
                        own.copied().unwrap_or(identity())
                    };
                    let entry = |a: usize, b: usize| L::from_lanes(|lane| inverse(lane)[a][b].channel(k));
                    flowed
                        .inverse
                        .push(std::array::from_fn(|a| std::array::from_fn(|b| entry(a, b))));
                    flowed
                        .volume
                        .push(L::from_lanes(|lane| (T::one() / det(&inverse(lane))).channel(k)));
                }
            }
        }
        flowed
    }

    #[inline(always)]
    fn at(&self, place: Place) -> usize {
        place.index(self.channels, self.members)
    }

    #[inline(always)]
    fn first(&self, place: Place) -> usize {
        self.at(place.value())
    }

    /// F A of a member.
    #[inline(always)]
    pub fn elastic(&self, place: Place, f: &Mat3<L>) -> Mat3<L> {
        matmul(f, &self.inverse[self.first(place)])
    }

    /// Its differential in a channel.
    #[inline(always)]
    pub fn change_of_elastic(&self, place: Place, [f, df]: Pair<L>) -> Mat3<L> {
        let (inverse, change) = (&self.inverse[self.first(place)], &self.inverse[self.at(place)]);
        matadd(&matmul(df, inverse), &matmul(f, change))
    }

    /// (P/det A + K) Aᵀ of a member.
    #[inline(always)]
    pub fn stress(&self, place: Place, own: &Mat3<L>, common: &Mat3<L>) -> Mat3<L> {
        let at = self.first(place);
        matmul_transposed(&plus(common, own, self.volume[at]), &self.inverse[at])
    }

    /// Its differential in a channel.
    #[inline(always)]
    pub fn change_of_stress(
        &self,
        place: Place,
        [own, change]: Pair<L>,
        [common, common_change]: Pair<L>,
    ) -> Mat3<L> {
        let (first, at) = (self.first(place), self.at(place));
        let value = plus(common, own, self.volume[first]);
        let by_volume = plus(common_change, own, self.volume[at]);
        matadd(
            &matmul_transposed(
                &plus(&by_volume, change, self.volume[first]),
                &self.inverse[first],
            ),
            &matmul_transposed(&value, &self.inverse[at]),
        )
    }

    /// Takes down how far the members of a block are strained; `bodies` are those of channel 0.
    #[inline(always)]
    pub fn measure(&mut self, block: usize, bodies: &[Body<L>]) {
        for (member, body) in bodies.iter().enumerate() {
            let place = Place {
                block,
                channel: 0,
                member,
            };
            let elastic = self.elastic(place, &body.deformation_gradient);
            let mut square = L::zero();
            for a in 0..3 {
                for b in 0..3 {
                    let mut entry = if a == b { -L::one() } else { L::zero() };
                    for row in &elastic {
                        entry = row[a].times_plus(row[b], entry);
                    }
                    square = entry.times_plus(entry, square);
                }
            }
            self.distances[member] = square;
        }
    }
}

/// Lets the particles in the first `lanes` lanes of the block that was moved last flow where they may.
pub fn flow<T: Laned, I: Instructions>(
    context: &StepContext<T>,
    block: usize,
    lanes: usize,
    blocks: &mut Blocks<T::Plain<I>>,
) {
    let Some(flowed) = blocks
        .material
        .as_mut()
        .and_then(|material| material.flowed.as_mut())
    else {
        return;
    };
    let onset = flowed.onset.lane(0);
    for member in 0..flowed.members {
        let (channels, members) = (flowed.channels, flowed.members);
        let at = |channel: usize| {
            let place = Place {
                block,
                channel,
                member,
            };
            place.index(channels, members)
        };
        let distances = flowed.distances[member];
        for lane in (0..lanes).filter(|&lane| distances.lane(lane) > onset) {
            let f = of_lane::<T, I>(lane, |k| &blocks.bodies[at(k)].deformation_gradient);
            let before = of_lane::<T, I>(lane, |k| &flowed.inverse[at(k)]);
            let Some(inverse) = relaxed(context, &f, before) else {
                continue;
            };
            let volume = T::one() / det(&inverse);
            for k in 0..T::CHANNELS {
                let registers = flowed.inverse[at(k)].iter_mut().flatten();
                for (register, number) in registers.zip(inverse.iter().flatten()) {
                    register.set_lane(lane, number.channel(k));
                }
                flowed.volume[at(k)].set_lane(lane, volume.channel(k));
            }
        }
    }
}

/// A after a particle has flowed; none where it does not.
fn relaxed<T: Real>(context: &StepContext<T>, f: &Mat3<T>, before: Mat3<T>) -> Option<Mat3<T>> {
    let mut after = None;
    for law in &context.physics.flow_laws {
        let inverse = after.unwrap_or(before);
        if let Some(relaxed) = law.relaxation(&matmul(f, &inverse)) {
            after = Some(matmul(&inverse, &relaxed));
        }
    }
    after
}

/// A matrix of one particle, with its derivatives.
fn of_lane<'a, T: Laned, I: Instructions>(
    lane: usize,
    channel: impl Fn(usize) -> &'a Mat3<T::Plain<I>>,
) -> Mat3<T> {
    std::array::from_fn(|a| std::array::from_fn(|b| T::from_channels(|k| channel(k)[a][b].lane(lane))))
}
