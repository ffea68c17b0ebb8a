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
    let left = (!facts.foreseen()).then(|| facts.held_out.in_words(facts.may_be_nothing()));
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
    let shows_nothing = facts.foreseen() && !facts.held_out.of_the_same;
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
    use super::super::conclude::tests::{fitted, fruitless_round, hint_of, judged, judged_at};
    use super::super::gates::Gate;
    use super::super::verdict::{ReasonCode, Verdict};
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

    /// What is said of a model that leaves so much where held out, before and after.
    fn said_of(
        structure: &Structure,
        mass_kg: Option<f64>,
        held_out_mm: [f64; 2],
        uncertain_mm: f64,
    ) -> Verdict {
        let mut after = fitted(structure, 1e-3);
        let before_m = if let Some(mass_kg) = mass_kg {
            after.best.theta[2] = mass_kg;
            // What no other parameter does.
            for (k, slope) in after.best.jacobian.column_mut(2).iter_mut().enumerate() {
                *slope = if k % 4 < 2 { 0.1 } else { -0.1 };
            }
            5e-3
        } else {
            1e-3
        };
        let held_out_m = held_out_mm.map(|mm| 1e-3 * mm);
        let (said, reasons) = judged_at(
            (structure, &after),
            before_m,
            held_out_m,
            uncertain_mm,
            (0.5, &[], &[]),
        );
        let warned = reasons.contains(&ReasonCode::HeldOutLeft);
        assert_eq!(warned, matches!(said, Verdict::Unexplained { .. }), "{said}");
        said
    }

    /// A model that is right in one motion alone is not right, whether effects made it so or it lacks nothing there.
    #[test]
    fn what_is_left_where_held_out_is_not_explained() {
        let said = said_of(&Structure::default(), None, [8.0; 2], 0.0);
        assert!(
            hint_of(&said).contains("8.0 mm are left (8.0 noise floors)"),
            "{said}"
        );
        let one = Structure::of_ids(&["tip_mass".to_owned()]);
        let with = |held_out_mm, uncertain_mm| said_of(&one, Some(0.3), held_out_mm, uncertain_mm);
        let said = with([8.0, 5.0], 0.0);
        assert!(
            hint_of(&said).starts_with("tip_mass would explain what was fitted, but"),
            "{said}"
        );
        let explained = |said| matches!(said, Verdict::Explained { .. });
        assert!(explained(with([8.0, 1.04], 0.0)));
        // Of 8 mm a tenth of the square is 2.7.
        assert!(explained(with([8.0, 2.6], 0.0)));
        // 1.7 mm over noise of 1 mm are left of 3: as the parameters' errors let expect, or not.
        assert!(explained(with([3.0, 2.0], 0.9)));
        hint_of(&with([3.0, 2.0], 0.5));
    }

    /// Seen on the benchmark: drag whose three coefficients might each have been none stood in for a jet, friction as unsure
    /// was the cause.
    #[test]
    fn what_may_be_nothing_has_to_foresee_nearly_all() {
        let one = Structure::of_ids(&["tip_mass".to_owned()]);
        let said = |mass_kg, left_mm| said_of(&one, Some(mass_kg), [3.0, left_mm], 0.9);
        assert!(
            hint_of(&said(0.0, 2.0)).contains("may be nothing"),
            "{}",
            said(0.0, 2.0)
        );
        let explained = |said| matches!(said, Verdict::Explained { .. });
        assert!(explained(said(0.3, 2.0)) && explained(said(0.0, 1.2)));
    }
}
