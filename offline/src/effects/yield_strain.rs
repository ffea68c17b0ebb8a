//! Yield: a rope that stays bent. Where von Mises' equivalent of the Hencky strain exceeds the yield
//! strain, the excess flows away and the elastic strain stays on the yield surface (associated flow,
//! no hardening, volume kept). The parameter is one over the yield strain, which is zero where nothing
//! ever yields; below the largest strain of a motion it changes nothing, so its slope at zero is none.
//!
//! With C = FᵀF the Hencky strain is H = ½ ln C, from the series ln C = 2 Σ X^(2k+1)/(2k+1),
//! X = (C − I)(C + I)⁻¹, which needs no eigenvectors. The factor that takes the excess away commutes
//! with C: F ← F exp(−Δ), Δ = (1 − ε_y/ε_eq) dev H.

use super::{EffectSpec, ParameterSpec, Quantity, Slope};
use crate::sim::physics::FlowLaw;
use crate::sim::real::Float;
use crate::sim::tensor::{Mat3, dot, identity, matadd, transpose, transpose_inverse};
use crate::sim::{Physics, Real};

/// What the effect is.
pub const SPEC: EffectSpec = EffectSpec {
    id: "yield",
    title: "yield",
    equation: "ε_eq = √(2/3) |dev H| ≤ ε_y",
    source: "return mapping for von Mises plasticity on Hencky strain; de Souza Neto, Perić and Owen, Computational Methods for Plasticity (2008), ch. 14",
    nuisance: false,
    of_the_rig: false,
    only_seen: false,
    quantity: Quantity::Inverse("a yield strain"),
    at_its_end: None,
    parameters: &[ParameterSpec {
        name: "one_over_strain",
        unit: "1",
        vanishes_at: 0.0,
        low: 0.0,
        high: 200.0,
        smallest_of_interest: 20.0,
        slope: Slope::SecantNearZero,
        sideways: false,
    }],
};

struct Yield<T> {
    one_over_strain: T,
}

/// Most terms of the logarithm's series: enough for stretches up to 1.4 in double precision's ninth digit.
const LOGARITHM_TERMS: usize = 7;
/// Most terms of the exponential's series.
const EXPONENTIAL_TERMS: usize = 8;
/// Most of ε_eq over |C − I|_F: √(2/3)/2 times the most of |ln c| over |c − 1|, 1.40, for stretches from 0.7 to 1.4.
const MOST_PER_DISTANCE: f64 = 0.6;

impl<T: Real> FlowLaw<T> for Yield<T> {
    fn onset(&self) -> f64 {
        1.0 / (MOST_PER_DISTANCE * self.one_over_strain.value())
    }

    fn relaxation(&self, elastic: &Mat3<T>) -> Option<Mat3<T>> {
        // Derivatives are dear, and wanted of what flows alone.
        let value = cauchy_green(&elastic.map(|row| row.map(|x| T::base(x.value()))));
        if distance_from_identity(&value) < self.onset() {
            return None;
        }
        let (_, equivalent) = deviator(&value);
        if equivalent.value() * self.one_over_strain.value() <= 1.0 {
            return None;
        }
        let (strain, equivalent) = deviator(&cauchy_green(elastic));
        let excess = T::one() - T::one() / (equivalent * self.one_over_strain);
        let back = strain.map(|row| row.map(|x| -(x * excess)));
        Some(exponential(&back))
    }
}

/// C = FᵀF.
fn cauchy_green<T: Real>(f: &Mat3<T>) -> Mat3<T> {
    let columns = transpose(f);
    symmetric(|i, j| dot(columns[i], columns[j]))
}

/// dev H and ε_eq.
fn deviator<T: Real>(c: &Mat3<T>) -> (Mat3<T>, T) {
    let mut strain = scaled(&logarithm(c), 0.5);
    let mean = (strain[0][0] + strain[1][1] + strain[2][2]).scale(1.0 / 3.0);
    for k in 0..3 {
        strain[k][k] -= mean;
    }
    let square = dot(strain[0], strain[0]) + dot(strain[1], strain[1]) + dot(strain[2], strain[2]);
    (strain, square.scale(2.0 / 3.0).sqrt())
}

fn distance_from_identity<T: Real>(c: &Mat3<T>) -> f64 {
    size(&matadd(c, &scaled(&identity(), -1.0)))
}

/// Frobenius norm.
fn size<T: Real>(m: &Mat3<T>) -> f64 {
    let squares = m.iter().flatten().map(|x| x.value().powi(2));
    squares.sum::<f64>().sqrt()
}

fn scaled<T: Real>(m: &Mat3<T>, factor: f64) -> Mat3<T> {
    m.map(|row| row.map(|x| x.scale(factor)))
}

/// A symmetric matrix from its entries in and above the diagonal.
fn symmetric<T: Real>(entry: impl Fn(usize, usize) -> T) -> Mat3<T> {
    let (xy, xz, yz) = (entry(0, 1), entry(0, 2), entry(1, 2));
    [
        [entry(0, 0), xy, xz],
        [xy, entry(1, 1), yz],
        [xz, yz, entry(2, 2)],
    ]
}

/// A B of symmetric matrices that commute.
fn product<T: Real>(a: &Mat3<T>, b: &Mat3<T>) -> Mat3<T> {
    symmetric(|i, j| dot(a[i], b[j]))
}

/// Gregory's series of ln C for a symmetric C near the identity (Higham, Functions of Matrices, 11.3), as far as its
/// terms and their derivatives can be told from nothing.
fn logarithm<T: Real>(c: &Mat3<T>) -> Mat3<T> {
    let one = identity();
    // The inverse of a symmetric matrix is its own transpose.
    let x = product(
        &matadd(c, &scaled(&one, -1.0)),
        &transpose_inverse(&matadd(c, &one)),
    );
    let square = product(&x, &x);
    let (mut power, mut sum, mut share) = (x, x, 1.0);
    let ratio = size(&square);
    for k in 1..LOGARITHM_TERMS {
        share *= ratio;
        if share < T::Base::EPSILON {
            break;
        }
        power = product(&power, &square);
        sum = matadd(&sum, &scaled(&power, 1.0 / (2 * k + 1) as f64));
    }
    scaled(&sum, 2.0)
}

/// The exponential's series of a symmetric matrix, as far as its terms and their derivatives can be told from nothing.
fn exponential<T: Real>(m: &Mat3<T>) -> Mat3<T> {
    let (mut term, mut sum, mut share) = (*m, matadd(&identity(), m), 1.0);
    let ratio = size(m);
    for k in 2..=EXPONENTIAL_TERMS {
        share *= ratio / (k - 1) as f64;
        if share < T::Base::EPSILON {
            break;
        }
        term = scaled(&product(&term, m), 1.0 / k as f64);
        sum = matadd(&sum, &term);
    }
    sum
}

/// Adds the effect to a physics.
pub fn add_to<T: Real>(values: &[T], physics: &mut Physics<T>) {
    physics.flow_laws.push(Box::new(Yield {
        one_over_strain: values[0],
    }));
}
