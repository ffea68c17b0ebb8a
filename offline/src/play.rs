//! A demonstration played by a simulated rope: what the rope of a model would have done in the measured one's place.

use crate::demo::{Demo, MarkerSample, Observations};
use crate::fit::{FitError, Problem, Resolution};
use crate::model::Structure;
use crate::observe::{bracket, interpolate};
use crate::residual::ResidualSummary;

/// Points of the rope that are kept per frame, evenly spaced, both ends among them.
const POINTS: usize = 25;

/// What the simulated rope did.
pub struct Played {
    /// The demonstration with the simulated rope's points as markers.
    pub demo: Demo,
    /// Steps of the simulation; none for poses at rest.
    pub steps: usize,
    /// Time step, s.
    pub dt_s: f64,
    /// How far what was measured lies from it; none where too little was measured to say.
    pub residual: Option<ResidualSummary>,
}

/// Moves a simulated rope as the measured one was moved.
///
/// # Errors
/// The simulation is refused or stops.
pub fn play(
    demo: &Demo,
    structure: &Structure,
    theta: &[f64],
    resolution: Resolution,
) -> Result<Played, FitError> {
    let problem = Problem::new(&[demo], resolution)?;
    let rollouts = problem.predict(structure, theta)?;
    let residual = problem.residuals_of(theta, &rollouts).ok();
    let rollout = &rollouts[0];
    let frames = demo.times_s().into_iter().zip(&rollout.frames);
    let markers = frames.flat_map(|(t_s, line)| {
        (0..POINTS).map(move |point| {
            // The ends' points are the middles of the outermost slices.
            let [first, last] = [rollout.arc_m[0], rollout.arc_m[rollout.arc_m.len() - 1]];
            let s_m = first + (last - first) * point as f64 / (POINTS - 1) as f64;
            MarkerSample {
                t_s,
                marker: format!("p{point:02}"),
                s_m,
                position_m: interpolate(line, bracket(&rollout.arc_m, s_m)),
            }
        })
    });
    let mut played = demo.clone();
    played.observations = Observations::Markers(markers.collect());
    played.spec.notes = format!(
        "simulated by offline {}, not measured: moved as in {}",
        env!("CARGO_PKG_VERSION"),
        demo.name
    );
    played.spec.cameras.clear();
    Ok(Played {
        demo: played,
        steps: rollout.steps,
        dt_s: rollout.dt_s,
        residual: residual.as_ref().map(ResidualSummary::of),
    })
}
