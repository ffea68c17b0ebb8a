//! Random scenes within the documented ranges: whatever is drawn, a rollout ends, or is refused or
//! stopped with a typed cause; it never panics, and no number that it returns is NaN.
//!
//! Ranges: the ropes that a demonstration may declare (`demo/check.rs`), but at most
//! [`MOST_SLENDER`] times as long as thick; E and ν of `model.rs`; friction 0 to 5; the gripper up to the
//! flange speed that the arm's box permits; release points of the task; every effect present in a third
//! of the scenes, its parameters uniform in their ranges. Every scene is checked at its whole length
//! and run up to [`PARTICLE_STEPS`] steps of one particle; of a camera that is behind, the frames that it
//! takes until then are asked for.

use super::case::{Case, Of};
use super::setup::knot;
use crate::collect::stream;
use crate::demo::RopeEnd;
use crate::effects;
use crate::model::{POISSON_RANGE, YOUNG_RANGE_PA};
use crate::sim::clamp::ClampPath;
use crate::sim::rope::RopeShape;
use crate::sim::scene::{Grip, MOST_PARTICLE_STEPS, Scene, Table};
use crate::sim::time_step::time_step_s;
use crate::sim::{Cause, Physics, SimError, simulate};
use crate::tell::Progress;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::Serialize;
use shared::profile::MotionLimits;
use shared::task::SwingTask;
use std::collections::BTreeMap;
use std::panic::catch_unwind;
use std::sync::atomic::{AtomicUsize, Ordering};

const FAMILY: Of = Of("random");
/// Steps times particles of one scene: some hundred to some thousand steps.
pub const PARTICLE_STEPS: f64 = 2e5;
/// Fewest steps of one scene.
const FEWEST_STEPS: f64 = 32.0;
/// Largest length over diameter.
pub const MOST_SLENDER: f64 = 500.0;
/// Flange speed that the arm's box permits, m/s.
const GRIPPER_M_S: [f64; 2] = [0.01, 1.0];
/// Examples that are kept of each kind of stop.
const EXAMPLES: usize = 3;

/// What became of the random scenes.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Outcomes {
    /// Number of scenes.
    pub scenes: usize,
    /// Count by what became of them.
    pub counts: BTreeMap<String, usize>,
    /// Steps of all rollouts.
    pub steps: usize,
    /// Scenes that ran their whole length.
    pub whole: usize,
    /// Rollouts in which a grip opened.
    pub released: usize,
    /// A few messages of each kind of stop.
    pub examples: BTreeMap<String, Vec<String>>,
}

/// One scene's end.
struct Outcome {
    kind: &'static str,
    message: String,
    steps: usize,
    whole: bool,
    released: bool,
}

/// Runs `count` random scenes on all threads, and tells of each that is done.
pub fn run(count: usize, seed: u64, progress: &(dyn Fn(Progress) + Sync)) -> Outcomes {
    let done = AtomicUsize::new(0);
    let ends: Vec<Outcome> = (0..count as u64)
        .into_par_iter()
        .map(|index| {
            let end = end_of(seed, index);
            progress(Progress {
                stage: "random scenes",
                done: done.fetch_add(1, Ordering::Relaxed) + 1,
                total: count,
                refused: 0,
            });
            end
        })
        .collect();
    let mut outcomes = Outcomes {
        scenes: count,
        ..Outcomes::default()
    };
    for end in ends {
        *outcomes.counts.entry(end.kind.into()).or_default() += 1;
        outcomes.steps += end.steps;
        outcomes.whole += usize::from(end.whole);
        outcomes.released += usize::from(end.released);
        let examples = outcomes.examples.entry(end.kind.into()).or_default();
        if !end.message.is_empty() && examples.len() < EXAMPLES {
            examples.push(end.message);
        }
    }
    outcomes
}

impl Outcomes {
    /// Nothing panics and nothing is silently NaN.
    pub fn cases(&self) -> Vec<Case> {
        let count = |kind: &str| self.counts.get(kind).copied().unwrap_or(0) as f64;
        let of = |what: &str| format!("{what} in {} random scenes", self.scenes);
        vec![
            FAMILY.absolute(of("panics"), "1", [0.0, count(PANIC)], 0.0),
            FAMILY.absolute(of("silent NaN"), "1", [0.0, count(SILENT)], 0.0),
        ]
    }

    /// The counts as text.
    pub fn text(&self) -> String {
        let mut text = format!(
            "\n{} random scenes, {} steps; {} ran their whole length, in {} a grip opened\n",
            self.scenes, self.steps, self.whole, self.released
        );
        for (kind, count) in &self.counts {
            text += &format!("  {count:>6} {kind}\n");
            for example in self.examples.get(kind).into_iter().flatten() {
                text += &format!("         e.g. {example}\n");
            }
        }
        text
    }
}

const PANIC: &str = "panicked";
const SILENT: &str = "silent NaN";

fn kind(cause: &Cause) -> &'static str {
    match cause {
        Cause::Inverted { .. } => "stopped: inverted",
        Cause::NonFinite { .. } => "stopped: not finite",
        Cause::TooFast { .. } => "stopped: too fast (CFL)",
        Cause::TooThin { .. } => "refused: too thin for the grid",
        Cause::Unreachable { .. } => "refused: unreachable",
        Cause::BentAtRest { .. } => "refused: bent too much at rest",
        Cause::Collapses { .. } => "refused: collapses under its weight",
        Cause::TooLong { .. } => "refused: too long",
        Cause::StepTooLong { .. } => "refused: step too long",
        Cause::YieldsAtRest { .. } => "refused: yields at rest",
        Cause::Memory { .. } => "refused: too little memory",
        Cause::OneWay => "refused: no way back",
        Cause::BadParameter { .. } => "refused: bad parameter",
        Cause::NoRest { .. } => "refused: no pose at rest",
        Cause::HangsAtStart => "refused: hangs at the start",
        Cause::RestsOnTable { .. } => "refused: rests on the table",
    }
}

fn end_of(seed: u64, index: u64) -> Outcome {
    // A panic is what is looked for; nothing of the scene is used after it.
    let mut end = catch_unwind(|| drawn(seed, index).map_or_else(|e| refused(&e), |drawn| play(&drawn)))
        .unwrap_or_else(|_| Outcome {
            kind: PANIC,
            message: "see the panic's own message".into(),
            steps: 0,
            whole: false,
            released: false,
        });
    if !end.message.is_empty() {
        end.message = format!("number {index}: {}", end.message);
    }
    end
}

fn refused(error: &SimError) -> Outcome {
    Outcome {
        kind: kind(&error.cause),
        message: error.to_string(),
        steps: error.step,
        whole: false,
        released: false,
    }
}

fn uniform(rng: &mut ChaCha8Rng, [low, high]: [f64; 2]) -> f64 {
    low + (high - low) * rng.random::<f64>()
}

fn log_uniform(rng: &mut ChaCha8Rng, [low, high]: [f64; 2]) -> f64 {
    uniform(rng, [low.ln(), high.ln()]).exp()
}

/// A random scene, shortened to what is run of it.
pub struct Drawn {
    /// The scene.
    pub scene: Scene,
    /// The rope's material and effects.
    pub physics: Physics<f32>,
    /// How long the scene was, s.
    pub natural_s: f64,
}

/// Random scene number `index` of a seed.
///
/// # Errors
/// What was drawn is refused.
pub fn drawn(seed: u64, index: u64) -> Result<Drawn, SimError> {
    let (mut scene, physics) = draw(&mut stream(seed, index))?;
    let natural_s = scene.duration_s;
    shorten(&mut scene, &physics);
    Ok(Drawn {
        scene,
        physics,
        natural_s,
    })
}

fn draw(rng: &mut ChaCha8Rng) -> Result<(Scene, Physics<f32>), SimError> {
    let length_m = log_uniform(rng, [0.01, 10.0]);
    let slender = log_uniform(rng, [2.0, MOST_SLENDER]);
    let diameter_m = (length_m / slender).clamp(2e-4, 0.2);
    let rope = RopeShape::of_density(length_m, diameter_m, log_uniform(rng, [5.0, 20_000.0]));
    let mut physics = Physics::base(
        log_uniform(rng, YOUNG_RANGE_PA) as f32,
        uniform(rng, POISSON_RANGE) as f32,
        uniform(rng, [0.0, 5.0]) as f32,
    );
    for (index, spec) in effects::ALL.iter().enumerate() {
        let present = rng.random::<f64>() < 1.0 / 3.0;
        let values: Vec<f32> = spec
            .parameters
            .iter()
            .map(|p| uniform(rng, [p.low, p.high]) as f32)
            .collect();
        if present {
            effects::add_to(index, &values, &mut physics);
        }
    }
    let cells = uniform(rng, [1.4, 2.4]);
    let speed_m_s = log_uniform(rng, GRIPPER_M_S);
    let scene = match rng.random_range(0..4) {
        0 => swing(rope, speed_m_s, cells, rng),
        1 => drop(rope, speed_m_s, cells, &physics),
        _ => lift(rope, speed_m_s, cells),
    }?;
    Ok((scene, physics))
}

/// Off the table at constant speed for a second, the rope's first tenth in the gripper.
fn lift(rope: RopeShape, speed_m_s: f64, cells: f64) -> Result<Scene, SimError> {
    let at = |t_s: f64, closed| knot(t_s, [0.0, 0.0, speed_m_s * t_s], [0.0, 0.0, speed_m_s], closed);
    let grips = vec![Grip {
        end: RopeEnd::Start,
        length_m: 0.1 * rope.length_m,
        path: ClampPath::new(vec![at(0.0, true), at(1.0, true)]),
    }];
    let table = Some(Table {
        height_m: -0.5 * rope.diameter_m,
    });
    let times = (0..=10).map(|i| 0.1 * f64::from(i)).collect();
    Scene::new(rope, [0.0; 3], [1.0, 0.0, 0.0], grips, table, cells, times)
}

/// The swing task with a random release point, as a run collects it; the rope is a rope of the task in
/// half of the scenes, and any rope in the others.
fn swing(rope: RopeShape, speed_m_s: f64, cells: f64, rng: &mut ChaCha8Rng) -> Result<Scene, SimError> {
    let task = SwingTask::PAPER;
    let rope = if rng.random::<bool>() {
        RopeShape::of_density(
            uniform(rng, [0.2, 0.4]),
            uniform(rng, [0.008, 0.03]),
            rope.density_kg_m3(),
        )
    } else {
        rope
    };
    let release_m = [task.release_x_m, task.release_z_m].map(|range| range.at(rng.random::<f64>()));
    let limits = MotionLimits {
        speed_m_s,
        ..MotionLimits::PAPER
    };
    Scene::swing(rope, &task, release_m, &limits, cells)
}

/// A level rope held at both ends; one end moves down and opens half-way through the shortened rollout.
fn drop(rope: RopeShape, speed_m_s: f64, cells: f64, physics: &Physics<f32>) -> Result<Scene, SimError> {
    let build = |end_s: f64| {
        let at = |t_s: f64, closed| {
            let end = [rope.length_m, 0.0, -speed_m_s * t_s];
            knot(t_s, end, [0.0, 0.0, -speed_m_s], closed)
        };
        let grip = |end, path| Grip {
            end,
            length_m: 0.1 * rope.length_m,
            path,
        };
        let grips = vec![
            grip(RopeEnd::Start, ClampPath::fixed([0.0; 3])),
            grip(
                RopeEnd::End,
                ClampPath::new(vec![at(0.0, true), at(0.5 * end_s, false)]),
            ),
        ];
        Scene::new(
            rope,
            [0.0; 3],
            [1.0, 0.0, 0.0],
            grips,
            None,
            cells,
            vec![0.5 * end_s, end_s],
        )
    };
    build(affordable_s(&build(0.01)?, physics).min(1.0))
}

/// Time that the budget of particle steps pays for, s.
fn affordable_s(scene: &Scene, physics: &Physics<f32>) -> f64 {
    let steps = (PARTICLE_STEPS / scene.layout().particles() as f64).max(FEWEST_STEPS);
    steps.floor() * time_step_s(scene, physics)
}

/// Shortens a scene to what its budget of steps pays for.
fn shorten(scene: &mut Scene, physics: &Physics<f32>) {
    let particles = scene.layout().particles() as f64;
    // What is too long as a whole must be refused as a whole.
    if scene.duration_s / time_step_s(scene, physics) * particles > MOST_PARTICLE_STEPS {
        return;
    }
    scene.duration_s = scene.duration_s.min(affordable_s(scene, physics));
    scene.score_from_s = scene.score_from_s.min(scene.duration_s);
    let late_s = f64::from(-scene.clock_offset_s(physics)).max(0.0);
    let last_s = scene.duration_s - late_s;
    scene.frame_times_s.retain(|&t_s| t_s < last_s);
    if last_s >= 0.0 {
        scene.frame_times_s.push(last_s);
    }
}

fn play(
    Drawn {
        scene,
        physics,
        natural_s,
    }: &Drawn,
) -> Outcome {
    let released = scene
        .grips
        .iter()
        .any(|g| g.path.closed(0.0) && !g.path.closed(scene.duration_s));
    match simulate(scene, physics) {
        Err(error) => refused(&error),
        Ok(rollout) => {
            let points = rollout
                .frames
                .iter()
                .chain(&rollout.grip_forces_n)
                .flatten()
                .flatten();
            let finite = points.chain(&rollout.reach_m).all(|x| x.is_finite());
            let told = rollout.frames.len() == scene.frame_times_s.len();
            Outcome {
                kind: if finite && told { "ran" } else { SILENT },
                message: String::new(),
                steps: rollout.steps,
                whole: scene.duration_s >= *natural_s,
                released,
            }
        }
    }
}
