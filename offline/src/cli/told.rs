//! What a run tells of its stages, line by line.

use super::progress::Reporter;
use offline::collect::DatasetSummary;
use offline::diagnose::{Advice, LEAST_NOISE_SCALE, NoiseSource};
use offline::evaluate::Evaluation;
use offline::fit::FINER;
use offline::model::Estimate;
use offline::pipeline::{Beside, Identified, Learned};
use offline::residual::ResidualSummary;
use offline::words::{with_error, with_unit};
use std::collections::BTreeMap;

pub(super) fn say_identified(identified: &Identified, reporter: &Reporter) {
    let outcome = &identified.outcome;
    say_estimates(&outcome.estimates(), reporter);
    reporter.say(&format!("verdict: {}", outcome.verdict));
    for reason in &outcome.reasons {
        reporter.say(&format!("  {reason}"));
    }
    let (before, after) = (
        ResidualSummary::of(&outcome.held_out_before),
        ResidualSummary::of(&outcome.held_out_after),
    );
    reporter.say(&format!(
        "held-out error {:.2} mm ({:.1} noise floors) before, {:.2} mm ({:.1}) after",
        before.rms_mm, before.floors, after.rms_mm, after.floors
    ));
    if let Some(force) = &identified.residual_force {
        reporter.say(&format!("what is left: {}", force.in_words));
    }
    say_advice(&identified.advice, reporter);
}

/// Times the declared noise by which what tells it may scatter without doubt of it.
const MOST_NOISE_SCALE: f64 = 3.0;

/// What is doubtful in the declared noise, where what tells it scatters by so many times as much. It says how the points of a
/// cloud lie about the rope's surface, too.
pub(super) fn noise_doubt(scale: f64, source: NoiseSource) -> Option<String> {
    let scatter = source.in_words();
    if source == NoiseSource::Jitter {
        Some(format!(
            "{scatter} {scale:.1} times noise_m, and neither frames at rest nor a repeated recording measure it; so much counts as \
             noise: correct noise_m in demo.toml, m"
        ))
    } else if scale <= LEAST_NOISE_SCALE {
        Some(format!(
            "{scatter} {LEAST_NOISE_SCALE} of noise_m or less, and noise smaller than that is not believed: what \
             the noise explains, and every verdict, hangs on noise_m; correct it in demo.toml, m"
        ))
    } else if scale > MOST_NOISE_SCALE {
        Some(format!(
            "{scatter} {scale:.1} times noise_m; so much counts as noise, but clouds are read as if their points \
             scattered by noise_m: correct it in demo.toml, m"
        ))
    } else {
        None
    }
}

/// Young's moduli that differ by more than this share are of two valleys; within one, descents end 1 % apart.
const OTHER_VALLEY: f64 = 0.05;
/// How many times the least cost a valley may cost that fits nearly as well.
const NEARLY_AS_WELL: f64 = 2.0;

/// Where another start of a fit ended, if that is elsewhere and fits nearly as well: what the model still lacks may be what
/// makes it worse. Given are ln E of the best and its cost, and those of all ends.
pub(super) fn other_valley((best, least): (f64, f64), ends: &[(f64, f64)]) -> Option<String> {
    let elsewhere = |&&(ln_young, cost): &&(f64, f64)| {
        f64::abs(ln_young - best) > OTHER_VALLEY && cost < NEARLY_AS_WELL * least
    };
    let &(ln_young, cost) = (ends.iter().filter(elsewhere)).min_by(|a, b| a.1.total_cmp(&b.1))?;
    Some(format!(
        "starts disagree: one ended at E = {:.3} MPa, where {:.2} times as much is left as at {:.3} MPa, which is used; the \
         demonstration hardly tells which is right: fit one of another motion as well",
        1e-6 * ln_young.exp(),
        (cost / least).sqrt(),
        1e-6 * best.exp()
    ))
}

pub(super) fn say_estimates(estimates: &[Estimate], reporter: &Reporter) {
    for e in estimates {
        reporter.say(&format!("  {}", estimate_line(e)));
    }
}

pub(super) fn say_rollouts(rollouts: &DatasetSummary, reporter: &Reporter) {
    let (scored, all) = (rollouts.scored, rollouts.rollouts);
    reporter.say(&format!("rollouts: {scored} of {all} have a score"));
    say_refusals(&rollouts.refusals, reporter);
}

fn say_refusals(refusals: &BTreeMap<String, usize>, reporter: &Reporter) {
    for (reason, count) in refusals {
        reporter.say(&format!("  refused: {count} ({reason})"));
    }
}

/// Effects that are told of the list of what matters for the swing; the report has all.
const RISKS_TOLD: usize = 3;

fn say_advice(advice: &Advice, reporter: &Reporter) {
    let risks = advice.swing.risks.iter().take(RISKS_TOLD);
    let told: Vec<String> = risks
        .filter_map(|risk| Some(format!("{} {:.1} mm", risk.allowed.name, risk.at_most_mm?)))
        .collect();
    match &advice.swing.missing {
        Some(why) => reporter.say(&format!("what matters for the swing is not known: {why}")),
        None => reporter.say(&format!(
            "could still move the reach of the swing by up to: {}",
            told.join(", ")
        )),
    }
    let next = &advice.next_demonstration;
    for motion in &next.motions {
        let figure = match (motion.power, motion.swing_mm) {
            (Some(power), _) => format!("{:3.0} % power", 100.0 * power),
            (None, Some(mm)) => format!("{mm:5.1} mm left"),
            (None, None) => "not simulated".into(),
        };
        reporter.say(&format!("  {figure}: {}", motion.words));
    }
    reporter.say(&format!("next demonstration: {}", next.in_words));
}

fn estimate_line(e: &Estimate) -> String {
    let note = if e.identified {
        ""
    } else {
        "  (not identified by these data)"
    };
    format!(
        "{} = {}{note}",
        e.name,
        with_unit(&with_error(e.value, e.standard_error), &e.unit)
    )
}

pub(super) fn say_learned(learned: &Learned, reporter: &Reporter) {
    say_misses(
        "policy: |goal - reached|",
        "goals of unseen ropes",
        &learned.evaluation,
        reporter,
    );
    let finer = format!("the same answers on a grid finer by {FINER}:");
    say_misses(&finer, "of them", &learned.finer, reporter);
    reporter.say(&format!(
        "this rope reaches goals from {}",
        learned.reach_m.metres()
    ));
}

fn say_misses(what: &str, of: &str, evaluation: &Evaluation, reporter: &Reporter) {
    if let Some(miss) = &evaluation.miss {
        reporter.say(&format!(
            "{what} {:.1} ± {:.1} mm over n = {} {of} (median {:.1}, p90 {:.1})",
            miss.mean_mm, miss.spread_mm, miss.count, miss.median_mm, miss.p90_mm
        ));
    }
    say_refusals(&evaluation.refusals, reporter);
}

pub(super) fn say_beside(others: &[Beside], reporter: &Reporter) {
    for (index, other) in others.iter().enumerate() {
        let miss = &other.miss;
        reporter.say(&format!(
            "rope {}, {}: reaches goals from {}, |goal - reached| {:.1} ± {:.1} mm over n = {} of them",
            index + 1,
            other.model.name,
            other.reach_m.metres(),
            miss.mean_mm,
            miss.spread_mm,
            miss.count
        ));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_valley_is_told_where_it_fits_nearly_as_well() {
        let (best, least) = (f64::ln(0.9e6), 100.0);
        let told =
            |young_pa: f64, cost: f64| other_valley((best, least), &[(best, least), (young_pa.ln(), cost)]);
        assert_eq!(told(0.91e6, 101.0), None, "the same valley");
        assert_eq!(told(0.5e6, 1000.0), None, "much worse");
        let words = told(0.5e6, 144.0).unwrap();
        assert!(
            words.contains("E = 0.500 MPa, where 1.20 times as much is left as at 0.900 MPa"),
            "{words}"
        );
    }

    #[test]
    fn a_declared_noise_that_the_data_contradict_is_doubted() {
        for (scale, source, word) in [
            (
                0.1,
                NoiseSource::Rest,
                Some("frames at rest scatter by 0.1 of noise_m"),
            ),
            (1.2, NoiseSource::Rest, None),
            (1.2, NoiseSource::Repeats, None),
            (1.2, NoiseSource::Jitter, Some("at least 1.2 times noise_m")),
            (
                10.0,
                NoiseSource::Repeats,
                Some("same motion scatter by 10.0 times noise_m"),
            ),
        ] {
            let doubt = noise_doubt(scale, source);
            assert_eq!(doubt.is_some(), word.is_some(), "{scale}");
            assert!(word.is_none_or(|word| doubt.unwrap().contains(word)), "{scale}");
        }
    }
}
