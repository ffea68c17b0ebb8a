//! Registers for any processor: four lanes of single or two of double precision.

use super::{Instructions, Lanes, polar_by_invariants, single_channel};
use crate::sim::blocks::{Blocks, Part, Stepped, Stop};
use crate::sim::real::Arithmetic;
use crate::sim::tensor::Mat3;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

/// What every processor has.
pub struct Portable;

impl Instructions for Portable {
    type Single = Single;
    type Double = Double;
}

macro_rules! register {
    ($name:ident, $inner:ty, $scalar:ty, $count:literal, $tolerance:expr) => {
        /// A register.
        #[derive(Clone, Copy, Debug)]
        pub struct $name($inner);

        single_channel!($name);

        impl Lanes for $name {
            type Scalar = $scalar;
            const COUNT: usize = $count;

            #[inline(always)]
            fn splat(value: $scalar) -> Self {
                Self(<$inner>::splat(value))
            }
            #[inline(always)]
            fn load(from: &[$scalar]) -> Self {
                let lanes: [$scalar; $count] = std::array::from_fn(|l| from[l]);
                Self(<$inner>::from(lanes))
            }
            #[inline(always)]
            fn store(self, to: &mut [$scalar]) {
                to[..$count].copy_from_slice(&self.0.to_array());
            }
            #[inline(always)]
            fn transpose(rows: &mut [Self]) {
                let columns = <$inner>::transpose(std::array::from_fn(|l| rows[l].0));
                for l in 0..$count {
                    rows[l] = Self(columns[l]);
                }
            }
        }

        impl Stepped for $name {
            fn step(blocks: &mut Blocks<Self>, part: &Part<Self>) -> Result<(), Stop> {
                blocks.step(part)
            }
        }

        impl Arithmetic for $name {
            type Mask = $inner;

            #[inline(always)]
            fn of(value: f64) -> Self {
                Self::splat(value as $scalar)
            }
            #[inline(always)]
            fn scale(self, c: f64) -> Self {
                self * Self::of(c)
            }
            #[inline(always)]
            fn times_plus(self, b: Self, c: Self) -> Self {
                Self(self.0.mul_add(b.0, c.0))
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                Self(self.0.sqrt())
            }
            #[inline(always)]
            fn exceeds(self, bound: Self) -> $inner {
                self.0.simd_gt(bound.0)
            }
            #[inline(always)]
            fn select(mask: $inner, yes: Self, no: Self) -> Self {
                Self(mask.select(yes.0, no.0))
            }
            #[inline(always)]
            fn everywhere(mask: $inner) -> bool {
                mask.all()
            }
            #[inline(always)]
            fn polar_rotation(f: &Mat3<Self>) -> Mat3<Self> {
                polar_by_invariants(f, $tolerance)
            }
        }

        portable_operator!($name, Add, add);
        portable_operator!($name, Sub, sub);
        portable_operator!($name, Mul, mul);
        portable_operator!($name, Div, div);

        impl Neg for $name {
            type Output = Self;
            #[inline(always)]
            fn neg(self) -> Self {
                Self(-self.0)
            }
        }
        impl AddAssign for $name {
            #[inline(always)]
            fn add_assign(&mut self, b: Self) {
                *self = *self + b;
            }
        }
        impl SubAssign for $name {
            #[inline(always)]
            fn sub_assign(&mut self, b: Self) {
                *self = *self - b;
            }
        }
    };
}

macro_rules! portable_operator {
    ($name:ident, $trait:ident, $method:ident) => {
        impl $trait for $name {
            type Output = Self;
            #[inline(always)]
            fn $method(self, b: Self) -> Self {
                Self($trait::$method(self.0, b.0))
            }
        }
    };
}

register!(Single, wide::f32x4, f32, 4, 3e-4);
register!(Double, wide::f64x2, f64, 2, 1e-8);
