//! The paper's tables of policies in simulation: which of its inputs a policy needs (the ablation), and what ropes beside
//! those that it learnt from cost it (the generalization test).
//!
//! Every policy learns from as many rollouts of the paper's rope in its own ranges, by the paper's regression and, in
//! another column, as this program's policies learn besides ([`crate::train`]), without rounds of their own answers. The
//! latter are told the nearest rope of their ranges, as in a run.
//! An input that is not given is drawn anew for each rollout: it says nothing. Goals are what a release drawn at random
//! reached with the rope that is asked about, so every goal can be reached.
//!
//! "R2S2R" is what the paper's authors call so: the same network without parameters, on rollouts of fixed ropes.

use super::scene::rope;
use super::table::Spread;
use crate::collect::{Dataset, Design, Sample, Stopped, Swinger, Watch, collect, stream};
use crate::evaluate::evaluate_told;
use crate::fit::Resolution;
use crate::model::Structure;
use crate::model_file::swing_hash;
use crate::paper_units::{METRES_PER_UNIT, young_pa};
use crate::pipeline::{Preset, RunSettings};
use crate::reach::Practice;
use crate::run_files::RunFolder;
use crate::sim::rope::RopeShape;
use crate::swing::SimulatedSwing;
use crate::train::{Learner, Schedule, TrainSettings};
use crate::trained::Trained;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use shared::policy::Policy;
use shared::task::{Interval, SwingTask};
use std::fmt::Write;
use std::path::Path;
use std::sync::atomic::Ordering;

/// The paper's ranges for policies in simulation, E in its units.
const YOUNG_UNITS: Interval = Interval {
    low: 1500.0,
    high: 8200.0,
};
const POISSON: Interval = Interval {
    low: 0.34,
    high: 0.36,
};
/// Its ranges out of distribution.
const OUTSIDE: [Interval; 2] = [
    Interval {
        low: 500.0,
        high: 1500.0,
    },
    Interval { low: 0.3, high: 0.33 },
];
/// Its three ropes as it estimated them, red, white and yellow: E in its units and ν.
const ROPES: [[f64; 2]; 3] = [[1779.38, 0.35], [3276.12, 0.346], [8000.31, 0.36]];

/// How often the paper's policies go through what they learn from, and how much of it is in a step.
const EPOCHS: u64 = 300;
const BATCH: u64 = 256;

/// Random streams of goals and of inputs that are not given lie above those of rollouts and of training.
const GOALS: u64 = 1 << 52;
const UNTOLD: u64 = 1 << 53;

/// How much is done for a table.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Rollouts that each policy learns from; the paper has 2,271.
    pub rollouts: u64,
    /// Cells across the rope.
    pub cells: f64,
    /// How the networks learn; without rounds.
    pub training: TrainSettings,
    /// Seed of everything random.
    pub seed: u64,
}

impl Settings {
    /// Settings of a preset, with another number of rollouts where one is given. Regression goes through them as often as
    /// the paper's does.
    pub fn of(preset: Preset, rollouts: Option<u64>, seed: u64) -> Self {
        let usual = if preset == Preset::Quick { 400 } else { 2271 };
        let rollouts = rollouts.unwrap_or(usual);
        Self {
            rollouts,
            cells: RunSettings::of(preset, seed).cells,
            training: TrainSettings {
                regression: Schedule {
                    steps: (EPOCHS * rollouts).div_ceil(BATCH) as usize,
                    batch: BATCH as usize,
                    ..TrainSettings::QUICK.regression
                },
                rounds: 0,
                seed,
                ..TrainSettings::QUICK
            },
            seed,
        }
    }
}

/// Which parameters of the rope a policy is told.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Told {
    young: bool,
    poisson: bool,
}

impl Told {
    const BOTH: Self = Self {
        young: true,
        poisson: true,
    };
    const NOTHING: Self = Self {
        young: false,
        poisson: false,
    };

    /// The first rope's parameters where they are told, the second's where they are not.
    fn of(self, rope: (f64, f64), other: (f64, f64)) -> (f64, f64) {
        (
            if self.young { rope.0 } else { other.0 },
            if self.poisson { rope.1 } else { other.1 },
        )
    }
}

/// One row: a policy, or two that learnt alike.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// What it is.
    pub name: String,
    /// Which ropes it is asked about.
    pub ropes: &'static str,
    /// |goal − reached| of the paper's regression, paper length units.
    pub regression: Spread,
    /// The same with this program's correction.
    pub corrected: Spread,
    /// Goals of both that no swing answered.
    pub refused: usize,
    /// What the paper prints.
    pub printed: &'static str,
}

/// A table of policies.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PolicyTable {
    /// What it shows and how it was made.
    pub title: String,
    /// Rows.
    pub rows: Vec<Row>,
}

impl PolicyTable {
    /// As Markdown.
    pub fn markdown(&self) -> String {
        let mut text = format!("{}\n\n", self.title);
        text += "| policy | ropes | n | paper's regression, paper units | mm | with our correction, paper units | mm | \
                 refused | paper |\n";
        text += &format!("|{}\n", "---|".repeat(9));
        let mm = |s: &Spread| {
            let scale = 1e3 * METRES_PER_UNIT;
            format!("{:.1} ± {:.1}", scale * s.mean, scale * s.deviation)
        };
        for row in &self.rows {
            let (regression, corrected) = (&row.regression, &row.corrected);
            let _ = writeln!(
                text,
                "| {} | {} | {} | {} | {} | {} | {} | {} | {} |",
                row.name,
                row.ropes,
                corrected.n,
                regression.shown(4),
                mm(regression),
                corrected.shown(4),
                mm(corrected),
                row.refused,
                row.printed
            );
        }
        text
    }
}

/// The bench on which policies learn and are asked.
struct Field<'a> {
    settings: &'a Settings,
    folder: RunFolder,
    design: Design,
    shape: RopeShape,
    swinger: &'a dyn Swinger,
    watch: Watch<'a>,
}

impl<'a> Field<'a> {
    fn new(
        settings: &'a Settings,
        out: &Path,
        swinger: &'a dyn Swinger,
        watch: Watch<'a>,
    ) -> anyhow::Result<Self> {
        let (shape, own) = (rope(), swing(settings));
        Ok(Self {
            design: Design {
                young_pa: pascals(&YOUNG_UNITS, &shape),
                poisson: POISSON,
                region: Design::region(&own.task, own.free_length_m()),
                goal_x_m: own.task.goal_x_m,
                rollouts: settings.rollouts,
                seed: settings.seed,
            },
            settings,
            folder: RunFolder::open(out)?,
            shape,
            swinger,
            watch,
        })
    }

    /// Rollouts of the random design.
    fn random(&self) -> anyhow::Result<Dataset> {
        self.design.check()?;
        self.rolled_out(0, &self.design.samples())
    }

    /// As many rollouts of some of the paper's ropes by turns; releases are those of the random design.
    fn of_ropes(&self, ropes: &[[f64; 2]]) -> anyhow::Result<Dataset> {
        let sample = |sample: Sample| {
            let (young_pa, poisson) = self.paper_rope(ropes[sample.index as usize % ropes.len()]);
            Sample {
                young_pa,
                poisson,
                ..sample
            }
        };
        let samples: Vec<Sample> = self.design.samples().into_iter().map(sample).collect();
        self.rolled_out(ropes.len(), &samples)
    }

    fn rolled_out(&self, number: usize, samples: &[Sample]) -> anyhow::Result<Dataset> {
        let folder = self.folder.rollouts(number);
        let model = swing_hash(&self.shape, self.settings.cells).value();
        collect(samples, self.swinger, &folder, model, self.watch)
    }

    fn paper_rope(&self, [young_units, poisson]: [f64; 2]) -> (f64, f64) {
        (young_pa(young_units, self.shape.density_kg_m3()), poisson)
    }

    /// What a policy learns that is told so much.
    fn learnt(&self, mut dataset: Dataset, told: Told) -> anyhow::Result<Trained> {
        for row in &mut dataset.rows {
            let sample = &mut row.sample;
            let other = self
                .design
                .rope(&mut stream(self.settings.seed, UNTOLD + sample.index));
            (sample.young_pa, sample.poisson) = told.of((sample.young_pa, sample.poisson), other);
        }
        let learner = Learner::start(&self.design, dataset, &self.settings.training, self.watch)?;
        Ok(learner.finish()?)
    }

    /// Goals of the task that random releases reach, for ropes that `rope` draws. `set` tells lists of goals apart.
    fn goals(
        &self,
        [set, count]: [u64; 2],
        rope: &(dyn Fn(u64, &mut rand_chacha::ChaCha8Rng) -> (f64, f64) + Sync),
    ) -> anyhow::Result<Vec<Practice>> {
        let goal = |index: u64| {
            let mut rng = stream(self.settings.seed, GOALS + (set << 32) + index);
            loop {
                if self.watch.stop.load(Ordering::Relaxed) {
                    return Err(Stopped.into());
                }
                let (young_pa, poisson) = rope(index, &mut rng);
                let release_m = self.design.release(&mut rng);
                if let Ok(goal_x_m) = self.swinger.reach_m(young_pa, poisson, release_m)
                    && self.design.goal_x_m.contains(goal_x_m)
                {
                    return Ok(Practice {
                        goal_x_m,
                        young_pa,
                        poisson,
                    });
                }
            }
        };
        (0..count).into_par_iter().map(goal).collect()
    }

    /// How far a policy that is told so much of a rope misses its goals, paper units; and how many no swing answered.
    /// `within` says whether it is told no more than that learnt from, as a run tells its policy.
    fn misses(
        &self,
        policy: &Policy,
        (told, within): (Told, bool),
        goals: &[Practice],
    ) -> anyhow::Result<(Spread, usize)> {
        let Design {
            young_pa, poisson, ..
        } = &self.design;
        let middle = (
            (0.5 * (young_pa.low.ln() + young_pa.high.ln())).exp(),
            poisson.at(0.5),
        );
        let of = |goal: &Practice| {
            let (e, nu) = told.of((goal.young_pa, goal.poisson), middle);
            if within {
                (young_pa.clamp(e), poisson.clamp(nu))
            } else {
                (e, nu)
            }
        };
        let found = evaluate_told(policy, self.swinger, goals, &of, self.watch)?;
        let spread = found.miss.map_or_else(
            || Spread::of(&[]),
            |miss| Spread {
                mean: miss.mean_paper,
                deviation: miss.spread_paper,
                n: miss.count,
            },
        );
        Ok((spread, goals.len() - spread.n))
    }

    fn row(
        &self,
        (name, ropes, printed): (&str, &'static str, &'static str),
        (trained, told): (&Trained, Told),
        goals: &[Practice],
    ) -> anyhow::Result<Row> {
        let (regression, refused) = self.misses(&trained.regression, (told, false), goals)?;
        let (corrected, also) = self.misses(&trained.policy, (told, true), goals)?;
        Ok(Row {
            name: name.into(),
            ropes,
            regression,
            corrected,
            refused: refused + also,
            printed,
        })
    }

    fn title(&self, what: &str) -> String {
        format!(
            "{what}: |goal − reached| in simulation, {} rollouts for each policy, regression in {} steps of {}, {:.2} cells \
             across the rope, seed {}",
            self.settings.rollouts,
            self.settings.training.regression.steps,
            self.settings.training.regression.batch,
            self.settings.cells,
            self.settings.seed
        )
    }
}

/// The paper's rope and task.
fn swing(settings: &Settings) -> SimulatedSwing {
    SimulatedSwing {
        rope: rope(),
        task: SwingTask::PAPER,
        structure: Structure::default(),
        effect_values: Vec::new(),
        resolution: Resolution {
            cells: settings.cells,
        },
    }
}

fn pascals(units: &Interval, shape: &RopeShape) -> Interval {
    let pa = |units: f64| young_pa(units, shape.density_kg_m3());
    Interval {
        low: pa(units.low),
        high: pa(units.high),
    }
}

/// Goals of the ablation, and of each half of the generalization test.
const ABLATION_GOALS: u64 = 30;
const GENERALIZATION_GOALS: u64 = 40;

/// The ablation: what each of a policy's inputs is worth.
///
/// # Errors
/// Stopped on request, too few rollouts had a score, or a file cannot be written.
pub fn ablation(settings: &Settings, out: &Path, watch: Watch) -> anyhow::Result<PolicyTable> {
    let swing = swing(settings);
    ablation_on(&Field::new(settings, out, &swing, watch)?)
}

fn ablation_on(field: &Field) -> anyhow::Result<PolicyTable> {
    let dataset = field.random()?;
    let goals = field.goals([0, ABLATION_GOALS], &|_, rng| field.design.rope(rng))?;
    let told = |young, poisson| Told { young, poisson };
    let inputs = [
        ("both parameters", told(true, true), "0.024 ± 0.021"),
        ("Young's modulus", told(true, false), "0.034 ± 0.040"),
        ("Poisson's ratio", told(false, true), "0.062 ± 0.058"),
        ("no parameters", told(false, false), "0.062 ± 0.059"),
    ];
    let row = |&(name, told, printed): &(&str, Told, &'static str)| {
        let trained = field.learnt(dataset.clone(), told)?;
        field.row((name, "new, same ranges", printed), (&trained, told), &goals)
    };
    Ok(PolicyTable {
        title: field.title("Ablation of the inputs"),
        rows: inputs.iter().map(row).collect::<anyhow::Result<_>>()?,
    })
}

/// The generalization test: ropes that were learnt from, and ropes outside of all ranges.
///
/// # Errors
/// Stopped on request, too few rollouts had a score, or a file cannot be written.
pub fn generalization(settings: &Settings, out: &Path, watch: Watch) -> anyhow::Result<PolicyTable> {
    let swing = swing(settings);
    let field = Field::new(settings, out, &swing, watch)?;
    let outside = Design {
        young_pa: pascals(&OUTSIDE[0], &field.shape),
        poisson: OUTSIDE[1],
        ..field.design
    };
    let known =
        |index: u64, _: &mut rand_chacha::ChaCha8Rng| field.paper_rope(ROPES[index as usize % ROPES.len()]);
    let inside = field.goals([1, GENERALIZATION_GOALS], &known)?;
    let beyond = field.goals([2, GENERALIZATION_GOALS], &|_, rng| outside.rope(rng))?;
    let policies = [
        (
            "ours",
            field.random()?,
            Told::BOTH,
            ["0.031 ± 0.050", "0.039 ± 0.042"],
        ),
        (
            "R2S2R, three ropes",
            field.of_ropes(&ROPES)?,
            Told::NOTHING,
            ["0.082 ± 0.081", "0.096 ± 0.104"],
        ),
        (
            "R2S2R, red rope",
            field.of_ropes(&ROPES[..1])?,
            Told::NOTHING,
            ["0.047 ± 0.033", "0.046 ± 0.044"],
        ),
    ];
    let mut rows = Vec::new();
    for (name, dataset, told, [id, ood]) in policies {
        let trained = field.learnt(dataset, told)?;
        let asked = [("the three", &inside, id), ("outside all ranges", &beyond, ood)];
        for (ropes, goals, printed) in asked {
            rows.push(field.row((name, ropes, printed), (&trained, told), goals)?);
        }
    }
    Ok(PolicyTable {
        title: field.title("Ropes inside and outside of what was learnt from"),
        rows,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::collect::stand_in::{DoublePendulum, unwatched};

    /// Of ropes whose stiffness changes the reach, as the stand-in's does.
    #[test]
    fn a_policy_that_is_told_nothing_of_the_rope_misses_by_more() {
        let settings = Settings::of(Preset::Quick, None, 3);
        let folder = tempfile::tempdir().unwrap();
        let field = Field::new(&settings, folder.path(), &DoublePendulum, unwatched()).unwrap();
        let table = ablation_on(&field).unwrap();
        let means: Vec<f64> = table.rows.iter().map(|row| row.corrected.mean).collect();
        assert!(2.0 * means[0] < means[3], "{means:?}");
        assert!(table.rows.iter().all(|row| row.refused == 0), "{table:?}");
        let text = table.markdown();
        assert!(
            text.contains("| both parameters | new, same ranges | 30 |"),
            "{text}"
        );
        assert!(text.contains("0.062 ± 0.059"), "{text}");
    }
}
