//! Tests of training, and the measurement behind the figures in the module's description.

use super::*;
use crate::collect::stand_in::{DoublePendulum, design, unwatched};
use crate::collect::{SwingRefusal, stream};
use crate::evaluate::{Evaluation, along, confirmed_reach, evaluate, unseen};
use crate::reach::Practice;
use rand::RngExt;
use shared::policy::Policy;
use shared::task::{Interval, SwingTask};
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

/// Few steps: enough to see that each stage does its work.
fn short() -> TrainSettings {
    let mut settings = TrainSettings::QUICK;
    settings.regression.steps = 400;
    settings.forward.steps = 600;
    settings.correction.steps = 400;
    settings.rounds = 1;
    settings.answers = 40;
    settings.round_forward.steps = 200;
    settings.round_correction.steps = 150;
    settings
}

fn trained_in(folder: &Path, settings: &TrainSettings) -> Trained {
    let run = RunFolder::open(folder).unwrap();
    train(&design(300), &DoublePendulum, &run, 7, settings, unwatched()).unwrap()
}

fn mean_mm(evaluation: &Evaluation) -> f64 {
    evaluation.miss.unwrap().mean_mm
}

#[test]
fn the_correction_makes_the_regression_several_times_better() {
    let folder = tempfile::tempdir().unwrap();
    let trained = trained_in(folder.path(), &short());
    let goals = unseen(&trained.reach, 20, 3, 1);
    let score = |policy| mean_mm(&evaluate(policy, &DoublePendulum, &goals, unwatched()).unwrap());
    let (regression, policy) = (score(&trained.regression), score(&trained.policy));
    assert!(
        policy < 2.0 && 3.0 * policy < regression,
        "{regression} mm became {policy} mm"
    );
    assert_eq!(trained.dataset.rollouts, 340);
    let allowed = SwingTask::PAPER.goal_x_m;
    assert!(
        goals.iter().all(|goal| allowed.contains(goal.goal_x_m)),
        "{goals:?}"
    );
    assert_eq!(trained.record.forward.len(), 2);
    assert!(trained.record.export_difference < 1e-5, "{:?}", trained.record);
}

#[test]
fn training_repeats_exactly_and_resumes_from_the_rollouts_on_disk() {
    let (one, two) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let mut settings = short();
    settings.correction.steps = 100;
    let first = trained_in(one.path(), &settings);
    let second = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let second = second.install(|| trained_in(two.path(), &settings));
    assert!(first == second, "two runs of one seed differ");
    let run = RunFolder::open(one.path()).unwrap();
    let saved = std::fs::read(run.weights()).unwrap();
    for plan in [0, 1].map(|round| run.rollouts(round)) {
        std::fs::remove_dir_all(plan).unwrap();
    }
    assert!(
        trained_in(one.path(), &settings) == first,
        "the saved policy differs"
    );
    assert!(!run.rollouts(0).exists(), "trained before, collected again");
    let other = TrainSettings { seed: 2, ..settings };
    assert!(
        trained_in(one.path(), &other) != first,
        "other settings, the same policy"
    );
    let damaged = &saved[..saved.len() - 1];
    std::fs::write(run.weights(), damaged).unwrap();
    assert!(
        trained_in(one.path(), &settings) == first,
        "the policy of a damaged file differs"
    );
    std::fs::remove_file(run.weights()).unwrap();
    for plan in std::fs::read_dir(run.rollouts(1)).unwrap() {
        std::fs::remove_file(plan.unwrap().path().join("shard_00000.bin")).unwrap();
    }
    trained_in(one.path(), &settings);
    assert!(
        std::fs::read(run.weights()).unwrap() == saved,
        "the resumed run differs"
    );
}

#[test]
fn too_little_to_learn_from_is_refused() {
    let few = collect_design(20, &DoublePendulum);
    let error = Learner::start(&design(20), few, &short(), unwatched()).err();
    assert_eq!(
        error,
        Some(TrainError::TooFew {
            scored: 20,
            rollouts: 20
        })
    );
    let mut one_rope = collect_design(64, &DoublePendulum);
    one_rope.rows.iter_mut().for_each(|row| row.sample.young_pa = 1e6);
    let error = Learner::start(&design(64), one_rope, &short(), unwatched()).err();
    assert_eq!(error, Some(TrainError::Constant("Young's modulus")));
}

#[test]
fn a_loss_that_explodes_and_a_stop_are_errors() {
    let dataset = collect_design(64, &DoublePendulum);
    let mut wild = short();
    wild.regression.learning_rate = 1e30;
    let error = Learner::start(&design(64), dataset.clone(), &wild, unwatched()).err();
    assert!(matches!(error, Some(TrainError::Diverged { .. })), "{error:?}");
    let stop = AtomicBool::new(true);
    let watch = Watch {
        stop: &stop,
        ..unwatched()
    };
    let error = Learner::start(&design(64), dataset, &short(), watch).err();
    assert_eq!(error, Some(TrainError::Stopped));
}

fn collect_design(rollouts: u64, swinger: &dyn Swinger) -> crate::collect::Dataset {
    let folder = tempfile::tempdir().unwrap();
    collect(
        &design(rollouts).samples(),
        swinger,
        folder.path(),
        7,
        unwatched(),
    )
    .unwrap()
}

/// The stand-in with a Gaussian error that depends on its arguments alone, as a grid's error does.
struct Noisy {
    spread_m: f64,
}

impl Swinger for Noisy {
    fn reach_m(&self, young_pa: f64, poisson: f64, release_m: [f64; 2]) -> Result<f64, SwingRefusal> {
        let reach = DoublePendulum.reach_m(young_pa, poisson, release_m)?;
        let bits = [young_pa, poisson, release_m[0], release_m[1]]
            .map(f64::to_le_bytes)
            .concat();
        let mut rng = stream(crate::run_files::Fnv64::of(&bits), 0);
        let uniform: f64 = (0..12).map(|_| rng.random::<f64>()).sum();
        Ok(reach + self.spread_m * (uniform - 6.0))
    }
}

/// Goals within what random release points of 60 unseen ropes truly reach.
fn true_goals() -> Vec<Practice> {
    let (design, mut rng) = (design(1), stream(9, 9));
    let mut goals = Vec::new();
    for _ in 0..60 {
        let (young_pa, poisson) = design.rope(&mut rng);
        let reach = |point| DoublePendulum.reach_m(young_pa, poisson, point).unwrap();
        let reaches: Vec<f64> = (0..400).map(|_| reach(design.release(&mut rng))).collect();
        let range = Interval {
            low: reaches.iter().copied().fold(f64::INFINITY, f64::min),
            high: reaches.iter().copied().fold(0.0, f64::max),
        };
        goals.extend((0..5).map(|_| Practice {
            goal_x_m: range.at(rng.random::<f64>()),
            young_pa,
            poisson,
        }));
    }
    goals
}

/// Prints the figures of the module's description.
#[test]
#[ignore = "a measurement of half a minute, not a test"]
fn measure_the_steps() {
    let goals = true_goals();
    for (spread_m, rollouts) in [(0.0, 500), (0.002, 500), (0.0, 650)] {
        let swinger = Noisy { spread_m };
        let folder = tempfile::tempdir().unwrap();
        let show = |step: &str, rows: usize, policy: &Policy| {
            let miss = evaluate(policy, &DoublePendulum, &goals, unwatched())
                .unwrap()
                .miss
                .unwrap();
            eprintln!(
                "noise {:.0} mm, {} rollouts, {step}: mean {:.2}, median {:.2}, p90 {:.2}, max {:.2} mm",
                1e3 * spread_m,
                rows,
                miss.mean_mm,
                miss.median_mm,
                miss.p90_mm,
                miss.max_mm
            );
        };
        for rounds in 0..=TrainSettings::QUICK.rounds {
            let settings = TrainSettings {
                rounds,
                ..TrainSettings::QUICK
            };
            let run = RunFolder::open(folder.path()).unwrap();
            let start = Instant::now();
            let trained = train(&design(rollouts), &swinger, &run, 7, &settings, unwatched()).unwrap();
            let seconds = start.elapsed().as_secs_f64();
            if rounds == 0 {
                show("regression", trained.dataset.rollouts, &trained.regression);
            }
            show(
                &format!("{rounds} rounds, {seconds:.1} s"),
                trained.dataset.rollouts,
                &trained.policy,
            );
        }
    }
}

#[test]
fn a_rope_is_told_which_goals_it_reaches() {
    let folder = tempfile::tempdir().unwrap();
    let trained = trained_in(folder.path(), &short());
    let predicted = trained.reach.reachable_m(1e6, 0.3);
    let goals = along(&predicted, 1e6, 0.3, 7);
    let evaluation = evaluate(&trained.policy, &DoublePendulum, &goals, unwatched()).unwrap();
    let confirmed = confirmed_reach(&evaluation).unwrap();
    assert!(predicted.contains(confirmed.low) && predicted.contains(confirmed.high));
    assert!(confirmed.high - confirmed.low > 0.9 * (predicted.high - predicted.low));
    let reach = DoublePendulum.reach_m(1e6, 0.3, [0.1, 0.2]).unwrap();
    assert!(confirmed.contains(reach));
}
