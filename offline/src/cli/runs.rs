//! `offline run` and the commands that stop earlier.

use super::output::{command_line, note, print};
use super::progress::Reporter;
use super::told::{
    noise_doubt, other_valley, say_beside, say_estimates, say_identified, say_learned, say_rollouts,
};
use super::{RunArguments, WrongUse};
use anyhow::Context;
use offline::PROGRAM;
use offline::collect::Watch;
use offline::diagnose::Noise;
use offline::fit::{Evaluation, FitResult, LEVEL, Problem, Profile, YOUNG};
use offline::inspect::{inspect, stale};
use offline::model::{Estimate, Structure};
use offline::model_file::ModelFile;
use offline::pipeline::{
    Beside, Identified, Inputs, Learned, NOT_DIAGNOSED, Profiled, RunSettings, Stage, Summary, beside, fit,
    freeze_policy, holds_diagnosis, identify, learn, profile, refuse_beside, refuse_strangers,
    refuse_unnameable, refuse_unswingable, refuse_untrained, rollouts,
};
use offline::report::{PolicySection, ReportInput, html, tables, views};
use offline::residual::{ResidualSummary, misfits};
use offline::run_files::{Fnv64, RunFolder, hex, write_whole};
use offline::tell::Progress;
use shared::task::SwingTask;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

/// The demonstrations that ship with the program, relative to the repository.
const SAMPLE: &str = "offline/demos/sample-rope";
/// The sample rope's fitting demonstration, then the ones that judge.
const SAMPLE_PARTS: [&str; 3] = ["fit", "held-out-1", "held-out-2"];

/// Noise floors of what a model leaves from which on its standard errors say little.
const TRUSTED_FLOORS: f64 = 2.0;

static STOP: AtomicBool = AtomicBool::new(false);

/// Runs all stages up to `last`. A whole run of a rope that cannot swing stops at its diagnosis, and fails once that is told.
pub fn run(arguments: &RunArguments, last: Stage, json: bool) -> anyhow::Result<()> {
    let reporter = Reporter::new();
    set_threads(arguments.threads)?;
    let (demos, held_out, name) = chosen(arguments)?;
    let inputs = Inputs::load(&name, &demos, &held_out)?;
    let (last, no_policy) = allowed(&inputs, last)?;
    if let Some(why) = &no_policy {
        reporter.say(&format!(
            "warning: there will be a diagnosis, but no policy: {why}"
        ));
    }
    let also = arguments.also.iter().map(|path| ModelFile::of_run_or_file(path));
    let also: Vec<ModelFile> = also.collect::<anyhow::Result<_>>()?;
    refuse_beside(&name, &also)?;
    if last >= Stage::Freeze {
        let length_m = inputs.demos[0].spec.rope.length_m;
        if let Some(warning) = arguments.place.reach(&SwingTask::PAPER, length_m)? {
            reporter.say(&format!("warning: {warning}"));
        }
    }
    warn_of_recordings(&inputs, &reporter);
    let settings = RunSettings::of(arguments.preset, arguments.seed);
    let out = arguments
        .out
        .clone()
        .unwrap_or_else(|| Path::new("runs").join(&name));
    let run = RunFolder::open(&out)?;
    let _held = run.hold()?;
    refuse_strangers(&run)?;
    if arguments.demo.is_empty() || holds_diagnosis(&run) {
        refuse_anothers(&run, &inputs)?;
    }
    let job = Job {
        run,
        inputs,
        also,
        settings,
        arguments,
        reporter,
    };
    let (mut summary, dataset, wrote) = if last == Stage::Fit {
        let (summary, wrote) = job.fit()?;
        (summary, None, wrote)
    } else {
        let (summary, dataset) = job.beyond_fit(last)?;
        (summary, dataset, true)
    };
    let blob = job.run.blob();
    match stale(&job.run) {
        Some(warning) => job.reporter.say(&format!("warning: {warning}")),
        None => summary.blob = blob.exists().then(|| blob.display().to_string()),
    }
    summary.wall_s = job.reporter.elapsed_s();
    if wrote {
        record(&summary, dataset, &job)?;
    }
    tell(&summary, json)?;
    match no_policy {
        Some(why) => Err(why.context("there is a diagnosis, but no policy")),
        None => Ok(()),
    }
}

/// The last of the stages up to `last` that this rope allows, and why that is not `last`: of a rope that cannot swing a whole
/// run ends with the diagnosis.
fn allowed(inputs: &Inputs, last: Stage) -> anyhow::Result<(Stage, Option<anyhow::Error>)> {
    if last <= Stage::Diagnose {
        return Ok((last, None));
    }
    match refuse_unswingable(inputs) {
        Err(why) if last == Stage::Report => Ok((Stage::Diagnose, Some(why))),
        swings => swings.map(|()| (last, None)),
    }
}

fn warn_of_recordings(inputs: &Inputs, reporter: &Reporter) {
    for warning in inputs.differences() {
        reporter.say(&format!("warning: {warning}"));
    }
    for demo in inputs.demos.iter().chain(&inputs.held_out) {
        for warning in offline::demo::warnings(demo) {
            reporter.say(&format!("warning: {}: {warning}", demo.name));
        }
    }
}

/// What a command works on.
struct Job<'a> {
    inputs: Inputs,
    /// Ropes that the blob holds beside the run's own.
    also: Vec<ModelFile>,
    settings: RunSettings,
    run: RunFolder,
    arguments: &'a RunArguments,
    reporter: Reporter,
}

impl Job<'_> {
    /// The base model's fit alone, and whether it left files.
    fn fit(&self) -> anyhow::Result<(Summary, bool)> {
        let (base, wrote) = fit(&self.inputs, &self.settings, &self.run, &self.reporter)?;
        let estimates = base.estimates();
        say_estimates(&estimates, &self.reporter);
        let held_out = ResidualSummary::of(&base.held_out);
        let of = if self.inputs.held_out.is_empty() {
            "error in the frames that were kept back"
        } else {
            "held-out error"
        };
        self.reporter.say(&format!(
            "{of} {:.2} mm ({:.1} noise floors)",
            held_out.rms_mm, held_out.floors
        ));
        if held_out.floors > TRUSTED_FLOORS {
            self.reporter.say(
                "warning: so much more than noise is left that what this model lacks may have moved its parameters by far more \
                 than their standard errors; `offline diagnose` looks for it",
            );
        }
        self.warn_of_valleys(&base.fitted);
        self.warn(&base.fitted, &base.noise);
        let of = Profiled {
            structure: &Structure::default(),
            fitted: &base.fitted,
            estimates: &estimates,
            grid_shift: &base.grid_shift,
            noise_scale: base.noise.scale,
        };
        let profiles = self.profiles(&of, &self.run.base_profile())?;
        let summary = Summary {
            profiles,
            ..self.summary(NOT_DIAGNOSED, (Vec::new(), estimates), [&base.held_out; 2])
        };
        Ok((summary, wrote))
    }

    /// Intervals by profile likelihood, where they are asked for or there already.
    fn profiles(&self, of: &Profiled, file: &Path) -> anyhow::Result<Vec<Profile>> {
        let say = |line: &str| self.reporter.say(line);
        let profiles = profile(
            &self.inputs,
            &self.settings,
            file,
            (of, self.arguments.profile),
            &say,
        )?;
        for one in &profiles {
            say(&format!("  {}: {:.0} % interval {one}", one.name, 100.0 * LEVEL));
        }
        Ok(profiles)
    }

    /// What was found, before anything is learnt.
    fn summary(
        &self,
        verdict: &str,
        (effects, parameters): (Vec<String>, Vec<Estimate>),
        held_out: [&Evaluation; 2],
    ) -> Summary {
        let [before, after] = held_out.map(ResidualSummary::of);
        Summary {
            folder: self.run.path().display().to_string(),
            verdict: verdict.into(),
            effects,
            parameters,
            profiles: Vec::new(),
            held_out_before_mm: before.rms_mm,
            held_out_after_mm: after.rms_mm,
            floor_mm: after.floor_mm,
            policy: None,
            policy_on_finer_grid: None,
            beside: Vec::new(),
            blob: None,
            report: None,
            wall_s: 0.0,
        }
    }

    /// The diagnosis and what comes after it; the hash of the rollouts where there are any.
    fn beyond_fit(&self, last: Stage) -> anyhow::Result<(Summary, Option<u64>)> {
        let (run, reporter) = (&self.run, &self.reporter);
        let identified = identify(&self.inputs, &self.settings, run, reporter)?;
        say_identified(&identified, reporter);
        let outcome = &identified.outcome;
        self.warn_of_valleys(&outcome.base);
        self.warn(&outcome.fitted, &outcome.noise);
        let mut summary = self.summary(
            &outcome.verdict.to_string(),
            (outcome.structure.ids(), outcome.estimates()),
            [&outcome.held_out_before, &outcome.held_out_after],
        );
        let of = Profiled {
            structure: &outcome.structure,
            fitted: &outcome.fitted,
            estimates: &summary.parameters,
            grid_shift: &outcome.grid_shift,
            noise_scale: outcome.noise.scale,
        };
        summary.profiles = self.profiles(&of, &run.profile())?;
        let (mut dataset, mut policy) = (None, None);
        if last > Stage::Diagnose {
            refuse_untrained(&identified, &self.settings, &self.also)?;
            // What comes before is kept round by round: there Ctrl-C ends the program at once.
            let progress = |p| reporter.advance(p);
            let watch = watch(&progress)?;
            if last == Stage::Collect {
                let rollouts = rollouts(&identified, &self.settings, run, watch)?;
                say_rollouts(&rollouts, reporter);
                dataset = Some(rollouts.hash);
            } else {
                let learned = learn(&identified, &self.settings, run, watch)?;
                summary.policy = learned.evaluation.miss;
                summary.policy_on_finer_grid = learned.finer.miss;
                say_learned(&learned, reporter);
                dataset = Some(learned.trained.dataset.hash);
                if last >= Stage::Freeze {
                    let trained = &learned.trained;
                    let others = beside(&trained.policy, &trained.reach, self.also.clone(), watch)?;
                    say_beside(&others, reporter);
                    self.freeze(&identified, (&learned, &others))?;
                    summary.beside = others.iter().map(Beside::summary).collect();
                }
                policy = Some(learned);
            }
        }
        let told = (&identified, summary.profiles.as_slice());
        // What tells of a policy stays until that is learnt anew.
        let told_already = policy.is_none() && run.evaluation().exists();
        if !told_already {
            self.write_tables(told, policy.as_ref())?;
        }
        if last >= Stage::Freeze || last == Stage::Diagnose && !told_already {
            reporter.say("drawing the report");
            let page = report(self, told, policy.as_ref())?;
            write_whole(&run.report(), page.as_bytes())?;
        }
        let page = Some(run.report()).filter(|page| page.exists());
        summary.report = page.map(|page| page.display().to_string());
        Ok((summary, dataset))
    }

    fn freeze(&self, identified: &Identified, learned: (&Learned, &[Beside])) -> anyhow::Result<()> {
        let frozen = freeze_policy(
            identified,
            learned,
            (&self.settings, self.arguments.place.frame()),
            &self.inputs.hashes,
            &self.run,
        )?;
        self.reporter.say(&format!(
            "froze {} bytes, read back, {} answers equal bit for bit",
            frozen.bytes, frozen.answers_compared
        ));
        Ok(())
    }

    fn write_tables(
        &self,
        (identified, profiles): (&Identified, &[Profile]),
        learned: Option<&Learned>,
    ) -> anyhow::Result<()> {
        let (demos, _) = self.inputs.members();
        let policy = learned.map(|l| [&l.evaluation, &l.finer]);
        let text = tables(&self.inputs.name, &demos, (&identified.outcome, profiles), policy);
        Ok(write_whole(&self.run.tables(), text.as_bytes())?)
    }

    fn warn_of_valleys(&self, base: &FitResult) {
        let best = (base.best.theta[YOUNG], base.cost);
        if let Some(warning) = other_valley(best, &base.ends) {
            self.reporter.say(&format!("warning: {warning}"));
        }
    }

    fn warn(&self, fitted: &FitResult, noise: &Noise) {
        if let Some(doubt) = noise
            .measured_scale()
            .and_then(|scale| noise_doubt(scale, noise.source))
        {
            self.reporter.say(&format!("warning: {doubt}"));
        }
        let (demos, _) = self.inputs.members();
        for warning in misfits(&demos, &fitted.best) {
            self.reporter.say(&format!("warning: {warning}"));
        }
    }
}

/// The page of a run.
fn report(
    job: &Job,
    (identified, profiles): (&Identified, &[Profile]),
    learned: Option<&Learned>,
) -> anyhow::Result<String> {
    let (demos, held_out) = job.inputs.members();
    let outcome = &identified.outcome;
    let mut before = Vec::new();
    let mut after = Vec::new();
    for (members, judges) in [(&demos, false), (&held_out, true)] {
        let mut problem = Problem::new(members, job.settings.resolution().finer())?;
        problem.noise_scale = outcome.noise.scale;
        before.extend(views(
            &problem,
            &Structure::default(),
            &outcome.base.best.theta,
            judges,
        )?);
        after.extend(views(
            &problem,
            &outcome.structure,
            &outcome.fitted.best.theta,
            judges,
        )?);
    }
    let path = job.run.blob();
    let blob = path.exists().then(|| inspect(&path)).transpose()?;
    Ok(html(&ReportInput {
        title: &job.inputs.name,
        demos: &demos,
        held_out: &held_out,
        outcome,
        profiles,
        residual_force: identified.residual_force.as_ref(),
        advice: &identified.advice,
        before: &before,
        after: &after,
        policy: learned.map(|l| PolicySection {
            evaluation: &l.evaluation,
            finer: &l.finer,
            record: &l.trained.record,
            dataset: &l.trained.dataset,
            blob: blob.as_ref(),
        }),
        provenance: &provenance(job),
    }))
}

fn provenance(job: &Job) -> Vec<(String, String)> {
    let settings = &job.settings;
    [
        ("command", command_line()),
        ("program", PROGRAM.into()),
        ("seed", job.arguments.seed.to_string()),
        ("cells across the rope", format!("{:.2}", settings.cells)),
        ("random rollouts", settings.rollouts.to_string()),
        ("threads", rayon::current_num_threads().to_string()),
        ("wall time so far", format!("{:.0} s", job.reporter.elapsed_s())),
    ]
    .map(|(key, value)| (key.to_owned(), value))
    .to_vec()
}

/// Whom rollouts and training tell how far they are, and who may stop them.
pub fn watch(progress: &(dyn Fn(Progress) + Sync)) -> anyhow::Result<Watch<'_>> {
    catch_interrupt()?;
    Ok(Watch {
        progress,
        stop: &STOP,
    })
}

/// Ctrl-C ends collecting and training where files are whole; the second one leaves at once.
fn catch_interrupt() -> anyhow::Result<()> {
    ctrlc::set_handler(|| {
        if STOP.swap(true, Ordering::Relaxed) {
            std::process::exit(130);
        }
        note(
            "stopping after the rollouts that are running, those of an unfinished shard are made again; press Ctrl-C again \
             to leave at once",
        );
    })
    .context("cannot catch Ctrl-C")
}

/// Demonstrations to fit, demonstrations to judge by, and the rope's name.
fn chosen(arguments: &RunArguments) -> anyhow::Result<(Vec<PathBuf>, Vec<PathBuf>, String)> {
    let given = arguments.name.as_deref().unwrap_or("rope");
    refuse_unnameable(given, arguments.demo.len()).map_err(|error| WrongUse(error.to_string()))?;
    if arguments.demo.is_empty() {
        let [fit, judges @ ..] = shipped()?;
        let name = arguments.name.clone().unwrap_or_else(|| "sample-rope".into());
        return Ok((vec![fit], judges.to_vec(), name));
    }
    let of_parent = || {
        let full = arguments.demo[0].canonicalize().ok()?;
        Some(full.parent()?.file_name()?.to_string_lossy().into_owned())
    };
    let name = arguments
        .name
        .clone()
        .or_else(of_parent)
        .unwrap_or_else(|| "rope".into());
    Ok((arguments.demo.clone(), arguments.held_out.clone(), name))
}

/// Refuses to go on with these recordings in the folder of a run of others: hours of it would be lost to a forgotten
/// `--held-out`, and its model and policy would become the sample rope's where nobody named any.
fn refuse_anothers(run: &RunFolder, inputs: &Inputs) -> anyhow::Result<()> {
    // What cannot be read is no run to lose.
    let Ok(model) = ModelFile::load(&run.model()) else {
        return Ok(());
    };
    let own = inputs.of_model(&model);
    let named = |held_out: bool| {
        let scenes = model.scene.iter().filter(|scene| scene.held_out == held_out);
        let names: Vec<&str> = scenes.map(|scene| scene.demo.as_str()).collect();
        if names.is_empty() {
            "none".to_owned()
        } else {
            names.join(", ")
        }
    };
    anyhow::ensure!(
        own,
        "{} is a run of other recordings (fitted: {}; held out: {}): name them again with --demo and --held-out, or give \
         these another folder with --out",
        run.path().display(),
        named(false),
        named(true)
    );
    Ok(())
}

/// Folders of the demonstrations that ship with the program, the one to fit first.
pub fn shipped() -> anyhow::Result<[PathBuf; 3]> {
    let sample = Path::new(SAMPLE);
    anyhow::ensure!(
        sample.is_dir(),
        "the sample rope is not at {SAMPLE}: run from the repository's folder, or name your own with --demo"
    );
    Ok(SAMPLE_PARTS.map(|part| sample.join(part)))
}

/// Uses that many threads, or all cores.
pub fn set_threads(threads: Option<usize>) -> anyhow::Result<()> {
    if let Some(threads) = threads {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build_global()
            .context("cannot set the number of threads")?;
    }
    Ok(())
}

/// Writes `run.json`.
fn record(summary: &Summary, dataset: Option<u64>, job: &Job) -> anyhow::Result<()> {
    let record = serde_json::json!({
        "command": command_line(),
        "program": PROGRAM,
        "formats": {
            "demo": offline::demo::FORMAT,
            "model": offline::model_file::FORMAT,
            "blob": shared::blob::FORMAT_VERSION,
        },
        "revisions": { "simulator": offline::sim::REVISION, "diagnosis": offline::diagnose::REVISION },
        "seed": job.arguments.seed,
        "settings": job.settings,
        "task_frame": job.arguments.place.frame(),
        "threads": rayon::current_num_threads(),
        "hashes": hashes(job, dataset),
        "summary": summary,
    });
    write_whole(&job.run.record(), &serde_json::to_vec_pretty(&record)?)?;
    Ok(())
}

/// Prints what was found or where everything is.
fn tell(summary: &Summary, json: bool) -> anyhow::Result<()> {
    if json {
        print(serde_json::to_string_pretty(summary)?)?;
    } else {
        print(format_args!(
            "done in {:.0} s; everything is in {}",
            summary.wall_s, summary.folder
        ))?;
        for (what, path) in [("report", &summary.report), ("policy", &summary.blob)] {
            if let Some(path) = path {
                print(format_args!("  {what}: {path}"))?;
            }
        }
    }
    Ok(())
}

/// FNV-1a hashes of what went in and of every file that is there now, by whichever command it was left, hexadecimal.
fn hashes(job: &Job, dataset: Option<u64>) -> serde_json::Value {
    let run = &job.run;
    let file = |path: PathBuf| std::fs::read(path).ok().map(|bytes| hex(Fnv64::of(&bytes)));
    let demos = |list: &[u64]| list.iter().copied().map(hex).collect::<Vec<_>>();
    serde_json::json!({
        "demos": demos(&job.inputs.hashes),
        "held_out": demos(&job.inputs.held_out_hashes),
        "fit": file(run.fit()),
        "residual": file(run.residual()),
        "diagnosis": file(run.diagnosis()),
        "model": file(run.model()),
        "dataset": dataset.map(hex),
        "weights": file(run.weights()),
        "evaluation": file(run.evaluation()),
        "evaluation_finer_grid": file(run.finer_evaluation()),
        "blob": file(run.blob()),
        "tables": file(run.tables()),
        "report": file(run.report()),
    })
}
