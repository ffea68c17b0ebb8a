//! Yield: a rope that stays bent. Where von Mises' equivalent of the Hencky strain exceeds the yield
//! strain, the excess flows away and the elastic strain stays on the yield surface (associated flow,
//! no hardening, volume kept). The parameter is one over the yield strain, which is zero where nothing
//! ever yields; below the largest strain of a motion it changes nothing, so its slope at zero is none.
//!
//! With C = FᵀF the Hencky strain is H = ½ ln C, from the series ln C = 2 Σ X^(2k+1)/(2k+1),
//! X = (C − I)(C + I)⁻¹, which needs no eigenvectors. The factor that takes the excess away commutes
//! with C: F ← F exp(−Δ), Δ = (1 − ε_y/ε_eq) dev H.

use super::{EffectSpec, ParameterSpec, Slope};
use crate::sim::physics::FlowLaw;
use crate::sim::tensor::{Mat3, dot, identity, matmul, transpose, transpose_inverse};
use crate::sim::{Physics, Real};

/// What the effect is.
pub const SPEC: EffectSpec = EffectSpec {
    id: "yield",
    title: "yield",
    equation: "ε_eq = √(2/3) |dev H| ≤ ε_y",
    source: "return mapping for von Mises plasticity on Hencky strain; de Souza Neto, Perić and Owen, Computational Methods for Plasticity (2008), ch. 14",
    nuisance: false,
    only_seen: false,
    parameters: &[ParameterSpec {
        name: "one_over_strain",
        unit: "1",
        vanishes_at: 0.0,
        low: 0.0,
        high: 200.0,
        smallest_of_interest: 20.0,
        slope: Slope::SecantNearZero,
    }],
};

struct Yield<T> {
    one_over_strain: T,
}

/// Terms of the logarithm's series: enough for stretches up to 1.4 in double precision's ninth digit.
const LOGARITHM_TERMS: usize = 7;
/// Terms of the exponential's series.
const EXPONENTIAL_TERMS: usize = 8;

impl<T: Real> FlowLaw<T> for Yield<T> {
    fn relaxation(&self, elastic: &Mat3<T>) -> Option<Mat3<T>> {
        let c = matmul(&transpose(elastic), elastic);
        // Cheap bound: ε_eq ≤ |C − I|_F below stretches of 1.4 and above 0.7.
        let inverse = self.one_over_strain.value();
        if (distance_from_identity(&c) * inverse) < 1.0 {
            return None;
        }
        let mut strain = scaled(&logarithm(&c), 0.5);
        let mean = (strain[0][0] + strain[1][1] + strain[2][2]).scale(1.0 / 3.0);
        for k in 0..3 {
            strain[k][k] -= mean;
        }
        let square = dot(strain[0], strain[0]) + dot(strain[1], strain[1]) + dot(strain[2], strain[2]);
        let equivalent = square.scale(2.0 / 3.0).sqrt();
        if equivalent.value() * inverse <= 1.0 {
            return None;
        }
        let excess = T::one() - T::one() / (equivalent * self.one_over_strain);
        let back = strain.map(|row| row.map(|x| -(x * excess)));
        Some(exponential(&back))
    }
}

fn distance_from_identity<T: Real>(c: &Mat3<T>) -> f64 {
    let mut square = 0.0;
    for a in 0..3 {
        for b in 0..3 {
            let one = if a == b { 1.0 } else { 0.0 };
            square += (c[a][b].value() - one).powi(2);
        }
    }
    square.sqrt()
}

fn scaled<T: Real>(m: &Mat3<T>, factor: f64) -> Mat3<T> {
    m.map(|row| row.map(|x| x.scale(factor)))
}

fn plus<T: Real>(a: &Mat3<T>, b: &Mat3<T>) -> Mat3<T> {
    std::array::from_fn(|i| std::array::from_fn(|j| a[i][j] + b[i][j]))
}

/// Gregory's series of ln C for a symmetric C near the identity (Higham, Functions of Matrices, 11.3).
fn logarithm<T: Real>(c: &Mat3<T>) -> Mat3<T> {
    let one = identity();
    // The inverse of a symmetric matrix is its own transpose.
    let x = matmul(&plus(c, &scaled(&one, -1.0)), &transpose_inverse(&plus(c, &one)));
    let square = matmul(&x, &x);
    let mut power = x;
    let mut sum = x;
    for k in 1..LOGARITHM_TERMS {
        power = matmul(&power, &square);
        sum = plus(&sum, &scaled(&power, 1.0 / (2 * k + 1) as f64));
    }
    scaled(&sum, 2.0)
}

fn exponential<T: Real>(m: &Mat3<T>) -> Mat3<T> {
    let mut term = identity();
    let mut sum = identity();
    for k in 1..=EXPONENTIAL_TERMS {
        term = scaled(&matmul(&term, m), 1.0 / k as f64);
        sum = plus(&sum, &term);
    }
    sum
}

/// Adds the effect to a physics.
pub fn add_to<T: Real>(values: &[T], physics: &mut Physics<T>) {
    physics.flow_laws.push(Box::new(Yield {
        one_over_strain: values[0],
    }));
}
