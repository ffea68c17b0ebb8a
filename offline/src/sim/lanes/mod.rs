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

use super::dual::Dual;
use super::real::{Arithmetic, Float, Real};
use super::tensor::{Mat3, Vec3, cross};

/// Most lanes of any register.
pub const MOST_LANES: usize = 16;

/// A set of instructions: which registers it has.
pub trait Instructions: 'static {
    /// Registers of single precision.
    type Single: Lanes<Scalar = f32>;
    /// Registers of double precision.
    type Double: Lanes<Scalar = f64>;
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
    fn transpose(rows: &mut [Self; MOST_LANES]);

    /// A register from its lanes.
    #[inline(always)]
    fn from_lanes(mut lane: impl FnMut(usize) -> Self::Scalar) -> Self {
        let mut lanes = [Self::Scalar::zero(); MOST_LANES];
        for (l, value) in lanes.iter_mut().enumerate().take(Self::COUNT) {
            *value = lane(l);
        }
        Self::load(&lanes)
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
    /// The number from its channels.
    fn from_channels(channel: impl FnMut(usize) -> C) -> Self;
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
    fn from_channels(mut channel: impl FnMut(usize) -> C) -> Self {
        let value = channel(0);
        let mut number = Self {
            value,
            tangent: [value; N],
        };
        for k in 0..N {
            number.tangent[k] = channel(k + 1);
        }
        number
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
            fn from_channels(mut channel: impl FnMut(usize) -> $t) -> $t {
                channel(0)
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
    type Plain<I: Instructions>: Lanes<Scalar = Self::Base>;
    /// The number with a register in place of each of its channels.
    type Wide<I: Instructions>: Arithmetic + Channels<Self::Plain<I>>;
}

impl Laned for f32 {
    type Plain<I: Instructions> = I::Single;
    type Wide<I: Instructions> = I::Single;
}

impl Laned for f64 {
    type Plain<I: Instructions> = I::Double;
    type Wide<I: Instructions> = I::Double;
}

impl<const N: usize> Laned for Dual<f32, N> {
    type Plain<I: Instructions> = I::Single;
    type Wide<I: Instructions> = Dual<I::Single, N>;
}

impl<const N: usize> Laned for Dual<f64, N> {
    type Plain<I: Instructions> = I::Double;
    type Wide<I: Instructions> = Dual<I::Double, N>;
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
    let j = inner(f[0], cofactors[0]);
    let column = |b: usize| [f[0][b], f[1][b], f[2][b]];
    let columns = [column(0), column(1), column(2)];
    let c = |a: usize, b: usize| inner(columns[a], columns[b]);
    let (c00, c11, c22, c01, c02, c12) = (c(0, 0), c(1, 1), c(2, 2), c(0, 1), c(0, 2), c(1, 2));
    let trace = c00 + c11 + c22;
    let square = inner(cofactors[0], cofactors[0])
        + inner(cofactors[1], cofactors[1])
        + inner(cofactors[2], cofactors[2]);
    let two_j = j + j;
    let mut x = trace.scale(3.0).sqrt();
    for _ in 0..MAX_ROUNDS {
        let t = x.times_plus(x, -trace);
        let value = (t * t).times_plus(T::of(0.25), -two_j.times_plus(x, square));
        let change = value / t.times_plus(x, -two_j);
        let falls = change.exceeds(T::of(tolerance));
        x = T::select(falls, x - change, x);
        if T::everywhere(T::of(tolerance).exceeds(change)) {
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
            inner(row, [c00, c01, c02]),
            inner(row, [c01, c11, c12]),
            inner(row, [c02, c12, c22]),
        ];
        for b in 0..3 {
            let sum = of_f.times_plus(row[b], of_cofactors * cofactors[a][b]);
            r[a][b] = (-inverse).times_plus(fc[b], sum);
        }
    }
    r
}

/// a · b, fused.
#[inline(always)]
fn inner<T: Arithmetic>(a: Vec3<T>, b: Vec3<T>) -> T {
    a[2].times_plus(b[2], a[1].times_plus(b[1], a[0] * b[0]))
}
