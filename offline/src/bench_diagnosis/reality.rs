//! What plays the measured world: something that moves a rope with a known cause in it.

use super::experiment::{Motion, Track, marker_arcs_m};
use crate::demo::Demo;
use crate::effects;
use crate::fit::turns_in_grip;
use crate::model::Structure;
use crate::observe::{bracket, interpolate};
use crate::sim::rope::Sampling;
use crate::sim::scene::MIN_CELLS_PER_DIAMETER;
use crate::sim::{Scene, simulate};
use serde::{Deserialize, Serialize};

/// A cause with its size: an effect of the library with the values of its parameters, or something that
/// only the reality knows, with one value.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Part {
    /// Name.
    pub id: String,
    /// Values.
    pub values: Vec<f64>,
}

/// What a reality can play.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Repertoire {
    /// Its short name: `g2`, `g3`.
    pub world: String,
    /// Effects of the library.
    pub effects: Vec<String>,
    /// Causes outside the library.
    pub outside: Vec<String>,
}

/// Something that moves ropes.
pub trait Reality: Sync {
    /// Short name: `g2`, `g3`.
    fn name(&self) -> &'static str;

    /// Goes up with every change of what it plays that is none of [`crate::sim::REVISION`]: what it played before is then
    /// played anew, and answers about that count no more.
    fn revision(&self) -> u32;

    /// Names of the library's effects that it can play.
    fn effects(&self) -> Vec<&'static str>;

    /// Names of its causes outside the library, with the largest plausible size of each.
    fn outside(&self) -> Vec<(&'static str, f64)>;

    /// Where the markers are during each motion.
    ///
    /// # Errors
    /// The rope cannot be moved so; says why.
    fn tracks(&self, young_pa: f64, parts: &[Part], motions: &[Motion]) -> Result<Vec<Track>, String>;

    /// The same, as well as it takes to tell how large a cause has to be.
    ///
    /// # Errors
    /// The rope cannot be moved so; says why.
    fn rough_tracks(&self, young_pa: f64, parts: &[Part], motions: &[Motion]) -> Result<Vec<Track>, String> {
        self.tracks(young_pa, parts, motions)
    }

    /// What it can play.
    fn repertoire(&self) -> Repertoire {
        Repertoire {
            world: self.name().into(),
            effects: self.effects().into_iter().map(String::from).collect(),
            outside: self.outside().into_iter().map(|(id, _)| id.to_owned()).collect(),
        }
    }
}

/// Values of effects by which the size of a cause is counted. An effect that is not named here has its
/// first parameter's smallest size of interest.
const UNITS: &[(&str, &[f64])] = &[
    ("air_drag", &[0.3, 0.014, 0.0]),
    ("tilted_gravity", &[0.01, 0.006]),
    ("rest_curvature", &[0.0, 0.1]),
    ("curvature_gradient", &[0.0, 0.5]),
    ("steady_wind", &[1.0, 0.6]),
    ("camera_offset", &[0.001, 0.001, -0.001, 0.0, 0.005, 0.0]),
];

/// A library's effect at `size` units.
///
/// # Panics
/// `id` is not in the library.
pub fn part(id: &str, size: f64) -> Part {
    let spec = &effects::ALL[effects::find(id).expect("an effect of the library")];
    let unit = unit(id);
    Part {
        id: id.into(),
        values: spec
            .parameters
            .iter()
            .zip(unit)
            .map(|(p, u)| p.vanishes_at + size * u)
            .collect(),
    }
}

fn unit(id: &str) -> Vec<f64> {
    if let Some((_, unit)) = UNITS.iter().find(|(name, _)| *name == id) {
        return unit.to_vec();
    }
    let spec = &effects::ALL[effects::find(id).expect("an effect of the library")];
    let mut unit = vec![0.0; spec.parameters.len()];
    unit[0] = spec.parameters[0].smallest_of_interest;
    unit
}

/// Share of an effect's physical range that a cause may fill: at its end an estimate would be called
/// implausible.
const RANGE_SHARE: f64 = 0.9;

/// The largest size of a library's effect within its physical range, in units.
pub fn largest_size(id: &str) -> f64 {
    let spec = &effects::ALL[effects::find(id).expect("an effect of the library")];
    let room = |(p, u): (&effects::ParameterSpec, f64)| {
        let end = if u > 0.0 { p.high } else { p.low };
        (end - p.vanishes_at) / u
    };
    let rooms = spec.parameters.iter().zip(unit(id)).filter(|(_, u)| *u != 0.0);
    RANGE_SHARE * rooms.map(room).fold(f64::INFINITY, f64::min)
}

/// The simulator itself, but finer: other particles, half the cells' size, half the time step.
pub struct Finer;

/// Cells across the rope against the fitter's own; its predictions are those of 1.4 times as many.
const FINER: f64 = 2.0;
/// The same where no more is asked than how large a cause has to be.
const ROUGHER: f64 = 1.5;
/// Poisson's ratio of the rope.
const POISSON: f64 = 0.3;

impl Reality for Finer {
    fn name(&self) -> &'static str {
        "g2"
    }

    fn revision(&self) -> u32 {
        1
    }

    /// All but what a rope that lies straight at first does not show.
    fn effects(&self) -> Vec<&'static str> {
        let all = effects::ALL.iter().enumerate();
        all.filter(|(effect, _)| !turns_in_grip(*effect))
            .map(|(_, spec)| spec.id)
            .collect()
    }

    fn outside(&self) -> Vec<(&'static str, f64)> {
        Vec::new()
    }

    fn tracks(&self, young_pa: f64, parts: &[Part], motions: &[Motion]) -> Result<Vec<Track>, String> {
        on_grid(FINER, young_pa, parts, motions)
    }

    fn rough_tracks(&self, young_pa: f64, parts: &[Part], motions: &[Motion]) -> Result<Vec<Track>, String> {
        on_grid(ROUGHER, young_pa, parts, motions)
    }
}

fn on_grid(finer: f64, young_pa: f64, parts: &[Part], motions: &[Motion]) -> Result<Vec<Track>, String> {
    let play_one = |motion: &Motion| {
        let nothing_seen = vec![vec![[0.0; 3]; marker_arcs_m().len()]; motion.frame_times_s().len()];
        play(finer, young_pa, parts, &motion.demo(&nothing_seen, 0.0, 0))
    };
    motions.iter().map(play_one).collect()
}

impl Finer {
    /// Where the markers are during a demonstration in which nothing has to be seen yet.
    ///
    /// # Errors
    /// The rope cannot be moved so; says why.
    pub fn play(&self, young_pa: f64, parts: &[Part], demo: &Demo) -> Result<Track, String> {
        play(FINER, young_pa, parts, demo)
    }

    /// The same on a grid that is less fine, for what the finer one refuses: a rope that a gripper holds much askew from the
    /// start.
    ///
    /// # Errors
    /// The rope cannot be moved so; says why.
    pub fn rough_play(&self, young_pa: f64, parts: &[Part], demo: &Demo) -> Result<Track, String> {
        play(ROUGHER, young_pa, parts, demo)
    }
}

fn play(finer: f64, young_pa: f64, parts: &[Part], demo: &Demo) -> Result<Track, String> {
    let mut structure = Structure::default();
    let mut theta = vec![young_pa.ln(), POISSON];
    for part in parts {
        let effect = effects::find(&part.id).ok_or_else(|| format!("no effect {}", part.id))?;
        structure = structure.with(effect);
        theta.extend(&part.values);
    }
    let theta: Vec<f32> = theta.iter().map(|&t| t as f32).collect();
    let mut scene =
        Scene::of_demo(demo, finer * MIN_CELLS_PER_DIAMETER).map_err(|error| error.to_string())?;
    scene.sampling = Sampling {
        slice_cells: 0.43,
        section_cells: 0.3,
    };
    scene.step_share = 0.5;
    let mut physics = structure.physics(&theta, demo.spec.friction());
    physics.roll(demo.spec.rope.roll_rad);
    let rollout = simulate(&scene, &physics).map_err(|error| error.to_string())?;
    let frames = rollout.frames.iter();
    Ok(frames.map(|line| at_markers(&rollout.arc_m, line)).collect())
}

/// Points of a centreline at the markers.
fn at_markers(arcs_m: &[f64], line: &[[f32; 3]]) -> Vec<[f64; 3]> {
    marker_arcs_m()
        .into_iter()
        .map(|s| interpolate(line, bracket(arcs_m, s)))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_effect_has_a_unit_that_fits_into_its_range_many_times() {
        for spec in effects::ALL {
            assert!(largest_size(spec.id) >= 1.0, "{}", spec.id);
            let part = part(spec.id, largest_size(spec.id));
            for (p, v) in spec.parameters.iter().zip(&part.values) {
                assert!(*v >= p.low && *v <= p.high, "{}.{}", spec.id, p.name);
            }
        }
    }
}
