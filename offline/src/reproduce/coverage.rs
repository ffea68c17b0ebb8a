//! Whether the intervals of our fit hold: simulated demonstrations of random ropes before noisy cameras, each
//! fitted as every user's is, with the finer grid's predictions, and how often the truth lies within 95 %. The
//! paper reports no intervals. Each finished demonstration is a file, so that a run that was stopped goes on.

use super::adam::Parameters;
use super::data::{Source, WHOLE_RANGE, draw, record, seen_by_cameras};
use super::ours::{Fitted, Predicted, demo_of, fit_clouds};
use super::scene::{Discretisation, demonstration};
use super::table::Spread;
use crate::countdown::Countdown;
use crate::depth_cameras::cameras;
use crate::observe::Section;
use crate::run_files::{RunFolder, kept, made_by, write_whole};
use crate::statistics::{NORMAL_975, Rate};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::fmt::Write;
use std::path::Path;

/// Settings of the study.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Number of demonstrations.
    pub demonstrations: u64,
    /// How the data differ from the simulation that is fitted.
    pub source: Source,
    /// How the fitter cuts rope and time.
    pub fitter: Discretisation,
    /// Standard deviation of the two cameras' points, m.
    pub camera_noise_m: f64,
    /// Starts of each fit.
    pub starts: u64,
    /// Seed of ropes, starts and noise.
    pub seed: u64,
}

/// One demonstration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Judged {
    #[serde(default)]
    made_by: String,
    settings: Settings,
    truth: Parameters,
    fit: Fitted,
}

/// What the study found.
#[derive(Clone, Debug, Serialize)]
pub struct Coverage {
    /// Settings.
    pub settings: Settings,
    /// How the estimates fare against the truths.
    #[serde(flatten)]
    pub intervals: Intervals,
}

/// How estimates with their intervals fare against the truths.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Intervals {
    /// Relative error of E, %.
    pub young_percent: Spread,
    /// Size of that error, %.
    pub young_size_percent: Spread,
    /// Error of ν.
    pub poisson: Spread,
    /// Error over standard error, E and ν.
    pub standardised: [Spread; 2],
    /// How often the 95 % interval holds the truth, E and ν.
    pub covered: [Rate; 2],
    /// How often ν is called identified.
    pub poisson_identified: Rate,
    /// How often it is so, and further from the truth than three standard errors.
    pub poisson_confidently_wrong: Rate,
}

/// Standard errors from which on an identified parameter counts as wrong.
const WRONG: f64 = 3.0;
/// Streams of starts and noise differ from that of the ropes.
const START_SEED: u64 = 0x7374_6172;
const CAMERA_SEED: u64 = 0x636f_7665;

/// Makes and fits all demonstrations. `say` hears what was finished.
///
/// # Errors
/// A simulation stopped, or a file could not be written.
pub fn run(settings: &Settings, out: &Path, say: &(dyn Fn(&str) + Sync)) -> anyhow::Result<Coverage> {
    let folder = RunFolder::open(out)?;
    let countdown = Countdown::of(settings.demonstrations as usize);
    let found: Vec<(Parameters, Fitted)> = (0..settings.demonstrations)
        .into_par_iter()
        .map(|index| {
            let path = folder
                .path()
                .join("estimates")
                .join(format!("coverage-{index}.json"));
            let fresh = !path.exists();
            let judged = finish(settings, &path, index)?;
            let found = (judged.truth, judged.fit);
            let [e, nu] = standardised(&found);
            say(&format!(
                "{}: demonstration {index}: E off by {e:+.2}, ν by {nu:+.2} standard errors",
                countdown.ended(fresh)
            ));
            Ok(found)
        })
        .collect::<anyhow::Result<_>>()?;
    Ok(Coverage {
        settings: *settings,
        intervals: Intervals::of(&found),
    })
}

fn finish(settings: &Settings, path: &Path, index: u64) -> anyhow::Result<Judged> {
    // An estimate does not depend on how many there are.
    let settings = Settings {
        demonstrations: 0,
        ..*settings
    };
    if let Some(kept) =
        kept::<Judged>(path).filter(|kept| kept.settings == settings && kept.made_by == made_by())
    {
        return Ok(kept);
    }
    let truth = draw(WHOLE_RANGE, settings.seed, index);
    let rope = record(truth, settings.source, &settings.fitter)?;
    let noise_seed = (settings.seed ^ CAMERA_SEED).wrapping_add(index);
    let seen = seen_by_cameras(&rope, settings.camera_noise_m, noise_seed);
    let fitted = demonstration(&settings.fitter)?;
    let demo = demo_of(&fitted, seen, settings.camera_noise_m, cameras());
    let start_seed = (settings.seed ^ START_SEED).wrapping_add(index);
    let starts = (start_seed, settings.starts);
    let fit = fit_clouds(&demo, &fitted, Section::Surface, starts, Predicted::FinerGrid)?;
    let judged = Judged {
        made_by: made_by(),
        settings,
        truth,
        fit,
    };
    write_whole(path, &serde_json::to_vec_pretty(&judged)?)?;
    Ok(judged)
}

/// Error of an estimate over its standard error, of E and ν.
fn standardised((truth, fit): &(Parameters, Fitted)) -> [f64; 2] {
    [0, 1].map(|k| (fit.parameters[k] - truth[k]) / fit.standard_errors[k])
}

impl Intervals {
    /// Of truths with what was found of them.
    pub fn of(found: &[(Parameters, Fitted)]) -> Self {
        type Found = (Parameters, Fitted);
        let spread =
            |value: &dyn Fn(&Found) -> f64| Spread::of(&found.iter().map(value).collect::<Vec<f64>>());
        let percent = |(truth, fit): &Found| 100.0 * (fit.parameters[0] / truth[0] - 1.0);
        let wrong = |one: &Found| one.1.identified[1] && standardised(one)[1].abs() > WRONG;
        Self {
            young_percent: spread(&percent),
            young_size_percent: spread(&|one| percent(one).abs()),
            poisson: spread(&|(truth, fit)| fit.parameters[1] - truth[1]),
            standardised: [0, 1].map(|k| spread(&|one| standardised(one)[k])),
            covered: [0, 1]
                .map(|k| Rate::of(found.iter().map(|one| standardised(one)[k].abs() <= NORMAL_975))),
            poisson_identified: Rate::of(found.iter().map(|(_, fit)| fit.identified[1])),
            poisson_confidently_wrong: Rate::of(found.iter().map(wrong)),
        }
    }

    /// As a Markdown table.
    pub fn markdown(&self) -> String {
        let rate = |rate: &Rate| {
            let [low, high] = rate.wilson().unwrap_or([0.0, 1.0]).map(|end| 100.0 * end);
            format!("{} of {} ({low:.0} to {high:.0} %)", rate.hits, rate.of)
        };
        let spread = |s: &Spread, digits: usize| format!("{:+.digits$} ± {:.digits$}", s.mean, s.deviation);
        let lines = [
            (
                "95 % interval of E holds the truth (target 90 to 98 %)",
                rate(&self.covered[0]),
            ),
            ("95 % interval of ν holds the truth", rate(&self.covered[1])),
            ("error of E, %", spread(&self.young_percent, 3)),
            (
                "size of the error of E, % (target 2)",
                spread(&self.young_size_percent, 3),
            ),
            (
                "error of E over its standard error",
                spread(&self.standardised[0], 2),
            ),
            ("error of ν", spread(&self.poisson, 4)),
            (
                "error of ν over its standard error",
                spread(&self.standardised[1], 2),
            ),
            ("ν called identified", rate(&self.poisson_identified)),
            (
                "and wrong by over 3 standard errors (target 0)",
                rate(&self.poisson_confidently_wrong),
            ),
        ];
        let mut text = String::from("| | |\n|---|---|\n");
        for (name, value) in lines {
            let _ = writeln!(text, "| {name} | {value} |");
        }
        text
    }
}

impl Coverage {
    /// As Markdown.
    pub fn markdown(&self) -> String {
        format!(
            "Intervals of {} fits of simulated demonstrations, two cameras with {:.1} mm noise, seed {}; data made by: {}\n\n{}",
            self.intervals.covered[0].of,
            1e3 * self.settings.camera_noise_m,
            self.settings.seed,
            self.settings.source.words(),
            self.intervals.markdown()
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::StopReason;

    #[test]
    fn an_identified_ratio_that_is_wrong_is_counted_and_one_that_is_not_identified_is_not() {
        let found = |poisson: f64, identified: bool| {
            let fit = Fitted {
                parameters: [1010.0, poisson],
                standard_errors: [10.0, 0.006],
                identified: [true, identified],
                evaluations: 5,
                stop: StopReason::Converged,
            };
            ([1000.0, 0.222], fit)
        };
        let found = Intervals::of(&[found(0.443, true), found(0.443, false), found(0.222, true)]);
        assert_eq!(found.poisson_confidently_wrong, Rate { hits: 1, of: 3 });
        assert_eq!(found.poisson_identified, Rate { hits: 2, of: 3 });
        assert_eq!(found.covered, [Rate { hits: 3, of: 3 }, Rate { hits: 1, of: 3 }]);
        assert!((found.young_percent.mean - 1.0).abs() < 1e-12);
        assert!(
            found.markdown().contains("1 of 3 (6 to 79 %)"),
            "{}",
            found.markdown()
        );
    }
}
