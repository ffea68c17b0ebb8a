//! What nobody explains, as a force along the rope: how large, where and when, whether it feeds or brakes the rope, and
//! which simple laws describe it. A hint for people, never a cause: a force can imitate what is none, such as a
//! camera that moves.
//!
//! Data flows one way: `estimate` finds the force of each demonstration, [`motion`] says how the rope moves where and
//! when it pushes, [`terms`] asks which laws describe it in most halves of the data, `words` says it in a sentence.

mod estimate;
mod motion;
pub mod terms;
mod words;

use self::estimate::{Estimated, estimate};
use self::motion::Motion;
use self::terms::{TermShare, stable_terms};
use super::rounds::{LoopOptions, Outcome};
use crate::demo::Demo;
use crate::fit::{FitError, KNOTS, Problem};
use crate::sim::Scene;
use crate::sim::tensor::dot;
use serde::{Deserialize, Serialize};

/// Blocks of time of a demonstration in which the force is constant.
const BLOCKS: usize = 10;

/// The force that would explain what a model leaves.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ResidualForce {
    /// What stands below, as a sentence.
    pub in_words: String,
    /// The force of each demonstration.
    pub demos: Vec<DemoForce>,
    /// Share of the excess over the noise that it takes away when the rope is simulated under it.
    pub removed: f64,
    /// Its root mean square over the weight of the rope, both per length.
    pub of_weight: f64,
    /// Share of its mean square that does not change over time.
    pub static_share: f64,
    /// Work that it does on the rope, and work that it takes out of it, J.
    pub work_j: [f64; 2],
    /// Mean speed of the rope where and when it pushes, over the mean speed.
    pub speed_ratio: f64,
    /// Mean height of the rope where and when it pushes, above its mean height, m.
    pub higher_m: f64,
    /// Laws, and how often each was among the best on half of the data; the most frequent first.
    pub terms: Vec<TermShare>,
}

/// Share of the excess that a force has to take away to be worth describing.
const EXPLAINS: f64 = 0.5;

impl ResidualForce {
    /// Whether it takes away enough to be worth a look.
    pub fn explains(&self) -> bool {
        self.removed >= EXPLAINS
    }
}

/// The force on one demonstration's rope.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DemoForce {
    /// Name of the demonstration.
    pub demo: String,
    /// Length of a block of time, s; the first starts at zero.
    pub block_s: f64,
    /// Arc lengths of the knots between which it is linear, m.
    pub knots_m: [f64; KNOTS],
    /// Force per length, N/m along (x, y, z), by block and knot.
    pub force_n_m: Vec<[[f64; 3]; KNOTS]>,
}

/// The force that would explain what the final model leaves of what moves; poses at rest, where no time passes, have none.
///
/// # Errors
/// A simulation stopped, or too little was measured.
pub fn residual_force(
    demos: &[&Demo],
    outcome: &Outcome,
    options: &LoopOptions,
) -> Result<Option<ResidualForce>, FitError> {
    let moves = |demo: &Demo| !demo.spec.is_static();
    if !demos.iter().any(|demo| moves(demo)) {
        return Ok(None);
    }
    let scenes = Problem::new(demos, options.resolution)?.scenes;
    let theta = &outcome.fitted.best.theta;
    let one = |(&demo, scene): (&&Demo, Scene)| {
        let mut problem = Problem::of_scenes(vec![demo], vec![scene]);
        problem.noise_scale = outcome.noise.scale;
        let problem =
            problem
                .settled(&outcome.structure, theta)?
                .refined(options.finer, &outcome.structure, theta)?;
        estimate(&problem, &outcome.structure, theta, &outcome.noise)
    };
    let moving = demos.iter().zip(scenes).filter(|(demo, _)| moves(demo));
    let found: Vec<Estimated> = moving.map(one).collect::<Result<_, _>>()?;
    Ok(Some(summary(&found, options.seed)))
}

/// The force at one knot in one block of time.
struct Cell<'a> {
    force_n_m: [f64; 3],
    motion: &'a Motion,
    /// Length of rope times time, m s.
    extent: f64,
}

fn summary(found: &[Estimated], seed: u64) -> ResidualForce {
    let cells: Vec<Cell> = found.iter().flat_map(cells_of).collect();
    let sum = |of: &dyn Fn(&Cell) -> f64| cells.iter().map(|c| c.extent * of(c)).sum::<f64>();
    let square = |c: &Cell| dot(c.force_n_m, c.force_n_m);
    let power = |c: &Cell| dot(c.force_n_m, c.motion.velocity_m_s);
    let (all, pushes) = (sum(&|_| 1.0), sum(&square));
    let mean = |of: &dyn Fn(&Cell) -> f64| share(sum(of), all);
    let pushed = |of: &dyn Fn(&Cell) -> f64| share(sum(&|c| square(c) * of(c)), pushes);
    let total = |of: fn(&Estimated) -> f64| found.iter().map(of).sum::<f64>();
    let taken = total(|f| f.excess_m2[0] - f.excess_m2[1]);
    let mut force = ResidualForce {
        in_words: String::new(),
        demos: found.iter().map(|f| f.force.clone()).collect(),
        removed: share(taken, total(|f| f.excess_m2[0])),
        of_weight: share(
            share(pushes, all).sqrt() * found.len() as f64,
            total(|f| f.weight_n_m),
        ),
        static_share: share(total(steady_square), pushes),
        work_j: [sum(&|c| power(c).max(0.0)), sum(&|c| (-power(c)).max(0.0))],
        speed_ratio: share(pushed(&|c| c.motion.speed_m_s()), mean(&|c| c.motion.speed_m_s())),
        higher_m: pushed(&|c| c.motion.position_m[2]) - mean(&|c| c.motion.position_m[2]),
        terms: stable_terms(found, seed),
    };
    force.in_words = words::sentence(&force);
    force
}

/// A part of a whole; nothing of nothing.
fn share(part: f64, whole: f64) -> f64 {
    if whole > 0.0 { part / whole } else { 0.0 }
}

impl DemoForce {
    /// The middle of a block of time, s.
    pub fn middle_s(&self, block: usize) -> f64 {
        (block as f64 + 0.5) * self.block_s
    }
}

/// Length of rope that each knot stands for, m.
fn lengths_m(force: &DemoForce) -> [f64; KNOTS] {
    let gap_m = (force.knots_m[KNOTS - 1] - force.knots_m[0]) / (KNOTS - 1) as f64;
    let ends = [0, KNOTS - 1];
    std::array::from_fn(|knot| if ends.contains(&knot) { 0.5 * gap_m } else { gap_m })
}

fn cells_of(found: &Estimated) -> impl Iterator<Item = Cell<'_>> {
    let lengths_m = lengths_m(&found.force);
    found
        .force
        .force_n_m
        .iter()
        .zip(&found.motions)
        .flat_map(move |(forces, motions)| {
            (0..KNOTS).map(move |knot| Cell {
                force_n_m: forces[knot],
                motion: &motions[knot],
                extent: lengths_m[knot] * found.force.block_s,
            })
        })
}

/// The mean square of the force's mean over time, times length and time.
fn steady_square(found: &Estimated) -> f64 {
    let blocks = found.force.force_n_m.len() as f64;
    let at = |knot: usize| -> f64 {
        let mean = |k: usize| found.force.force_n_m.iter().map(|f| f[knot][k]).sum::<f64>() / blocks;
        (0..3).map(|k| mean(k).powi(2)).sum()
    };
    let lengths_m = lengths_m(&found.force);
    (0..KNOTS).map(|k| lengths_m[k] * at(k)).sum::<f64>() * found.force.block_s * blocks
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::Pushes;
    use nalgebra::{DMatrix, DVector};

    /// A rope that moves at 2 m/s along x, pushed by what `force` gives for each block.
    fn found(force: impl Fn(usize) -> [f64; 3], excess_m2: [f64; 2]) -> Estimated {
        let pushes = Pushes {
            block_s: 0.1,
            blocks: BLOCKS,
            knots_m: [0.0, 0.1, 0.2, 0.3],
        };
        let motion = |knot: usize| Motion {
            velocity_m_s: [2.0, 0.0, 0.0],
            knot,
            ..Motion::default()
        };
        Estimated {
            force: DemoForce {
                demo: "r".into(),
                block_s: pushes.block_s,
                knots_m: pushes.knots_m,
                force_n_m: (0..BLOCKS).map(|block| [force(block); KNOTS]).collect(),
            },
            motions: (0..BLOCKS).map(|_| std::array::from_fn(motion)).collect(),
            residual: DVector::zeros(BLOCKS),
            slopes: DMatrix::zeros(BLOCKS, pushes.components()),
            blocks: (0..BLOCKS).collect(),
            excess_m2,
            weight_n_m: 2.0,
        }
    }

    #[test]
    fn shares_work_and_size_of_known_forces_are_exact() {
        let steady = summary(&[found(|_| [-1.0, 0.0, 0.0], [4.0, 1.0])], 1);
        let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-12, "{a}, not {b}");
        near(steady.removed, 0.75);
        near(steady.of_weight, 0.5);
        near(steady.static_share, 1.0);
        near(steady.speed_ratio, 1.0);
        // 1 N/m against 2 m/s over 0.3 m and 1 s.
        near(steady.work_j[0], 0.0);
        near(steady.work_j[1], 0.6);
        let turns = |block: usize| [if block.is_multiple_of(2) { 1.0 } else { -1.0 }, 0.0, 0.0];
        let turning = summary(&[found(turns, [4.0, 5.0])], 1);
        near(turning.static_share, 0.0);
        near(turning.work_j[0], 0.3);
        near(turning.removed, -0.25);
    }

    #[test]
    fn nothing_is_no_number_that_a_file_cannot_hold() {
        let none = summary(&[found(|_| [0.0; 3], [0.0, 0.0])], 1);
        let text = serde_json::to_string(&none).unwrap();
        assert_eq!(serde_json::from_str::<ResidualForce>(&text).unwrap(), none);
    }
}
