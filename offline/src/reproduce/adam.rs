//! Adam on (E, ν) in paper units, with the paper's and the released code's step sizes.

/// Young's modulus in paper units and Poisson's ratio.
pub type Parameters = [f64; 2];

/// Step sizes for E (paper units) and ν.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rates(pub Parameters);

impl Rates {
    /// The paper's appendix: 10 for E; ν in the released code's ratio.
    pub const PAPER: Self = Self([10.0, 10.0 / SIM2SIM_RATIO]);
    /// The released code's default for sim2sim: 100 for E.
    pub const RELEASED: Self = Self([100.0, 100.0 / SIM2SIM_RATIO]);
    /// The released code's default for real2sim: ν moves half as fast.
    pub const RELEASED_REAL: Self = Self([100.0, 100.0 / REAL2SIM_RATIO]);
    /// The paper's step size for real2sim.
    pub const PAPER_REAL: Self = Self([10.0, 10.0 / REAL2SIM_RATIO]);
}

/// Step of E over step of ν in the released code.
const SIM2SIM_RATIO: f64 = 5e4;
const REAL2SIM_RATIO: f64 = 1e5;

/// Where the released code clips the parameters that it simulates. The iterate itself runs free.
pub const BOUNDS: [[f64; 2]; 2] = [[500.0, 10_700.0], [0.2, 0.4]];

/// Decays of the running means and the guard of the division, Kingma and Ba 2015; the released code's
/// defaults.
const BETA_MEAN: f64 = 0.9;
const BETA_SQUARE: f64 = 0.999;
const EPSILON: f64 = 1e-8;

/// The optimiser's state.
#[derive(Clone, Debug)]
pub struct Adam {
    /// The iterate, not clipped.
    pub parameters: Parameters,
    mean: Parameters,
    square: Parameters,
    steps: i32,
    rates: Rates,
}

impl Adam {
    /// Starts at `parameters`.
    pub fn new(parameters: Parameters, rates: Rates) -> Self {
        Self {
            parameters,
            mean: [0.0; 2],
            square: [0.0; 2],
            steps: 0,
            rates,
        }
    }

    /// One step down `gradient`.
    pub fn step(&mut self, gradient: Parameters) {
        self.steps += 1;
        for k in 0..2 {
            self.mean[k] = BETA_MEAN * self.mean[k] + (1.0 - BETA_MEAN) * gradient[k];
            self.square[k] = BETA_SQUARE * self.square[k] + (1.0 - BETA_SQUARE) * gradient[k].powi(2);
            let mean = self.mean[k] / (1.0 - BETA_MEAN.powi(self.steps));
            let square = self.square[k] / (1.0 - BETA_SQUARE.powi(self.steps));
            self.parameters[k] -= self.rates.0[k] * mean / (square.sqrt() + EPSILON);
        }
    }
}

/// The copy that is simulated.
pub fn clipped(parameters: Parameters) -> Parameters {
    std::array::from_fn(|k| parameters[k].clamp(BOUNDS[k][0], BOUNDS[k][1]))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The first step has the length of the rate; in the end the minimum of a quadratic is reached to
    /// within a step, though its curvatures differ by ten decades.
    #[test]
    fn a_quadratic_is_descended() {
        let minimum = [5000.0, 0.3];
        let gradient = |p: Parameters| [2e-6 * (p[0] - minimum[0]), 2e4 * (p[1] - minimum[1])];
        let mut adam = Adam::new([3000.0, 0.25], Rates::RELEASED);
        adam.step(gradient(adam.parameters));
        // ε stands against a gradient of 4e-3, hence not exactly the rate.
        assert!((adam.parameters[0] - 3100.0).abs() < 1e-3);
        assert!((adam.parameters[1] - 0.252).abs() < 1e-9);
        for _ in 0..400 {
            adam.step(gradient(adam.parameters));
        }
        for k in 0..2 {
            let miss = (adam.parameters[k] - minimum[k]).abs();
            assert!(miss < Rates::RELEASED.0[k], "{:?}", adam.parameters);
        }
    }

    /// What makes the paper's step size too small for its own range of starts.
    #[test]
    fn a_hundred_steps_of_ten_move_at_most_a_thousand() {
        let mut adam = Adam::new([2000.0, 0.3], Rates::PAPER);
        for _ in 0..100 {
            adam.step([-1.0, 0.0]);
        }
        assert!((adam.parameters[0] - 3000.0).abs() < 1e-3);
    }

    #[test]
    fn only_the_copy_is_clipped() {
        let adam = Adam::new([12_000.0, 0.1], Rates::PAPER);
        assert_eq!(clipped(adam.parameters), [10_700.0, 0.2]);
        assert_eq!(adam.parameters, [12_000.0, 0.1]);
    }
}
