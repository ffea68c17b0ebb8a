//! What the rounds amount to: the verdict, and the reasons for caution.

use super::gates::excess_removed;
use super::round::Round;
use super::verdict::{ReasonCode, Verdict};
use crate::effects;
use crate::fit::{Evaluation, FitResult};
use crate::model::{Estimate, Structure};
use crate::observe::Row;
use crate::residual::ResidualSummary;

/// Residual over noise at which nothing is left to explain.
pub(super) const WHITE_FLOORS: f64 = 1.05;
/// Share of the excess over noise and discretisation error from which on effects explain it although what they leave
/// is more than either: so much of a strong cause that its own form is known no better. On the benchmark the right
/// effects take away all of it; wind with less friction took 96 % of a tilt that the library did not know.
const ALMOST_ALL: f64 = 0.98;

/// Whether a fit leaves nothing that calls for a further effect: noise, the simulation's own error, `numerical_mm`, or
/// next to nothing of what was left before.
pub(super) fn explains(before: &ResidualSummary, fit: &FitResult, doubt: f64, numerical_mm: f64) -> bool {
    let after = ResidualSummary::of(&fit.best);
    after.floors <= WHITE_FLOORS
        || excess_mm(fit, doubt) <= numerical_mm
        || excess_removed(before, &after, numerical_mm) >= ALMOST_ALL
}

/// What a verdict is made from.
pub(super) struct Facts<'a> {
    /// Effects of the final model.
    pub structure: &'a Structure,
    /// Base fit, with the noise as it was measured.
    pub base: &'a ResidualSummary,
    /// Final fit.
    pub fitted: &'a FitResult,
    /// Parameters of the final model.
    pub estimates: &'a [Estimate],
    /// Rounds in order.
    pub rounds: &'a [Round],
    /// What fits as well as the effects that were accepted last.
    pub rivals: &'a [Vec<String>],
    /// Number of demonstrations that were fitted, and that were held out.
    pub demos: [usize; 2],
    /// Whether the noise was measured.
    pub pure_error: bool,
    /// As [`super::noise::Noise::doubt`] says.
    pub doubt: f64,
    /// Whether a further round could not be simulated.
    pub stopped: bool,
}

impl Facts<'_> {
    /// Effects that stand, and what was accepted last with everything that fits as well; each may be several together.
    fn alternatives(&self) -> (Vec<String>, Vec<String>) {
        let accepted = self.rounds.iter().rfind(|round| !round.accepted.is_empty());
        let last = accepted.map_or(1, |round| round.accepted.len());
        let mut found = self.structure.ids();
        let last = found.split_off(found.len().saturating_sub(last));
        let alike = std::iter::once(&last).chain(self.rivals);
        let alike = alike.map(|ids| effects::together(ids)).collect();
        (found, alike)
    }
}

/// The verdict and the reasons for caution.
pub(super) fn conclude(facts: &Facts) -> (Verdict, Vec<ReasonCode>) {
    let (structure, fitted, rounds) = (facts.structure, facts.fitted, facts.rounds);
    let now = ResidualSummary::of(&fitted.best);
    let mut reasons = Vec::new();
    if !facts.pure_error {
        reasons.push(ReasonCode::NoPureError);
    }
    if facts.demos[0] == 1 {
        reasons.push(ReasonCode::OneDemonstration);
    }
    if facts.demos[1] == 0 {
        reasons.push(ReasonCode::HeldOutInTime);
    }
    if facts.stopped {
        reasons.push(ReasonCode::RoundStopped);
    }
    let numerical_mm = rounds.last().map_or(0.0, |r| r.table.discretisation_mm);
    let left_mm = excess_mm(fitted, facts.doubt);
    let numerical = left_mm <= numerical_mm;
    let white = now.floors <= WHITE_FLOORS;
    if !white {
        reasons.push(if numerical {
            ReasonCode::Numerical
        } else {
            ReasonCode::Partial
        });
    }
    if structure.effects.is_empty() {
        // Some effect nearly always imitates a part of the simulation's own error; none was accepted.
        let verdict = if white || numerical {
            Verdict::NothingMissing
        } else {
            Verdict::Unexplained {
                hint: hint(&fitted.best),
            }
        };
        return (verdict, reasons);
    }
    if !explains(facts.base, fitted, facts.doubt, numerical_mm) {
        reasons.push(ReasonCode::ProxySuspected);
        let removed = excess_removed(facts.base, &now, numerical_mm);
        return (stand_in(facts, [removed, left_mm]), reasons);
    }
    let verdict = explained(facts);
    let seen = structure.effects.iter().any(|&e| effects::ALL[e].only_seen);
    if seen && matches!(verdict, Verdict::Explained { .. }) {
        reasons.push(ReasonCode::Sensor);
    }
    (verdict, reasons)
}

/// Root mean square of what a fit leaves beyond the noise and beyond doubt about it, mm; `doubt` is a share of the
/// floor's square.
pub(super) fn excess_mm(fitted: &FitResult, doubt: f64) -> f64 {
    let now = ResidualSummary::of(&fitted.best);
    (now.rms_mm.powi(2) - (1.0 + doubt) * now.floor_mm.powi(2))
        .max(0.0)
        .sqrt()
}

/// Effects that leave more than noise and the simulation's own error are stand-ins, or causes beside another. `removed`
/// is their share of the excess, `left_mm` what they leave.
fn stand_in(facts: &Facts, [removed, left_mm]: [f64; 2]) -> Verdict {
    let effects = facts.structure.ids();
    let (_, alike) = facts.alternatives();
    let alike = match alike.as_slice() {
        [] | [_] => String::new(),
        [last, rivals @ ..] => format!(" (so would {} instead of {last})", rivals.join(" or ")),
    };
    Verdict::Unexplained {
        hint: format!(
            "{} would take away {:.0} % of the excess over the noise{alike}, but leave {left_mm:.1} mm of it: not the \
             whole cause, or stand-ins for it; {}",
            effects.join(" and "),
            100.0 * removed,
            hint(&facts.fitted.best)
        ),
    }
}

fn explained(facts: &Facts) -> Verdict {
    let (found, alike) = facts.alternatives();
    if alike.len() > 1 {
        return Verdict::Confounded {
            found,
            effects: alike,
            separating_demonstration: "a demonstration at three times or a third of this speed, or with the \
                                       rope gripped at its other end, changes their ratio"
                .into(),
        };
    }
    Verdict::Explained {
        effects: facts.structure.ids(),
        parameters: facts.estimates[2..].to_vec(),
    }
}

/// Where and when the residual is largest against its standard error: one that the cameras hardly see is large
/// by chance.
fn hint(evaluation: &Evaluation) -> String {
    let clearness = |row: &Row| row.offset_m.abs() / row.sigma_m;
    let clearest = evaluation
        .rows
        .iter()
        .enumerate()
        .flat_map(|(d, rows)| rows.iter().map(move |r| (d, r)))
        .max_by(|a, b| clearness(a.1).total_cmp(&clearness(b.1)));
    match clearest {
        Some((demo, row)) => format!(
            "the clearest offset, {:.1} mm along ({:.1}, {:.1}, {:.1}), is at s = {:.3} m in frame {} of demonstration {}",
            1e3 * row.offset_m,
            row.direction[0],
            row.direction[1],
            row.direction[2],
            row.arc_m,
            row.frame,
            demo + 1
        ),
        None => "nothing was measured".into(),
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::round::Refit;
    use super::super::score::ScoreTable;
    use super::*;
    use crate::effects;
    use crate::fit::estimates;
    use nalgebra::DMatrix;

    /// A fit that leaves `rms_m` where the noise is 1 mm.
    pub fn fitted(structure: &Structure, rms_m: f64) -> FitResult {
        let row = |frame: usize| Row {
            frame,
            station: 0,
            arc_m: 0.1,
            position_m: [0.0; 3],
            direction: [1.0, 0.0, 0.0],
            offset_m: if frame.is_multiple_of(2) { rms_m } else { -rms_m },
            sigma_m: 0.001,
        };
        let theta = structure.start(1e6);
        let rows: Vec<Row> = (0..100).map(row).collect();
        let evaluation = Evaluation {
            jacobian: DMatrix::from_element(rows.len(), theta.len(), 1e-3),
            theta,
            most_rows: rows.len(),
            rows: vec![rows],
        };
        FitResult::at(evaluation, structure)
    }

    /// A round in which an effect was significant but failed its gates.
    fn fruitless_round(discretisation_mm: f64) -> Round {
        let nothing = ResidualSummary::of(&fitted(&Structure::default(), 1e-3).best);
        Round {
            known: Vec::new(),
            table: ScoreTable {
                discretisation_mm,
                ..ScoreTable::of(Vec::new())
            },
            refits: vec![Refit {
                ids: vec![effects::ALL[0].id.into()],
                parameters: Vec::new(),
                theta: Vec::new(),
                cost: 0.0,
                fit: nothing.clone(),
                held_out: nothing,
                gates: Vec::new(),
                passed: false,
            }],
            accepted: Vec::new(),
            dropped: Vec::new(),
            instead_of: Vec::new(),
        }
    }

    /// Verdict on a model that leaves `after_m` of `before_m`, both with noise.
    fn verdict_of(
        structure: &Structure,
        [before_m, after_m]: [f64; 2],
        discretisation_mm: f64,
        rivals: &[Vec<String>],
    ) -> (Verdict, Vec<ReasonCode>) {
        let base = fitted(&Structure::default(), before_m);
        let fitted = fitted(structure, after_m);
        conclude(&Facts {
            structure,
            base: &ResidualSummary::of(&base.best),
            fitted: &fitted,
            estimates: &estimates(&fitted.best, structure),
            rounds: &[fruitless_round(discretisation_mm)],
            rivals,
            demos: [1, 1],
            pure_error: true,
            doubt: 0.0,
            stopped: false,
        })
    }

    fn hint_of(verdict: &Verdict) -> &str {
        match verdict {
            Verdict::Unexplained { hint } => hint,
            other => panic!("{other}"),
        }
    }

    /// Wind and friction took 96 % of a tilt that was hidden from the library, and were called its explanation.
    #[test]
    fn effects_that_leave_more_than_noise_and_grid_explain_nothing() {
        let structure = Structure { effects: vec![0] };
        let verdict = |before_m: f64, after_m: f64| verdict_of(&structure, [before_m, after_m], 0.5, &[]);
        let (said, reasons) = verdict(5e-3, 1.5e-3);
        let hint = hint_of(&said);
        let told = format!(
            "{} would take away 96 % of the excess over the noise",
            effects::ALL[0].id
        );
        assert!(hint.starts_with(&told), "{hint}");
        assert!(reasons.contains(&ReasonCode::Partial) && reasons.contains(&ReasonCode::ProxySuspected));
        let [near, strong] = [verdict(5e-3, 1.1e-3), verdict(20e-3, 1.4e-3)].map(|v| v.0);
        assert!(matches!(near, Verdict::Explained { .. }), "{near}");
        assert!(matches!(strong, Verdict::Explained { .. }), "{strong}");
    }

    #[test]
    fn what_is_the_cameras_is_said_to_be_where_it_is_the_explanation() {
        let of = |id: &str| Structure {
            effects: vec![effects::find(id).unwrap()],
        };
        let reasons = |id: &str, after_m: f64, rivals: &[Vec<String>]| {
            verdict_of(&of(id), [5e-3, after_m], 0.5, rivals)
                .1
                .contains(&ReasonCode::Sensor)
        };
        let lag = [vec!["gripper_lag".to_owned()]];
        assert!(reasons("clock_offset", 1.1e-3, &[]));
        assert!(!reasons("tip_mass", 1.1e-3, &[]));
        assert!(
            !reasons("clock_offset", 1.1e-3, &lag),
            "which of the two is not known"
        );
        assert!(
            !reasons("clock_offset", 1.5e-3, &[]),
            "it may stand in for another"
        );
    }

    #[test]
    fn the_hint_points_where_the_residual_is_clear_not_where_the_cameras_hardly_see() {
        let mut evaluation = fitted(&Structure::default(), 2e-3).best;
        let rows = &mut evaluation.rows[0];
        (rows[7].offset_m, rows[7].sigma_m) = (20e-3, 15e-3);
        rows[8].offset_m = 3e-3;
        let hint = hint(&evaluation);
        assert!(
            hint.contains("3.0 mm") && hint.contains("in frame 8 of"),
            "{hint}"
        );
    }

    /// A cable's poses were as well explained by its curl as by gravity that leans, and only one of them was told.
    #[test]
    fn what_would_do_as_well_as_a_stand_in_is_told() {
        let structure = Structure { effects: vec![0] };
        let rivals = ["rest_curvature", "curvature_gradient"].map(|id| vec![id.to_owned()]);
        let (said, _) = verdict_of(&structure, [5e-3, 1.5e-3], 0.5, &rivals);
        let hint = hint_of(&said);
        let told = format!(
            "(so would rest_curvature or curvature_gradient instead of {})",
            effects::ALL[0].id
        );
        assert!(hint.contains(&told), "{hint}");
    }

    /// The benchmark's ropes without any cause were called unexplained because some effect imitated the
    /// simulation's own error, though it failed every gate.
    #[test]
    fn what_is_no_larger_than_the_simulations_own_error_lacks_nothing() {
        let bare = |rms_m: f64| verdict_of(&Structure::default(), [rms_m; 2], 1.0, &[]);
        let (verdict, reasons) = bare(1.2e-3);
        assert_eq!(verdict, Verdict::NothingMissing);
        assert!(reasons.contains(&ReasonCode::Numerical));
        let (verdict, reasons) = bare(2e-3);
        assert!(matches!(verdict, Verdict::Unexplained { .. }), "{verdict}");
        assert!(reasons.contains(&ReasonCode::Partial));
    }
}
