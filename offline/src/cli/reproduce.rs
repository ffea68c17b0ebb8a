//! `offline reproduce …`: the paper's tables.

use super::numbers::{above_zero, count, seed, threads, within};
use super::output::print;
use super::progress::Reporter;
use super::runs;
use super::simulate::CELLS;
use clap::builder::PossibleValuesParser;
use clap::{Args, Subcommand};
use offline::collect::Watch;
use offline::demo::Demo;
use offline::pipeline::Preset;
use offline::reproduce::data::Source;
use offline::reproduce::method::{METHODS, Method};
use offline::reproduce::pointnet::{PointNet, Variant};
use offline::reproduce::policies::{self, PolicyTable};
use offline::reproduce::sim2sim::Baseline;
use offline::reproduce::table::Table;
use offline::reproduce::{coverage, ours, real2sim, scene, sim2sim};
use offline::run_files::{prepare_folder, write_whole};
use std::path::{Path, PathBuf};

/// Which of the paper's tables.
#[derive(Subcommand)]
pub enum Reproduce {
    /// Parameters of simulated ropes whose truth is known (the paper's first table).
    #[command(after_help = "Example: offline reproduce sim2sim --preset quick --out runs/sim2sim")]
    Sim2sim {
        #[command(flatten)]
        common: Common,
        /// How the data differ from the simulation that is fitted.
        #[arg(long, value_enum, default_value = "sampled")]
        data: Source,
        /// True ropes; the paper's five by default.
        #[arg(long, default_value_t = 5, value_parser = count::<u64>(1..=1000), allow_negative_numbers = true)]
        truths: u64,
        /// Simulated demonstrations that PointNet++ learns from; 0 leaves it out.
        #[arg(long, value_parser = count::<u64>(0..=1_000_000), allow_negative_numbers = true)]
        pointnet_demonstrations: Option<u64>,
        /// Passes that PointNet++ makes over them.
        #[arg(long, value_parser = count::<usize>(1..=100_000), allow_negative_numbers = true)]
        pointnet_epochs: Option<usize>,
        /// Only these estimators: each takes a minute, with the paper's 150 steps of Adam some. Leaves PointNet++ out, which
        /// takes 40 minutes to learn from as many demonstrations as the paper's, in 30 passes.
        #[arg(long, num_args = 1.., value_name = "ESTIMATOR",
            value_parser = PossibleValuesParser::new(METHODS.map(Method::slug)))]
        only: Vec<String>,
    },
    /// Parameters of measured ropes (the paper's second table).
    #[command(after_help = "Example: offline reproduce real2sim --demo my-rope/lift-1 --out runs/real2sim")]
    Real2sim {
        #[command(flatten)]
        common: Common,
        /// Demonstrations; the shipped ones by default.
        #[arg(long, num_args = 1.., value_name = "DIR")]
        demo: Vec<PathBuf>,
        /// Random starts of the paper's estimator.
        #[arg(long, value_parser = count::<u64>(1..=1000), allow_negative_numbers = true)]
        starts: Option<u64>,
    },
    /// How often the 95 % intervals of our fit hold the truth, over random ropes before two cameras.
    #[command(after_help = "Example: offline reproduce coverage --demonstrations 60 --out runs/coverage")]
    Coverage(Intervals),
    /// What each input is worth to a policy (the paper's ablation).
    #[command(after_help = "Example: offline reproduce ablation --preset quick --out runs/policies")]
    Ablation(Policies),
    /// Ropes inside and outside of what a policy learnt from (the paper's generalization test).
    #[command(after_help = "Example: offline reproduce generalization --preset quick --out runs/policies")]
    Generalization(Policies),
}

/// How the intervals are tested.
#[derive(Args)]
pub struct Intervals {
    /// Demonstrations.
    #[arg(long, default_value_t = 200, value_parser = count::<u64>(1..=10_000), allow_negative_numbers = true)]
    demonstrations: u64,
    /// How the data differ from the simulation that is fitted.
    #[arg(long, value_enum, default_value = "finer")]
    data: Source,
    /// Standard deviation of the cameras' points, mm.
    #[arg(long, default_value_t = 2.0, value_parser = above_zero, allow_negative_numbers = true)]
    noise_mm: f64,
    /// Seed of ropes, starts and noise.
    #[arg(long, default_value_t = 1, value_parser = seed(), allow_negative_numbers = true)]
    seed: u64,
    /// Folder of the estimates; a stopped run goes on there.
    #[arg(long, value_name = "DIR", default_value = "runs/coverage")]
    out: PathBuf,
    /// Threads; all cores by default.
    #[arg(long, value_parser = threads(), allow_negative_numbers = true)]
    threads: Option<usize>,
}

/// How much policies learn.
#[derive(Args)]
pub struct Policies {
    /// How much to do.
    #[arg(long, value_enum, default_value = "quick")]
    preset: Preset,
    /// Rollouts that each policy learns from; the preset's by default, the paper's are 2271.
    #[arg(long, value_parser = count::<u64>(50..=1_000_000), allow_negative_numbers = true)]
    rollouts: Option<u64>,
    /// Seed of everything random.
    #[arg(long, default_value_t = 1, value_parser = seed(), allow_negative_numbers = true)]
    seed: u64,
    /// Folder of rollouts and tables; a stopped run goes on there.
    #[arg(long, value_name = "DIR", default_value = "runs/policies")]
    out: PathBuf,
    /// Threads; all cores by default.
    #[arg(long, value_parser = threads(), allow_negative_numbers = true)]
    threads: Option<usize>,
}

/// What both tables take.
#[derive(Args)]
pub struct Common {
    /// How much to do.
    #[arg(long, value_enum, default_value = "quick")]
    preset: Preset,
    /// Seed of everything random.
    #[arg(long, default_value_t = 1, value_parser = seed(), allow_negative_numbers = true)]
    seed: u64,
    /// Folder of the estimates; a stopped run goes on there. `runs/<table>` by default.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Steps of Adam; the preset's by default.
    #[arg(long, value_parser = count::<usize>(1..=100_000), allow_negative_numbers = true)]
    iterations: Option<usize>,
    /// Cells across the rope; the preset's by default.
    #[arg(long, value_parser = within(CELLS))]
    cells: Option<f64>,
    /// Threads; all cores by default.
    #[arg(long, value_parser = threads(), allow_negative_numbers = true)]
    threads: Option<usize>,
}

/// Makes a table.
pub fn run(table: &Reproduce, json: bool) -> anyhow::Result<()> {
    let reporter = Reporter::new();
    match table {
        Reproduce::Sim2sim {
            common,
            data,
            truths,
            pointnet_demonstrations,
            pointnet_epochs,
            only,
        } => {
            runs::set_threads(common.threads)?;
            let mut settings = sim2sim::Settings::of(common.preset, common.seed);
            settings.truths = *truths;
            settings.source = *data;
            settings.effort.iterations = common.iterations.unwrap_or(settings.effort.iterations);
            settings.fitter.cells = common.cells.unwrap_or(settings.fitter.cells);
            if let Some(effort) = &mut settings.pointnet {
                effort.demonstrations = pointnet_demonstrations.unwrap_or(effort.demonstrations);
                effort.epochs = pointnet_epochs.unwrap_or(effort.epochs);
            }
            settings.pointnet = settings.pointnet.filter(|effort| effort.demonstrations > 0);
            let out = folder(common, "sim2sim");
            // PointNet++ learns before the table looks at its folder.
            prepare_folder(&out)?;
            let methods = chosen(only);
            if !only.is_empty() {
                settings.pointnet = None;
            }
            let table = sim2sim_table(&settings, &methods, &out, &reporter)?;
            finish(&[table], &out, json)
        }
        Reproduce::Real2sim { common, demo, starts } => {
            runs::set_threads(common.threads)?;
            let mut settings = real2sim::Settings::of(common.preset, common.seed);
            settings.effort.iterations = common.iterations.unwrap_or(settings.effort.iterations);
            settings.cells = common.cells.unwrap_or(settings.cells);
            settings.gradient_starts = starts.unwrap_or(settings.gradient_starts);
            let folders = if demo.is_empty() {
                runs::shipped()?.to_vec()
            } else {
                demo.clone()
            };
            let demos = folders
                .iter()
                .map(|path| Ok(Demo::load_to_simulate(path)?))
                .collect::<anyhow::Result<Vec<_>>>()?;
            let out = folder(common, "real2sim");
            let tables = real2sim::run(&settings, &demos, &out, &|line| reporter.say(line))?;
            finish(&tables, &out, json)
        }
        Reproduce::Coverage(intervals) => test_intervals(intervals, &reporter, json),
        Reproduce::Ablation(asked) => {
            policies_table(asked, ("ablation", policies::ablation), &reporter, json)
        }
        Reproduce::Generalization(asked) => {
            let table: MakeTable = policies::generalization;
            policies_table(asked, ("generalization", table), &reporter, json)
        }
    }
}

fn test_intervals(intervals: &Intervals, reporter: &Reporter, json: bool) -> anyhow::Result<()> {
    runs::set_threads(intervals.threads)?;
    let settings = coverage::Settings {
        demonstrations: intervals.demonstrations,
        source: intervals.data,
        fitter: scene::Discretisation::default(),
        camera_noise_m: 1e-3 * intervals.noise_mm,
        starts: ours::STARTS,
        seed: intervals.seed,
    };
    let found = coverage::run(&settings, &intervals.out, &|line| reporter.say(line))?;
    let machine = serde_json::to_string_pretty(&found)?;
    write_whole(&intervals.out.join("coverage.json"), machine.as_bytes())?;
    let text = found.markdown();
    write_whole(&intervals.out.join("coverage.md"), text.as_bytes())?;
    print(if json { &machine } else { &text })
}

/// Makes a table of policies.
type MakeTable = fn(&policies::Settings, &Path, Watch) -> anyhow::Result<PolicyTable>;

fn policies_table(
    asked: &Policies,
    (name, make): (&str, MakeTable),
    reporter: &Reporter,
    json: bool,
) -> anyhow::Result<()> {
    runs::set_threads(asked.threads)?;
    let settings = policies::Settings::of(asked.preset, asked.rollouts, asked.seed);
    let table = make(&settings, &asked.out, runs::watch(&|p| reporter.advance(p))?)?;
    let text = table.markdown();
    write_whole(&asked.out.join(format!("{name}.md")), text.as_bytes())?;
    let machine = serde_json::to_string_pretty(&table)?;
    write_whole(&asked.out.join(format!("{name}.json")), machine.as_bytes())?;
    print(if json { &machine } else { &text })
}

/// The estimators with these names; all where none is named.
fn chosen(names: &[String]) -> Vec<Method> {
    let named = |method: &Method| names.iter().any(|name| name == method.slug());
    METHODS
        .into_iter()
        .filter(|method| names.is_empty() || named(method))
        .collect()
}

fn sim2sim_table(
    settings: &sim2sim::Settings,
    methods: &[Method],
    out: &Path,
    reporter: &Reporter,
) -> anyhow::Result<Table> {
    let say = |line: &str| reporter.say(line);
    let mut networks = Vec::new();
    if let Some(effort) = &settings.pointnet {
        for variant in [Variant::AsPublished, Variant::Fair] {
            networks.push(PointNet::trained(
                variant,
                effort,
                &settings.fitter,
                settings.effort.seed,
                out,
                &say,
            )?);
        }
    }
    let baselines: Vec<&dyn Baseline> = networks.iter().map(|net| net as &dyn Baseline).collect();
    sim2sim::run(settings, methods, out, &baselines, &say)
}

fn folder(common: &Common, name: &str) -> PathBuf {
    common.out.clone().unwrap_or_else(|| Path::new("runs").join(name))
}

fn finish(tables: &[Table], out: &Path, json: bool) -> anyhow::Result<()> {
    let text = tables.iter().map(Table::markdown).collect::<Vec<_>>().join("\n");
    write_whole(&out.join("table.md"), text.as_bytes())?;
    let machine = serde_json::to_string_pretty(tables)?;
    write_whole(&out.join("table.json"), machine.as_bytes())?;
    print(if json { &machine } else { &text })
}
