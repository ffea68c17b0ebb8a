//! What speaks against an explanation that leaves nothing where it was fitted, and against what came nearest to one.

use super::conclude::Facts;
use super::round::{Refit, Round};
use super::score::Invariance;
use crate::effects;
use crate::model::Estimate;
use crate::words::{significant, with_unit};

/// Why what explains all that was fitted is not the cause, for people; nothing where nothing speaks against it.
pub(super) fn hint(facts: &Facts) -> Option<String> {
    let ends = facts.structure.effects_at_an_end(&facts.fitted.best.theta);
    let left = (!facts.held_out.foreseen()).then(|| facts.held_out.in_words());
    let against = left
        .or_else(|| at_an_end(facts, &ends))
        .or_else(|| not_the_same(facts))?;
    Some(format!(
        "{} would explain what was fitted, but {against}: not the whole cause, or stand-ins for it{}",
        facts.structure.ids().join(" and "),
        to_look_at(facts, &ends),
    ))
}

/// What came nearest where the last round accepted nothing, and which gates it failed, for people: friction explained one
/// motion, and nothing of it was to be seen in the other, which judged. It fails the fewest gates and of such fits best.
pub(super) fn nearest(rounds: &[Round]) -> Option<String> {
    let last = rounds.last().filter(|round| round.accepted.is_empty())?;
    let failed = |refit: &Refit| {
        let failed = refit.gates.iter().filter(|gate| !gate.passed);
        failed
            .map(|gate| format!("{} ({})", gate.name, gate.detail))
            .collect::<Vec<_>>()
    };
    let fewest = |a: &&Refit, b: &&Refit| {
        failed(a)
            .len()
            .cmp(&failed(b).len())
            .then(a.cost.total_cmp(&b.cost))
    };
    let refits = last.refits.iter().filter(|refit| !failed(refit).is_empty());
    let nearest = refits.min_by(fewest)?;
    Some(format!(
        "nearest came {}, which failed {}",
        effects::together(&nearest.ids),
        failed(nearest).join(" and ")
    ))
}

/// What to do where another demonstration judges that shows nothing of what is left, for people: no effect can foresee
/// there what the base model foresees as well.
pub(super) fn no_judge(facts: &Facts) -> Option<String> {
    let judged = facts.rounds.last().is_some_and(|round| !round.refits.is_empty());
    let base = facts.structure.effects.is_empty();
    let shows_nothing = facts.held_out.foreseen() && !facts.held_out.of_the_same;
    (base && judged && shows_nothing).then(|| {
        "where held out nothing is missing, so that no effect can show itself there: without --held-out, parts of \
         what is fitted judge"
            .into()
    })
}

/// What the last refit took to the `ends` of its range, for people: no cause is so large, and the gates asked for what was
/// added before. A cable's damping and end mass passed; its curl was then added, and took the mass along from 0.3 kg to
/// the 0.5 kg at which its range ends.
fn at_an_end(facts: &Facts, ends: &[usize]) -> Option<String> {
    let told = |&entry: &usize| {
        let Estimate {
            name, unit, value, ..
        } = &facts.estimates[entry];
        format!("{name} = {}", with_unit(&significant(*value), unit))
    };
    let told: Vec<String> = ends.iter().map(told).collect();
    (!told.is_empty()).then(|| {
        format!(
            "the fit takes {} to the end of the physical range",
            told.join(" and ")
        )
    })
}

/// What there is to look at where the last refit took an effect to one of the `ends` of its range, for people.
fn to_look_at(facts: &Facts, ends: &[usize]) -> String {
    let at_its_end = |&effect: &usize| {
        let entries = facts.structure.entries(effect);
        ends.iter().any(|end| entries.contains(end))
    };
    let effects = facts.structure.effects.iter().copied().filter(at_its_end);
    let advice = effects.filter_map(|effect| effects::ALL[effect].at_its_end);
    advice.map(|words| format!("; {words}")).collect()
}

/// What is not the same in all parts of what was fitted, for people, by the demonstration in which it is least so.
fn not_the_same(facts: &Facts) -> Option<String> {
    let told = |one: &Invariance| {
        let demo = one.least_alike();
        format!(
            "{} is not the same throughout: {} in thirds of demonstration {}",
            one.parameter,
            one.in_words(demo),
            demo + 1
        )
    };
    let apart = facts.invariances.iter().filter(|one| !one.same());
    let told: Vec<String> = apart.map(told).collect();
    (!told.is_empty()).then(|| told.join(" and "))
}

#[cfg(test)]
mod tests {
    use super::super::conclude::tests::{fruitless_round, judged};
    use super::super::gates::Gate;
    use super::*;
    use crate::model::Structure;

    /// Seen on the benchmark: friction explained one motion, and could not be seen in the other, which judged. All that was
    /// said was where the clearest offset is.
    #[test]
    fn what_came_nearest_is_told_with_what_spoke_against_it() {
        let mut round = fruitless_round(0.5);
        let mut other = round.refits[0].clone();
        let gate = |name: &str, passed| Gate::new(name, passed, format!("{name} in figures"));
        round.refits[0].gates = vec![gate("off nothing", false), gate("held-out gain", false)];
        (other.ids, other.cost) = (vec!["table_friction".into()], 1.0);
        other.gates = vec![gate("significant", true), gate("held-out gain", false)];
        round.refits.push(other);
        let told = nearest(std::slice::from_ref(&round)).unwrap();
        assert_eq!(
            told,
            "nearest came table_friction, which failed held-out gain (held-out gain in figures)"
        );
        round.accepted = vec!["tip_mass".into()];
        assert_eq!(nearest(&[round]), None);
    }

    /// Seen on the same: without the other motion friction was found in 50 s.
    #[test]
    fn where_the_judge_shows_nothing_another_is_named() {
        let told = |held_out_m: f64| {
            let base = Structure::default();
            let (said, _) = judged(&base, [2e-3; 2], [held_out_m; 2], 0.0, (0.5, &[]));
            said.to_string().contains("without --held-out")
        };
        assert_eq!([1e-3, 2e-3].map(told), [true, false]);
    }
}
