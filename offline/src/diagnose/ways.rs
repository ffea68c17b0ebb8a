//! The way that a loop takes, round after round, and the other that it might have taken: the effect that passed second in
//! the first round may be the cause of what the first stands in for. Air drag was, by what was held out, before the damping
//! of a real cable, whose rest shape then fitted nothing.

use super::accounted::{WHITE_FLOORS, excess_mm};
use super::bench::Bench;
use super::choice::{Standing, last_gates, likelier};
use super::memory::{KeptModel, Memory};
use super::revise::{better, needed};
use super::rivals::{by_another_way, still_rivals};
use super::round::{Round, one_round};
use super::rounds::{LoopOptions, physical_effects};
use crate::effects;
use crate::fit::{Evaluation, FitError, FitResult, Library};
use crate::model::Structure;
use crate::residual::ResidualSummary;
use crate::tell::Tell;

/// How far the loop has come.
pub(super) struct SoFar {
    pub(super) now: Standing,
    pub(super) rounds: Vec<Round>,
    /// What passed second in the first round.
    pub(super) other: Option<KeptModel>,
}

/// Where the loop ended.
pub(super) struct Ended<'a> {
    /// Refined at the model of the last round.
    pub(super) bench: Bench<'a>,
    pub(super) model: Standing,
    pub(super) rounds: Vec<Round>,
    /// Slopes of the last round.
    pub(super) library: Option<Library>,
    /// Whether a further round could not be simulated.
    pub(super) stopped: bool,
    /// As [`SoFar::other`].
    other: Option<KeptModel>,
}

/// The way that begins with the likeliest effect or, where that leaves something and the other does better, the one that
/// begins with what passed second. `before` is what the base model leaves.
pub(super) fn all_rounds<'a>(
    bench: &Bench<'a>,
    at: SoFar,
    before: &ResidualSummary,
    options: &LoopOptions,
    keep: &dyn Fn(&SoFar),
    progress: &dyn Tell,
) -> Result<Ended<'a>, FitError> {
    let ended = one_way(bench, at, options, keep, progress)?;
    let other = other_beginning(bench, &ended, before, options, progress);
    // What a run that is killed goes on from is the first way: it comes here again.
    let again = other.and_then(|at| {
        at.map(|at| one_way(bench, at, options, &|_| (), progress))
            .transpose()
    });
    let (mut best, other) = match again {
        Ok(Some(again)) if likelier(&again.model, &ended.model) => (again, ended),
        Ok(Some(again)) => {
            progress.say("that does no better");
            (ended, again)
        }
        Ok(None) => return Ok(ended),
        // What the first way found stands.
        Err(error) => {
            progress.say(&format!("not to its end: {error}"));
            return Ok(ended);
        }
    };
    let rival = by_another_way(&best.model, &other.model);
    best.model.rivals.extend(rival);
    Ok(best)
}

/// Where the other way begins, if the first leaves something and did not come by what passed second.
fn other_beginning(
    bench: &Bench,
    ended: &Ended,
    before: &ResidualSummary,
    options: &LoopOptions,
    progress: &dyn Tell,
) -> Result<Option<SoFar>, FitError> {
    let (Some(kept), Some(first)) = (&ended.other, ended.rounds.first()) else {
        return Ok(None);
    };
    let found = ended.model.structure.ids();
    let came_by = kept.effects.iter().all(|id| found.contains(id));
    if came_by || !leaves_something(bench, &ended.model, &ended.rounds) {
        return Ok(None);
    }
    let (one, other) = (
        effects::together(&first.accepted),
        effects::together(&kept.effects),
    );
    progress.say(&format!(
        "something is left: beginning with {other}, which passed as well, instead of {one}"
    ));
    let bench = &kept.bench(bench)?;
    let now = kept.again(bench)?;
    let mut round = Round {
        accepted: kept.effects.clone(),
        instead_of: first.accepted.clone(),
        dropped: Vec::new(),
        nothing: Vec::new(),
        ..first.clone()
    };
    let gates = last_gates(bench, &now, &kept.effects, before, options, progress);
    if gates.iter().any(|gate| !gate.passed) {
        return Ok(None);
    }
    if let Some(refit) = round.refits.iter_mut().find(|refit| refit.ids == kept.effects) {
        refit.ask(gates);
    }
    Ok(Some(SoFar {
        now: now.followed(bench)?.1,
        rounds: vec![round],
        other: None,
    }))
}

/// Round after round until nothing is left to explain, nothing explains it, or a model that was found cannot be looked
/// into any further: what was found until then stands.
fn one_way<'a>(
    bench: &Bench<'a>,
    mut at: SoFar,
    options: &LoopOptions,
    keep: &dyn Fn(&SoFar),
    progress: &dyn Tell,
) -> Result<Ended<'a>, FitError> {
    // So it is where a loop goes on that was killed after its last round.
    let found_nothing = |round: &Round| round.accepted.is_empty();
    let mut done = at.rounds.last().is_some_and(found_nothing);
    let (mut library, mut stopped) = (None, false);
    let mut here = bench.refined(&at.now.structure, &at.now.fitted.best.theta)?;
    keep(&at);
    while !done && at.goes_on(bench, options) {
        let mut turn = match one_round(&here, &at.now, options, progress) {
            Err(error) if !at.rounds.is_empty() => {
                progress.say(&format!("no further round: {error}"));
                stopped = true;
                break;
            }
            turn => turn?,
        };
        done = turn.next.is_none();
        if let Some(next) = turn.next {
            let (mut next, dropped) = needed(&here, &at.now, next, progress);
            next.rivals.extend(still_rivals(
                &here,
                &at.now,
                &next,
                &turn.round,
                options,
                progress,
            ));
            turn.round.dropped = dropped;
            match next.followed(bench) {
                Ok(followed) => (here, at.now) = followed,
                Err(error) => {
                    progress.say(&format!("no further round: {error}"));
                    (at.now, done, stopped) = (next, true, true);
                }
            }
        }
        if at.rounds.is_empty() {
            at.other = turn.second;
        }
        at.rounds.push(turn.round);
        keep(&at);
        library = Some(turn.library);
    }
    Ok(Ended {
        model: better(&here, at.now, &at.rounds, progress)?,
        bench: here,
        rounds: at.rounds,
        library,
        stopped,
        other: at.other,
    })
}

impl SoFar {
    /// The loop before its first round.
    pub(super) fn at_first(bench: &Bench, base: &FitResult, held_out: &Evaluation) -> Result<Self, FitError> {
        let structure = Structure::default();
        let fitted = bench.again(&structure, &base.best.theta)?;
        Ok(Self {
            now: Standing::judged(structure, fitted, ResidualSummary::of(held_out)),
            rounds: Vec::new(),
            other: None,
        })
    }

    /// The loop where a killed one was.
    pub(super) fn again(memory: Memory, bench: &Bench) -> Result<Self, FitError> {
        Ok(Self {
            now: Standing {
                rivals: memory.rivals,
                ..memory.now.again(&memory.now.bench(bench)?)?
            },
            rounds: memory.rounds,
            other: memory.other,
        })
    }

    /// Whether there is something left that a further round could explain.
    fn goes_on(&self, bench: &Bench, options: &LoopOptions) -> bool {
        physical_effects(&self.now.structure) < options.max_effects
            && leaves_something(bench, &self.now, &self.rounds)
    }
}

/// Whether a model leaves something over the noise that is not the simulation's own error.
fn leaves_something(bench: &Bench, model: &Standing, rounds: &[Round]) -> bool {
    model.left.floors > WHITE_FLOORS && !only_numerical(&model.left, rounds, bench.doubt(&model.fitted.best))
}

/// Whether a model with effects leaves nothing but what the simulation itself was off by in the last round. No
/// further effect could be believed, and a round takes as long as all before it.
fn only_numerical(left: &ResidualSummary, rounds: &[Round], doubt: f64) -> bool {
    let has_effects = |round: &&Round| !round.known.is_empty() || !round.accepted.is_empty();
    let last = rounds.last().filter(has_effects);
    last.is_some_and(|round| excess_mm(left, doubt) <= round.table.discretisation_mm)
}

#[cfg(test)]
mod tests {
    use super::super::revise::tests::{base, options, recorded, with};
    use super::super::score::ScoreTable;
    use super::*;
    use crate::bench_diagnosis::reality::part;
    use crate::tell::Silent;

    /// Seen with three recordings fitted together: what the tip mass left was more than the simulation was off by without
    /// it and less than with it, and every effect was tried for that, alone and together, for four minutes.
    #[test]
    fn nothing_is_refitted_for_what_the_simulation_itself_is_off_by() {
        let demos = recorded(&[part("tilted_gravity", 8.0)]);
        let options = options();
        let bench = Bench::new(&[&demos[0]], &[&demos[1]], &options).unwrap();
        let round = |id: &str| {
            let (bench, model) = with(&bench, &[id]).followed(&bench).unwrap();
            let turn = one_round(&bench, &model, &options, &Silent).unwrap();
            assert_eq!(turn.next.is_none(), turn.round.accepted.is_empty());
            turn.round
        };
        let [right, stand_in] = ["tilted_gravity", "air_drag"].map(round);
        assert!(right.only_numerical && right.refits.is_empty());
        assert!(!stand_in.only_numerical && !stand_in.refits.is_empty());
        let left = ResidualSummary::of(&with(&bench, &["tilted_gravity"]).fitted.best);
        let after = |round: &Round| only_numerical(&left, std::slice::from_ref(round), 0.0);
        assert!(after(&right));
        assert!(
            !after(&Round {
                known: Vec::new(),
                ..right.clone()
            }),
            "a base model's slight effects are asked for"
        );
    }

    /// The rope leans because its table does. Drag was taken for the cause and the tilt passed second; nothing else may be
    /// added to either.
    #[test]
    fn what_passed_second_takes_the_place_of_what_leaves_more() {
        let demos = recorded(&[part("tilted_gravity", 8.0)]);
        let options = LoopOptions {
            max_effects: 1,
            ..options()
        };
        let bench = Bench::new(&[&demos[0]], &[&demos[1]], &options).unwrap();
        let before = base(&bench).left;
        let model = |id: &str| with(&bench, &[id]);
        let all = |first: &str, second: Option<&str>| {
            let at = SoFar {
                now: model(first),
                rounds: vec![Round {
                    known: Vec::new(),
                    table: ScoreTable::of(Vec::new()),
                    refits: Vec::new(),
                    accepted: vec![first.to_owned()],
                    only_numerical: false,
                    dropped: Vec::new(),
                    nothing: Vec::new(),
                    instead_of: Vec::new(),
                }],
                other: second.map(|id| KeptModel::of(&model(id))),
            };
            let ended = all_rounds(&bench, at, &before, &options, &|_| (), &Silent).unwrap();
            let round = ended.rounds[0].clone();
            (ended.model.structure.ids(), round.accepted, round.instead_of)
        };
        let [drag, tilt] = ["air_drag", "tilted_gravity"].map(|id| vec![id.to_owned()]);
        let none = Vec::new();
        assert_eq!(
            all("air_drag", Some("tilted_gravity")),
            (tilt.clone(), tilt.clone(), drag.clone())
        );
        assert_eq!(all("air_drag", None), (drag.clone(), drag, none.clone()));
        assert_eq!(
            all("tilted_gravity", Some("air_drag")),
            (tilt.clone(), tilt, none)
        );
    }
}
