//! The paper's units, and the only place that knows them: one length unit is 0.5 m.

/// Metres in one of the paper's length units.
pub const METRES_PER_UNIT: f64 = 0.5;

/// Young's modulus in the paper's units, for a rope of density `density_kg_m3`: equal E / (ρ g L) with
/// the released code's gravity of 12 units/s² gives E = E_paper · ρ · 9.81 · 0.5 / 12.
pub fn young_paper(young_pa: f64, density_kg_m3: f64) -> f64 {
    young_pa / (density_kg_m3 * 9.81 * METRES_PER_UNIT / 12.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_papers_range_is_that_of_soft_ropes() {
        assert!((young_paper(0.204e6, 1000.0) - 500.0).abs() < 2.0);
        assert!((young_paper(4.29e6, 1000.0) - 10_500.0).abs() < 10.0);
    }
}
