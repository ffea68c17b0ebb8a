//! Evaluations that are kept: the same answers, swung by the same rope on the same grid, are not swung again.

use crate::collect::{Swinger, Watch};
use crate::evaluate::{Evaluation, evaluate};
use crate::reach::Practice;
use crate::run_files::{kept, write_whole};
use serde::{Deserialize, Serialize};
use shared::policy::Policy;
use std::path::Path;

/// What such a file holds.
#[derive(Serialize, Deserialize)]
struct EvaluationFile {
    /// Hash of what swings.
    swing: u64,
    #[serde(flatten)]
    evaluation: Evaluation,
}

/// The evaluation of a policy's answers that `file` holds, or a new one, which is kept there. `swing` is the hash of what
/// swings.
///
/// # Errors
/// Stopped on request, or the file cannot be written.
pub(super) fn evaluated(
    file: &Path,
    (policy, goals): (&Policy, &[Practice]),
    (swinger, swing): (&dyn Swinger, u64),
    watch: Watch,
) -> anyhow::Result<Evaluation> {
    let same = |there: &EvaluationFile| there.swing == swing && there.evaluation.is_of(policy, goals);
    if let Some(there) = kept::<EvaluationFile>(file).filter(same) {
        return Ok(there.evaluation);
    }
    let made = EvaluationFile {
        swing,
        evaluation: evaluate(policy, swinger, goals, watch)?,
    };
    write_whole(file, &serde_json::to_vec_pretty(&made)?)?;
    Ok(made.evaluation)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::collect::SwingRefusal;
    use crate::collect::stand_in::unwatched;
    use crate::freeze::tests::policy;
    use std::sync::atomic::{AtomicUsize, Ordering};

    /// Counts its swings, of which some are refused.
    #[derive(Default)]
    struct Counting(AtomicUsize);

    impl Swinger for Counting {
        fn reach_m(&self, young_pa: f64, _: f64, release_m: [f64; 2]) -> Result<f64, SwingRefusal> {
            self.0.fetch_add(1, Ordering::Relaxed);
            if young_pa > 1e6 {
                return Err(SwingRefusal::Failed("too stiff".into()));
            }
            Ok(0.1 + release_m[0] / 3.0)
        }
    }

    #[test]
    fn only_what_was_not_swung_is_swung() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("evaluation.json");
        let goals = |count: usize| -> Vec<Practice> {
            let goal = |k: usize| Practice {
                goal_x_m: 0.3 + 0.1 / (3.0 + k as f64),
                young_pa: 0.7e6 + 1e5 * k as f64,
                poisson: 0.3,
            };
            (0..count).map(goal).collect()
        };
        let swinger = Counting::default();
        let swung = |spread_m: f64, count: usize, swing: u64| {
            let before = swinger.0.load(Ordering::Relaxed);
            let (policy, goals) = (policy(spread_m), goals(count));
            let evaluation = evaluated(&file, (&policy, &goals), (&swinger, swing), unwatched()).unwrap();
            assert!(evaluation.is_of(&policy, &goals));
            (evaluation, swinger.0.load(Ordering::Relaxed) - before)
        };
        let (first, all) = swung(0.04, 6, 1);
        assert_eq!((first.refusals.len(), all), (1, 6));
        assert_eq!(swung(0.04, 6, 1), (first, 0), "kept to the last digit");
        assert_eq!(swung(0.04, 5, 1).1, 5, "other goals");
        assert_eq!(swung(0.04, 5, 2).1, 5, "another rope");
        assert_eq!(swung(0.05, 5, 2).1, 5, "another policy");
    }
}
