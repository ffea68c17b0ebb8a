//! The answer first: verdict, error before and after, parameters, reasons for caution.

use super::ReportInput;
use super::page::{effect_title, parameter_title};
use crate::diagnose::{Invariance, Verdict, size_in_words};
use crate::fit::{Profile, estimates};
use crate::model::{Estimate, Structure};
use crate::paper_units::young_paper;
use crate::residual::ResidualSummary;
use crate::words::{significant, unit, with_error};
use maud::{Markup, html};

pub(super) fn section(input: &ReportInput) -> Markup {
    let outcome = input.outcome;
    let base = estimates(&outcome.base.best, &Structure::default());
    let found = outcome.estimates();
    let before = ResidualSummary::of(&outcome.held_out_before);
    let after = ResidualSummary::of(&outcome.held_out_after);
    let density = input.demos.first().map(|demo| demo.spec.rope.density_kg_m3());
    html! {
        div class=(format!("answer {}", tone(&outcome.verdict))) {
            p.verdict { (headline(&outcome.verdict)) }
            p { (error_line(&before, &after)) }
            p { "Rope: " (list(&found[..2])) "." }
            @if let Verdict::Explained { effects, parameters } = &outcome.verdict {
                p { "The model lacked: " (list(parameters)) "." }
                @for words in effects.iter().filter_map(|id| size_in_words(id, parameters)) {
                    p { "That is " (words) "." }
                }
            }
            p { "Next: " (input.advice.next_demonstration.in_words) "." }
        }
        h3 { "Parameters" }
        (parameters((&base, &found), input.profiles, density))
        @if !outcome.invariances.is_empty() {
            h3 { "The same throughout?" }
            (invariances(&outcome.invariances))
        }
        h3 { "Reasons for caution" }
        @if outcome.reasons.is_empty() {
            p { "None." }
        } @else {
            ul { @for reason in &outcome.reasons { li { (reason.to_string()) } } }
        }
    }
}

/// What each effect comes to in each part of what was fitted.
fn invariances(all: &[Invariance]) -> Markup {
    html! {
        table {
            tr { th { "effect" } th { "fitted to thirds of each demonstration" } th { "apart by" } th { "the same" } }
            @for one in all {
                tr {
                    td { (parameter_title(&one.parameter, &one.unit)) }
                    td { @for demo in one.demos() { div { (one.in_words(demo)) } } }
                    td { (format!("{:.0} % of what it does", 100.0 * one.share)) }
                    td { @if one.same() { "yes" } @else { b { "no" } } }
                }
            }
        }
        p.quiet {
            "A cause is the same from part to part; a stand-in is not. It counts as the same where the parts are apart by "
            "no more than noise and the simulation’s own error make of one value, or by a third of what the effect does. "
            "Everything else is free too, so that the values need not surround the fitted one; ± is the noise’s standard error."
        }
    }
}

/// The verdict with names for people; the sizes of what explains stand below it.
pub(super) fn headline(verdict: &Verdict) -> String {
    let titles = |ids: &[String]| ids.iter().map(|id| effect_title(id).to_owned()).collect();
    match verdict {
        Verdict::Explained { effects, .. } => Verdict::Explained {
            effects: titles(effects),
            parameters: Vec::new(),
        }
        .to_string(),
        Verdict::Confounded {
            found,
            effects,
            separating_demonstration,
        } => Verdict::Confounded {
            found: titles(found),
            effects: titles(effects),
            separating_demonstration: separating_demonstration.clone(),
        }
        .to_string(),
        other => other.to_string(),
    }
}

fn tone(verdict: &Verdict) -> &'static str {
    match verdict {
        Verdict::NothingMissing | Verdict::Explained { .. } => "good",
        Verdict::Confounded { .. } => "warn",
        Verdict::Unexplained { .. } => "bad",
    }
}

/// Held-out error before and after.
pub(super) fn error_line(before: &ResidualSummary, after: &ResidualSummary) -> Markup {
    let change = 100.0 * (1.0 - after.rms_mm / before.rms_mm);
    let said = if change.abs() < 0.5 {
        "unchanged".to_owned()
    } else if change > 0.0 {
        format!("{change:.0} % less")
    } else {
        format!("{:.0} % more", -change)
    };
    html! {
        "Held-out error: " b { (format!("{:.2} → {:.2} mm", before.rms_mm, after.rms_mm)) }
        (format!(
            ", or {:.1} → {:.1} noise floors of {:.2} mm ({said}).",
            before.floors, after.floors, after.floor_mm
        ))
    }
}

/// Parameters one after the other.
fn list(found: &[Estimate]) -> Markup {
    html! {
        @for (index, estimate) in found.iter().enumerate() {
            @if index > 0 { ", " }
            @if estimate.identified {
                (parameter_title(&estimate.name, &estimate.unit)) " = " b { (value(estimate)) }
            } @else {
                (parameter_title(&estimate.name, &estimate.unit)) " not identified"
            }
        }
    }
}

/// Value, standard error and unit; moduli in MPa.
fn value(estimate: &Estimate) -> String {
    let scale = scale_of(estimate);
    let unit = if scale == 1.0 { unit(&estimate.unit) } else { "MPa" };
    format!(
        "{} {unit}",
        with_error(scale * estimate.value, scale * estimate.standard_error)
    )
    .trim_end()
    .to_owned()
}

/// Moduli are shown in MPa.
fn scale_of(estimate: &Estimate) -> f64 {
    if estimate.unit == "Pa" { 1e-6 } else { 1.0 }
}

fn cell(estimate: Option<&Estimate>) -> Markup {
    html! {
        @match estimate {
            None => span.quiet { "—" },
            Some(estimate) if !estimate.identified => {
                "not identified" br; span.quiet { "(" (value(estimate)) ")" }
            },
            Some(estimate) => (value(estimate)),
        }
    }
}

/// A modulus of a rope of this density in the paper's units; none for what is no modulus.
pub(super) fn in_paper_units(estimate: &Estimate, density_kg_m3: Option<f64>) -> Option<String> {
    let density = density_kg_m3.filter(|_| estimate.unit == "Pa")?;
    Some(with_error(
        young_paper(estimate.value, density),
        young_paper(estimate.standard_error, density),
    ))
}

/// The 95 % interval of an estimate times a scale; none where nobody asked for it.
pub(super) fn interval(estimate: &Estimate, scale: f64, profiles: &[Profile]) -> Option<String> {
    let profile = profiles.iter().find(|one| one.name == estimate.name)?;
    Some(profile.in_words(|end| significant(scale * end)))
}

fn parameters(
    (base, found): (&[Estimate], &[Estimate]),
    profiles: &[Profile],
    density_kg_m3: Option<f64>,
) -> Markup {
    let paper = |estimate: &Estimate| {
        let density = density_kg_m3.filter(|_| estimate.identified);
        in_paper_units(estimate, density)
    };
    html! {
        table {
            tr {
                th { "parameter" } th { "base model" } th { "final model" }
                @if !profiles.is_empty() { th { "95 % interval" } }
                th { "final, paper’s units" }
            }
            @for estimate in found {
                tr {
                    td { (parameter_title(&estimate.name, &estimate.unit)) }
                    td { (cell(base.iter().find(|one| one.name == estimate.name))) }
                    td { (cell(Some(estimate))) }
                    @if !profiles.is_empty() {
                        td { @match interval(estimate, scale_of(estimate), profiles) {
                            Some(text) => (text),
                            None => span.quiet { "—" },
                        } }
                    }
                    td { @match paper(estimate) { Some(text) => (text), None => span.quiet { "—" } } }
                }
            }
        }
        p.quiet {
            "± is one standard error: noise with its correlation and, in the final model, how far a finer grid, "
            "thinner slices and another place on the grid would move the value; errors of the model itself are not in it. "
            "Every simulated rope here is that of the finer grid. "
            "A parameter is not identified where the data say little beyond its prior, or of Young’s modulus less than a "
            "factor of 1.6; the value in brackets is then no more than one place in its range."
            @if !profiles.is_empty() {
                " The interval is by profile likelihood: all that the data allow while every other parameter follows, "
                "the simulation’s own error added."
            }
        }
    }
}
