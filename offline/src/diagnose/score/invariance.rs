//! Whether an effect of a model is the same in every part of what was fitted.
//!
//! A cause is there all the time; a stand-in grows and shrinks with what it stands in for, as the place of a camera does
//! that drifts. Each third of each demonstration is given a value of its own, to first order, everything else free. How
//! much better that fits than one value for all is Cochran's Q (Biometrics 10, 1954), held against the same pseudo-data as
//! the scores. Causes are what stays the same where circumstances change (Peters, Bühlmann and Meinshausen, J. R. Stat.
//! Soc. B 78, 2016).

use super::free::{always_free, factor, normal_matrix};
use super::{Projector, precision, pseudo_data, quantile, whitened_vector};
use crate::diagnose::noise::{Noise, Whitener};
use crate::effects;
use crate::fit::Evaluation;
use crate::model::Structure;
use crate::words::{with_error, with_unit};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Parts of a demonstration.
const PARTS: usize = 3;
/// How far, against what an effect does, it may do something else in some parts and still be the same. A camera that drifts
/// evenly from where it is declared is, on average, 1/√12 of its drift from one that stands elsewhere by half of it: 0.58.
const MOST_APART: f64 = 1.0 / 3.0;

/// How an effect fares in parts of what was fitted.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Invariance {
    /// Name of the effect.
    pub id: String,
    /// Name of the parameter that is clearest off nothing.
    pub parameter: String,
    /// Its unit.
    pub unit: String,
    /// Its value in each part, in order.
    pub parts: Vec<PartValue>,
    /// Drop of the whitened sum of squares where each part has values of its own.
    pub statistic: f64,
    /// What it reaches in 95 % of pseudo-data in which the effect is the same.
    pub threshold: f64,
    /// How far the parts' values move what is seen, over how far the effect does.
    pub share: f64,
}

/// The value of a parameter in a part of a demonstration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PartValue {
    /// The demonstration, from 0.
    pub demo: usize,
    /// Its first and last frame there.
    pub frames: [usize; 2],
    /// Value.
    pub value: f64,
    /// Standard error, noise only.
    pub standard_error: f64,
}

impl Invariance {
    /// Whether it counts as the same: no more apart than chance lets it be, or than a small part of what it does.
    pub fn same(&self) -> bool {
        self.statistic <= self.threshold || self.share <= MOST_APART
    }

    /// The demonstrations, each once.
    pub fn demos(&self) -> Vec<usize> {
        let mut demos: Vec<usize> = self.parts.iter().map(|part| part.demo).collect();
        demos.dedup();
        demos
    }

    /// The demonstration of which two parts are furthest apart for their standard errors.
    pub fn least_alike(&self) -> usize {
        let apart = |a: &PartValue, b: &PartValue| {
            (a.value - b.value).abs() / a.standard_error.hypot(b.standard_error)
        };
        let furthest = |demo: usize| {
            let own = || self.parts.iter().filter(move |part| part.demo == demo);
            let pairs = own().flat_map(|a| own().map(move |b| apart(a, b)));
            pairs.fold(0.0, f64::max)
        };
        let demos = self.demos().into_iter();
        demos
            .max_by(|&a, &b| furthest(a).total_cmp(&furthest(b)))
            .unwrap_or(0)
    }

    /// The values of one demonstration, for people.
    pub fn in_words(&self, demo: usize) -> String {
        let parts = self.parts.iter().filter(|part| part.demo == demo);
        let values: Vec<String> = parts
            .map(|part| with_error(part.value, part.standard_error))
            .collect();
        with_unit(&values.join(", "), &self.unit)
    }
}

/// How each effect of a model fares in parts of what was fitted. `over_noise` and `nuisances` are as in
/// [`super::ScoreProblem`].
pub(in super::super) fn invariances(
    (evaluation, structure): (&Evaluation, &Structure),
    noise: &Noise,
    over_noise: &DVector<f64>,
    nuisances: bool,
    seed: u64,
) -> Vec<Invariance> {
    let whitener = noise.whitener(evaluation);
    let data = Data {
        evaluation,
        structure,
        slopes: evaluation.whitened_jacobian(),
        parts: parts(evaluation),
        residual: whitened_vector(&whitener, evaluation.whitened()),
        discretisation: whitened_vector(&whitener, over_noise.clone()),
        whitener,
        nuisances,
        seed,
    };
    let effects = structure.effects.iter();
    effects.map(|&effect| data.invariance(effect)).collect()
}

/// A part of a demonstration: its rows among all, and its frames.
struct Part {
    demo: usize,
    rows: Range<usize>,
    frames: [usize; 2],
}

/// Parts with equally many rows, but that no frame is divided.
fn parts(evaluation: &Evaluation) -> Vec<Part> {
    let mut parts = Vec::new();
    let mut first = 0;
    for (demo, rows) in evaluation.rows.iter().enumerate() {
        let frame_of = |k: usize| rows[k * rows.len() / PARTS].frame;
        let starts = |k: usize| match k {
            PARTS => rows.len(),
            _ => rows.partition_point(|row| row.frame < frame_of(k)),
        };
        for k in (0..PARTS).filter(|_| !rows.is_empty()) {
            let own = starts(k)..starts(k + 1);
            if let [begin, .., end] = &rows[own.clone()] {
                parts.push(Part {
                    demo,
                    rows: first + own.start..first + own.end,
                    frames: [begin.frame, end.frame],
                });
            }
        }
        first += rows.len();
    }
    parts
}

struct Data<'a> {
    evaluation: &'a Evaluation,
    structure: &'a Structure,
    slopes: DMatrix<f64>,
    parts: Vec<Part>,
    whitener: Whitener,
    residual: DVector<f64>,
    discretisation: DVector<f64>,
    nuisances: bool,
    seed: u64,
}

impl Data<'_> {
    fn invariance(&self, effect: usize) -> Invariance {
        let (spec, entries) = (&effects::ALL[effect], self.structure.entries(effect));
        let divided = self.divided(effect);
        let right = divided.right(&self.residual);
        let (by_part, by_all) = divided.changes(&right);
        let own = DVector::from_iterator(
            entries.len(),
            entries
                .clone()
                .zip(spec.parameters)
                .map(|(k, p)| self.evaluation.theta[k] - p.vanishes_at),
        );
        let moved = |values: DVector<f64>| (&divided.traces * values).norm();
        let errors = divided.by_part.inverse().diagonal().map(f64::sqrt);
        let of_one = divided.by_all.inverse().diagonal().map(f64::sqrt);
        let clear = |&k: &usize| (own[k] / of_one[k]).abs();
        let lead = (0..own.len())
            .max_by(|a, b| clear(a).total_cmp(&clear(b)))
            .expect("an effect has parameters");
        let info = &self.structure.parameters()[entries.start + lead];
        let value = |(i, part): (usize, &Part)| PartValue {
            demo: part.demo,
            frames: part.frames,
            value: self.evaluation.theta[entries.start + lead] + by_part[i * own.len() + lead],
            standard_error: errors[i * own.len() + lead],
        };
        Invariance {
            id: spec.id.into(),
            parameter: info.name.clone(),
            unit: info.unit.into(),
            parts: self.parts.iter().enumerate().map(value).collect(),
            statistic: divided.statistic(&right),
            threshold: self.threshold(&divided),
            share: moved(&by_part - divided.in_all(&by_all))
                / moved(divided.in_all(&own)).max(f64::MIN_POSITIVE),
        }
    }

    /// The effect with values of its own in each part.
    fn divided(&self, effect: usize) -> Divided {
        let (entries, info) = (self.structure.entries(effect), self.structure.parameters());
        let slopes = &self.slopes;
        let others: Vec<usize> = (0..info.len()).filter(|k| !entries.contains(k)).collect();
        let of_others: Vec<_> = others.iter().map(|&k| info[k].clone()).collect();
        let free = self.whitener.apply(&slopes.select_columns(&others));
        let nuisances = self.nuisances && !effects::ALL[effect].nuisance;
        let (free, priors) = always_free(self.evaluation, &self.whitener, (free, &of_others), nuisances);
        let solver = Projector::new(free, &priors);
        let count = entries.len();
        let mut columns = DMatrix::zeros(slopes.nrows(), count * self.parts.len());
        for (i, part) in self.parts.iter().enumerate() {
            let from = (part.rows.start, entries.start);
            let own = slopes.view(from, (part.rows.len(), count));
            columns
                .view_mut((part.rows.start, i * count), (part.rows.len(), count))
                .copy_from(&own);
        }
        let traces = solver.remove(&self.whitener.apply(&columns));
        let prior: Vec<f64> = info[entries].iter().map(precision).collect();
        Divided::new(solver, traces, &prior)
    }

    fn threshold(&self, divided: &Divided) -> f64 {
        let statistic = |pseudo: DVector<f64>| divided.statistic(&divided.right(&pseudo));
        quantile(
            pseudo_data(&self.discretisation, self.seed)
                .map(statistic)
                .collect(),
        )
    }
}

/// Normal equations of an effect with a value per part, and with one for all.
struct Divided {
    solver: Projector,
    traces: DMatrix<f64>,
    by_part: Cholesky<f64, Dyn>,
    by_all: Cholesky<f64, Dyn>,
    /// How many parameters the effect has.
    count: usize,
}

impl Divided {
    fn new(solver: Projector, traces: DMatrix<f64>, prior: &[f64]) -> Self {
        let count = prior.len();
        let parts = traces.ncols() / count;
        // Together the parts have the prior of the whole.
        let of_parts: Vec<f64> = (0..traces.ncols())
            .map(|k| prior[k % count] / parts as f64)
            .collect();
        let by_part = normal_matrix(&traces, &of_parts);
        let by_all = DMatrix::from_fn(count, count, |a, b| {
            let pairs = (0..parts).flat_map(|i| (0..parts).map(move |j| (i, j)));
            pairs.map(|(i, j)| by_part[(i * count + a, j * count + b)]).sum()
        });
        Self {
            solver,
            traces,
            by_part: factor(by_part),
            by_all: factor(by_all),
            count,
        }
    }

    fn right(&self, residual: &DVector<f64>) -> DVector<f64> {
        self.traces.tr_mul(&self.solver.remove_vector(residual))
    }

    fn of_all(&self, right: &DVector<f64>) -> DVector<f64> {
        let of = |a: usize| right.iter().skip(a).step_by(self.count).sum();
        DVector::from_fn(self.count, |a, _| of(a))
    }

    /// The same values in every part.
    fn in_all(&self, values: &DVector<f64>) -> DVector<f64> {
        DVector::from_fn(self.traces.ncols(), |k, _| values[k % self.count])
    }

    /// By how much the values change, part by part and as one.
    fn changes(&self, right: &DVector<f64>) -> (DVector<f64>, DVector<f64>) {
        (self.by_part.solve(right), self.by_all.solve(&self.of_all(right)))
    }

    fn statistic(&self, right: &DVector<f64>) -> f64 {
        let (by_part, by_all) = self.changes(right);
        right.dot(&by_part) - self.of_all(right).dot(&by_all)
    }
}

#[cfg(test)]
pub(in super::super) mod tests {
    use super::*;
    use crate::bench_diagnosis::noise::{CORRELATION, correlated};
    use crate::diagnose::noise::tests::{LIKE_THE_BENCHMARKS, rows_of};
    use crate::observe::Row;

    const FRAMES: usize = 24;
    const STATIONS: usize = 8;

    /// What thirds of a rope's motion say of an effect. Each of its parameters has a value in each third and moves the rope by
    /// so many metres per unit, in ways of its own, in the thirds that see it.
    fn of_effect(id: &str, parameters: &[([f64; 3], f64)], sees: [bool; 3], seed: u64) -> Invariance {
        let noise = |seed| correlated(FRAMES, STATIONS, 0.001, CORRELATION, seed);
        let mut rows = rows_of(&noise(seed), FRAMES);
        let third = |row: &Row| PARTS * row.frame / FRAMES;
        let structure = Structure::default().with(effects::find(id).expect("in the registry"));
        let way = |k: usize| -> Vec<f64> {
            let ways = noise(1000 + k as u64).into_iter().flatten().flatten();
            ways.map(|m| m / 0.001).collect()
        };
        let scales: Vec<f64> = [1e-3, 1e-3]
            .into_iter()
            .chain(parameters.iter().map(|p| p.1))
            .collect();
        let ways: Vec<Vec<f64>> = (0..scales.len()).map(way).collect();
        let jacobian = DMatrix::from_fn(rows.len(), scales.len(), |i, k| {
            let seen = k < 2 || sees[third(&rows[i])];
            if seen { scales[k] * ways[k][i] } else { 0.0 }
        });
        let mut theta = structure.start(1e6);
        for (k, (values, _)) in parameters.iter().enumerate() {
            let fitted = values.iter().sum::<f64>() / PARTS as f64;
            theta[2 + k] = fitted;
            for (i, row) in rows.iter_mut().enumerate() {
                row.offset_m += jacobian[(i, 2 + k)] * (values[third(row)] - fitted);
            }
        }
        let evaluation = Evaluation {
            theta,
            most_rows: rows.len(),
            rows: vec![rows],
            huber: f64::INFINITY,
            jacobian,
        };
        let errors = DVector::zeros(evaluation.len());
        invariances(
            (&evaluation, &structure),
            &LIKE_THE_BENCHMARKS,
            &errors,
            true,
            seed,
        )
        .remove(0)
    }

    /// The same of a tip mass that is `mass_kg` in each third, and 10 g of which move the rope by 3 mm.
    pub fn of_thirds(mass_kg: [f64; 3], seed: u64) -> Invariance {
        of_effect("tip_mass", &[(mass_kg, 0.3)], [true; 3], seed)
    }

    /// Cochran's Q of noise alone exceeds its threshold as often as it says: in 5 % of 200, give or take three standard
    /// errors; and the parts' values scatter as their standard errors say.
    #[test]
    fn what_is_the_same_is_rarely_said_to_be_apart() {
        const SEEDS: u64 = 200;
        let (mut apart, mut squares) = (0, 0.0);
        for seed in 0..SEEDS {
            let found = of_thirds([0.010; 3], seed);
            apart += usize::from(found.statistic > found.threshold);
            let z = |part: &PartValue| (part.value - 0.010) / part.standard_error;
            squares += found.parts.iter().map(|part| z(part).powi(2)).sum::<f64>();
            assert!(found.same() && found.parts.len() == 3);
        }
        let mean_square = squares / (3.0 * SEEDS as f64);
        println!("{apart} of {SEEDS}, mean square {mean_square}");
        assert!((1..=19).contains(&apart), "{apart}");
        assert!((mean_square - 1.0).abs() < 0.25, "{mean_square}");
    }

    /// A mass that grows from nothing through the motion is told by its thirds, and is no tip mass.
    #[test]
    fn what_grows_through_a_motion_is_not_the_same() {
        let grows = of_thirds([0.003, 0.010, 0.017], 7);
        println!("{grows:?}");
        for (part, kg) in grows.parts.iter().zip([0.003, 0.010, 0.017]) {
            assert!((part.value - kg).abs() < 4.0 * part.standard_error, "{part:?}");
        }
        assert!(!grows.same());
        let hardly = of_thirds([0.0095, 0.010, 0.0105], 7);
        assert!(hardly.statistic > hardly.threshold && hardly.same(), "{hardly:?}");
        let frames: Vec<[usize; 2]> = grows.parts.iter().map(|part| part.frames).collect();
        assert_eq!(frames, [[0, 7], [8, 15], [16, 23]]);
    }

    /// A rope that leans towards one side for sure, and towards the other as far as nobody can tell: in the first third, while it
    /// lies on a table, neither is seen.
    #[test]
    fn the_parameter_that_all_parts_together_make_clearest_is_told() {
        let found = of_effect(
            "tilted_gravity",
            &[([0.03; 3], 1e-3), ([0.01; 3], 0.3)],
            [false, true, true],
            7,
        );
        assert_eq!(found.parameter, "tilted_gravity.toward_y_rad");
        let [on_table, .., last] = &found.parts[..] else {
            panic!("{found:?}")
        };
        assert!(on_table.standard_error > 100.0 * last.standard_error, "{found:?}");
        assert!(found.same() && (last.value - 0.01).abs() < 4.0 * last.standard_error);
    }
}
