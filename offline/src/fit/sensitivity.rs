//! Predictions and how they change with each entry of θ: from tangents, from secants, and without another simulation
//! where an effect only changes what the cameras report ([`super::passes`]).
//!
//! A pass holds only the effects that it asks about and those that are present: one that is at its
//! vanishing value changes nothing, bit for bit, so leaving it out saves time and nothing else. Effects that
//! change the material and are not present have passes of their own: a rollout with one costs more.

use super::passes::{Busy, MAX_TANGENTS, Pass, Plan, plan, spread, vanishes};
use super::problem::{FitError, Problem};
use crate::model::Structure;
use crate::sim::Track;
use crate::sim::dual::Dual;
use crate::sim::real::{Arithmetic, Float};
use crate::sim::start::Start;
use crate::sim::tensor::{Vec3, lift3, value3};
use crate::sim::{Real, Rollout};
use rayon::prelude::*;

/// Lanes of the slopes of what is seen.
const SEEN: usize = 8;

/// Points, or their slopes, by frame and slice.
pub(super) type Frames = Vec<Vec<[f64; 3]>>;

/// Entries of θ whose trial could not be simulated, and why.
pub(super) type Failures = Vec<(usize, FitError)>;

/// A demonstration as the model predicts it.
#[derive(Clone)]
pub(super) struct Trace {
    /// At θ.
    pub(super) prediction: Prediction,
    /// Change of the centreline per unit of each entry of θ, m; empty for those that were not asked for.
    pub(super) slopes: Vec<Frames>,
}

/// What a pass found of one demonstration.
struct Part {
    /// The prediction at θ, where the pass made one.
    prediction: Option<Prediction>,
    slopes: Vec<(usize, Frames)>,
}

/// A prediction without tangents.
#[derive(Clone)]
pub(super) struct Prediction {
    /// Arc length of each slice, m.
    pub(super) arc_m: Vec<f64>,
    /// Centreline, m.
    pub(super) frames: Frames,
    /// Particles, m, by frame; none where the scene does not keep them.
    pub(super) particles: Frames,
    /// What is seen of the rope, by frame.
    pub(super) tracks: Vec<Track<f64>>,
}

fn are_numbers(frames: &Frames) -> bool {
    frames.iter().flatten().flatten().all(|slope| slope.is_finite())
}

/// The part of a structure and of θ that the simulation needs: elasticity, effects that are present,
/// and effects with an entry in `asked`. The last list says where its entries stand in θ.
fn needed(structure: &Structure, theta: &[f64], asked: &[usize]) -> (Structure, Vec<usize>) {
    let mut kept = Structure::default();
    let mut places: Vec<usize> = (0..kept.parameters().len()).collect();
    for &effect in &structure.effects {
        let mut mine = structure.entries(effect);
        if !vanishes(structure, theta, effect) || mine.clone().any(|k| asked.contains(&k)) {
            kept.effects.push(effect);
            places.extend(&mut mine);
        }
    }
    (kept, places)
}

impl Problem<'_> {
    /// Every demonstration with slopes for every entry of θ that is not held.
    ///
    /// # Errors
    /// A simulation stopped.
    pub(super) fn traces(
        &self,
        structure: &Structure,
        theta: &[f64],
        held: &[bool],
    ) -> Result<Vec<Trace>, FitError> {
        let (traces, failed) = self.traces_that_run(structure, theta, held)?;
        failed
            .into_iter()
            .next()
            .map_or(Ok(traces), |(_, error)| Err(error))
    }

    /// As [`traces`](Self::traces), but an entry of θ whose trial cannot be simulated, or whose slope has grown beyond
    /// every number, loses only its own slopes: they are empty, and the list says why.
    ///
    /// # Errors
    /// θ itself cannot be simulated.
    pub(super) fn traces_that_run(
        &self,
        structure: &Structure,
        theta: &[f64],
        held: &[bool],
    ) -> Result<(Vec<Trace>, Failures), FitError> {
        let Plan { passes, seen } = plan(structure, theta, held);
        let busy = Busy::with(self.demos.len() * passes.len());
        let passes_of = |demo: usize| match self.scenes[demo].start {
            // Where the start is sought, when the search ends depends on which tangents it carries.
            Start::Straight => spread(&passes, busy.threads_each()),
            _ => passes.clone(),
        };
        let passes: Vec<Vec<Pass>> = (0..self.demos.len()).map(passes_of).collect();
        let jobs: Vec<(usize, &Pass)> = (0..self.demos.len())
            .flat_map(|d| passes[d].iter().map(move |pass| (d, pass)))
            .collect();
        let parts: Vec<Result<Part, FitError>> = jobs
            .into_par_iter()
            .map(|(d, pass)| self.part(d, structure, theta, pass))
            .collect();
        drop(busy);
        let mut failed = Vec::new();
        let mut parts = parts.into_iter();
        let mut traces = Vec::new();
        for (demo, passes) in passes.iter().enumerate() {
            let (mut prediction, mut stopped) = (None, None);
            let mut slopes = vec![Vec::new(); theta.len()];
            for (pass, part) in passes.iter().zip(parts.by_ref()) {
                match part {
                    Ok(part) => {
                        prediction = prediction.or(part.prediction);
                        for (column, frames) in part.slopes {
                            if are_numbers(&frames) {
                                slopes[column] = frames;
                            } else {
                                failed.push((column, self.no_slope(demo, structure, column)));
                            }
                        }
                    }
                    Err(error) => {
                        failed.extend(pass.columns().iter().map(|&c| (c, error.clone())));
                        stopped = stopped.or(Some(error));
                    }
                }
            }
            let Some(prediction) = prediction else {
                return Err(stopped.unwrap_or_else(|| FitError::NoStart("no pass was planned".into())));
            };
            for (column, frames) in self.seen_slopes(demo, (structure, theta), &seen, &prediction) {
                slopes[column] = frames;
            }
            traces.push(Trace { prediction, slopes });
        }
        Ok((traces, failed))
    }

    fn no_slope(&self, demo: usize, structure: &Structure, column: usize) -> FitError {
        FitError::NoSlope {
            demo: self.demos[demo].name.clone(),
            parameter: structure.parameters()[column].name.clone(),
        }
    }

    /// Slopes with respect to some entries of θ that only change what the cameras report of a known motion.
    pub(super) fn seen_slopes(
        &self,
        demo: usize,
        (structure, theta): (&Structure, &[f64]),
        columns: &[usize],
        prediction: &Prediction,
    ) -> Vec<(usize, Frames)> {
        let slopes = |columns: &[usize]| self.seen_at_once(demo, (structure, theta), columns, prediction);
        columns.chunks(SEEN).flat_map(slopes).collect()
    }

    fn seen_at_once(
        &self,
        demo: usize,
        (structure, theta): (&Structure, &[f64]),
        columns: &[usize],
        prediction: &Prediction,
    ) -> Vec<(usize, Frames)> {
        let inputs = inputs::<f64, SEEN>(theta, columns, 0..theta.len());
        let physics = structure.physics(&inputs, 0.0);
        let lifted = |points: &[[f64; 3]]| points.iter().map(|&p| lift3(p)).collect();
        let frames: Vec<Vec<Vec3<Dual<f64, SEEN>>>> = prediction
            .tracks
            .iter()
            .map(|track| {
                let track = Track {
                    points_m: lifted(&track.points_m),
                    velocities_m_s: lifted(&track.velocities_m_s),
                };
                track.seen(&physics, &self.scenes[demo])
            })
            .collect();
        tangents_of(&frames, columns)
    }

    fn part(&self, demo: usize, structure: &Structure, theta: &[f64], pass: &Pass) -> Result<Part, FitError> {
        match pass {
            Pass::Tangents(columns) => match columns.len() {
                0 | 1 => self.tangents::<1>(demo, structure, theta, columns),
                2 => self.tangents::<2>(demo, structure, theta, columns),
                3 => self.tangents::<3>(demo, structure, theta, columns),
                4 => self.tangents::<4>(demo, structure, theta, columns),
                5 | 6 => self.tangents::<6>(demo, structure, theta, columns),
                7 | 8 => self.tangents::<8>(demo, structure, theta, columns),
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
        if self.rests(demo) {
            let inputs = inputs::<f64, N>(theta, columns, places);
            self.poses(demo, &kept, &inputs).map(|poses| part(poses, columns))
        } else {
            let inputs = inputs::<f32, N>(theta, columns, places);
            self.rollout(demo, &kept, &inputs)
                .map(|rollout| part(rollout, columns))
        }
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
            let mut moved = theta.to_vec();
            moved[column] = value;
            self.prediction(demo, structure, &moved).map(|p| p.frames)
        };
        let (from, to) = rayon::join(|| at(ends[0]), || at(ends[1]));
        let middle = theta[column];
        let ((start, from), (end, to)) = match (from, to) {
            (Ok(a), Ok(b)) => ((ends[0], a), (ends[1], b)),
            // Where only one side can be simulated, it says as much to first order.
            (Ok(a), Err(_)) if ends[0] < middle => ((ends[0], a), (middle, at(middle)?)),
            (Err(_), Ok(b)) if middle < ends[1] => ((middle, at(middle)?), (ends[1], b)),
            (Err(error), _) | (_, Err(error)) => return Err(error),
        };
        let per_unit = 1.0 / (end - start);
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

    /// One demonstration as the model predicts it, without slopes.
    ///
    /// # Errors
    /// The simulation stopped.
    pub(super) fn prediction(
        &self,
        demo: usize,
        structure: &Structure,
        theta: &[f64],
    ) -> Result<Prediction, FitError> {
        let (kept, places) = needed(structure, theta, &[]);
        let inputs = places.iter().map(|&k| theta[k]);
        if self.rests(demo) {
            let inputs: Vec<f64> = inputs.collect();
            self.poses(demo, &kept, &inputs)
                .map(|rollout| Prediction::of(&rollout))
        } else {
            let inputs: Vec<f32> = inputs.map(|t| t as f32).collect();
            self.rollout(demo, &kept, &inputs)
                .map(|rollout| Prediction::of(&rollout))
        }
    }
}

/// The entries of θ at `places`, those of `columns` as inputs with a lane each.
fn inputs<F: Float, const N: usize>(
    theta: &[f64],
    columns: &[usize],
    places: impl IntoIterator<Item = usize>,
) -> Vec<Dual<F, N>> {
    let input = |k: usize| match columns.iter().position(|&c| c == k) {
        Some(lane) => Dual::input(theta[k], lane),
        None => Dual::of(theta[k]),
    };
    places.into_iter().map(input).collect()
}

/// What a rollout with tangents says about `columns`.
fn part<F: Float, const N: usize>(rollout: Rollout<Dual<F, N>>, columns: &[usize]) -> Part {
    let slopes = tangents_of(&rollout.frames, columns);
    Part {
        prediction: Some(Prediction::of(&rollout)),
        slopes,
    }
}

/// The tangents of frames, lane by lane.
fn tangents_of<F: Float, const N: usize>(
    frames: &[Vec<Vec3<Dual<F, N>>>],
    columns: &[usize],
) -> Vec<(usize, Frames)> {
    let of_lane = |(lane, &column): (usize, &usize)| (column, frames_of(frames, lane));
    columns.iter().enumerate().map(of_lane).collect()
}

/// The tangents of frames in one lane.
pub(super) fn frames_of<F: Float, const N: usize>(frames: &[Vec<Vec3<Dual<F, N>>>], lane: usize) -> Frames {
    let slope = |point: &[Dual<F, N>; 3]| point.map(|x| x.tangent[lane].value());
    frames.iter().map(|f| f.iter().map(slope).collect()).collect()
}

impl Prediction {
    /// The values of a rollout.
    pub(super) fn of<T: Real>(rollout: &Rollout<T>) -> Self {
        let plain = |points: &Vec<Vec3<T>>| points.iter().map(|&point| value3(point)).collect();
        let track = |track: &Track<T>| Track {
            points_m: plain(&track.points_m),
            velocities_m_s: plain(&track.velocities_m_s),
        };
        Self {
            frames: rollout.frames.iter().map(plain).collect(),
            particles: rollout.particles.iter().map(plain).collect(),
            tracks: rollout.tracks.iter().map(track).collect(),
            arc_m: rollout.arc_m.clone(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::kinds::changes_material;
    use super::*;
    use crate::effects;

    fn index(id: &str) -> usize {
        effects::find(id).expect("in the registry")
    }

    #[test]
    fn the_whole_library_is_differentiated_once_in_balanced_passes() {
        let structure = Structure {
            effects: (0..effects::ALL.len()).collect(),
        };
        let theta = structure.start(1e6);
        let Plan { passes, mut seen } = plan(&structure, &theta, &vec![false; theta.len()]);
        for pass in &passes {
            match pass {
                Pass::Tangents(columns) => {
                    assert!(columns.len() <= MAX_TANGENTS);
                    // One effect that changes the material would slow down all others of its pass.
                    let (kept, _) = needed(&structure, &theta, columns);
                    let slow = kept.effects.iter().filter(|&&e| changes_material(e)).count();
                    assert!(slow == 0 || slow == kept.effects.len(), "{columns:?}");
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

    /// How many threads are idle is chance; what a fit finds is not.
    #[test]
    fn slopes_have_the_same_bits_on_any_number_of_threads() {
        let demo = crate::demo::Demo::load("demos/sample-rope/fit").unwrap();
        // The clamp moves, the rope slides on the table: more of it would tell no more.
        let demo = demo.cut(0.0, 0.9, demo.spec.start).unwrap();
        let problem = Problem::new(&[&demo], crate::fit::Resolution { cells: 1.5 }).unwrap();
        let ids = [
            "tip_mass",
            "air_drag",
            "internal_damping",
            "rest_curvature",
            "tilted_gravity",
        ];
        let structure = Structure {
            effects: ids.map(index).to_vec(),
        };
        let mut theta = structure.start(0.9e6);
        for (value, p) in theta.iter_mut().zip(structure.parameters()).skip(2) {
            *value = 0.9 * p.prior_mean + 0.02 * p.high;
        }
        same_on_threads(&problem, &structure, &theta, &[2, 3, 16]);
        // Effects that vanish, which passes leave out where they do not ask for them.
        let structure = Structure {
            effects: (0..effects::ALL.len()).collect(),
        };
        same_on_threads(&problem, &structure, &structure.start(0.9e6), &[16]);
    }

    fn same_on_threads(problem: &Problem, structure: &Structure, theta: &[f64], counts: &[usize]) {
        let mut whole = plan(structure, theta, &vec![false; theta.len()]).passes;
        whole.retain(|pass| matches!(pass, Pass::Tangents(_)));
        let slopes = |threads| {
            let mut slopes = vec![Frames::new(); theta.len()];
            let passes = spread(&whole, threads);
            let parts = passes
                .par_iter()
                .map(|pass| problem.part(0, structure, theta, pass).unwrap());
            for (column, frames) in parts.collect::<Vec<_>>().into_iter().flat_map(|part| part.slopes) {
                slopes[column] = frames;
            }
            (passes.len(), slopes)
        };
        let (alone, at_once) = slopes(1);
        for &threads in counts {
            let (passes, spread) = slopes(threads);
            assert!(passes > alone && spread == at_once, "{threads} threads");
        }
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
    fn what_is_held_takes_no_pass() {
        let structure = Structure {
            effects: vec![index("rest_curvature"), index("camera_offset")],
        };
        let mut theta = structure.start(1e6);
        theta[3] = 0.5;
        let mut held = vec![false; theta.len()];
        held[1] = true;
        held[2] = true;
        let Plan { passes, seen } = plan(&structure, &theta, &held);
        assert_eq!(
            passes,
            [Pass::Tangents(vec![0, 3])],
            "one that is present needs no other pass"
        );
        assert_eq!(seen.len(), 6);
        let Plan { passes, seen } = plan(&structure, &theta, &vec![true; theta.len()]);
        assert_eq!(passes, [Pass::Tangents(Vec::new())]);
        assert!(seen.is_empty());
    }

    #[test]
    fn a_wind_has_a_secant_at_rest_and_a_tangent_when_it_blows() {
        let structure = Structure {
            effects: vec![index("steady_wind")],
        };
        let at = |q: f64| plan(&structure, &[14.0, 0.3, q, q], &[false; 4]).passes.len();
        assert_eq!((at(0.0), at(4.0)), (3, 1));
    }
}
