//! Registers of numbers, one per lane, for AVX-512, AVX2 and any other processor; and the choice among
//! them at run time.
//!
//! A kept crate gives these types too ([`wide`], which the portable ones come from), but chooses the
//! instructions when it is compiled; the shipped program has to choose when it runs.

mod portable;
#[cfg(target_arch = "x86_64")]
mod x86;

pub use portable::Portable;
#[cfg(target_arch = "x86_64")]
pub use x86::{Avx2, Avx512};

use super::blocks::Stepped;
use super::dual::Dual;
use super::elastic::fused_dot;
use super::real::{Arithmetic, Float, Real};
use super::tensor::{Mat3, cross};

/// Most lanes of any register.
pub const MOST_LANES: usize = 16;

/// A set of instructions: which registers it has.
pub trait Instructions: 'static {
    /// Registers of single precision.
    type Single: Stepped<Scalar = f32>;
    /// Registers of double precision.
    type Double: Stepped<Scalar = f64>;
}

/// A register.
pub trait Lanes: Arithmetic + Channels<Self> {
    /// What is in a lane.
    type Scalar: Float;
    /// Number of lanes, at most [`MOST_LANES`].
    const COUNT: usize;

    /// The same number in every lane.
    fn splat(value: Self::Scalar) -> Self;
    /// The first numbers of a slice that is at least as long as a register.
    fn load(from: &[Self::Scalar]) -> Self;
    /// Writes the lanes to the start of a slice that is at least as long.
    fn store(self, to: &mut [Self::Scalar]);
    /// Turns the first [`Self::COUNT`] registers, as rows of a matrix, into its columns.
    fn transpose(rows: &mut [Self]);

    /// A register from its lanes.
    #[inline(always)]
    fn from_lanes(mut lane: impl FnMut(usize) -> Self::Scalar) -> Self {
        let mut lanes = [Self::Scalar::zero(); MOST_LANES];
        for (l, value) in lanes.iter_mut().enumerate().take(Self::COUNT) {
            *value = lane(l);
        }
        Self::load(&lanes)
    }

    /// One lane, read from memory: needs no instruction of the registers, so it is cheap also where code was
    /// not compiled for them.
    #[inline(always)]
    fn lane(&self, index: usize) -> Self::Scalar {
        const { assert!(size_of::<Self>() == Self::COUNT * size_of::<Self::Scalar>()) };
        assert!(index < Self::COUNT);
        // SAFETY: a register lies in memory as its lanes one after the other and nothing else (the size is
        // checked above), every bit pattern is a number, and the index is one of a lane.
        unsafe { *std::ptr::from_ref(self).cast::<Self::Scalar>().add(index) }
    }

    /// Writes one lane, to memory.
    #[inline(always)]
    fn set_lane(&mut self, index: usize, value: Self::Scalar) {
        const { assert!(size_of::<Self>() == Self::COUNT * size_of::<Self::Scalar>()) };
        assert!(index < Self::COUNT);
        // SAFETY: as in [`Self::lane`].
        unsafe { *std::ptr::from_mut(self).cast::<Self::Scalar>().add(index) = value }
    }

    /// The lanes; those beyond [`Self::COUNT`] are zero.
    #[inline(always)]
    fn to_lanes(self) -> [Self::Scalar; MOST_LANES] {
        let mut lanes = [Self::Scalar::zero(); MOST_LANES];
        self.store(&mut lanes);
        lanes
    }
}

/// A number seen as its value, channel 0, and its derivatives, one channel each. What is linear with
/// constant coefficients, above all the transfer between particles and nodes, acts on every channel
/// alone.
pub trait Channels<C> {
    /// Number of channels.
    const CHANNELS: usize;
    /// One channel.
    fn channel(&self, index: usize) -> C;
    /// Sets one channel.
    fn set_channel(&mut self, index: usize, value: C);

    /// The number from its channels.
    #[inline(always)]
    fn from_channels(mut channel: impl FnMut(usize) -> C) -> Self
    where
        Self: Arithmetic,
    {
        let mut number = Self::zero();
        for k in 0..Self::CHANNELS {
            number.set_channel(k, channel(k));
        }
        number
    }
}

impl<C: Arithmetic, const N: usize> Channels<C> for Dual<C, N> {
    const CHANNELS: usize = N + 1;

    #[inline(always)]
    fn channel(&self, index: usize) -> C {
        if index == 0 {
            self.value
        } else {
            self.tangent[index - 1]
        }
    }
    #[inline(always)]
    fn set_channel(&mut self, index: usize, value: C) {
        if index == 0 {
            self.value = value;
        } else {
            self.tangent[index - 1] = value;
        }
    }
}

/// The only channel of a number without derivatives is itself.
macro_rules! single_channel {
    ($t:ty) => {
        impl $crate::sim::lanes::Channels<$t> for $t {
            const CHANNELS: usize = 1;

            #[inline(always)]
            fn channel(&self, _: usize) -> $t {
                *self
            }
            #[inline(always)]
            fn set_channel(&mut self, _: usize, value: $t) {
                *self = value;
            }
        }
    };
}
use single_channel;
single_channel!(f32);
single_channel!(f64);

/// A number whose rollouts run many particles at once: `f32`, `f64` and their dual numbers.
pub trait Laned: Real + Channels<<Self as Real>::Base> {
    /// Registers of the number without its derivatives.
    type Plain<I: Instructions>: Stepped<Scalar = Self::Base>;
    /// The number with a register in place of each of its channels.
    type Wide<I: Instructions>: Arithmetic + Channels<Self::Plain<I>>;
    /// The same number in double precision, which a search for a rope at rest takes.
    type Double: Laned;
}

impl Laned for f32 {
    type Plain<I: Instructions> = I::Single;
    type Wide<I: Instructions> = I::Single;
    type Double = f64;
}

impl Laned for f64 {
    type Plain<I: Instructions> = I::Double;
    type Wide<I: Instructions> = I::Double;
    type Double = f64;
}

impl<const N: usize> Laned for Dual<f32, N> {
    type Plain<I: Instructions> = I::Single;
    type Wide<I: Instructions> = Dual<I::Single, N>;
    type Double = Dual<f64, N>;
}

impl<const N: usize> Laned for Dual<f64, N> {
    type Plain<I: Instructions> = I::Double;
    type Wide<I: Instructions> = Dual<I::Double, N>;
    type Double = Dual<f64, N>;
}

/// Polar decomposition without a matrix iteration (Hoger and Carlson 1984; Franca 1989). With C = Fᵀ F
/// and the invariants I, II, J of U = C^½, the first is the largest root of
/// (x² − tr C)²/4 − 2 J x − |cof F|² = 0; from above, Newton's iteration falls onto it. Then
/// R = ((I² − II) F + I cof F − F C) / (I II − J), by the theorem of Cayley and Hamilton.
///
/// A lane stops when it has converged, so its bits do not depend on its neighbours.
#[inline(always)]
fn polar_by_invariants<T: Arithmetic>(f: &Mat3<T>, tolerance: f64) -> Mat3<T> {
    const MAX_ROUNDS: usize = 40;
    let cofactors = [cross(f[1], f[2]), cross(f[2], f[0]), cross(f[0], f[1])];
    let j = fused_dot(f[0], cofactors[0]);
    let c0 = [f[0][0], f[1][0], f[2][0]];
    let c1 = [f[0][1], f[1][1], f[2][1]];
    let c2 = [f[0][2], f[1][2], f[2][2]];
    let (c00, c11, c22) = (fused_dot(c0, c0), fused_dot(c1, c1), fused_dot(c2, c2));
    let (c01, c02, c12) = (fused_dot(c0, c1), fused_dot(c0, c2), fused_dot(c1, c2));
    let trace = c00 + c11 + c22;
    let square = fused_dot(cofactors[0], cofactors[0])
        + fused_dot(cofactors[1], cofactors[1])
        + fused_dot(cofactors[2], cofactors[2]);
    let two_j = j + j;
    let mut x = trace.scale(3.0).sqrt();
    let mut unfinished = T::one();
    for _ in 0..MAX_ROUNDS {
        let t = x.times_plus(x, -trace);
        let value = (t * t).times_plus(T::of(0.25), -two_j.times_plus(x, square));
        let change = unfinished * value / t.times_plus(x, -two_j);
        x -= change;
        // The error after this round is of the order of the square of the change.
        let more = change.exceeds(T::of(tolerance));
        unfinished = T::select(more, unfinished, T::zero());
        if T::everywhere(T::one().exceeds(unfinished)) {
            break;
        }
    }
    let second = x.times_plus(x, -trace).scale(0.5);
    let inverse = T::one() / x.times_plus(second, -j);
    let of_f = x.times_plus(x, -second) * inverse;
    let of_cofactors = x * inverse;
    let mut r = *f;
    for a in 0..3 {
        let row = f[a];
        let fc = [
            fused_dot(row, [c00, c01, c02]),
            fused_dot(row, [c01, c11, c12]),
            fused_dot(row, [c02, c12, c22]),
        ];
        for b in 0..3 {
            let sum = of_f.times_plus(row[b], of_cofactors * cofactors[a][b]);
            r[a][b] = (-inverse).times_plus(fc[b], sum);
        }
    }
    r
}

/// One channel of a number, in every lane.
#[inline(always)]
pub fn channel<T: Laned, I: Instructions>(number: T, k: usize) -> T::Plain<I> {
    T::Plain::<I>::splat(number.channel(k))
}

/// All channels of a number, each in every lane of a register.
pub fn channels<T: Laned, I: Instructions>(number: T) -> Vec<T::Plain<I>> {
    (0..T::CHANNELS).map(|k| channel::<T, I>(number, k)).collect()
}
