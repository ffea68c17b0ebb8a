//! The paper's units, and the only place that knows them: one length unit is 0.5 m, and the released
//! code's gravity is 12 units/s².

use crate::sim::physics::GRAVITY_M_S2;

/// Metres in one of the paper's length units.
pub const METRES_PER_UNIT: f64 = 0.5;

/// Gravity of the released code, units/s².
const GRAVITY_PER_S2: f64 = 12.0;

/// Young's modulus in the paper's units, for a rope of density `density_kg_m3`: equal E / (ρ g L) with
/// the released code's gravity of 12 units/s² gives E = E_paper · ρ · 9.81 · 0.5 / 12.
pub fn young_paper(young_pa: f64, density_kg_m3: f64) -> f64 {
    young_pa / pascals_per_unit(density_kg_m3)
}

/// Young's modulus in Pa of the paper's `young_paper`, for a rope of density `density_kg_m3`.
pub fn young_pa(young_paper: f64, density_kg_m3: f64) -> f64 {
    young_paper * pascals_per_unit(density_kg_m3)
}

fn pascals_per_unit(density_kg_m3: f64) -> f64 {
    density_kg_m3 * GRAVITY_M_S2 * METRES_PER_UNIT / GRAVITY_PER_S2
}

/// Seconds of the real world in one second of the paper's: equal Froude numbers v²/(g L) need times in
/// the ratio of √(L/g).
pub fn seconds_per_unit() -> f64 {
    (METRES_PER_UNIT * GRAVITY_PER_S2 / GRAVITY_M_S2).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_papers_range_is_that_of_soft_ropes() {
        assert!((young_paper(0.204e6, 1000.0) - 500.0).abs() < 2.0);
        assert!((young_paper(4.29e6, 1000.0) - 10_500.0).abs() < 10.0);
        assert!((young_pa(young_paper(1.0e6, 900.0), 900.0) - 1.0e6).abs() < 1e-6);
    }

    /// Free fall through one length unit takes the same time in both worlds.
    #[test]
    fn gravity_is_the_same_in_both_units() {
        let paper_s = (2.0 / GRAVITY_PER_S2).sqrt();
        let real_s = (2.0 * METRES_PER_UNIT / GRAVITY_M_S2).sqrt();
        assert!((paper_s * seconds_per_unit() - real_s).abs() < 1e-12);
    }
}
