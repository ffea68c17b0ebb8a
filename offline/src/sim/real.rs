//! The number type of the simulator: `f32` and `f64` for rollouts, [`super::Dual`] for sensitivities.

use super::tensor::{Mat3, transpose_inverse};
use std::fmt::Debug;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

/// What the physics of one particle or node computes with: a number, a number with tangents, or a
/// register of such numbers, one per lane, for as many particles or nodes at once.
pub trait Arithmetic:
    Copy
    + Debug
    + Send
    + Sync
    + 'static
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
    + SubAssign
{
    /// Yes or no, per lane.
    type Mask: Copy;

    /// A constant.
    fn of(value: f64) -> Self;
    /// Product with a constant; cheaper than `self * Self::of(c)` for dual numbers.
    fn scale(self, c: f64) -> Self;
    /// self b + c; in registers rounded once where the processor can.
    fn times_plus(self, b: Self, c: Self) -> Self;
    /// Square root of a positive number.
    fn sqrt(self) -> Self;
    /// Where the value is larger than that of `bound`; never for NaN.
    fn exceeds(self, bound: Self) -> Self::Mask;
    /// `yes` where the mask holds, otherwise `no`, each with its derivatives.
    fn select(mask: Self::Mask, yes: Self, no: Self) -> Self;
    /// Whether the mask holds in every lane.
    fn everywhere(mask: Self::Mask) -> bool;
    /// Rotation R of the polar decomposition of a matrix with positive determinant.
    fn polar_rotation(f: &Mat3<Self>) -> Mat3<Self>;

    /// Adds self b to a sum, and keeps in `lost` what rounding leaves out of it, for the next time (Kahan 1965): many
    /// steps, each smaller than the last digit of the sum, are not lost.
    #[inline(always)]
    fn carry_to(self, b: Self, sum: &mut Self, lost: &mut Self) {
        let step = self.times_plus(b, *lost);
        let next = *sum + step;
        *lost = step - (next - *sum);
        *sum = next;
    }
    /// Zero.
    #[inline(always)]
    fn zero() -> Self {
        Self::of(0.0)
    }
    /// One.
    #[inline(always)]
    fn one() -> Self {
        Self::of(1.0)
    }
}

/// `f32` or `f64`.
pub trait Float: Real + PartialOrd {
    /// Distance from one to the next number.
    const EPSILON: f64;
}
impl Float for f32 {
    const EPSILON: f64 = f32::EPSILON as f64;
}
impl Float for f64 {
    const EPSILON: f64 = f64::EPSILON;
}

/// One real number with the operations that laws need.
pub trait Real: Arithmetic {
    /// The number type without derivatives, for constants such as weights.
    type Base: Float;
    /// A vector of three numbers as a node holds it. Plain numbers fill a vector register, with an
    /// idle fourth lane; measured, a step is then a third faster than on three numbers one by one.
    type Packed: Copy
        + Debug
        + Send
        + Sync
        + 'static
        + Add<Output = Self::Packed>
        + Sub<Output = Self::Packed>
        + AddAssign;

    /// Packs a vector.
    fn pack(v: [Self; 3]) -> Self::Packed;
    /// Unpacks a vector.
    fn unpack(v: Self::Packed) -> [Self; 3];
    /// Product of a packed vector with a constant.
    fn packed_times(v: Self::Packed, c: Self::Base) -> Self::Packed;
    /// A constant of the base type.
    fn base(value: f64) -> Self::Base;
    /// Product with a constant of the base type.
    fn times(self, c: Self::Base) -> Self;
    /// The value without its derivatives.
    fn value(self) -> f64;
    /// Exponential function.
    fn exp(self) -> Self;
    /// Sine and cosine.
    fn sin_cos(self) -> (Self, Self);

    /// Number of derivatives that a number carries.
    const TANGENTS: usize = 0;
    /// Derivative number `index`.
    fn tangent(self, _index: usize) -> f64 {
        0.0
    }
    /// A number from its value and its derivatives.
    fn with_tangents(value: f64, _tangent: impl Fn(usize) -> f64) -> Self {
        Self::of(value)
    }
}

/// Three numbers side by side: the packed vector of number types that have no vector register.
#[derive(Clone, Copy, Debug)]
pub struct Triple<T>(pub(super) [T; 3]);

impl<T: Real> Add for Triple<T> {
    type Output = Self;
    #[inline(always)]
    fn add(self, b: Self) -> Self {
        Self([self.0[0] + b.0[0], self.0[1] + b.0[1], self.0[2] + b.0[2]])
    }
}

impl<T: Real> Sub for Triple<T> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, b: Self) -> Self {
        Self([self.0[0] - b.0[0], self.0[1] - b.0[1], self.0[2] - b.0[2]])
    }
}

impl<T: Real> AddAssign for Triple<T> {
    #[inline(always)]
    fn add_assign(&mut self, b: Self) {
        *self = *self + b;
    }
}

/// Newton's iteration R ← (R + R⁻ᵀ)/2 from F (Higham 1986). Rope strains are small, so it converges
/// quadratically in three or four rounds; `tolerance` bounds the last change of an entry.
#[inline(always)]
fn newton_polar<T: Real>(f: &Mat3<T>, tolerance: f64) -> Mat3<T> {
    const MAX_ROUNDS: usize = 32;
    let mut r = *f;
    for _ in 0..MAX_ROUNDS {
        let inverse = transpose_inverse(&r);
        let mut change = 0f64;
        for a in 0..3 {
            for b in 0..3 {
                let next = (r[a][b] + inverse[a][b]).scale(0.5);
                change = change.max((next - r[a][b]).value().abs());
                r[a][b] = next;
            }
        }
        // The error after this round is of the order of the square of the change.
        if change < tolerance {
            break;
        }
    }
    r
}

macro_rules! float {
    ($t:ty, $packed:ty, $tolerance:expr) => {
        impl Arithmetic for $t {
            type Mask = bool;

            #[inline(always)]
            fn of(value: f64) -> Self {
                value as $t
            }
            #[inline(always)]
            fn scale(self, c: f64) -> Self {
                self * c as $t
            }
            #[inline(always)]
            fn times_plus(self, b: Self, c: Self) -> Self {
                self * b + c
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                self.sqrt()
            }
            #[inline(always)]
            fn exceeds(self, bound: Self) -> bool {
                self > bound
            }
            #[inline(always)]
            fn select(mask: bool, yes: Self, no: Self) -> Self {
                if mask { yes } else { no }
            }
            #[inline(always)]
            fn everywhere(mask: bool) -> bool {
                mask
            }
            #[inline(always)]
            fn polar_rotation(f: &Mat3<Self>) -> Mat3<Self> {
                newton_polar(f, $tolerance)
            }
        }

        impl Real for $t {
            type Base = $t;
            type Packed = $packed;

            #[inline(always)]
            fn pack(v: [Self; 3]) -> $packed {
                <$packed>::new([v[0], v[1], v[2], 0.0])
            }
            #[inline(always)]
            fn unpack(v: $packed) -> [Self; 3] {
                let [x, y, z, _] = v.to_array();
                [x, y, z]
            }
            #[inline(always)]
            fn packed_times(v: $packed, c: $t) -> $packed {
                v * <$packed>::splat(c)
            }

            #[inline(always)]
            fn base(value: f64) -> $t {
                value as $t
            }
            #[inline(always)]
            fn times(self, c: $t) -> Self {
                self * c
            }
            #[inline(always)]
            fn value(self) -> f64 {
                self as f64
            }
            #[inline(always)]
            fn exp(self) -> Self {
                self.exp()
            }
            #[inline(always)]
            fn sin_cos(self) -> (Self, Self) {
                self.sin_cos()
            }
        }
    };
}

float!(f32, wide::f32x4, 1e-4);
float!(f64, wide::f64x4, 1e-8);
