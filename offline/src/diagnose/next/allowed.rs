//! What the data still allow of every parameter, without another pass over the library.

use super::super::noise::Noise;
use super::super::rounds::Outcome;
use super::super::score::ScoreProblem;
use super::models::Model;
use super::power::shown;
use super::swing_risk::{Allowed, Unseen};
use crate::effects;
use crate::fit::Evaluation;
use crate::fit::Library;
use crate::model::Structure;
use nalgebra::DMatrix;
use std::collections::HashMap;

/// Normal quantile of a two-sided 90 % interval.
const NINETY: f64 = 1.644_853_627;

/// Chance below which something would probably not have been seen.
const LIKELY: f64 = 0.8;

/// What the data allow of effects that the model lacks: the score test's intervals, each effect alone,
/// widened by what the model leaves unexplained; and what would probably not have been seen.
pub(super) fn not_in_model(
    wide: &Evaluation,
    structure: &Structure,
    known: &Structure,
    noise: &Noise,
) -> (Vec<Allowed>, Vec<Unseen>) {
    let problem = ScoreProblem::new(wide, structure, known, noise, true);
    let widened = problem.misfit().sqrt();
    let (mut list, mut unseen) = (Vec::new(), Vec::new());
    for (effect, estimate, error) in problem.intervals() {
        let spec = &effects::ALL[effect];
        for (index, p) in spec.parameters.iter().enumerate() {
            let allowed = Allowed {
                name: format!("{}.{}", spec.id, p.name),
                unit: p.unit.into(),
                effect: Some(effect),
                index,
                in_model: false,
                value: p.vanishes_at,
                interval: [p.low, p.high],
                bounded_by_range: true,
            };
            let error = widened * error[index];
            let (size, half) = (p.smallest_of_interest, NINETY * error);
            let power = shown(size / error);
            if power < LIKELY {
                unseen.push(Unseen {
                    name: allowed.name.clone(),
                    unit: allowed.unit.clone(),
                    size,
                    power,
                });
            }
            list.push(allowed.within(p.vanishes_at + estimate[index], half, [p.low, p.high]));
        }
    }
    (list, unseen)
}

/// The slopes of the library where the last round started, on the rows of the final fit: another pass over
/// the library would take as long as a round. The model's own slopes are those of the final fit.
pub(super) fn transplanted(
    library: &Library,
    fitted: &Evaluation,
    own: &Structure,
    wide: &Model,
) -> Evaluation {
    let columns = |structure: &Structure| -> Vec<String> {
        structure.parameters().into_iter().map(|p| p.name).collect()
    };
    let (theirs, names) = (columns(&library.structure), columns(&wide.structure));
    let known = columns(own).len();
    let sources = names[known..]
        .iter()
        .map(|name| theirs.iter().position(|other| other == name));
    let sources: Vec<Option<usize>> = sources.collect();
    let mut jacobian = DMatrix::zeros(fitted.len(), names.len());
    let (mut i, mut first) = (0, 0);
    for (rows, before) in fitted.rows.iter().zip(&library.evaluation.rows) {
        let mut places: HashMap<(usize, usize), Vec<usize>> = HashMap::new();
        for (j, row) in before.iter().enumerate() {
            places.entry((row.frame, row.station)).or_default().push(j);
        }
        for row in rows {
            jacobian
                .view_mut((i, 0), (1, known))
                .copy_from(&fitted.jacobian.row(i).columns(0, known));
            for &j in places.get(&(row.frame, row.station)).into_iter().flatten() {
                let alike: f64 = (0..3).map(|k| row.direction[k] * before[j].direction[k]).sum();
                for (k, source) in sources.iter().enumerate() {
                    let slope = source.map_or(0.0, |s| library.evaluation.jacobian[(first + j, s)]);
                    jacobian[(i, known + k)] += alike * slope;
                }
            }
            i += 1;
        }
        first += before.len();
    }
    Evaluation {
        theta: wide.theta.clone(),
        rows: fitted.rows.clone(),
        most_rows: fitted.most_rows,
        huber: fitted.huber,
        jacobian,
    }
}

/// What the data allow of the model's own parameters.
pub(super) fn in_model(outcome: &Outcome) -> Vec<Allowed> {
    let structure = &outcome.structure;
    let info = structure.parameters();
    let owners = structure.effects.iter().flat_map(|&e| {
        let count = effects::ALL[e].parameters.len();
        (0..count).map(move |index| (Some(e), index))
    });
    let owners = [(None, 0), (None, 1)].into_iter().chain(owners);
    let all = outcome.estimates().into_iter().zip(&info).zip(owners);
    all.map(|((estimate, info), (effect, index))| {
        let of_theta = |value: f64| {
            if effect.is_none() && index == 0 {
                value.exp()
            } else {
                value
            }
        };
        let allowed = Allowed {
            name: estimate.name,
            unit: estimate.unit,
            effect,
            index,
            in_model: true,
            value: estimate.value,
            interval: [0.0; 2],
            bounded_by_range: true,
        };
        let range = [of_theta(info.low), of_theta(info.high)];
        allowed.within(estimate.value, NINETY * estimate.standard_error, range)
    })
    .collect()
}
