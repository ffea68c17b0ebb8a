//! How the effects of the library ranked in each round, what the refits said, what was ruled out.

use super::page::{effect_title, without_unit};
use crate::diagnose::{Refit, Round, Score, Untested};
use crate::effects::{self, ParameterSpec};
use crate::words::{significant, unit, with_error};
use maud::{Markup, html};
use std::collections::BTreeMap;
use std::slice::from_ref;

pub(super) fn section(rounds: &[Round]) -> Markup {
    html! {
        h2 { "Which physics is missing" }
        @if rounds.is_empty() {
            p { "No effect was scored: the base model leaves nothing but noise." }
        }
        @for (index, round) in rounds.iter().enumerate() {
            h3 { (format!("Round {}: {}", index + 1, known(round))) }
            (ranking(round))
            (refits(round))
        }
        @if !rounds.is_empty() {
            h3 { "Not accepted, and why" }
            ul {
                @for (id, why) in not_accepted(rounds) { li { b { (effect_title(&id)) } ": " (why) } }
                @for effect in untested(rounds) {
                    li { b { (effect_title(&effect.id)) } ": not ruled out, it could not be tried: " (effect.why) }
                }
            }
        }
    }
}

/// Every effect that is not in the model, with the reason: for one that was dropped that it was, else the last round in
/// which it was refitted and passed counts most, because later rounds hold what it ties with.
pub(super) fn not_accepted(rounds: &[Round]) -> Vec<(String, String)> {
    let Some(last) = rounds.last() else {
        return Vec::new();
    };
    let gone = dropped(rounds);
    let open = last
        .table
        .scores
        .iter()
        .filter(|s| !is_accepted(last, &s.id) && gone.iter().all(|(id, _)| *id != s.id))
        .filter(|s| untested(rounds).iter().all(|effect| effect.id != s.id));
    let open = open.map(|score| {
        let passed = |round: &Round| refit(round, from_ref(&score.id)).is_some_and(|refit| refit.passed);
        let (number, round) = match rounds.iter().enumerate().rfind(|(_, round)| passed(round)) {
            Some(found) => found,
            None => (rounds.len() - 1, last),
        };
        let own = round.table.scores.iter().find(|one| one.id == score.id);
        let why = reason(round, own.unwrap_or(score));
        (score.id.clone(), format!("in round {}, {why}", number + 1))
    });
    let open: Vec<(String, String)> = open.collect();
    open.into_iter().chain(gone).collect()
}

/// Effects that were dropped and did not come back, with the round that dropped them last.
fn dropped(rounds: &[Round]) -> Vec<(String, String)> {
    let mut gone: BTreeMap<&String, String> = BTreeMap::new();
    for (number, round) in rounds.iter().enumerate() {
        gone.retain(|id, _| !is_accepted(round, id));
        let why = format!(
            "dropped in round {}: beside {} nothing needs it",
            number + 1,
            titles(&round.accepted)
        );
        gone.extend(round.dropped.iter().map(|id| (id, why.clone())));
        let in_the_end =
            "dropped in the end: its standard error lets it be nothing, and the others explain the rest";
        gone.extend(round.nothing.iter().map(|id| (id, in_the_end.to_owned())));
    }
    gone.into_iter().map(|(id, why)| (id.clone(), why)).collect()
}

/// Effects that the last round could not try.
fn untested(rounds: &[Round]) -> &[Untested] {
    rounds.last().map_or(&[], |round| &round.table.untested)
}

fn known(round: &Round) -> String {
    if round.known.is_empty() {
        return "effects on top of the base model".to_owned();
    }
    format!("effects on top of {}", titles(&round.known))
}

fn titles(ids: &[String]) -> String {
    let titles: Vec<&str> = ids.iter().map(|id| effect_title(id)).collect();
    titles.join(" and ")
}

fn is_accepted(round: &Round, id: &str) -> bool {
    round.accepted.iter().any(|accepted| accepted == id)
}

/// The refit with these effects.
pub(super) fn refit<'a>(round: &'a Round, ids: &[String]) -> Option<&'a Refit> {
    round.refits.iter().find(|refit| refit.ids == ids)
}

fn ranking(round: &Round) -> Markup {
    html! {
        div.scroll { table {
            tr {
                th { "effect" } th.n { "score" } th.n { "threshold" } th { "one-step estimate" }
                th.n { "absorbed" } th { "nearest rival (cosine)" } th { "outcome" }
            }
            @for score in &round.table.scores {
                tr.best[is_accepted(round, &score.id)] {
                    td { (effect_title(&score.id)) }
                    td.n { @if score.significant() { b { (tidy(score.statistic)) } } @else { (tidy(score.statistic)) } }
                    td.n { (tidy(score.threshold)) }
                    td { (one_step(score)) }
                    td.n { (format!("{:.0} %", 100.0 * score.absorbed_share)) }
                    td { @match &score.nearest_rival {
                        Some(rival) => {
                            (format!("{} ({:+.2})", effect_title(rival), score.rival_cosine))
                            @if let Some(also) = others_alike(score, rival) { span.quiet { " also " (also) } }
                        },
                        None => span.quiet { "none" },
                    } }
                    td { (brief(round, score)) }
                }
            }
        } }
        (together(round))
        @if !round.instead_of.is_empty() {
            p {
                b { (titles(&round.instead_of)) } " came first here and was accepted; the loop then found nothing that "
                "explained the rest, and came further from what passed second."
            }
        }
        @for id in &round.dropped {
            p {
                b { (effect_title(id)) } " is dropped: beside what this round found, the model is no worse without it "
                "than chance lets it be."
            }
        }
        @for id in &round.nothing {
            p {
                b { (effect_title(id)) } " is dropped in the end: two standard errors, which hold the simulation’s own "
                "error, let it be nothing, and what remains explains the rope without it."
            }
        }
        p.quiet {
            "Score: drop of the sum of squares, in units of the noise, that the effect would bring to first "
            "order. Threshold: in 95 % of pseudo-data that hold noise and the error of the grid ("
            (format!("{:.2}", round.table.discretisation_mm)) " mm) but no effect, no effect’s score exceeds its own. "
            "One-step estimate: where one linear step ends; a step too far may end where nothing is physical. "
            "Absorbed: share of the effect’s trace that the model’s parameters and a shifted camera can imitate. "
            "Nearest rival: the effect whose trace, after that, is most alike; “also” names others that these data hardly "
            "tell apart from it."
        }
    }
}

/// The other members of an effect's family.
fn others_alike(score: &Score, rival: &str) -> Option<String> {
    let others: Vec<String> = score.family.iter().filter(|id| *id != rival).cloned().collect();
    (!others.is_empty()).then(|| titles(&others))
}

/// The effects that would explain the residual together, where any was refitted so.
fn together(round: &Round) -> Markup {
    let subsets = round.table.subsets.iter();
    let refitted: Vec<_> = subsets.filter_map(|s| Some((s, refit(round, &s.ids)?))).collect();
    html! {
        @if !refitted.is_empty() {
            p {
                "No effect passed alone: two causes can hide each other. Those that would explain most together, to first "
                "order and with physical values, were refitted together; they have to take away half of the excess, where "
                "fitted and where held out, and none of them may be one without which the model is as good."
            }
            div.scroll { table {
                tr { th { "together" } th.n { "score" } th.n { "threshold" } th { "outcome" } }
                @for (subset, refit) in refitted {
                    tr.best[subset.ids == round.accepted] {
                        td { (titles(&subset.ids)) }
                        td.n { (tidy(subset.statistic)) }
                        td.n { (tidy(subset.threshold)) }
                        td {
                            @if subset.ids == round.accepted { span.yes { "accepted" } }
                            @else if refit.passed { "passed, second" }
                            @else { span.no { "refit failed" } }
                        }
                    }
                }
            } }
        }
    }
}

fn tidy(score: f64) -> String {
    if score < 99.5 {
        significant(score)
    } else {
        format!("{score:.0}")
    }
}

fn one_step(score: &Score) -> Markup {
    let specs: &[ParameterSpec] =
        effects::find(&score.id).map_or(&[], |index| effects::ALL[index].parameters);
    let values = score.estimate.iter().zip(&score.standard_error);
    html! {
        @for (spec, (estimate, error)) in specs.iter().zip(values) {
            div {
                span.quiet { (without_unit(spec.name, spec.unit)) } " "
                @if error.is_finite() && (*estimate != 0.0 || *error > 0.0) {
                    (with_error(spec.vanishes_at + estimate, *error)) " " (unit(spec.unit))
                    @if !(spec.low..=spec.high).contains(&(spec.vanishes_at + estimate)) {
                        " " span.no { "(not physical)" }
                    }
                } @else {
                    "held at " (significant(spec.vanishes_at))
                }
            }
        }
    }
}

/// What became of an effect, in a word.
pub(super) fn outcome(round: &Round, score: &Score) -> &'static str {
    match refit(round, from_ref(&score.id)) {
        _ if is_accepted(round, &score.id) && round.accepted.len() > 1 => "accepted, in company",
        _ if is_accepted(round, &score.id) => "accepted",
        Some(refit) if refit.passed => "passed, second",
        Some(_) => "refit failed",
        None if score.significant() => "not refitted",
        None => "below threshold",
    }
}

/// The same in the colour of its tone.
fn brief(round: &Round, score: &Score) -> Markup {
    let tone = match refit(round, from_ref(&score.id)) {
        _ if is_accepted(round, &score.id) => "yes",
        Some(refit) if !refit.passed => "no",
        None if !score.significant() => "quiet",
        _ => "",
    };
    html! { span.nowrap.(tone) { (outcome(round, score)) } }
}

/// Why an effect was not accepted.
pub(super) fn reason(round: &Round, score: &Score) -> String {
    let accepted = refit(round, &round.accepted);
    let statistic = tidy(score.statistic);
    match (refit(round, from_ref(&score.id)), accepted) {
        (Some(other), Some(_)) if other.passed && round.instead_of == other.ids => {
            "it passes every gate and came first, but the loop then found nothing that explained the rest"
                .into()
        }
        (Some(other), Some(best)) if other.passed && other.held_out.rms_mm < best.held_out.rms_mm => format!(
            "it passes the gates before the finer grid and leaves {:.2} mm where held out, {} {:.2}: not so much less as to \
             outweigh how far off the rig would have been set up",
            other.held_out.rms_mm,
            titles(&best.ids),
            best.held_out.rms_mm
        ),
        (Some(other), Some(best)) if other.passed => format!(
            "it passes the gates before the finer grid, but leaves {:.2} mm where fitted and {:.2} where held out; {} leaves {:.2} and {:.2}",
            other.fit.rms_mm,
            other.held_out.rms_mm,
            titles(&best.ids),
            best.fit.rms_mm,
            best.held_out.rms_mm
        ),
        (Some(other), None) if other.passed => "it passes every gate".into(),
        (Some(other), _) => {
            let failed = other.gates.iter().filter(|gate| !gate.passed);
            let failed: Vec<String> = failed.map(|g| format!("{} ({})", g.name, g.detail)).collect();
            format!("refitted, fails at: {}", failed.join("; "))
        }
        (None, Some(best)) if score.significant() => format!(
            "not refitted: its score {statistic} is above the threshold, but {} came first and leaves {:.2} mm where \
             fitted, {:.1} noise floors",
            titles(&best.ids),
            best.fit.rms_mm,
            best.fit.floors
        ),
        (None, None) if round.only_numerical && score.significant() => format!(
            "not ruled out: its score {statistic} was not looked into, because no more than the simulation's own error is left"
        ),
        (None, None) if score.significant() => format!(
            "not ruled out: its score {statistic} is above the threshold, but small beside the best, or its refit stopped"
        ),
        (None, _) => format!(
            "score {statistic}, below the {} that data without any effect reach",
            tidy(score.threshold)
        ),
    }
}

fn refits(round: &Round) -> Markup {
    html! {
        @if round.only_numerical {
            p {
                "No effect was refitted: what the model leaves is no more than the simulation's own error of "
                (format!("{:.2} mm.", round.table.discretisation_mm))
            }
        } @else if round.refits.is_empty() {
            p { "No effect was refitted: none is significant." }
        }
        @for refit in &round.refits {
            p {
                "Refitted with " b { (titles(&refit.ids)) }
                @for p in &refit.parameters {
                    ", " (without_unit(p.name.split_once('.').map_or(p.name.as_str(), |(_, name)| name), &p.unit))
                    " = " (with_error(p.value, p.standard_error)) " " (unit(&p.unit))
                    @if !p.identified { " (not identified)" }
                }
                (format!(
                    ": {:.2} mm where fitted, {:.2} mm where held out.",
                    refit.fit.rms_mm, refit.held_out.rms_mm
                ))
            }
            table {
                tr { th { "gate" } th {} th { "figures" } }
                @for gate in &refit.gates {
                    tr {
                        td { (gate.name) }
                        td { @if gate.passed { span.yes { "✓" } } @else { span.no { "✗" } } }
                        td { (gate.detail) }
                    }
                }
            }
        }
    }
}
