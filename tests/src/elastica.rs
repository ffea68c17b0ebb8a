//! Euler's elastica under its own weight in the x-z plane: a chain of rigid links with bending springs
//! at its joints, solved for rest by Newton's method. It shares no code with the simulator.

use nalgebra::{DMatrix, DVector};

/// A planar elastica at rest.
#[derive(Clone, Copy, Debug)]
pub struct Elastica {
    /// Free length, m.
    pub length_m: f64,
    /// Bending stiffness, N m².
    pub bending_n_m2: f64,
    /// Weight per length, N/m.
    pub weight_n_m: f64,
    /// Weight at the far end, N.
    pub end_weight_n: f64,
    /// Angle of the tangent at the near clamp, counted from +x towards +z, rad.
    pub start_angle: f64,
    /// Where the far end is clamped, if it is: (x, z) from the near clamp, m, and its tangent's angle, rad.
    pub far_clamp: Option<([f64; 2], f64)>,
}

/// Number of links.
const LINKS: usize = 120;
/// The solution is followed from a rod this many times as stiff, in this many stages.
const STIFFEST: f64 = 300.0;
const STAGES: u32 = 16;

impl Elastica {
    /// Points (x, z) at the ends of the links, from the near clamp on, m. `guess` gives the angle of
    /// the tangent at a share of the length, rad.
    ///
    /// # Panics
    /// Newton's method does not converge.
    pub fn points_m(&self, guess: impl Fn(f64) -> f64) -> Vec<[f64; 2]> {
        let constraints = if self.far_clamp.is_some() { 2 } else { 0 };
        let mut unknowns = DVector::zeros(LINKS + constraints);
        for i in 0..LINKS {
            unknowns[i] = guess((i as f64 + 0.5) / LINKS as f64);
        }
        // From a stiff rod, which lies near the guess, to the soft one.
        for stage in (0..=STAGES).rev() {
            let stiffer = Self {
                bending_n_m2: self.bending_n_m2 * STIFFEST.powf(f64::from(stage) / f64::from(STAGES)),
                ..*self
            };
            stiffer.settle(&mut unknowns);
        }
        self.chain(&unknowns)
    }

    fn settle(&self, unknowns: &mut DVector<f64>) {
        for round in 0.. {
            assert!(round < 100, "the elastica does not converge");
            let (residual, slope) = self.equations(unknowns);
            let step = slope.lu().solve(&residual).expect("a regular system");
            let largest = step.rows(0, LINKS).amax();
            *unknowns -= &step * (0.3 / largest).min(1.0);
            if largest < 1e-10 {
                break;
            }
        }
    }

    fn chain(&self, angles: &DVector<f64>) -> Vec<[f64; 2]> {
        let ds = self.length_m / LINKS as f64;
        let mut points = vec![[0.0; 2]];
        for i in 0..LINKS {
            let [x, z] = points[i];
            points.push([x + ds * angles[i].cos(), z + ds * angles[i].sin()]);
        }
        points
    }

    /// Gradient of energy plus multipliers times constraints, and its derivative.
    fn equations(&self, u: &DVector<f64>) -> (DVector<f64>, DMatrix<f64>) {
        let ds = self.length_m / LINKS as f64;
        let spring = self.bending_n_m2 / ds;
        let size = u.len();
        let (mut r, mut k) = (DVector::zeros(size), DMatrix::zeros(size, size));
        let pull = if size > LINKS {
            [u[LINKS], u[LINKS + 1]]
        } else {
            [0.0; 2]
        };
        for i in 0..LINKS {
            // Weight that hangs beyond the middle of this link.
            let beyond = self.weight_n_m * ds * (LINKS as f64 - i as f64 - 0.5) + self.end_weight_n;
            let (sin, cos) = u[i].sin_cos();
            r[i] += beyond * ds * cos + ds * (-pull[0] * sin + pull[1] * cos);
            k[(i, i)] += -beyond * ds * sin - ds * (pull[0] * cos + pull[1] * sin);
            if size > LINKS {
                k[(i, LINKS)] = -ds * sin;
                k[(LINKS, i)] = -ds * sin;
                k[(i, LINKS + 1)] = ds * cos;
                k[(LINKS + 1, i)] = ds * cos;
            }
        }
        // Between a clamp and the middle of the first link lies half a link: twice the stiffness.
        r[0] += 2.0 * spring * (u[0] - self.start_angle);
        k[(0, 0)] += 2.0 * spring;
        for i in 1..LINKS {
            let turn = u[i] - u[i - 1];
            r[i] += spring * turn;
            r[i - 1] -= spring * turn;
            k[(i, i)] += spring;
            k[(i - 1, i - 1)] += spring;
            k[(i, i - 1)] -= spring;
            k[(i - 1, i)] -= spring;
        }
        if let Some((at_m, angle)) = self.far_clamp {
            r[LINKS - 1] += 2.0 * spring * (u[LINKS - 1] - angle);
            k[(LINKS - 1, LINKS - 1)] += 2.0 * spring;
            let end = self.chain(u)[LINKS];
            r[LINKS] = end[0] - at_m[0];
            r[LINKS + 1] = end[1] - at_m[1];
        }
        (r, k)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A stiff cantilever sags by w L⁴/(8 E I) + P L³/(3 E I).
    #[test]
    fn a_stiff_cantilever_sags_as_beam_theory_says() {
        let rod = Elastica {
            length_m: 0.5,
            bending_n_m2: 10.0,
            weight_n_m: 2.0,
            end_weight_n: 0.5,
            start_angle: 0.0,
            far_clamp: None,
        };
        let sag = -rod.points_m(|_| 0.0)[LINKS][1];
        let exact = 2.0 * 0.5f64.powi(4) / 80.0 + 0.5 * 0.5f64.powi(3) / 30.0;
        assert!((sag / exact - 1.0).abs() < 1e-3, "{sag} against {exact}");
    }
}
