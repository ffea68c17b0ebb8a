//! What to do next: the motions that were considered with what each would tell, and how far each effect
//! could move the swing at the size that the data still allow.

use super::page::{effect_title, parameter_title, sentence};
use crate::diagnose::{Advice, MotionProspect, NextDemonstration, Question, SwingRisk, SwingRisks, Unseen};
use crate::words::{significant, unit, with_unit};
use maud::{Markup, html};

pub(super) fn section(advice: &Advice) -> Markup {
    html! {
        h2 { "The next demonstration" }
        (motions(&advice.next_demonstration))
        h2 { "What matters for the swing" }
        (risks(&advice.swing))
    }
}

fn motions(next: &NextDemonstration) -> Markup {
    html! {
        (question(&next.question))
        p { b { (sentence(&next.in_words)) } }
        @if !next.motions.is_empty() {
            table {
                tr { th { "motion" } th.n { "lasts" } (heads(&next.question)) }
                @for motion in &next.motions {
                    tr.best[next.proposed.as_deref() == Some(motion.id.as_str())] {
                        td { (motion.words) }
                        td.n { (format!("{:.1} s", motion.duration_s)) }
                        (figures(motion, &next.question))
                    }
                }
            }
            (explained(&next.question))
        }
    }
}

fn question(question: &Question) -> Markup {
    html! {
        @match question {
            Question::Nothing { .. } => {},
            Question::TellApart { models } => {
                p { "These data cannot tell which model is true: " (models_in_words(models)) "." }
            },
            Question::Narrow { parameter, unit: of, half_width, swing_mm } => {
                p {
                    "These data leave open the " (parameter_title(parameter, of)) ": its 90 % interval is ± "
                    (with_unit(&significant(*half_width), of)) ", which is worth ± "
                    (format!("{swing_mm:.1}")) " mm of the swing’s reach."
                }
            },
        }
    }
}

fn models_in_words(models: &[Vec<String>]) -> String {
    let one = |effects: &Vec<String>| {
        let titles: Vec<&str> = effects.iter().map(|id| effect_title(id)).collect();
        titles.join(" with ")
    };
    models.iter().map(one).collect::<Vec<_>>().join(" or ")
}

fn heads(question: &Question) -> Markup {
    html! {
        @match question {
            Question::Nothing { .. } => {},
            Question::TellApart { .. } => { th.n { "non-centrality" } th.n { "power" } },
            Question::Narrow { .. } => { th.n { "interval then" } th.n { "of the reach" } },
        }
    }
}

fn figures(motion: &MotionProspect, question: &Question) -> Markup {
    let number = |value: Option<f64>, text: &dyn Fn(f64) -> String| value.map_or("—".to_owned(), text);
    html! {
        @match question {
            Question::Nothing { .. } => {},
            Question::TellApart { .. } => {
                td.n { (number(motion.noncentrality, &|l| significant(l))) }
                td.n { (number(motion.power, &|p| format!("{:.0} %", 100.0 * p))) }
            },
            Question::Narrow { unit: of, .. } => {
                td.n { (number(motion.half_width, &|w| format!("± {}", with_unit(&significant(w), of)))) }
                td.n { (number(motion.swing_mm, &|mm| format!("± {mm:.1} mm"))) }
            },
        }
        @if let Some(why) = &motion.failed { td.quiet { (why) } }
    }
}

fn explained(question: &Question) -> Markup {
    html! {
        p.quiet {
            @match question {
                Question::Nothing { .. } => {},
                Question::TellApart { .. } => {
                    "Power: probability that the diagnosis, by the rule that left them alike, rejects the wrong one of two "
                    "models when the other is true, for the pair that is hardest to tell apart, with these data and one "
                    "such recording together. "
                },
                Question::Narrow { .. } => {
                    "Interval then: half of the 90 % interval with these data and one such recording together. "
                },
            }
            "Computed with the fitted model, the noise as it was measured and what the model leaves unexplained; "
            "what all models get wrong alike is not in it."
        }
    }
}

fn risks(swing: &SwingRisks) -> Markup {
    html! {
        @if let Some(why) = &swing.missing {
            p { "Not known: " (why) "." }
        } @else {
            p {
                "How far each effect could move the reach of a swing at the size that the data still allow, however "
                "invisible it is in the demonstration. The fitted rope, released at "
                (listed(&swing.releases_m, |[x, z]| format!("({x:.2}, {z:.2}) m"))) ", reaches "
                (listed(&swing.reaches_m, |m| format!("{m:.3} m"))) "; the middle one of these changes counts, the first "
                "where it is small."
            }
            table {
                tr {
                    th { "effect, its parameter that matters most" } th.n { "still allowed" }
                    th.n { "per unit" } th.n { "reach moves by up to" }
                }
                @for risk in &swing.risks { (risk_row(risk)) }
            }
            p.quiet {
                "Still allowed: 90 % interval, of the score test for effects that the model lacks (each alone), of the fit "
                "for those that it holds (in bold). * The data do not bound it; the end of its physical range counts. "
                "Several effects may describe the same small rest of error, so an interval that leaves out nothing is no "
                "finding. Differences of about 1 mm are the simulation’s own."
            }
        }
        (unseen(&swing.unseen))
    }
}

/// What the data would probably not have shown.
fn unseen(unseen: &[Unseen]) -> Markup {
    html! {
        @if !unseen.is_empty() {
            h3 { "What could be there unseen" }
            p {
                "Effects that the model lacks and that these data would probably not have shown at their smallest size of "
                "interest, with the chance that they would have:"
            }
            ul {
                @for one in unseen {
                    li {
                        b { (parameter_title(&one.name, &one.unit)) } " of " (with_unit(&significant(one.size), &one.unit))
                        (format!(": {:.0} %", 100.0 * one.power))
                    }
                }
            }
        }
    }
}

fn listed<T: Copy>(values: &[T], text: impl Fn(T) -> String) -> String {
    values.iter().map(|&v| text(v)).collect::<Vec<_>>().join(", ")
}

fn risk_row(risk: &SwingRisk) -> Markup {
    let allowed = &risk.allowed;
    let title = parameter_title(&allowed.name, &allowed.unit);
    let (scale, of) = match allowed.unit.as_str() {
        "Pa" => (1e6, "MPa"),
        other => (1.0, unit(other)),
    };
    let per_unit = if of.is_empty() {
        "mm".to_owned()
    } else {
        format!("mm per {of}")
    };
    let [low, high] = allowed.interval.map(|end| significant(end / scale));
    html! {
        tr {
            td { @if allowed.in_model { b { (title) } } @else { (title) } }
            td.n { (low) " to " (high) " " (of) @if allowed.bounded_by_range { " *" } }
            td.n { (risk.slope_mm_per_unit.map_or("—".to_owned(), |s| format!("{} {per_unit}", significant(s * scale)))) }
            td.n { (risk.at_most_mm.map_or("not simulated".to_owned(), |mm| format!("{mm:.1} mm"))) }
        }
    }
}
