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
use self::words::EXPLAINS;
use super::noise::Noise;
use super::rounds::{LoopOptions, Outcome, problems};
use crate::demo::{Demo, SceneKind};
use crate::fit::{Correlation, FitError, KNOTS, Problem};
use crate::sim::physics::GRAVITY_M_S2;
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

/// The force that would explain what the final model leaves; none for poses at rest, where no time passes.
///
/// # Errors
/// A simulation stopped, or too little was measured.
pub fn residual_force(
    demos: &[&Demo],
    held_out: &[&Demo],
    outcome: &Outcome,
    options: &LoopOptions,
) -> Result<Option<ResidualForce>, FitError> {
    if demos.iter().any(|demo| demo.spec.scene == SceneKind::Static) {
        return Ok(None);
    }
    let (fit, _) = problems(demos, held_out, options)?;
    let noise_scale = outcome.noise_scale.unwrap_or(1.0);
    let noise = noise_of(outcome);
    let mut found = Vec::new();
    for (&demo, scene) in demos.iter().zip(fit.scenes) {
        let mut problem = Problem::of_scenes(vec![demo], vec![scene]);
        problem.noise_scale = noise_scale;
        found.push(estimate(
            &problem,
            &outcome.structure,
            &outcome.fitted.best.theta,
            &noise,
        )?);
    }
    Ok(Some(summary(&found, options.seed)))
}

/// The noise's correlation is not kept beyond the loop; that of the final residual is an upper bound on it, which
/// costs a hint some sharpness and invents nothing.
fn noise_of(outcome: &Outcome) -> Noise {
    let correlation = Correlation::of(&outcome.fitted.best);
    Noise {
        scale: outcome.noise_scale.unwrap_or(1.0),
        in_time: correlation.in_time.min(MOST_ALIKE),
        along_rope: correlation.along_rope.min(MOST_ALIKE),
        values: f64::INFINITY,
    }
}

/// Beyond it whitening would see nothing but the fastest changes.
const MOST_ALIKE: f64 = 0.7;

/// A vector by block and knot with what it weighs.
struct Cell<'a> {
    force_n_m: [f64; 3],
    motion: &'a Motion,
    /// Length of rope times time, m s.
    extent: f64,
}

fn summary(found: &[Estimated], seed: u64) -> ResidualForce {
    let cells: Vec<Cell> = found.iter().flat_map(cells_of).collect();
    let sum = |of: &dyn Fn(&Cell) -> f64| cells.iter().map(|c| c.extent * of(c)).sum::<f64>();
    let square = |f: [f64; 3]| f.iter().map(|x| x * x).sum::<f64>();
    let (all, pushes) = (sum(&|_| 1.0), sum(&|c| square(c.force_n_m)));
    let mean = |of: &dyn Fn(&Cell) -> f64| sum(of) / all;
    let pushed = |of: &dyn Fn(&Cell) -> f64| sum(&|c| square(c.force_n_m) * of(c)) / pushes;
    let power = |c: &Cell| {
        (0..3)
            .map(|k| c.force_n_m[k] * c.motion.velocity_m_s[k])
            .sum::<f64>()
    };
    let weight_n_m = found.iter().map(|f| f.weight_n_m).sum::<f64>() / found.len() as f64;
    let (mut left, mut before) = (0.0, 0.0);
    for f in found {
        left += f.excess_m2[1];
        before += f.excess_m2[0];
    }
    let mut force = ResidualForce {
        in_words: String::new(),
        demos: found.iter().map(|f| f.force.clone()).collect(),
        removed: 1.0 - left / before,
        of_weight: (pushes / all).sqrt() / weight_n_m,
        static_share: found.iter().map(steady_square).sum::<f64>() / pushes,
        work_j: [sum(&|c| power(c).max(0.0)), sum(&|c| (-power(c)).max(0.0))],
        speed_ratio: pushed(&|c| c.motion.speed_m_s()) / mean(&|c| c.motion.speed_m_s()).max(1e-9),
        higher_m: pushed(&|c| c.motion.position_m[2]) - mean(&|c| c.motion.position_m[2]),
        terms: stable_terms(found, seed),
    };
    force.in_words = words::sentence(&force);
    force
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

/// Weight of a metre of a demonstration's rope, N.
fn weight_n_m(demo: &Demo) -> f64 {
    demo.spec.rope.mass_kg / demo.spec.rope.length_m * GRAVITY_M_S2
}
