//! Predictions and how they change with each entry of θ: from tangents, in groups as large as a pass
//! carries, and from secants where a parameter has no useful tangent ([`Slope`]).
//!
//! A pass holds only the effects that it asks about and those that are present: one that is at its
//! vanishing value changes nothing, bit for bit, so leaving it out saves time and nothing else.

use super::problem::{FitError, Problem};
use crate::effects::{self, Slope};
use crate::model::Structure;
use crate::sim::dual::Dual;
use crate::sim::tensor::value3;
use crate::sim::{Real, Rollout};
use rayon::prelude::*;

/// Most tangents of one pass.
const MAX_TANGENTS: usize = 12;

/// Points, or their slopes, by frame and slice.
type Frames = Vec<Vec<[f64; 3]>>;

/// A demonstration as the model predicts it.
pub(super) struct Trace {
    /// Arc length of each slice, m.
    pub(super) arc_m: Vec<f64>,
    /// Centreline, m.
    pub(super) frames: Frames,
    /// Its change per unit of each entry of θ, m.
    pub(super) slopes: Vec<Frames>,
}

/// Simulations that give some columns of the Jacobian.
#[derive(Clone, Debug, PartialEq)]
enum Pass {
    /// Tangents with respect to these entries of θ.
    Tangents(Vec<usize>),
    /// The change from `from` to `to` of one entry of θ.
    Secant { column: usize, from: f64, to: f64 },
}

/// What a pass found of one demonstration.
struct Part {
    /// The prediction at θ, where the pass made one.
    prediction: Option<(Vec<f64>, Frames)>,
    slopes: Vec<(usize, Frames)>,
}

/// How each entry of θ is differentiated.
fn passes(structure: &Structure, theta: &[f64]) -> Vec<Pass> {
    let info = structure.parameters();
    let specs = structure.effects.iter().flat_map(|&e| effects::ALL[e].parameters);
    let mut tangents: Vec<usize> = (0..info.len() - specs.clone().count()).collect();
    let mut secants = Vec::new();
    for (spec, column) in specs.zip(tangents.len()..) {
        let value = theta[column];
        let step = spec.smallest_of_interest;
        let secant = match spec.slope {
            Slope::Tangent => false,
            Slope::SecantNearZero => (value - spec.vanishes_at).abs() < step,
            Slope::Secant => true,
        };
        if secant {
            secants.push(Pass::Secant {
                column,
                from: (value - step).max(spec.low),
                to: (value + step).min(spec.high),
            });
        } else {
            tangents.push(column);
        }
    }
    let groups = tangents.len().div_ceil(MAX_TANGENTS);
    let size = tangents.len().div_ceil(groups);
    let mut passes: Vec<Pass> = tangents.chunks(size).map(|c| Pass::Tangents(c.to_vec())).collect();
    passes.extend(secants);
    passes
}

/// The part of a structure and of θ that the simulation needs: elasticity, effects that are present,
/// and effects with an entry in `asked`. The last list says where its entries stand in θ.
fn needed(structure: &Structure, theta: &[f64], asked: &[usize]) -> (Structure, Vec<usize>) {
    let count = |e: usize| effects::ALL[e].parameters.len();
    let total: usize = structure.effects.iter().map(|&e| count(e)).sum();
    let mut first = theta.len() - total;
    let mut places: Vec<usize> = (0..first).collect();
    let mut kept = Structure::default();
    for &effect in &structure.effects {
        let mine = first..first + count(effect);
        let vanishes = effects::ALL[effect]
            .parameters
            .iter()
            .zip(&theta[mine.clone()])
            .all(|(p, &value)| value == p.vanishes_at);
        if !vanishes || mine.clone().any(|k| asked.contains(&k)) {
            kept.effects.push(effect);
            places.extend(mine.clone());
        }
        first = mine.end;
    }
    (kept, places)
}

impl Problem<'_> {
    /// Every demonstration with slopes for every entry of θ.
    ///
    /// # Errors
    /// A simulation stopped.
    pub(super) fn traces(&self, structure: &Structure, theta: &[f64]) -> Result<Vec<Trace>, FitError> {
        let passes = passes(structure, theta);
        let jobs: Vec<(usize, &Pass)> = (0..self.demos.len())
            .flat_map(|d| passes.iter().map(move |pass| (d, pass)))
            .collect();
        let parts: Vec<Part> = jobs
            .into_par_iter()
            .map(|(d, pass)| self.part(d, structure, theta, pass))
            .collect::<Result<_, _>>()?;
        let mut parts = parts.into_iter();
        Ok((0..self.demos.len())
            .map(|_| {
                let mut trace = Trace {
                    arc_m: Vec::new(),
                    frames: Vec::new(),
                    slopes: vec![Vec::new(); theta.len()],
                };
                for part in parts.by_ref().take(passes.len()) {
                    if let (Some((arc_m, frames)), true) = (part.prediction, trace.arc_m.is_empty()) {
                        (trace.arc_m, trace.frames) = (arc_m, frames);
                    }
                    for (column, frames) in part.slopes {
                        trace.slopes[column] = frames;
                    }
                }
                trace
            })
            .collect())
    }

    fn part(&self, demo: usize, structure: &Structure, theta: &[f64], pass: &Pass) -> Result<Part, FitError> {
        match pass {
            Pass::Tangents(columns) => match columns.len() {
                0..=2 => self.tangents::<2>(demo, structure, theta, columns),
                3 => self.tangents::<3>(demo, structure, theta, columns),
                4 => self.tangents::<4>(demo, structure, theta, columns),
                5..=8 => self.tangents::<8>(demo, structure, theta, columns),
                _ => self.tangents::<MAX_TANGENTS>(demo, structure, theta, columns),
            },
            &Pass::Secant { column, from, to } => self.secant(demo, structure, theta, column, [from, to]),
        }
    }

    fn tangents<const N: usize>(
        &self,
        demo: usize,
        structure: &Structure,
        theta: &[f64],
        columns: &[usize],
    ) -> Result<Part, FitError> {
        let (kept, places) = needed(structure, theta, columns);
        let inputs: Vec<Dual<f32, N>> = places
            .iter()
            .map(|&k| match columns.iter().position(|&c| c == k) {
                Some(lane) => Dual::input(theta[k], lane),
                None => Dual::of(theta[k]),
            })
            .collect();
        let rollout = self.rollout(demo, &kept, &inputs)?;
        let slopes = columns
            .iter()
            .enumerate()
            .map(|(lane, &column)| {
                let slope = |point: &[Dual<f32, N>; 3]| point.map(|x| f64::from(x.tangent[lane]));
                let frames = rollout
                    .frames
                    .iter()
                    .map(|f| f.iter().map(slope).collect())
                    .collect();
                (column, frames)
            })
            .collect();
        Ok(Part {
            prediction: Some(values(rollout)),
            slopes,
        })
    }

    fn secant(
        &self,
        demo: usize,
        structure: &Structure,
        theta: &[f64],
        column: usize,
        ends: [f64; 2],
    ) -> Result<Part, FitError> {
        let at = |value: f64| {
            let (kept, places) = needed(structure, theta, &[column]);
            let entry = |&k: &usize| if k == column { value } else { theta[k] } as f32;
            let inputs: Vec<f32> = places.iter().map(entry).collect();
            self.rollout(demo, &kept, &inputs).map(|r| values(r).1)
        };
        let (from, to) = rayon::join(|| at(ends[0]), || at(ends[1]));
        let (from, to) = (from?, to?);
        let per_unit = 1.0 / (ends[1] - ends[0]);
        let slope = |(a, b): (&[f64; 3], &[f64; 3])| std::array::from_fn(|k| (b[k] - a[k]) * per_unit);
        let frames = from
            .iter()
            .zip(&to)
            .map(|(a, b)| a.iter().zip(b).map(slope).collect())
            .collect();
        Ok(Part {
            prediction: None,
            slopes: vec![(column, frames)],
        })
    }
}

/// The values of a rollout: arc lengths and centrelines.
fn values<T: Real>(rollout: Rollout<T>) -> (Vec<f64>, Frames) {
    let frames = rollout
        .frames
        .iter()
        .map(|frame| frame.iter().map(|&point| value3(point)).collect())
        .collect();
    (rollout.arc_m, frames)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn index(id: &str) -> usize {
        effects::find(id).expect("in the registry")
    }

    #[test]
    fn the_whole_library_is_differentiated_once_in_balanced_passes() {
        let structure = Structure {
            effects: (0..effects::ALL.len()).collect(),
        };
        let theta = structure.start(1e6);
        let passes = passes(&structure, &theta);
        let mut seen = Vec::new();
        for pass in &passes {
            match pass {
                Pass::Tangents(columns) => {
                    assert!(columns.len() <= MAX_TANGENTS);
                    seen.extend(columns);
                }
                Pass::Secant { column, from, to } => {
                    assert!(from < to);
                    seen.push(*column);
                }
            }
        }
        seen.sort_unstable();
        assert_eq!(seen, (0..theta.len()).collect::<Vec<_>>());
    }

    #[test]
    fn a_pass_leaves_out_what_it_does_not_ask_about_and_what_vanishes() {
        let structure = Structure {
            effects: vec![index("tip_mass"), index("steady_wind"), index("clock_offset")],
        };
        let mut theta = structure.start(1e6);
        theta[5] = 0.01;
        let (kept, places) = needed(&structure, &theta, &[2]);
        assert_eq!(kept.effects, [index("tip_mass"), index("clock_offset")]);
        assert_eq!(places, [0, 1, 2, 5]);
    }

    #[test]
    fn a_wind_has_a_secant_at_rest_and_a_tangent_when_it_blows() {
        let structure = Structure {
            effects: vec![index("steady_wind")],
        };
        let at = |q: f64| passes(&structure, &[14.0, 0.3, q, q]).len();
        assert_eq!((at(0.0), at(4.0)), (3, 1));
    }
}
