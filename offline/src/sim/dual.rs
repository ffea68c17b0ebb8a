//! Forward-mode differentiation: a value with N tangents that pass through every operation.

use super::real::{Arithmetic, Float, Real, Triple};
use super::tensor::{Mat3, matmul, transpose, transpose_inverse};
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

/// A value and its derivatives with respect to N inputs, in single or double precision.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dual<F, const N: usize> {
    /// Value.
    pub value: F,
    /// Derivatives.
    pub tangent: [F; N],
}

impl<F: Arithmetic, const N: usize> Dual<F, N> {
    /// The input with index `index`, whose derivative with respect to itself is one.
    pub fn input(value: f64, index: usize) -> Self {
        let mut tangent = [F::zero(); N];
        tangent[index] = F::one();
        Self {
            value: F::of(value),
            tangent,
        }
    }

    /// f(self) where `slope` is f'(self.value).
    #[inline(always)]
    fn chain(self, value: F, slope: F) -> Self {
        Self::per_lane(value, |k| slope * self.tangent[k])
    }

    #[inline(always)]
    fn per_lane(value: F, lane: impl Fn(usize) -> F) -> Self {
        let mut tangent = [F::zero(); N];
        for k in 0..N {
            tangent[k] = lane(k);
        }
        Self { value, tangent }
    }
}

impl<F: Arithmetic, const N: usize> Add for Dual<F, N> {
    type Output = Self;
    #[inline(always)]
    fn add(self, b: Self) -> Self {
        Self::per_lane(self.value + b.value, |k| self.tangent[k] + b.tangent[k])
    }
}

impl<F: Arithmetic, const N: usize> Sub for Dual<F, N> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, b: Self) -> Self {
        Self::per_lane(self.value - b.value, |k| self.tangent[k] - b.tangent[k])
    }
}

impl<F: Arithmetic, const N: usize> Mul for Dual<F, N> {
    type Output = Self;
    #[inline(always)]
    // The product rule adds.
    #[allow(clippy::suspicious_arithmetic_impl)]
    fn mul(self, b: Self) -> Self {
        Self::per_lane(self.value * b.value, |k| {
            self.tangent[k] * b.value + self.value * b.tangent[k]
        })
    }
}

impl<F: Arithmetic, const N: usize> Div for Dual<F, N> {
    type Output = Self;
    #[inline(always)]
    fn div(self, b: Self) -> Self {
        let inverse = F::one() / b.value;
        let value = self.value * inverse;
        Self::per_lane(value, |k| (self.tangent[k] - value * b.tangent[k]) * inverse)
    }
}

impl<F: Arithmetic, const N: usize> Neg for Dual<F, N> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self::per_lane(-self.value, |k| -self.tangent[k])
    }
}

impl<F: Arithmetic, const N: usize> AddAssign for Dual<F, N> {
    #[inline(always)]
    fn add_assign(&mut self, b: Self) {
        *self = *self + b;
    }
}

impl<F: Arithmetic, const N: usize> SubAssign for Dual<F, N> {
    #[inline(always)]
    fn sub_assign(&mut self, b: Self) {
        *self = *self - b;
    }
}

impl<F: Float, const N: usize> Real for Dual<F, N> {
    type Base = F;
    type Packed = Triple<Self>;

    const TANGENTS: usize = N;

    fn tangent(self, index: usize) -> f64 {
        self.tangent[index].value()
    }
    fn with_tangents(value: f64, tangent: impl Fn(usize) -> f64) -> Self {
        Self::per_lane(F::of(value), |k| F::of(tangent(k)))
    }

    #[inline(always)]
    fn pack(v: [Self; 3]) -> Triple<Self> {
        Triple(v)
    }
    #[inline(always)]
    fn unpack(v: Triple<Self>) -> [Self; 3] {
        v.0
    }
    #[inline(always)]
    fn packed_times(v: Triple<Self>, c: F) -> Triple<Self> {
        Triple([v.0[0].times(c), v.0[1].times(c), v.0[2].times(c)])
    }

    #[inline(always)]
    fn base(value: f64) -> F {
        F::of(value)
    }
    #[inline(always)]
    fn times(self, c: F) -> Self {
        self.chain(self.value * c, c)
    }
    #[inline(always)]
    fn value(self) -> f64 {
        self.value.value()
    }
    #[inline(always)]
    fn exp(self) -> Self {
        let value = self.value.exp();
        self.chain(value, value)
    }
    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        let (sin, cos) = self.value.sin_cos();
        (self.chain(sin, cos), self.chain(cos, -sin))
    }
}

impl<F: Arithmetic, const N: usize> Arithmetic for Dual<F, N> {
    type Mask = F::Mask;

    #[inline(always)]
    fn of(value: f64) -> Self {
        Self {
            value: F::of(value),
            tangent: [F::zero(); N],
        }
    }
    #[inline(always)]
    fn scale(self, c: f64) -> Self {
        let c = F::of(c);
        self.chain(self.value * c, c)
    }
    #[inline(always)]
    fn times_plus(self, b: Self, c: Self) -> Self {
        let value = self.value.times_plus(b.value, c.value);
        Self::per_lane(value, |k| {
            self.tangent[k].times_plus(b.value, self.value.times_plus(b.tangent[k], c.tangent[k]))
        })
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        let root = self.value.sqrt();
        self.chain(root, F::of(0.5) / root)
    }
    #[inline(always)]
    fn exceeds(self, bound: Self) -> F::Mask {
        self.value.exceeds(bound.value)
    }
    #[inline(always)]
    fn select(mask: F::Mask, yes: Self, no: Self) -> Self {
        Self::per_lane(F::select(mask, yes.value, no.value), |k| {
            F::select(mask, yes.tangent[k], no.tangent[k])
        })
    }
    #[inline(always)]
    fn everywhere(mask: F::Mask) -> bool {
        F::everywhere(mask)
    }

    /// The value by Newton's iteration, the derivative in closed form: dR = R Ω, Ω the cross-product matrix of ω, with
    /// (tr(S) I − S) ω = axial(Rᵀ dF − dFᵀ R), S = Rᵀ F. It is regular wherever two singular
    /// values of F do not sum to zero, F = I included, unlike the derivative of an SVD.
    #[inline(always)]
    fn polar_rotation(f: &Mat3<Self>) -> Mat3<Self> {
        let mut value = [[F::zero(); 3]; 3];
        for i in 0..3 {
            for j in 0..3 {
                value[i][j] = f[i][j].value;
            }
        }
        let r = F::polar_rotation(&value);
        let s = matmul(&transpose(&r), &value);
        let trace = s[0][0] + s[1][1] + s[2][2];
        let mut system = [[F::zero(); 3]; 3];
        for i in 0..3 {
            for j in 0..3 {
                system[i][j] = if i == j { trace - s[i][j] } else { -s[i][j] };
            }
        }
        let inverse = transpose(&transpose_inverse(&system));
        // The lanes run along the tangents: constant matrices times tangent vectors.
        let a = |i: usize, j: usize| -> Self {
            Self::per_lane(F::zero(), |k| {
                r[0][i] * f[0][j].tangent[k] + r[1][i] * f[1][j].tangent[k] + r[2][i] * f[2][j].tangent[k]
            })
        };
        let axial = [a(2, 1) - a(1, 2), a(0, 2) - a(2, 0), a(1, 0) - a(0, 1)];
        let weighted = |c: [F; 3], v: &[Self; 3], value: F| -> Self {
            Self::per_lane(value, |k| {
                c[0] * v[0].tangent[k] + c[1] * v[1].tangent[k] + c[2] * v[2].tangent[k]
            })
        };
        let w = inverse.map(|row| weighted(row, &axial, F::zero()));
        let mut out = [[Self::zero(); 3]; 3];
        for i in 0..3 {
            for j in 0..3 {
                // Column j of R Ω: R (ω × e_j) has the entries below.
                let (p, q) = ((j + 1) % 3, (j + 2) % 3);
                out[i][j] =
                    Self::per_lane(r[i][j], |k| r[i][p] * w[q].tangent[k] - r[i][q] * w[p].tangent[k]);
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polar_rotation_derivative_matches_differences_also_at_identity() {
        for base in [
            [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            [[0.8, -0.5, 0.1], [0.55, 0.9, -0.2], [0.0, 0.25, 1.1]],
        ] {
            for entry in 0..9 {
                let (row, column) = (entry / 3, entry % 3);
                let dual: Mat3<Dual<f64, 1>> = std::array::from_fn(|i| {
                    std::array::from_fn(|j| {
                        let mut d = Dual::of(base[i][j]);
                        if (i, j) == (row, column) {
                            d.tangent[0] = 1.0;
                        }
                        d
                    })
                });
                let got = Dual::polar_rotation(&dual);
                let h = 1e-6;
                let shifted = |sign: f64| {
                    let mut m = base;
                    m[row][column] += sign * h;
                    f64::polar_rotation(&m)
                };
                let (plus, minus) = (shifted(1.0), shifted(-1.0));
                for i in 0..3 {
                    for j in 0..3 {
                        let difference = (plus[i][j] - minus[i][j]) / (2.0 * h);
                        assert!((got[i][j].tangent[0] - difference).abs() < 1e-7);
                    }
                }
            }
        }
    }
}
