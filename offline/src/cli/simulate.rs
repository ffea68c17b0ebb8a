//! `offline simulate`: what a rope does, moved as in a demonstration or let go in a swing.

use super::WrongUse;
use super::numbers::{finite, within};
use super::output::{note, print};
use super::runs::shipped;
use anyhow::Context;
use clap::Args;
use offline::collect::Swinger;
use offline::demo::{Demo, refuse_to_replace};
use offline::effects;
use offline::fit::Resolution;
use offline::model::{POISSON_PRIOR, POISSON_RANGE, Structure, YOUNG_RANGE_PA};
use offline::model_file::ModelFile;
use offline::play::{Played, play};
use offline::sim::rope::RopeShape;
use offline::sim::scene::MIN_CELLS_PER_DIAMETER;
use offline::swing::SimulatedSwing;
use shared::task::SwingTask;
use std::path::{Path, PathBuf};

/// Cells across the rope: fewer bend too easily, and the work grows with their fourth power, at the end of the range
/// to 800 times that of its beginning.
pub const CELLS: [f64; 2] = [MIN_CELLS_PER_DIAMETER, 8.0];

/// Which rope does what.
#[derive(Args)]
pub struct SimulateArguments {
    /// Rope: a run, or a model.toml. Values given beside it replace its own.
    #[arg(long, value_name = "RUN|FILE")]
    model: Option<PathBuf>,
    /// Young's modulus, Pa.
    #[arg(long, value_parser = within(YOUNG_RANGE_PA), required_unless_present = "model", allow_negative_numbers = true)]
    young_pa: Option<f64>,
    /// Poisson's ratio; 0.3 without a model.
    #[arg(long, value_parser = within(POISSON_RANGE), allow_negative_numbers = true)]
    poisson: Option<f64>,
    /// An effect and its parameters, listed below: tip_mass=0.009.
    #[arg(long, value_name = "ID=VALUE[,VALUE]", num_args = 1.., value_parser = effect)]
    effect: Vec<Effect>,
    /// Demonstration whose rope is moved as it was; the shipped sample rope's by default.
    #[arg(long, value_name = "DIR")]
    demo: Option<PathBuf>,
    /// Swing instead: release the rope's end at this point of the task's plane, m, and say how far it reaches.
    #[arg(long, num_args = 2, value_names = ["X", "Z"], value_parser = finite, allow_negative_numbers = true)]
    release: Option<Vec<f64>>,
    /// Cells across the rope: a finer grid is slower. By default as a diagnosis predicts a demonstration, and as a policy
    /// is taught a swing, on a coarser one.
    #[arg(long, value_parser = within(CELLS))]
    cells: Option<f64>,
    /// Demonstration folder to write, with the simulated rope's points as markers.
    #[arg(long, value_name = "DIR", conflicts_with = "release")]
    out: Option<PathBuf>,
}

/// Examples, and what the effects' parameters are.
pub fn after_help() -> String {
    let mut help = String::from(
        "Examples: offline simulate --model runs/sample-rope --demo my-rope/lift-1 --out simulated\n          \
         offline simulate --young-pa 0.9e6 --effect tip_mass=0.009 --release 0.08 0.15\n\n\
         Effects, their parameters and the ranges of these:",
    );
    for spec in effects::ALL {
        let parameters = spec.parameters.iter();
        let parameters: Vec<String> = parameters
            .map(|p| format!("{} {} to {}", p.name, p.low, p.high))
            .collect();
        help += &format!("\n  {:<18} {}", spec.id, parameters.join(", "));
    }
    help
}

/// An effect of the registry with its parameters.
#[derive(Clone, Debug)]
struct Effect {
    index: usize,
    values: Vec<f64>,
}

fn effect(text: &str) -> Result<Effect, String> {
    let (id, values) = text
        .split_once('=')
        .ok_or("write the effect, an equals sign and its parameters")?;
    let index = effects::known(id)?;
    let values: Vec<f64> = values
        .split(',')
        .map(|value| value.parse().map_err(|_| format!("`{value}` is no number")))
        .collect::<Result<_, _>>()?;
    let parameters = effects::ALL[index].parameters;
    if values.len() != parameters.len() {
        let names: Vec<String> = parameters
            .iter()
            .map(|p| format!("{} ({})", p.name, p.unit))
            .collect();
        return Err(format!(
            "{id} has {} parameters: {}",
            names.len(),
            names.join(", ")
        ));
    }
    for (value, p) in values.iter().zip(parameters) {
        if !(p.low..=p.high).contains(value) {
            return Err(format!("{} lies from {} to {} {}", p.name, p.low, p.high, p.unit));
        }
    }
    Ok(Effect { index, values })
}

/// A rope as simulations take it.
struct Rope {
    /// Shape and mass; none where no model says.
    shape: Option<RopeShape>,
    structure: Structure,
    /// ln E, ν, parameters of the effects.
    theta: Vec<f64>,
}

impl Rope {
    fn of(arguments: &SimulateArguments) -> anyhow::Result<Self> {
        let model = arguments
            .model
            .as_deref()
            .map(ModelFile::of_run_or_file)
            .transpose()?;
        let (mut structure, mut values) = match &model {
            Some(model) => model.structure()?,
            None => (Structure::default(), Vec::new()),
        };
        for (k, effect) in arguments.effect.iter().enumerate() {
            if arguments.effect[..k]
                .iter()
                .any(|other| other.index == effect.index)
            {
                let id = effects::ALL[effect.index].id;
                anyhow::bail!(WrongUse(format!(
                    "--effect {id} stands there twice: give it once"
                )));
            }
            replace(&mut structure, &mut values, effect);
        }
        let of_model = |k: usize| model.as_ref().map(|model| model.elasticity[k].value);
        let young_pa = arguments
            .young_pa
            .or(of_model(0))
            .context("clap asks for one of them")?;
        let poisson = arguments.poisson.or(of_model(1)).unwrap_or(POISSON_PRIOR[0]);
        let mut theta = vec![young_pa.ln(), poisson];
        theta.extend(values);
        Ok(Self {
            shape: model.map(|model| model.rope),
            structure,
            theta,
        })
    }
}

/// Adds an effect, or gives it other values where the structure has it.
fn replace(structure: &mut Structure, values: &mut Vec<f64>, effect: &Effect) {
    let mut first = 0;
    for &index in &structure.effects {
        let count = effects::ALL[index].parameters.len();
        if index == effect.index {
            values[first..first + count].copy_from_slice(&effect.values);
            return;
        }
        first += count;
    }
    *structure = structure.with(effect.index);
    values.extend(&effect.values);
}

/// Simulates and says what the rope did.
pub fn run(arguments: &SimulateArguments, json: bool) -> anyhow::Result<()> {
    let rope = Rope::of(arguments)?;
    for effect in &arguments.effect {
        let spec = &effects::ALL[effect.index];
        if let Some(words) = spec.in_words(&effect.values) {
            note(format_args!("{}: {words}", spec.id));
        }
    }
    let folder = || -> anyhow::Result<PathBuf> {
        match &arguments.demo {
            Some(folder) => Ok(folder.clone()),
            None => Ok(shipped()?[0].clone()),
        }
    };
    let on = |usual: Resolution| arguments.cells.map_or(usual, |cells| Resolution { cells });
    let swing = |shape: RopeShape, release: &[f64]| {
        let release_m = [release[0], release[1]];
        swing(&rope, shape, release_m, on(Resolution::COARSEST), json)
    };
    if let (Some(release), Some(shape), None) = (&arguments.release, rope.shape, &arguments.demo) {
        return swing(shape, release);
    }
    if let Some(out) = &arguments.out {
        // Before minutes of simulation, not after them.
        refuse_to_replace(out)?;
    }
    let demo = Demo::load_to_simulate(folder()?)?;
    let shape = RopeShape::of_spec(&demo.spec.rope);
    if rope.shape.is_some_and(|own| !own.is_of_one_rope(&shape)) {
        note(
            "warning: the model is of another rope than the demonstration: size and mass are the demonstration's",
        );
    }
    if let Some(release) = &arguments.release {
        return swing(shape, release);
    }
    let played = play(
        &demo,
        &rope.structure,
        &rope.theta,
        on(Resolution::COARSEST.finer()),
    )?;
    if let Some(out) = &arguments.out {
        played.demo.save(out)?;
    }
    say(&demo, &played, arguments.out.as_deref(), json)
}

fn swing(
    rope: &Rope,
    shape: RopeShape,
    release_m: [f64; 2],
    resolution: Resolution,
    json: bool,
) -> anyhow::Result<()> {
    let swing = SimulatedSwing {
        rope: shape,
        task: SwingTask::PAPER,
        structure: rope.structure.clone(),
        effect_values: rope.theta[2..].to_vec(),
        resolution,
    };
    let [x, z] = release_m;
    let reach_m = swing
        .reach_m(rope.theta[0].exp(), rope.theta[1], release_m)
        .map_err(|refusal| anyhow::anyhow!("released at ({x}, {z}) m: {refusal}"))?;
    if json {
        print(serde_json::json!({ "release_m": release_m, "reach_m": reach_m }))
    } else {
        print(format_args!(
            "released at ({x}, {z}) m the tip reaches x = {reach_m:.4} m"
        ))
    }
}

fn say(demo: &Demo, played: &Played, out: Option<&Path>, json: bool) -> anyhow::Result<()> {
    if json {
        let line = serde_json::json!({
            "demo": demo.name, "frames": demo.times_s().len(), "steps": played.steps, "dt_s": played.dt_s,
            "residual": played.residual, "written": out.map(|out| out.display().to_string()),
        });
        return print(line);
    }
    print(format_args!(
        "{}: {} frames, {} steps of {:.1} us",
        demo.name,
        demo.times_s().len(),
        played.steps,
        1e6 * played.dt_s
    ))?;
    match &played.residual {
        Some(r) => print(format_args!(
            "{} offsets of the measured rope from it: {:.2} mm (rms of each), {:.1} times what noise_m makes of them",
            r.rows, r.rms_mm, r.floors
        ))?,
        None => print("too little of the rope was measured to compare")?,
    }
    match out {
        Some(out) => print(format_args!("wrote {}", out.display())),
        None => Ok(()),
    }
}
