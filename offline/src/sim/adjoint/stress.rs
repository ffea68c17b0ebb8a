//! Derivative of the elastic stress, safe wherever the rope may be, F = I included.
//!
//! The derivative of the rotation R of F = R S is dR = R Ω(ω) with
//! (tr(S) I − S) ω = axial(Rᵀ dF − dFᵀ R), where Ω(ω) is the cross-product matrix. The system's
//! eigenvalues are sums of two singular values of F: no difference of singular values is divided by,
//! as the derivative of an SVD does, so equal singular values (F = I) are nothing special. It is
//! singular only where two singular values sum to zero, which det F > 0 with S positive definite
//! excludes.
//!
//! P is the gradient of an energy, and R that of the nuclear norm of F. Their derivatives are
//! symmetric, so the same function serves forward and reverse mode.

use crate::sim::elastic::Lame;
use crate::sim::real::Real;
use crate::sim::tensor::{
    Mat3, Vec3, add, cross, dot, matmul, matvec, mul, sub, transpose, transpose_inverse,
};

/// The rotation of a matrix and the derivative of that rotation.
pub(super) struct PolarDerivative<T> {
    pub(super) rotation: Mat3<T>,
    inverse: Mat3<T>,
}

impl<T: Real> PolarDerivative<T> {
    #[inline(always)]
    pub(super) fn at(f: &Mat3<T>) -> Self {
        let rotation = T::polar_rotation(f);
        let s = matmul(&transpose(&rotation), f);
        let trace = s[0][0] + s[1][1] + s[2][2];
        let mut system = [[T::zero(); 3]; 3];
        for i in 0..3 {
            for j in 0..3 {
                system[i][j] = if i == j { trace - s[i][j] } else { -s[i][j] };
            }
        }
        // The system is symmetric, so its inverse is its transpose's.
        Self {
            rotation,
            inverse: transpose_inverse(&system),
        }
    }

    /// dR for dF, which is also the derivative of Σ R̄ R with respect to F for R̄ = dF.
    #[inline(always)]
    pub(super) fn apply(&self, direction: &Mat3<T>) -> Mat3<T> {
        let a = matmul(&transpose(&self.rotation), direction);
        let axial = [a[2][1] - a[1][2], a[0][2] - a[2][0], a[1][0] - a[0][1]];
        let spin = matvec(&self.inverse, axial);
        // Row i of R Ω is (row i of R) × ω.
        self.rotation.map(|row| cross(row, spin))
    }
}

/// What the elastic stress hands back.
pub(super) struct StressCotangent<T> {
    /// With respect to F.
    pub(super) deformation_gradient: Mat3<T>,
    /// With respect to μ and λ.
    pub(super) lame: [T; 2],
}

/// Pulls `cotangent`, the derivative of the result with respect to P = 2μ (F − R) + λ (J − 1) cof F,
/// back to F, μ and λ.
#[inline(always)]
pub(super) fn pull_back_piola<T: Real>(
    f: &Mat3<T>,
    lame: &Lame<T>,
    cotangent: &Mat3<T>,
) -> StressCotangent<T> {
    let polar = PolarDerivative::at(f);
    let cofactors = [cross(f[1], f[2]), cross(f[2], f[0]), cross(f[0], f[1])];
    let strain = dot(f[0], cofactors[0]) - T::one();
    let turn = polar.apply(cotangent);
    let mut shear = T::zero();
    let mut volume = T::zero();
    for a in 0..3 {
        shear += dot(cotangent[a], sub(f[a], polar.rotation[a]));
        volume += dot(cotangent[a], cofactors[a]);
    }
    let two_mu = lame.mu.scale(2.0);
    let pressure = lame.lambda * strain;
    let [c0, c1, c2] = *cotangent;
    // Σ c · d(cof F), gathered by the rows of dF.
    let bend: [Vec3<T>; 3] = [
        add(cross(c1, f[2]), cross(f[1], c2)),
        add(cross(f[2], c0), cross(c2, f[0])),
        add(cross(c0, f[1]), cross(f[0], c1)),
    ];
    let mut out = [[T::zero(); 3]; 3];
    for a in 0..3 {
        let elastic = mul(sub(cotangent[a], turn[a]), two_mu);
        let pressed = add(mul(cofactors[a], lame.lambda * volume), mul(bend[a], pressure));
        out[a] = add(elastic, pressed);
    }
    StressCotangent {
        deformation_gradient: out,
        lame: [shear.scale(2.0), volume * strain],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::Dual;
    use crate::sim::elastic::piola_stress;
    use crate::sim::tensor::identity;

    const LAME: Lame<f64> = Lame {
        mu: 0.9e6,
        lambda: 1.7e6,
    };
    const DIRECTION: Mat3<f64> = [[0.3, -0.8, 0.5], [0.1, 0.7, -0.4], [-0.6, 0.2, 0.9]];

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

    fn largest(m: &Mat3<f64>) -> f64 {
        m.iter().flatten().fold(0.0, |most, x| x.abs().max(most))
    }

    fn difference(a: &Mat3<f64>, b: &Mat3<f64>) -> f64 {
        let rows: Mat3<f64> = std::array::from_fn(|i| sub(a[i], b[i]));
        largest(&rows)
    }

    fn moved(f: &Mat3<f64>, by: f64) -> Mat3<f64> {
        std::array::from_fn(|i| std::array::from_fn(|j| f[i][j] + by * DIRECTION[i][j]))
    }

    fn along(f: &Mat3<f64>) -> Mat3<Dual<f64, 1>> {
        std::array::from_fn(|i| {
            std::array::from_fn(|j| Dual {
                value: f[i][j],
                tangent: [DIRECTION[i][j]],
            })
        })
    }

    /// Against differences (error h² of them, 1e-7 with h = 1e-5 and rounding) and forward mode.
    #[test]
    fn the_rotation_has_a_derivative_at_identity_at_equal_stretches_and_far_turned() {
        let h = 1e-5;
        for (name, f) in hard_cases() {
            let got = PolarDerivative::at(&f).apply(&DIRECTION);
            let (plus, minus) = (
                f64::polar_rotation(&moved(&f, h)),
                f64::polar_rotation(&moved(&f, -h)),
            );
            let slope: Mat3<f64> =
                std::array::from_fn(|i| std::array::from_fn(|j| (plus[i][j] - minus[i][j]) / (2.0 * h)));
            let forward = Dual::polar_rotation(&along(&f)).map(|row| row.map(|x| x.tangent[0]));
            println!(
                "{name}: against differences {:.1e}, against forward mode {:.1e}",
                difference(&got, &slope),
                difference(&got, &forward)
            );
            assert!(difference(&got, &slope) < 1e-7, "{name}");
            assert!(difference(&got, &forward) < 1e-12, "{name}");
        }
    }

    /// Σ c·dP(d) = Σ d·(pulled back c), with dP by forward mode; so are the slopes to μ and λ.
    #[test]
    fn the_pulled_back_stress_agrees_with_forward_mode() {
        let cotangent = [[0.4, 0.9, -0.2], [-0.7, 0.1, 0.6], [0.8, -0.3, -0.5]];
        let inner = |a: &Mat3<f64>, b: &Mat3<f64>| (0..3).map(|i| dot(a[i], b[i])).sum::<f64>();
        for (name, f) in hard_cases() {
            let got = pull_back_piola(&f, &LAME, &cotangent);
            let constant = Lame {
                mu: Dual::of(LAME.mu),
                lambda: Dual::of(LAME.lambda),
            };
            let (pk1, _) = piola_stress(&along(&f), &constant);
            let forward = inner(&cotangent, &pk1.map(|row| row.map(|x| x.tangent[0])));
            let reverse = inner(&got.deformation_gradient, &DIRECTION);
            assert!(
                (forward - reverse).abs() < 1e-12 * LAME.lambda,
                "{name}: {forward} {reverse}"
            );
            for (k, slope) in got.lame.into_iter().enumerate() {
                let input = |value, on| Dual {
                    value,
                    tangent: [if on { 1.0 } else { 0.0 }],
                };
                let lame = Lame {
                    mu: input(LAME.mu, k == 0),
                    lambda: input(LAME.lambda, k == 1),
                };
                let (pk1, _) = piola_stress(&f.map(|row| row.map(Dual::<f64, 1>::of)), &lame);
                let forward = inner(&cotangent, &pk1.map(|row| row.map(|x| x.tangent[0])));
                assert!((forward - slope).abs() < 1e-12, "{name}, {k}: {forward} {slope}");
            }
        }
    }

    /// In single precision the derivative is that of the same matrix in double, to rounding.
    #[test]
    fn single_precision_keeps_the_derivative() {
        for (name, f) in hard_cases() {
            let single: Mat3<f32> = f.map(|row| row.map(|x| x as f32));
            let rounded = single.map(|row| row.map(f64::from));
            let got = PolarDerivative::at(&single).apply(&DIRECTION.map(|row| row.map(|x| x as f32)));
            let expected = PolarDerivative::at(&rounded).apply(&DIRECTION);
            let error = difference(&got.map(|row| row.map(f64::from)), &expected);
            println!("{name}: {error:.1e}");
            assert!(error < 1e-5, "{name}: {error:.1e}");
        }
    }
}
