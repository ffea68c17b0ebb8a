//! A trained policy in the twin world: its answers are swung by a rod that shares nothing with the simulator it learnt on.

use offline::evaluate::{Attempt, Evaluation, MissSummary};
use rayon::prelude::*;
use std::path::Path;
use tests::effects::WorldEffects;
use tests::sample_rope::TIP_MASS_KG;
use tests::swing::{TOLERANCE_M, calm_reach_m};

/// Names the folder of a run of the sample rope.
const RUN: &str = "GENORM_RUN";

/// What the policy was judged by in its run are swings of the simulator that it learnt on. In the rod, with the thing of
/// 9 g that the run has to have found at the rope's end, its answers miss by no more than the two may differ. The rod has
/// 0.3 for Poisson's ratio, whatever the attempt has.
#[test]
#[ignore = "a minute, and needs a run of the sample rope, named by GENORM_RUN; for a figure in the README"]
fn a_policys_answers_are_as_good_in_the_independent_rod() {
    let run = std::env::var_os(RUN).expect("GENORM_RUN names the folder of a run of the sample rope");
    let text =
        std::fs::read_to_string(Path::new(&run).join("evaluation.json")).expect("it evaluated a policy");
    let evaluation: Evaluation = serde_json::from_str(&text).expect("an evaluation");
    let own = evaluation.miss.expect("swings with a score");
    let rope = WorldEffects {
        tip_mass_kg: TIP_MASS_KG,
        ..WorldEffects::default()
    };
    let miss_mm = |attempt: &Attempt| {
        let reached_m = calm_reach_m(attempt.goal.young_pa, &rope, attempt.release_m);
        1e3 * (reached_m - attempt.goal.goal_x_m).abs()
    };
    let misses_mm: Vec<f64> = evaluation.attempts.par_iter().map(miss_mm).collect();
    let rod = MissSummary::new(misses_mm).expect("goals");
    for (what, miss) in [("rod", &rod), ("simulator", &own)] {
        println!(
            "{what}: |goal - reached| {:.1} ± {:.1} mm, n = {} (median {:.1}, p90 {:.1}, largest {:.1})",
            miss.mean_mm, miss.spread_mm, miss.count, miss.median_mm, miss.p90_mm, miss.max_mm
        );
    }
    assert!(
        rod.mean_mm < own.mean_mm + 1e3 * TOLERANCE_M,
        "{} mm",
        rod.mean_mm
    );
}
