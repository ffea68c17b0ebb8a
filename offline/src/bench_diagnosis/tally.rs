//! Counts answers: the rows that the benchmark promises, and who was named for whom.

use super::ablations::ablations;
use super::cells::Kind;
use super::run::{Answer, Missing, Said, Value};
use crate::statistics::{Rate, median};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Effects that are one to first order: a clock that is off and a gripper that lags, wind and tilt.
const FAMILIES: [[&str; 2]; 2] = [["gripper_lag", "clock_offset"], ["steady_wind", "tilted_gravity"]];
/// Normal quantile of a two-sided 90 % interval.
const NINETY: f64 = 1.644_853_627;
/// Strength from which on a single effect has to be found nearly always, in noise floors.
const CLEAR_FLOORS: f64 = 2.0;

/// One line of the promised table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Line {
    /// What is counted.
    pub what: String,
    /// What was promised, in words; none of what is only counted.
    pub target: Option<String>,
    /// What was found.
    pub figure: Figure,
    /// Whether it is as promised; none where nothing was measured.
    pub met: Option<bool>,
    /// Whether so many answers tell it: both ends of a rate's interval would be judged alike.
    #[serde(default)]
    pub sure: bool,
}

/// A measured figure.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Figure {
    /// A rate.
    Rate(Rate),
    /// A number, from so many answers.
    Number(Option<f64>, usize),
    /// So many.
    Count(usize),
}

/// Everything that is counted for one reality.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Tally {
    /// Name of the reality.
    pub world: String,
    /// As [`super::cells::Cell::alone`] has it.
    pub alone: bool,
    /// As [`super::cells::Cell::clouds`] has it.
    #[serde(default)]
    pub clouds: bool,
    /// The promised lines.
    pub lines: Vec<Line>,
    /// How often which effect was named first, by true cause: columns are effects and verdicts.
    pub confusion: BTreeMap<String, BTreeMap<String, usize>>,
    /// The same lines of false alarm and wrong cause with a part of the method left out.
    pub ablations: Vec<Line>,
}

fn same_family(a: &str, b: &str) -> bool {
    a == b || FAMILIES.iter().any(|f| f.contains(&a) && f.contains(&b))
}

/// Whether the library still holds an effect that no demonstration tells from the hidden one: what explains as well as the
/// truth is no wrong cause.
fn twin_is_left(answer: &Answer) -> bool {
    let hidden = |id: &str| answer.cell.causes.iter().any(|cause| cause == id);
    FAMILIES.iter().any(|[a, b]| hidden(a) != hidden(b))
}

/// Whether the answer says that anything is missing, or says nothing at all.
fn alarmed(answer: &Answer) -> bool {
    answer.said != Said::Nothing
}

/// Whether the first effect named is the cause or of its family.
fn right_first(answer: &Answer) -> bool {
    let cause = &answer.cell.causes[0];
    answer
        .named
        .first()
        .is_some_and(|named| same_family(named, cause))
}

/// Whether an effect is none of the causes, nor of the family of one.
pub(super) fn is_strange(answer: &Answer, id: &str) -> bool {
    answer.cell.causes.iter().all(|cause| !same_family(id, cause))
}

/// Whether the answer names an effect that is none of the causes.
pub(super) fn names_strange(answer: &Answer) -> bool {
    answer.named.iter().any(|named| is_strange(answer, named))
}

/// Whether an answer is the right one: nothing where nothing is missing, else the cause and no other.
pub(super) fn is_right(answer: &Answer) -> bool {
    match answer.cell.kind() {
        Kind::Nothing => !alarmed(answer),
        Kind::Single => right_first(answer) && !names_strange(answer),
        Kind::Pair => answer.cell.causes.iter().all(|cause| found(answer, cause)) && !names_strange(answer),
        Kind::Foreign => honest(answer),
    }
}

/// Whether a cause that the library does not know was noticed and nothing else is called its explanation, alone or as one
/// of several that fit alike.
fn honest(answer: &Answer) -> bool {
    match answer.said {
        Said::Unexplained => true,
        Said::Explained => !names_strange(answer),
        Said::Confounded => !answer.set.iter().any(|id| is_strange(answer, id)),
        Said::Nothing | Said::Failed => false,
    }
}

fn found(answer: &Answer, cause: &str) -> bool {
    answer.named.iter().any(|named| same_family(named, cause))
}

/// The parameter that leads the true effect, where it was named.
fn leading(answer: &Answer) -> Option<&Value> {
    let known = answer.values.iter().filter(|v| v.truth.is_some());
    known.max_by(|a, b| a.size.total_cmp(&b.size))
}

/// Relative error of the leading parameter.
fn value_error(value: &Value) -> f64 {
    let truth = value.truth.unwrap_or(value.vanishes_at);
    (value.value - truth).abs() / (truth - value.vanishes_at).abs()
}

fn covers(value: &Value) -> bool {
    let truth = value.truth.unwrap_or(value.vanishes_at);
    (value.value - truth).abs() <= NINETY * value.standard_error
}

/// Share of the excess over the noise that the final model takes away in the motion that chose nothing; none where there
/// is no excess.
fn excess_removed(sealed_mm: Option<[f64; 3]>) -> Option<f64> {
    let [before, after, floor] = sealed_mm?.map(|mm| mm * mm);
    (before > floor).then(|| (before - after) / (before - floor))
}

/// Whether there is another model than the base model to judge; a failed diagnosis counts as a bad one.
fn changed(answer: &Answer) -> bool {
    !answer.accepted.is_empty() || answer.said == Said::Failed
}

/// Whether the final model is as good there as the base model, but for 2 %.
fn no_worse(answer: &Answer) -> bool {
    answer
        .sealed_mm
        .is_some_and(|[before, after, _]| after <= 1.02 * before)
}

fn rate(what: &str, target: &str, rate: Rate, met: impl Fn(f64) -> bool) -> Line {
    Line {
        what: what.into(),
        target: Some(target.into()),
        figure: Figure::Rate(rate),
        met: rate.share().map(&met),
        sure: rate.wilson().is_some_and(|[low, high]| met(low) == met(high)),
    }
}

fn number(what: &str, target: &str, values: Vec<f64>, met: impl Fn(f64) -> bool) -> Line {
    let count = values.len();
    let middle = median(values);
    Line {
        what: what.into(),
        target: Some(target.into()),
        figure: Figure::Number(middle, count),
        met: middle.map(met),
        sure: true,
    }
}

fn count(what: &str, count: usize) -> Line {
    Line {
        what: what.into(),
        target: None,
        figure: Figure::Count(count),
        met: None,
        sure: true,
    }
}

/// Counts the answers about one reality, and why cells of it were left out. `value_target` is the largest median error
/// of an effect's value. A diagnosis that failed is a miss of every rate.
pub fn tally(world: &str, all: &[Answer], left_out: &[&Missing], value_target: f64) -> Tally {
    let mine: Vec<&Answer> = all.iter().filter(|a| a.cell.world == world).collect();
    let whole: Vec<&Answer> = mine
        .iter()
        .copied()
        .filter(|a| a.cell.without.is_none())
        .collect();
    let mut lines = single_lines(&whole, value_target);
    lines.extend(other_lines(&whole));
    let not_made = |missing: &&&Missing| matches!(missing, Missing::NotMade(_));
    let not_made = left_out.iter().filter(not_made).count();
    lines.push(count(
        "cells left out: the cause cannot be so strong, or its rope not be simulated",
        left_out.len() - not_made,
    ));
    lines.push(count("cells left out: their truth was not made", not_made));
    let failed = whole.iter().filter(|a| a.said == Said::Failed).count();
    lines.push(count("diagnoses that failed", failed));
    Tally {
        world: world.into(),
        alone: mine.iter().any(|a| a.cell.alone),
        clouds: mine.iter().any(|a| a.cell.clouds),
        lines,
        confusion: confusion(&whole),
        ablations: ablations(&mine),
    }
}

fn of_kind<'a>(answers: &[&'a Answer], kind: Kind) -> Vec<&'a Answer> {
    answers
        .iter()
        .copied()
        .filter(|a| a.cell.kind() == kind)
        .collect()
}

fn single_lines(whole: &[&Answer], value_target: f64) -> Vec<Line> {
    let single = of_kind(whole, Kind::Single);
    let clear: Vec<&Answer> = single
        .iter()
        .copied()
        .filter(|a| a.cell.floors >= CLEAR_FLOORS)
        .collect();
    let faint = single.iter().filter(|a| a.cell.floors == 1.0);
    let right: Vec<&Answer> = clear
        .iter()
        .copied()
        .filter(|a| a.named.contains(&a.cell.causes[0]))
        .collect();
    let named = clear.iter().filter(|a| !a.named.is_empty());
    let sizes: Vec<f64> = named.map(|a| a.set.len() as f64).collect();
    let mean = (!sizes.is_empty()).then(|| sizes.iter().sum::<f64>() / sizes.len() as f64);
    let mut lines = vec![
        rate(
            "no effect in the data: anything but nothing missing is said",
            "at most 5 %",
            Rate::of(of_kind(whole, Kind::Nothing).into_iter().map(alarmed)),
            |p| p <= 0.05,
        ),
        rate(
            "single effect, 2 floors or more: right family first",
            "at least 95 %",
            Rate::of(clear.iter().map(|a| right_first(a))),
            |p| p >= 0.95,
        ),
        rate(
            "single effect, 1 floor: right family first",
            "at least 80 %",
            Rate::of(faint.map(|a| right_first(a))),
            |p| p >= 0.8,
        ),
        rate(
            "truth inside the confidence set, 2 floors or more",
            "at least 95 %",
            Rate::of(clear.iter().map(|a| a.set.contains(&a.cell.causes[0]))),
            |p| p >= 0.95,
        ),
        Line {
            what: "mean size of the confidence set, where one is named".into(),
            target: Some("at most 1.5".into()),
            figure: Figure::Number(mean, sizes.len()),
            met: mean.map(|m| m <= 1.5),
            sure: true,
        },
    ];
    lines.extend(lines_of_right(&right, value_target));
    lines
}

/// How well the right effect was found where it was.
fn lines_of_right(right: &[&Answer], value_target: f64) -> Vec<Line> {
    let leaders: Vec<&Value> = right.iter().filter_map(|a| leading(a)).collect();
    vec![
        number(
            "effect's value, median error",
            &format!("at most {:.0} %", 100.0 * value_target),
            leaders.iter().map(|v| value_error(v)).collect(),
            |m| m <= value_target,
        ),
        rate(
            "90 % intervals hold the truth",
            "85 to 95 %",
            Rate::of(leaders.iter().map(|v| covers(v))),
            |p| (0.85..=0.95).contains(&p),
        ),
        number(
            "excess removed by the right effect in a sealed motion, median share",
            "at least 90 %",
            right.iter().filter_map(|a| excess_removed(a.sealed_mm)).collect(),
            |m| m >= 0.9,
        ),
    ]
}

fn other_lines(whole: &[&Answer]) -> Vec<Line> {
    let foreign = of_kind(whole, Kind::Foreign);
    let clear = |a: &&&Answer| a.cell.floors >= CLEAR_FLOORS;
    let (mut hidden, outside): (Vec<&Answer>, Vec<&Answer>) =
        foreign.iter().filter(clear).copied().partition(|a| a.cell.hidden);
    hidden.retain(|a| !twin_is_left(a));
    let honest = |list: &[&Answer]| Rate::of(list.iter().map(|a| honest(a)));
    let pairs = of_kind(whole, Kind::Pair);
    vec![
        rate(
            "effect outside the library: noticed, and no wrong cause called its explanation",
            "at least 90 %",
            honest(&outside),
            |p| p >= 0.9,
        ),
        rate(
            "true effect hidden from the library, which holds no twin of it: noticed, and no wrong cause called so",
            "at least 90 %",
            honest(&hidden),
            |p| p >= 0.9,
        ),
        rate(
            "pairs: both found",
            "at least 85 %",
            Rate::of(pairs.iter().map(|a| a.cell.causes.iter().all(|c| found(a, c)))),
            |p| p >= 0.85,
        ),
        rate(
            "pairs: a false third",
            "at most 5 %",
            Rate::of(pairs.iter().map(|a| a.said == Said::Failed || names_strange(a))),
            |p| p <= 0.05,
        ),
        rate(
            "error in a sealed motion, where effects were accepted, no worse than the base model's by more than 2 %",
            "at least 99 %",
            Rate::of(whole.iter().filter(|a| changed(a)).map(|a| no_worse(a))),
            |p| p >= 0.99,
        ),
        rate(
            "the proposed demonstration resolves the ambiguity",
            "at least 80 %",
            Rate::of(
                whole
                    .iter()
                    .filter_map(|a| a.follow_up.as_ref()?.resolves(&a.cell.causes)),
            ),
            |p| p >= 0.8,
        ),
        number(
            "one diagnosis, median wall time as run, s",
            "under 120 s on 2 cores",
            whole.iter().map(|a| a.wall_s).collect(),
            |s| s < 120.0,
        ),
    ]
}

/// Rows: true causes; columns: what was named first, or the verdict that names nothing.
fn confusion(whole: &[&Answer]) -> BTreeMap<String, BTreeMap<String, usize>> {
    let mut matrix: BTreeMap<String, BTreeMap<String, usize>> = BTreeMap::new();
    for answer in whole {
        let mut truth = match answer.cell.causes.len() {
            0 => "(none)".to_owned(),
            _ => answer.cell.causes.join("+"),
        };
        if answer.cell.hidden {
            truth += " (hidden)";
        }
        let named = match answer.said {
            Said::Nothing => "(nothing)".to_owned(),
            Said::Unexplained => "(unexplained)".to_owned(),
            Said::Failed => "(failed)".to_owned(),
            Said::Confounded => format!("(confounded) {}", answer.set.join(" or ")),
            Said::Explained => answer.named.join("+"),
        };
        *matrix.entry(truth).or_default().entry(named).or_default() += 1;
    }
    matrix
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::cells::Cell;
    use super::super::follow_up::FollowUp;
    use super::*;

    /// An answer to a question about `causes` that names `named`.
    pub fn answer(causes: &[&str], floors: f64, named: &[&str], rivals: &[&str]) -> Answer {
        let list = |names: &[&str]| -> Vec<String> { names.iter().map(ToString::to_string).collect() };
        let said = match (named.len(), rivals.len()) {
            (0, _) => Said::Unexplained,
            (_, 0) => Said::Explained,
            _ => Said::Confounded,
        };
        Answer {
            made_by: String::new(),
            truth: 0,
            cell: Cell {
                world: "g2".into(),
                causes: list(causes),
                floors,
                noise_mm: 1.0,
                seed: 1,
                hidden: false,
                without: None,
                alone: false,
                clouds: false,
            },
            said,
            words: String::new(),
            reasons: Vec::new(),
            accepted: list(named),
            named: list(named),
            set: list(&[named, rivals].concat()),
            values: Vec::new(),
            held_out_mm: [5.0, 1.2, 1.0],
            sealed_mm: Some([5.0, 1.2, 1.0]),
            fitted_mm: [5.0, 1.2, 1.0],
            discretisation_mm: 0.1,
            significant: None,
            refits: Vec::new(),
            invariances: Vec::new(),
            wall_s: 10.0,
            follow_up: None,
        }
    }

    fn line<'a>(tally: &'a Tally, start: &str) -> &'a Line {
        tally.lines.iter().find(|l| l.what.starts_with(start)).unwrap()
    }

    /// Answers of every kind, right and wrong.
    fn answers() -> Vec<Answer> {
        let mut hidden = answer(&["tip_mass"], 5.0, &["density_gradient"], &[]);
        hidden.cell.hidden = true;
        let mut alike = hidden.clone();
        alike.cell.causes = vec!["clock_offset".into()];
        alike.named = vec!["gripper_lag".into()];
        let mut nothing = answer(&[], 0.0, &[], &[]);
        nothing.said = Said::Nothing;
        let follow_up = |left: &[&str]| FollowUp {
            proposed: Some("slower".into()),
            power: Some(0.9),
            left: left.iter().map(|id| vec![id.to_string()]).collect(),
            failed: None,
        };
        let alike_again = Answer {
            follow_up: Some(follow_up(&["tip_mass", "density_gradient"])),
            ..answer(&["tip_mass"], 2.0, &["density_gradient"], &["tip_mass"])
        };
        let resolved = Answer {
            follow_up: Some(follow_up(&["tip_mass"])),
            ..alike_again.clone()
        };
        // Accepted, and not named as the cause.
        let worse = Answer {
            accepted: vec!["air_drag".into()],
            sealed_mm: Some([1.0, 1.03, 1.0]),
            ..nothing.clone()
        };
        let overlooked = Answer {
            said: Said::Nothing,
            ..answer(&["air_jet"], 5.0, &[], &[])
        };
        let broken = Answer {
            said: Said::Failed,
            sealed_mm: None,
            ..answer(&[], 0.0, &[], &[])
        };
        vec![
            nothing,
            worse,
            overlooked,
            broken,
            answer(&[], 0.0, &["air_drag"], &[]),
            answer(&["tip_mass"], 5.0, &["tip_mass"], &[]),
            alike_again,
            resolved,
            answer(&["tip_mass"], 1.0, &[], &[]),
            answer(&["clock_offset"], 2.0, &["gripper_lag"], &[]),
            answer(&["air_jet"], 5.0, &[], &[]),
            answer(&["air_jet"], 5.0, &["steady_wind"], &[]),
            hidden,
            alike,
            answer(
                &["tip_mass", "camera_offset"],
                5.0,
                &["camera_offset", "tip_mass", "air_drag"],
                &[],
            ),
        ]
    }

    #[test]
    fn every_line_counts_what_it_says() {
        let not_made = Missing::NotMade("truths/some.json".into());
        let no_such_rope = Missing::NoSuchRope("leaves only 0.1 of 5 mm".into());
        let tally = tally("g2", &answers(), &[&not_made, &no_such_rope, &not_made], 0.1);
        let rate = |start: &str| match line(&tally, start).figure {
            Figure::Rate(rate) => (rate.hits, rate.of),
            _ => panic!("{start} is no rate"),
        };
        assert_eq!(rate("no effect"), (2, 4));
        assert_eq!(rate("single effect, 2"), (2, 4));
        assert_eq!(rate("single effect, 1"), (0, 1));
        assert_eq!(rate("truth inside"), (3, 4));
        assert_eq!(rate("the proposed"), (1, 2));
        assert_eq!(line(&tally, "mean size").figure, Figure::Number(Some(1.5), 4));
        assert_eq!(rate("effect outside"), (1, 3));
        assert_eq!(rate("true effect hidden"), (0, 1));
        assert_eq!(rate("pairs: both"), (1, 1));
        assert_eq!(rate("pairs: a false"), (1, 1));
        assert_eq!(rate("error in a sealed"), (9, 11));
        let counted = |start: &str| line(&tally, start).figure;
        assert_eq!(counted("cells left out: the cause"), Figure::Count(1));
        assert_eq!(counted("cells left out: their truth"), Figure::Count(2));
        assert_eq!(counted("diagnoses that"), Figure::Count(1));
        assert_eq!(line(&tally, "no effect").met, Some(false));
        assert_eq!(tally.confusion["tip_mass"]["(unexplained)"], 1);
        assert_eq!(
            tally.confusion["tip_mass"]["(confounded) density_gradient or tip_mass"],
            2
        );
    }

    #[test]
    fn values_are_judged_by_the_parameter_that_leads() {
        let mut right = answer(&["air_drag"], 5.0, &["air_drag"], &[]);
        let value = |name: &str, value: f64, truth: f64, size: f64| Value {
            name: name.into(),
            value,
            standard_error: 0.05,
            truth: Some(truth),
            size,
            vanishes_at: 0.0,
        };
        right.values = vec![value("a", 0.5, 0.1, 2.0), value("b", 1.1, 1.0, 4.0)];
        let tally = tally("g2", &[right], &[], 0.1);
        let Figure::Number(Some(error), 1) = line(&tally, "effect's value").figure else {
            panic!("no error")
        };
        assert!((error - 0.1).abs() < 1e-12);
        // 0.1 off with a standard error of 0.05: 2 of them, outside 1.64.
        let Figure::Rate(held) = line(&tally, "90 %").figure else {
            panic!("no rate")
        };
        assert_eq!((held.hits, held.of), (0, 1));
        // (25 - 1.44)/(25 - 1).
        let Figure::Number(Some(removed), 1) = line(&tally, "excess removed").figure else {
            panic!("no share")
        };
        assert!((removed - 23.56 / 24.0).abs() < 1e-12);
    }
}
