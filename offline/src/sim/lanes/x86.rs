//! Registers of AVX2 with fused multiply-add, and of AVX-512.
//!
//! Safety: a value of these types exists only inside a rollout that was started after the processor
//! had been asked for the instructions ([`crate::sim::rollout::simulate`]); every method relies on that.

use super::{Instructions, Lanes, polar_by_invariants, single_channel};
use crate::sim::blocks::{Blocks, Part, Stepped, Stop};
use crate::sim::real::Arithmetic;
use crate::sim::tensor::Mat3;
use std::arch::x86_64::*;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

/// AVX2 with fused multiply-add.
pub struct Avx2;

impl Instructions for Avx2 {
    type Single = Single8;
    type Double = Double4;
}

/// AVX-512.
pub struct Avx512;

impl Instructions for Avx512 {
    type Single = Single16;
    type Double = Double8;
}

macro_rules! register {
    (
        $name:ident($inner:ty) of $count:literal $scalar:ty, mask $mask:ty, features $features:literal, tolerance $tolerance:expr,
        $add:ident $sub:ident $mul:ident $div:ident $sqrt:ident $fma:ident
        $splat:ident $zero:ident $load:ident $store:ident,
        ($a:ident, $b:ident) => $exceeds:expr,
        ($chosen:ident, $yes:ident, $no:ident) => $select:expr,
        ($whole:ident) => $everywhere:expr,
        $transpose:ident
    ) => {
        /// A register.
        #[derive(Clone, Copy, Debug)]
        pub struct $name($inner);

        single_channel!($name);

        impl Lanes for $name {
            type Scalar = $scalar;
            const COUNT: usize = $count;

            #[inline(always)]
            fn splat(value: $scalar) -> Self {
                // SAFETY: see the head of this file.
                Self(unsafe { $splat(value) })
            }
            #[inline(always)]
            fn load(from: &[$scalar]) -> Self {
                let lanes = &from[..$count];
                // SAFETY: see the head of this file; the slice holds as many numbers as are read.
                Self(unsafe { $load(lanes.as_ptr()) })
            }
            #[inline(always)]
            fn store(self, to: &mut [$scalar]) {
                let lanes = &mut to[..$count];
                // SAFETY: see the head of this file; the slice holds as many numbers as are written.
                unsafe { $store(lanes.as_mut_ptr(), self.0) }
            }
            #[inline(always)]
            fn transpose(rows: &mut [Self]) {
                // SAFETY: see the head of this file.
                unsafe { $transpose(rows) }
            }
        }

        impl Stepped for $name {
            fn step(blocks: &mut Blocks<Self>, part: &Part<Self>) -> Result<(), Stop> {
                #[target_feature(enable = $features)]
                unsafe fn compiled(blocks: &mut Blocks<$name>, part: &Part<$name>) -> Result<(), Stop> {
                    blocks.step(part)
                }
                // SAFETY: see the head of this file.
                unsafe { compiled(blocks, part) }
            }
        }

        impl Arithmetic for $name {
            type Mask = $mask;

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
                // SAFETY: see the head of this file.
                Self(unsafe { $fma(self.0, b.0, c.0) })
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                // SAFETY: see the head of this file.
                Self(unsafe { $sqrt(self.0) })
            }
            #[inline(always)]
            fn exceeds(self, bound: Self) -> $mask {
                let ($a, $b) = (self.0, bound.0);
                // SAFETY: see the head of this file.
                unsafe { $exceeds }
            }
            #[inline(always)]
            fn select(mask: $mask, yes: Self, no: Self) -> Self {
                let ($chosen, $yes, $no) = (mask, yes.0, no.0);
                // SAFETY: see the head of this file.
                Self(unsafe { $select })
            }
            #[inline(always)]
            #[allow(unused_unsafe)]
            fn everywhere(mask: $mask) -> bool {
                let $whole = mask;
                // SAFETY: see the head of this file.
                unsafe { $everywhere }
            }
            #[inline(always)]
            fn polar_rotation(f: &Mat3<Self>) -> Mat3<Self> {
                polar_by_invariants(f, $tolerance)
            }
        }

        operator!($name, Add, add, $add);
        operator!($name, Sub, sub, $sub);
        operator!($name, Mul, mul, $mul);
        operator!($name, Div, div, $div);

        impl Neg for $name {
            type Output = Self;
            #[inline(always)]
            fn neg(self) -> Self {
                // SAFETY: see the head of this file.
                Self(unsafe { $sub($zero(), self.0) })
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

macro_rules! operator {
    ($name:ident, $trait:ident, $method:ident, $intrinsic:ident) => {
        impl $trait for $name {
            type Output = Self;
            #[inline(always)]
            fn $method(self, b: Self) -> Self {
                // SAFETY: see the head of this file.
                Self(unsafe { $intrinsic(self.0, b.0) })
            }
        }
    };
}

register!(
    Single8(__m256) of 8 f32, mask __m256, features "avx2,fma", tolerance 3e-4,
    _mm256_add_ps _mm256_sub_ps _mm256_mul_ps _mm256_div_ps _mm256_sqrt_ps _mm256_fmadd_ps
    _mm256_set1_ps _mm256_setzero_ps _mm256_loadu_ps _mm256_storeu_ps,
    (a, b) => _mm256_cmp_ps::<_CMP_GT_OQ>(a, b),
    (mask, yes, no) => _mm256_blendv_ps(no, yes, mask),
    (of) => _mm256_movemask_ps(of) == 0xff,
    transpose_single8
);
register!(
    Double4(__m256d) of 4 f64, mask __m256d, features "avx2,fma", tolerance 1e-8,
    _mm256_add_pd _mm256_sub_pd _mm256_mul_pd _mm256_div_pd _mm256_sqrt_pd _mm256_fmadd_pd
    _mm256_set1_pd _mm256_setzero_pd _mm256_loadu_pd _mm256_storeu_pd,
    (a, b) => _mm256_cmp_pd::<_CMP_GT_OQ>(a, b),
    (mask, yes, no) => _mm256_blendv_pd(no, yes, mask),
    (of) => _mm256_movemask_pd(of) == 0xf,
    transpose_double4
);
register!(
    Single16(__m512) of 16 f32, mask __mmask16, features "avx512f", tolerance 3e-4,
    _mm512_add_ps _mm512_sub_ps _mm512_mul_ps _mm512_div_ps _mm512_sqrt_ps _mm512_fmadd_ps
    _mm512_set1_ps _mm512_setzero_ps _mm512_loadu_ps _mm512_storeu_ps,
    (a, b) => _mm512_cmp_ps_mask::<_CMP_GT_OQ>(a, b),
    (mask, yes, no) => _mm512_mask_blend_ps(mask, no, yes),
    (of) => of == 0xffff,
    transpose_single16
);
register!(
    Double8(__m512d) of 8 f64, mask __mmask8, features "avx512f", tolerance 1e-8,
    _mm512_add_pd _mm512_sub_pd _mm512_mul_pd _mm512_div_pd _mm512_sqrt_pd _mm512_fmadd_pd
    _mm512_set1_pd _mm512_setzero_pd _mm512_loadu_pd _mm512_storeu_pd,
    (a, b) => _mm512_cmp_pd_mask::<_CMP_GT_OQ>(a, b),
    (mask, yes, no) => _mm512_mask_blend_pd(mask, no, yes),
    (of) => of == 0xff,
    transpose_double8
);

// Transposes exchange ever larger halves: neighbours first, then quarters of a register.

#[inline(always)]
unsafe fn transpose_double4(rows: &mut [Double4]) {
    let rows = &mut rows[..Double4::COUNT];
    // SAFETY: see the head of this file.
    unsafe {
        let (a, b) = (rows[0].0, rows[1].0);
        let (c, d) = (rows[2].0, rows[3].0);
        let (ab, ab_high) = (_mm256_unpacklo_pd(a, b), _mm256_unpackhi_pd(a, b));
        let (cd, cd_high) = (_mm256_unpacklo_pd(c, d), _mm256_unpackhi_pd(c, d));
        rows[0].0 = _mm256_permute2f128_pd::<0x20>(ab, cd);
        rows[1].0 = _mm256_permute2f128_pd::<0x20>(ab_high, cd_high);
        rows[2].0 = _mm256_permute2f128_pd::<0x31>(ab, cd);
        rows[3].0 = _mm256_permute2f128_pd::<0x31>(ab_high, cd_high);
    }
}

#[inline(always)]
unsafe fn transpose_single8(rows: &mut [Single8]) {
    let rows = &mut rows[..Single8::COUNT];
    // SAFETY: see the head of this file.
    unsafe {
        for first in [0, 4] {
            let (a, b) = (rows[first].0, rows[first + 1].0);
            let (c, d) = (rows[first + 2].0, rows[first + 3].0);
            let (ab, ab_high) = (_mm256_unpacklo_ps(a, b), _mm256_unpackhi_ps(a, b));
            let (cd, cd_high) = (_mm256_unpacklo_ps(c, d), _mm256_unpackhi_ps(c, d));
            rows[first].0 = _mm256_shuffle_ps::<0x44>(ab, cd);
            rows[first + 1].0 = _mm256_shuffle_ps::<0xee>(ab, cd);
            rows[first + 2].0 = _mm256_shuffle_ps::<0x44>(ab_high, cd_high);
            rows[first + 3].0 = _mm256_shuffle_ps::<0xee>(ab_high, cd_high);
        }
        for k in 0..4 {
            let (a, b) = (rows[k].0, rows[k + 4].0);
            rows[k].0 = _mm256_permute2f128_ps::<0x20>(a, b);
            rows[k + 4].0 = _mm256_permute2f128_ps::<0x31>(a, b);
        }
    }
}

#[inline(always)]
unsafe fn transpose_double8(rows: &mut [Double8]) {
    let rows = &mut rows[..Double8::COUNT];
    // SAFETY: see the head of this file.
    unsafe {
        for k in [0, 2, 4, 6] {
            let (a, b) = (rows[k].0, rows[k + 1].0);
            rows[k].0 = _mm512_unpacklo_pd(a, b);
            rows[k + 1].0 = _mm512_unpackhi_pd(a, b);
        }
        for (low, apart) in [(0, 2), (1, 2), (4, 2), (5, 2)] {
            let (a, b) = (rows[low].0, rows[low + apart].0);
            rows[low].0 = _mm512_shuffle_f64x2::<0x88>(a, b);
            rows[low + apart].0 = _mm512_shuffle_f64x2::<0xdd>(a, b);
        }
        // Registers 0 and 1 hold columns 0, 4 and 1, 5; registers 2 and 3 hold 2, 6 and 3, 7.
        for k in 0..4 {
            let (a, b) = (rows[k].0, rows[k + 4].0);
            rows[k].0 = _mm512_shuffle_f64x2::<0x88>(a, b);
            rows[k + 4].0 = _mm512_shuffle_f64x2::<0xdd>(a, b);
        }
    }
}

#[inline(always)]
unsafe fn transpose_single16(rows: &mut [Single16]) {
    let rows = &mut rows[..Single16::COUNT];
    // SAFETY: see the head of this file.
    unsafe {
        for first in [0, 4, 8, 12] {
            let (a, b) = (rows[first].0, rows[first + 1].0);
            let (c, d) = (rows[first + 2].0, rows[first + 3].0);
            let (ab, ab_high) = (_mm512_unpacklo_ps(a, b), _mm512_unpackhi_ps(a, b));
            let (cd, cd_high) = (_mm512_unpacklo_ps(c, d), _mm512_unpackhi_ps(c, d));
            rows[first].0 = _mm512_shuffle_ps::<0x44>(ab, cd);
            rows[first + 1].0 = _mm512_shuffle_ps::<0xee>(ab, cd);
            rows[first + 2].0 = _mm512_shuffle_ps::<0x44>(ab_high, cd_high);
            rows[first + 3].0 = _mm512_shuffle_ps::<0xee>(ab_high, cd_high);
        }
        // Register k of a group of four holds the quarters of columns k, k + 4, k + 8, k + 12.
        for k in 0..4 {
            let (a, b) = (rows[k].0, rows[k + 4].0);
            let (c, d) = (rows[k + 8].0, rows[k + 12].0);
            let (ab, ab_high) = (
                _mm512_shuffle_f32x4::<0x44>(a, b),
                _mm512_shuffle_f32x4::<0xee>(a, b),
            );
            let (cd, cd_high) = (
                _mm512_shuffle_f32x4::<0x44>(c, d),
                _mm512_shuffle_f32x4::<0xee>(c, d),
            );
            rows[k].0 = _mm512_shuffle_f32x4::<0x88>(ab, cd);
            rows[k + 4].0 = _mm512_shuffle_f32x4::<0xdd>(ab, cd);
            rows[k + 8].0 = _mm512_shuffle_f32x4::<0x88>(ab_high, cd_high);
            rows[k + 12].0 = _mm512_shuffle_f32x4::<0xdd>(ab_high, cd_high);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::lanes::MOST_LANES;

    fn transposes<L: Lanes>() {
        let entry = |row: usize, column: usize| L::Scalar::of((100 * row + column) as f64);
        let mut rows = [L::zero(); MOST_LANES];
        for row in 0..L::COUNT {
            rows[row] = L::from_lanes(|column| entry(row, column));
        }
        L::transpose(&mut rows);
        for row in 0..L::COUNT {
            let got = rows[row].to_lanes();
            for column in 0..L::COUNT {
                assert!(got[column] == entry(column, row), "{row} {column}");
                assert!(rows[row].lane(column) == got[column], "{row} {column}");
            }
        }
    }

    #[test]
    fn rows_become_columns() {
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            transposes::<Single8>();
            transposes::<Double4>();
        }
        if is_x86_feature_detected!("avx512f") {
            transposes::<Single16>();
            transposes::<Double8>();
        }
    }
}
