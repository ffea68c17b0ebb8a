//! The least-squares problem: demonstrations, scenes, and one evaluation of residual and Jacobian.

use super::cost::huber;
use super::numerical::Refinement;
use super::push::Pushes;
use super::sensitivity::{Prediction, Trace};
use super::share::{FrameShare, Frames};
use super::uncertainty::STIFFNESS_ACCURACY;
use crate::demo::Demo;
use crate::effects;
use crate::model::{ParameterInfo, Structure};
use crate::observe::{Centreline, Row, Section, bracket, measure, most_rows, noise_m};
use crate::sim::physics::ForceField;
use crate::sim::rest::settle_poses;
use crate::sim::start::Start;
use crate::sim::{Hung, Laned, Physics, Real, Rollout, Scene, SimError, poses, simulate_hung};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use std::borrow::Cow;
use std::sync::Arc;
use thiserror::Error;

/// Why a fit could not be made.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum FitError {
    /// A simulation stopped.
    #[error("{demo}: {error}")]
    Simulation {
        /// Demonstration.
        demo: String,
        /// Reason.
        error: SimError,
    },
    /// A derivative is no number.
    #[error(
        "{demo}: how the rope changes with {parameter} has grown beyond every number: the motion there is chaotic or the simulation unstable"
    )]
    NoSlope {
        /// Demonstration.
        demo: String,
        /// Parameter.
        parameter: String,
    },
    /// No start led anywhere.
    #[error("no start could be simulated; the first failure was: {0}")]
    NoStart(String),
    /// Too little was measured.
    #[error(
        "{demo}: only {rows} offsets could be measured{}, at least {needed} are needed: {}",
        .share.in_words(), .share.when_too_few()
    )]
    TooFewRows {
        /// Demonstration.
        demo: String,
        /// Number of rows.
        rows: usize,
        /// Number needed.
        needed: usize,
        /// Which part of it was asked for.
        share: FrameShare,
    },
}

/// Grid resolution of a simulation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Resolution {
    /// Cells across the rope.
    pub cells: f64,
}

/// Demonstrations with the scenes that simulate them.
#[derive(Clone)]
pub struct Problem<'a> {
    /// Demonstrations.
    pub demos: Vec<&'a Demo>,
    /// One scene per demonstration.
    pub scenes: Vec<Scene>,
    /// Factor on the declared noise, measured at rest without the model.
    pub noise_scale: f64,
    /// Which frames of each demonstration count; the others are left out.
    pub(crate) frames: FrameShare,
    /// Which points of the rope the clouds hold.
    pub section: Section,
    /// What is added to every prediction; nothing where they are the grid's own.
    pub(crate) refinement: Option<Arc<Refinement>>,
    /// Share by which the simulated bending stiffness may be off from the measured rope's.
    pub stiffness_accuracy: f64,
}

/// Residual and Jacobian at one θ. Rows of all demonstrations stand one after another.
#[derive(Clone)]
pub struct Evaluation {
    /// θ.
    pub theta: Vec<f64>,
    /// Measured offsets per demonstration.
    pub rows: Vec<Vec<Row>>,
    /// How many they would be if the cameras saw every station, whatever θ is.
    pub most_rows: usize,
    /// Whitened offsets beyond this count linearly.
    pub huber: f64,
    /// d(prediction)/dθ along each row's direction, m per unit of θ; empty without tangents, zero for
    /// what was not asked for.
    pub jacobian: DMatrix<f64>,
}

/// A model with further effects of the library at their vanishing values.
pub struct Library {
    /// Effects of the model, then those that could be tried.
    pub structure: Structure,
    /// Residual of the model, and slopes for all of them.
    pub evaluation: Evaluation,
    /// Effects that could not be simulated at any size of interest, and why.
    pub failed: Vec<(usize, FitError)>,
}

/// Fewest rows of a demonstration worth fitting.
const MIN_ROWS: usize = 20;

impl<'a> Problem<'a> {
    /// Scenes of the demonstrations at a resolution.
    ///
    /// # Errors
    /// A demonstration cannot be simulated.
    pub fn new(demos: &[&'a Demo], resolution: Resolution) -> Result<Self, FitError> {
        let scenes = demos
            .iter()
            .map(|demo| Scene::of_demo(demo, resolution.cells).map_err(|error| simulation(demo, error)))
            .collect::<Result<_, _>>()?;
        Ok(Self::of_scenes(demos.to_vec(), scenes))
    }

    /// Demonstrations with a scene for each, all of their frames.
    pub fn of_scenes(demos: Vec<&'a Demo>, scenes: Vec<Scene>) -> Self {
        Self {
            demos,
            scenes,
            noise_scale: 1.0,
            frames: FrameShare::All,
            section: Section::default(),
            refinement: None,
            stiffness_accuracy: STIFFNESS_ACCURACY,
        }
    }

    /// The same for a part of the frames; what comes after the last of them is not simulated.
    pub fn of_share(mut self, frames: FrameShare) -> Self {
        self.frames = frames;
        for d in 0..self.demos.len() {
            let rests = self.rests(d);
            let all = Frames::of(self.demos[d]);
            let times_s = &mut self.scenes[d].frame_times_s;
            let counts = |&frame: &usize| frames.contains(frame, &all);
            let kept = (0..times_s.len()).rev().find(counts).map_or(0, |last| last + 1);
            if kept < times_s.len() && !rests {
                times_s.truncate(kept);
                self.scenes[d].duration_s = times_s.last().copied().unwrap_or(0.0);
            }
        }
        self
    }

    /// Residuals without derivatives.
    ///
    /// # Errors
    /// A simulation stopped, or too little was measured.
    pub fn residuals(&self, structure: &Structure, theta: &[f64]) -> Result<Evaluation, FitError> {
        self.residuals_of(theta, &self.predict(structure, theta)?)
    }

    /// The same of a problem that is settled at θ.
    pub(super) fn residuals_as_begun(
        &self,
        structure: &Structure,
        theta: &[f64],
    ) -> Result<Evaluation, FitError> {
        self.residuals_of(theta, &self.predict_as_begun(structure, theta)?)
    }

    /// Residuals of what [`Self::predict`] returned for θ.
    ///
    /// # Errors
    /// Too little was measured.
    pub fn residuals_of(&self, theta: &[f64], rollouts: &[Rollout<f32>]) -> Result<Evaluation, FitError> {
        let rows = (0..self.demos.len())
            .into_par_iter()
            .map(|d| self.rows_of(d, &Prediction::of(&rollouts[d])))
            .collect::<Result<_, _>>()?;
        Ok(Evaluation {
            theta: theta.to_vec(),
            rows,
            most_rows: self.most_rows(),
            huber: huber(self.noise_scale),
            jacobian: DMatrix::zeros(0, 0),
        })
    }

    /// Residuals and Jacobian.
    ///
    /// # Errors
    /// A simulation stopped, or too little was measured.
    pub fn evaluate(&self, structure: &Structure, theta: &[f64]) -> Result<Evaluation, FitError> {
        Ok(self.settled_and_evaluated(structure, theta)?.1)
    }

    /// The problem settled at θ, with residuals and Jacobian there.
    pub(super) fn settled_and_evaluated(
        &self,
        structure: &Structure,
        theta: &[f64],
    ) -> Result<(Self, Evaluation), FitError> {
        let here = self.settled(structure, theta)?;
        let traced = here.traced(structure, theta, &vec![false; theta.len()])?;
        Ok((here, traced.evaluation))
    }

    /// Residual and Jacobian of a structure with `asked`, further effects at their vanishing values. Columns of what
    /// moves the rope only out of the plane in which it was seen are zero.
    ///
    /// # Errors
    /// The structure without them cannot be simulated, or too little was measured.
    pub fn library(
        &self,
        structure: &Structure,
        theta: &[f64],
        asked: &[usize],
    ) -> Result<Library, FitError> {
        let (mut wide, mut wide_theta) = (structure.clone(), theta.to_vec());
        wide.effects.extend(asked);
        wide_theta.extend(asked.iter().flat_map(|&effect| effects::ALL[effect].vanishing()));
        let here = self.settled(structure, theta)?;
        let (mut traces, failures) =
            here.traces_that_run(&wide, &wide_theta, &vec![false; wide_theta.len()])?;
        let (mut tested, mut failed) = (structure.clone(), Vec::new());
        let mut kept: Vec<usize> = (0..theta.len()).collect();
        let mut first = theta.len();
        for &effect in asked {
            let mine = first..first + effects::ALL[effect].parameters.len();
            first = mine.end;
            if let Some((_, error)) = failures.iter().find(|(column, _)| mine.contains(column)) {
                failed.push((effect, error.clone()));
            } else {
                tested.effects.push(effect);
                kept.extend(mine);
            }
        }
        if let Some((_, error)) = failures.into_iter().find(|(column, _)| *column < theta.len()) {
            return Err(error);
        }
        for trace in &mut traces {
            trace.slopes = kept
                .iter()
                .map(|&k| std::mem::take(&mut trace.slopes[k]))
                .collect();
        }
        let theta: Vec<f64> = kept.iter().map(|&k| wide_theta[k]).collect();
        let mut evaluation = self.evaluation(&tested, &theta, &traces)?;
        let unseen = self.out_of_plane(&tested, &evaluation).into_iter().enumerate();
        for (k, _) in unseen.filter(|(_, unseen)| *unseen) {
            evaluation.jacobian.column_mut(k).fill(0.0);
        }
        Ok(Library {
            evaluation,
            structure: tested,
            failed,
        })
    }

    /// Which entries of θ move a rope only out of the plane in which it was seen. A fit leaves them where they are, and
    /// no score asks for them: to second order they would stand in for whatever shortens the rope there.
    pub fn out_of_plane(&self, structure: &Structure, evaluation: &Evaluation) -> Vec<bool> {
        /// Change of a row over the whole range of a parameter, in standard errors, that is none.
        const NONE: f64 = 0.1;
        let info = structure.parameters();
        if !self.demos.iter().all(|demo| demo.spec.planar) {
            return vec![false; info.len()];
        }
        let jacobian = evaluation.whitened_jacobian();
        let moves = |k: usize, p: &ParameterInfo| jacobian.column(k).amax() * (p.high - p.low) > NONE;
        let entries = info.iter().enumerate();
        entries.map(|(k, p)| !moves(k, p)).collect()
    }

    /// How many parameters of an effect a fit is free to change.
    pub fn free_entries(&self, structure: &Structure, evaluation: &Evaluation, effect: usize) -> usize {
        let held = self.out_of_plane(structure, evaluation);
        held[structure.entries(effect)]
            .iter()
            .filter(|&&held| !held)
            .count()
    }

    /// Whether a demonstration tells nothing of an entry of θ, by its kind. Slopes alone do not say so: they are none in
    /// the plane only, and a cable that had left it by little had a camera turned by 0.16 rad about the vertical in the
    /// end.
    fn says_nothing_of(&self, d: usize, entry: &ParameterInfo) -> bool {
        entry.sideways && self.stays_in_plane(d)
    }

    /// Whether a rope moves in the plane in which it was seen.
    pub(super) fn stays_in_plane(&self, demo: usize) -> bool {
        self.demos[demo].spec.stays_in_plane()
    }

    /// What the cameras saw against what is predicted, with slopes.
    pub(super) fn evaluation(
        &self,
        structure: &Structure,
        theta: &[f64],
        traces: &[Trace],
    ) -> Result<Evaluation, FitError> {
        let rows: Vec<Vec<Row>> = (0..self.demos.len())
            .into_par_iter()
            .map(|d| self.rows_of(d, &traces[d].prediction))
            .collect::<Result<_, _>>()?;
        let mut jacobian = DMatrix::zeros(rows.iter().map(Vec::len).sum(), theta.len());
        let mut row_index = 0;
        let entries = structure.parameters();
        for (d, (rows, trace)) in rows.iter().zip(traces).enumerate() {
            let told: Vec<usize> = (0..theta.len())
                .filter(|&k| !trace.slopes[k].is_empty() && !self.says_nothing_of(d, &entries[k]))
                .collect();
            for row in rows {
                let place = bracket(&trace.prediction.arc_m, row.arc_m);
                for &k in &told {
                    jacobian[(row_index, k)] = row.along(&trace.slopes[k][row.frame], place);
                }
                row_index += 1;
            }
        }
        Ok(Evaluation {
            theta: theta.to_vec(),
            rows,
            most_rows: self.most_rows(),
            huber: huber(self.noise_scale),
            jacobian,
        })
    }

    /// Whether a demonstration is poses at rest: a search for them takes double precision throughout, tangents too.
    pub(super) fn rests(&self, demo: usize) -> bool {
        self.demos[demo].spec.is_static()
    }

    /// The same problem, in which ropes that hang are sought where they rest at θ: a rope much like that one is found
    /// in a fraction of the time, and slopes at θ itself in no more than a step.
    ///
    /// # Errors
    /// No rest state was found.
    pub fn settled(&self, structure: &Structure, theta: &[f64]) -> Result<Self, FitError> {
        let mut settled = self.clone();
        settled
            .scenes
            .par_iter_mut()
            .enumerate()
            .try_for_each(|(d, scene)| {
                let physics = self.physics(d, structure, theta);
                settle_poses(scene, &physics).map_err(|error| simulation(self.demos[d], error))?;
                self.begin_as_seen(d, scene, structure, theta)
            })?;
        Ok(settled)
    }

    /// The same where the ropes of a settled problem, at another resolution or for other frames, rest near by.
    ///
    /// # Errors
    /// No rest state was found.
    pub fn settled_near(
        &self,
        settled: &Self,
        structure: &Structure,
        theta: &[f64],
    ) -> Result<Self, FitError> {
        let mut near = self.clone();
        for (demo, scene) in near.demos.iter().zip(&mut near.scenes) {
            if let Some(same) = settled.demos.iter().position(|other| std::ptr::eq(*other, *demo)) {
                scene.start.begin_near(&settled.scenes[same].start);
            }
        }
        near.settled(structure, theta)
    }

    pub(super) fn physics<T: Real>(&self, demo: usize, structure: &Structure, theta: &[T]) -> Physics<T> {
        let spec = &self.demos[demo].spec;
        let mut physics = structure.physics(theta, spec.friction());
        physics.roll(spec.rope.roll_rad);
        physics
    }

    /// The poses of a demonstration at rest.
    pub(super) fn poses<T: Real>(
        &self,
        demo: usize,
        structure: &Structure,
        theta: &[T],
    ) -> Result<Rollout<T>, FitError> {
        let physics = self.physics(demo, structure, theta);
        poses(&self.scenes[demo], &physics).map_err(|error| simulation(self.demos[demo], error))
    }

    /// Simulates one demonstration that goes on in time.
    pub(super) fn rollout<T: Laned>(
        &self,
        demo: usize,
        structure: &Structure,
        theta: &[T],
    ) -> Result<Rollout<T>, FitError> {
        self.rollout_under(demo, structure, theta, None)
    }

    /// The same under a force that no effect describes.
    pub(super) fn rollout_under<T: Laned>(
        &self,
        demo: usize,
        structure: &Structure,
        theta: &[T],
        force_field: Option<ForceField<T>>,
    ) -> Result<Rollout<T>, FitError> {
        let stopped = |error| simulation(self.demos[demo], error);
        let scene = &self.scenes[demo];
        let mut physics = self.physics(demo, structure, theta);
        physics.force_field = force_field;
        simulate_hung(scene, &physics, &|| self.hung(demo, structure, theta)).map_err(stopped)
    }

    /// How the rope of a demonstration that goes on in time hangs at its start, found in double precision.
    fn hung<T: Laned>(
        &self,
        demo: usize,
        structure: &Structure,
        theta: &[T],
    ) -> Result<Option<Hung<T>>, SimError> {
        let scene = &self.scenes[demo];
        if !matches!(scene.start, Start::Rest(_) | Start::Moving(_)) {
            return Ok(None);
        }
        let double = |t: &T| T::Double::with_tangents(t.value(), |k| t.tangent(k));
        let theta: Vec<T::Double> = theta.iter().map(double).collect();
        let hung = Hung::of(scene, &self.physics(demo, structure, &theta))?;
        Ok(hung.map(|hung| hung.in_numbers_of()))
    }

    /// Measures one demonstration against a prediction.
    fn rows_of(&self, index: usize, prediction: &Prediction) -> Result<Vec<Row>, FitError> {
        let demo = self.demos[index];
        let all = Frames::of(demo);
        let mut rows = Vec::new();
        let refined = |frame: usize, points_m| match &self.refinement {
            Some(refinement) => Cow::Owned(refinement.of_points((index, frame), points_m)),
            None => Cow::Borrowed(points_m),
        };
        for (frame, points_m) in prediction.frames.iter().enumerate() {
            if !self.frames.contains(frame, &all) {
                continue;
            }
            let filled_m = prediction.particles.get(frame).map_or(&[][..], Vec::as_slice);
            let line = Centreline {
                arc_m: &prediction.arc_m,
                points_m: &refined(frame, points_m),
                length_m: demo.spec.rope.length_m,
                filled_m: &refined(frame, filled_m),
            };
            rows.extend(
                measure(demo, frame, &line, self.section)
                    .into_iter()
                    .map(|row| Row {
                        sigma_m: row.sigma_m * self.noise_scale,
                        ..row
                    }),
            );
        }
        if rows.len() < MIN_ROWS {
            return Err(FitError::TooFewRows {
                demo: demo.name.clone(),
                rows: rows.len(),
                needed: MIN_ROWS,
                share: self.frames,
            });
        }
        Ok(rows)
    }

    /// See [`Evaluation::most_rows`].
    fn most_rows(&self) -> usize {
        let of_demo = |demo: &&Demo| -> usize {
            let all = Frames::of(demo);
            let frames = most_rows(demo).into_iter().enumerate();
            let counts = frames.filter(|(frame, _)| self.frames.contains(*frame, &all));
            counts.map(|(_, rows)| rows).sum()
        };
        self.demos.iter().map(of_demo).sum()
    }

    /// Centrelines of the demonstrations at θ, m: per demonstration, frame and slice.
    ///
    /// # Errors
    /// A simulation stopped.
    pub fn predict(&self, structure: &Structure, theta: &[f64]) -> Result<Vec<Rollout<f32>>, FitError> {
        if self.some_begin_in_motion() {
            self.settled(structure, theta)?.predict_as_begun(structure, theta)
        } else {
            self.predict_as_begun(structure, theta)
        }
    }

    /// The same of a problem that is settled at θ.
    pub(super) fn predict_as_begun(
        &self,
        structure: &Structure,
        theta: &[f64],
    ) -> Result<Vec<Rollout<f32>>, FitError> {
        (0..self.demos.len())
            .into_par_iter()
            .map(|d| self.predict_under(d, structure, theta, None))
            .collect()
    }

    /// One demonstration, under pushes where there are any: N/m by component. Poses at rest are found without them.
    ///
    /// # Errors
    /// The simulation stopped.
    pub fn predict_under(
        &self,
        demo: usize,
        structure: &Structure,
        theta: &[f64],
        pushed: Option<(&Pushes, &[f64])>,
    ) -> Result<Rollout<f32>, FitError> {
        if self.rests(demo) {
            return self.poses(demo, structure, theta).map(Rollout::rounded);
        }
        let scene = &self.scenes[demo];
        let field = pushed.map(|(pushes, force_n_m)| pushes.field(scene, force_n_m));
        self.rollout_under(demo, structure, &single(theta), field)
    }
}

fn single(theta: &[f64]) -> Vec<f32> {
    theta.iter().map(|&t| t as f32).collect()
}

pub(super) fn simulation(demo: &Demo, error: SimError) -> FitError {
    FitError::Simulation {
        demo: demo.name.clone(),
        error,
    }
}

impl Evaluation {
    /// All rows in order.
    pub fn all_rows(&self) -> impl Iterator<Item = &Row> {
        self.rows.iter().flatten()
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.rows.iter().map(Vec::len).sum()
    }

    /// Whether nothing was measured.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Offsets over their standard errors.
    pub fn whitened(&self) -> DVector<f64> {
        DVector::from_iterator(self.len(), self.all_rows().map(|r| r.offset_m / r.sigma_m))
    }

    /// Jacobian over the rows' standard errors.
    pub fn whitened_jacobian(&self) -> DMatrix<f64> {
        self.over_noise(self.jacobian.clone())
    }

    /// Columns with a number per row over the rows' standard errors.
    pub fn over_noise(&self, mut columns: DMatrix<f64>) -> DMatrix<f64> {
        for (i, row) in self.all_rows().enumerate() {
            columns.row_mut(i).scale_mut(1.0 / row.sigma_m);
        }
        columns
    }

    /// Root mean square of a number per row that is over the row's standard error, m.
    pub fn rms_of_m(&self, over_noise: &DVector<f64>) -> f64 {
        let rows = self.all_rows().zip(over_noise);
        let square: f64 = rows.map(|(row, value)| (row.sigma_m * value).powi(2)).sum();
        (square / self.len() as f64).sqrt()
    }

    /// Root mean square of the offsets, m.
    pub fn rms_m(&self) -> f64 {
        (self.all_rows().map(|r| r.offset_m * r.offset_m).sum::<f64>() / self.len() as f64).sqrt()
    }

    /// Root mean square of the standard errors, m: the error of a perfect model.
    pub fn floor_m(&self) -> f64 {
        noise_m(self.all_rows())
    }
}
