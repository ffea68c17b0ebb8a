//! Derivative of the elastic stress, safe wherever the rope may be, F = I included.
//!
//! The derivative of the rotation R of F = R S is dR = R Ω(ω) with
//! (tr(S) I − S) ω = axial(Rᵀ dF − dFᵀ R), where Ω(ω) is the cross-product matrix. The system's
//! eigenvalues are sums of two singular values of F: no difference of singular values is divided by,
//! as the derivative of an SVD does, so equal singular values (F = I) are nothing special. It is
//! singular only where two singular values sum to zero, which det F > 0 with S positive definite
//! excludes.
//!
//! P is the gradient of an energy, so its derivative is symmetric: the differential that carries
//! tangents forward ([`StressDifferential`]) is the one that carries derivatives back.

use crate::sim::elastic::{Lame, Strained, StressDifferential};
use crate::sim::real::Arithmetic;
use crate::sim::tensor::Mat3;

/// What the elastic stress hands back.
pub(super) struct StressCotangent<T> {
    /// With respect to F.
    pub(super) deformation_gradient: Mat3<T>,
    /// With respect to μ and λ.
    pub(super) lame: [T; 2],
}

/// Pulls `cotangent`, the derivative of the result with respect to P, back to F, μ and λ.
#[inline(always)]
pub(super) fn pull_back_piola<T: Arithmetic>(
    f: &Mat3<T>,
    lame: &Lame<T>,
    cotangent: &Mat3<T>,
) -> StressCotangent<T> {
    let strained = Strained::new(f);
    let still = Lame {
        mu: T::zero(),
        lambda: T::zero(),
    };
    StressCotangent {
        deformation_gradient: StressDifferential::new(&strained, lame).of(cotangent, &still),
        lame: strained.by_moduli(cotangent),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::elastic::piola_stress;
    use crate::sim::real::Real;
    use crate::sim::tensor::{dot, identity, matmul, sub, transpose};
    use crate::sim::{Dual, adjoint::var::Session};

    const LAME: Lame<f64> = Lame {
        mu: 0.9e6,
        lambda: 1.7e6,
    };
    const DIRECTION: Mat3<f64> = [[0.3, -0.8, 0.5], [0.1, 0.7, -0.4], [-0.6, 0.2, 0.9]];
    const COTANGENT: Mat3<f64> = [[0.4, 0.9, -0.2], [-0.7, 0.1, 0.6], [0.8, -0.3, -0.5]];

    /// Rotation by an angle about (1, 2, −2)/3 (Rodrigues).
    fn rotation(angle: f64) -> Mat3<f64> {
        let k = [1.0 / 3.0, 2.0 / 3.0, -2.0 / 3.0];
        let (sin, cos) = angle.sin_cos();
        let spin = [[0.0, -k[2], k[1]], [k[2], 0.0, -k[0]], [-k[1], k[0], 0.0]];
        std::array::from_fn(|i| {
            std::array::from_fn(|j| {
                let same = if i == j { cos } else { 0.0 };
                same + sin * spin[i][j] + (1.0 - cos) * k[i] * k[j]
            })
        })
    }

    /// Q diag(s) Qᵀ turned by an angle: singular values s, axes that are nobody's coordinate axes.
    fn stretched(singular: [f64; 3], angle: f64) -> Mat3<f64> {
        let axes = rotation(0.7);
        let stretch = axes.map(|row| std::array::from_fn(|j| row[j] * singular[j]));
        matmul(&rotation(angle), &matmul(&stretch, &transpose(&axes)))
    }

    /// F = I, equal and nearly equal singular values, strong compression, rotations up to half a turn.
    fn hard_cases() -> Vec<(&'static str, Mat3<f64>)> {
        vec![
            ("identity", identity()),
            ("rotation by 3.1", rotation(3.1)),
            ("all equal", stretched([1.3; 3], 0.4)),
            ("two equal", stretched([1.2, 1.2, 0.7], 2.5)),
            ("nearly equal", stretched([1.1, 1.1 + 1e-9, 1.1 - 1e-12], 1.0)),
            (
                "nearly identity",
                stretched([1.0 + 1e-10, 1.0, 1.0 - 1e-13], 1e-9),
            ),
            ("all different", stretched([0.6, 1.0, 1.5], -2.0)),
            ("compressed", stretched([0.3, 0.31, 1.0], 0.9)),
        ]
    }

    fn difference(a: &Mat3<f64>, b: &Mat3<f64>) -> f64 {
        let rows: Mat3<f64> = std::array::from_fn(|i| sub(a[i], b[i]));
        rows.iter().flatten().fold(0.0, |most, x| x.abs().max(most))
    }

    fn inner(a: &Mat3<f64>, b: &Mat3<f64>) -> f64 {
        (0..3).map(|i| dot(a[i], b[i])).sum()
    }

    fn along(f: &Mat3<f64>) -> Mat3<Dual<f64, 1>> {
        std::array::from_fn(|i| {
            std::array::from_fn(|j| Dual {
                value: f[i][j],
                tangent: [DIRECTION[i][j]],
            })
        })
    }

    fn tangent(m: &Mat3<Dual<f64, 1>>) -> Mat3<f64> {
        m.map(|row| row.map(|x| x.tangent[0]))
    }

    /// Against differences, whose error is h² and rounding: 1e-7 with h = 1e-5.
    #[test]
    fn the_rotation_has_a_derivative_at_identity_at_equal_stretches_and_far_turned() {
        let h = 1e-5;
        for (name, f) in hard_cases() {
            let moved = |by: f64| -> Mat3<f64> {
                std::array::from_fn(|i| std::array::from_fn(|j| f[i][j] + by * DIRECTION[i][j]))
            };
            let (plus, minus) = (f64::polar_rotation(&moved(h)), f64::polar_rotation(&moved(-h)));
            let slope: Mat3<f64> =
                std::array::from_fn(|i| std::array::from_fn(|j| (plus[i][j] - minus[i][j]) / (2.0 * h)));
            let forward = tangent(&Dual::polar_rotation(&along(&f)));
            let off = difference(&forward, &slope);
            println!("{name}: rotation off by {off:.1e}");
            assert!(off < 1e-7, "{name}");
        }
    }

    /// Σ c·dR(d) = Σ d·(pulled back c) for the recorded rotation, with dR by forward mode.
    #[test]
    fn the_recorded_rotation_agrees_with_forward_mode() {
        for (name, f) in hard_cases() {
            let session = Session::open();
            let inputs = f.map(|row| row.map(|x| session.input(x)));
            let rotation = Arithmetic::polar_rotation(&inputs);
            for (var, bar) in rotation.iter().flatten().zip(COTANGENT.iter().flatten()) {
                session.seed(*var, *bar);
            }
            session.sweep(0);
            let bars = inputs.map(|row| row.map(|x| session.adjoint(x)));
            let forward = inner(&COTANGENT, &tangent(&Dual::polar_rotation(&along(&f))));
            let reverse = inner(&DIRECTION, &bars);
            assert!((forward - reverse).abs() < 1e-12, "{name}: {forward} {reverse}");
            let value = rotation.map(|row| row.map(Real::value));
            assert!(difference(&value, &f64::polar_rotation(&f)) == 0.0, "{name}");
        }
    }

    /// Σ c·dP(d) = Σ d·(pulled back c), with dP by forward mode; so are the slopes to μ and λ.
    #[test]
    fn the_pulled_back_stress_agrees_with_forward_mode() {
        for (name, f) in hard_cases() {
            let got = pull_back_piola(&f, &LAME, &COTANGENT);
            let constant = Lame {
                mu: Dual::of(LAME.mu),
                lambda: Dual::of(LAME.lambda),
            };
            let forward = inner(&COTANGENT, &tangent(&piola_stress(&along(&f), &constant).0));
            let reverse = inner(&got.deformation_gradient, &DIRECTION);
            assert!(
                (forward - reverse).abs() < 1e-12 * LAME.lambda,
                "{name}: {forward} {reverse}"
            );
            for (k, slope) in got.lame.into_iter().enumerate() {
                let lame = Lame {
                    mu: Dual {
                        value: LAME.mu,
                        tangent: [if k == 0 { 1.0 } else { 0.0 }],
                    },
                    lambda: Dual {
                        value: LAME.lambda,
                        tangent: [if k == 1 { 1.0 } else { 0.0 }],
                    },
                };
                let (pk1, _) = piola_stress(&f.map(|row| row.map(Dual::<f64, 1>::of)), &lame);
                let forward = inner(&COTANGENT, &tangent(&pk1));
                assert!((forward - slope).abs() < 1e-12, "{name}, {k}: {forward} {slope}");
            }
        }
    }

    /// In single precision the derivative is that of the same matrix in double, to rounding.
    #[test]
    fn single_precision_keeps_the_derivative() {
        let single_lame = Lame {
            mu: LAME.mu as f32,
            lambda: LAME.lambda as f32,
        };
        for (name, f) in hard_cases() {
            let single: Mat3<f32> = f.map(|row| row.map(|x| x as f32));
            let rounded = single.map(|row| row.map(f64::from));
            let cotangent = COTANGENT.map(|row| row.map(|x| x as f32));
            let got = pull_back_piola(&single, &single_lame, &cotangent).deformation_gradient;
            let expected = pull_back_piola(&rounded, &LAME, &COTANGENT).deformation_gradient;
            let error = difference(&got.map(|row| row.map(f64::from)), &expected) / LAME.lambda;
            println!("{name}: {error:.1e}");
            assert!(error < 1e-5, "{name}: {error:.1e}");
        }
    }
}
