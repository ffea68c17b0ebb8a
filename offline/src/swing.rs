//! The swing task in the simulator: what a rope with its effects reaches from a release point.

use crate::collect::{SwingRefusal, Swinger};
use crate::fit::Resolution;
use crate::model::Structure;
use crate::sim::legs::Placed;
use crate::sim::physics::GRAVITY_M_S2;
use crate::sim::rest::{redivided, rest_near};
use crate::sim::rollout::grip_motions;
use crate::sim::rope::RopeShape;
use crate::sim::tensor::{norm, sub};
use crate::sim::{Cause, Physics, Real, Scene, SimError, simulate};
use shared::profile::MotionLimits;
use shared::task::SwingTask;

/// A rope of known shape and effects whose elastic parameters vary.
#[derive(Clone, Debug, PartialEq)]
pub struct SimulatedSwing {
    /// Shape and mass.
    pub rope: RopeShape,
    /// The task.
    pub task: SwingTask,
    /// Effects.
    pub structure: Structure,
    /// Parameters of the effects, in the order of the structure.
    pub effect_values: Vec<f64>,
    /// Grid.
    pub resolution: Resolution,
}

/// A rope folded at its release point can buckle out of the task plane, as a real one does; in an exactly
/// planar simulation only rounding would start that. This lean of gravity starts it the same way every
/// time (measured: without it the reach of such releases is up to 15 mm off; planar ones move by 0.001 mm).
const LEAN_RAD: f64 = 1e-3;

impl SimulatedSwing {
    /// Length of rope between the two grips, m.
    pub fn free_length_m(&self) -> f64 {
        self.task.free_length_m(self.rope.length_m)
    }

    /// The same swing on a finer grid ([`Resolution::finer`]).
    pub fn on_finer_grid(&self) -> Self {
        Self {
            resolution: self.resolution.finer(),
            ..self.clone()
        }
    }
}

/// The lean while the gripper arrives: ropes that fall do so at once, instead of waiting up to a second for the
/// small lean to grow.
const FIRST_LEAN_RAD: f64 = 0.3;
/// How long after the gripper's arrival it lasts, s.
const ARRIVAL_S: f64 = 0.05;
/// How long the rope then comes nearer to rest, s.
const CALM_S: f64 = 0.15;
/// Cells across the rope until then: rests of other grids are near enough to begin from.
const COARSE_CELLS: f64 = 1.0;
/// The end of that time on the swing's own grid, s, in which what was carried over from the other becomes smooth; without
/// it Newton's method takes two or three times as many matrices.
const FINER_S: f64 = 0.01;
/// How near to where it opens a gripper counts as arrived, m. The rest is sought with the gripper where it opens.
const THERE_M: f64 = 3e-4;
/// How long before it opens the gripper is asked where that is, s.
const OPENING_S: f64 = 1e-6;

impl SimulatedSwing {
    /// Coefficients and laws of a rope, with gravity that leans out of the plane.
    fn physics<T: Real>(&self, young_pa: f64, poisson: f64, lean_rad: f64) -> Physics<T> {
        let mut theta = vec![T::of(young_pa.ln()), T::of(poisson)];
        theta.extend(self.effect_values.iter().map(|&value| T::of(value)));
        // No table in this scene, so its friction does not matter.
        let mut physics = self.structure.physics(&theta, 0.0);
        physics.gravity_m_s2[1] += T::of(lean_rad * GRAVITY_M_S2);
        physics
    }

    /// The reach of a rope that does not remember its way, in legs: near its rest, to it by Newton's method, and the
    /// swing. Simulated to its rest it would need double precision, because in single a rope that has fallen out of
    /// the plane never gets there, and up to two seconds.
    ///
    /// Reach against that of the robot's way where it has come to rest, 11 releases, E 0.3, 0.9 and 3 MPa: within
    /// 0.1 mm in 33 of 33, at most 0.021 mm; settled in time ([`Scene::swing_settled`]) in 30, at most 0.42 mm. That was
    /// with all of the way on the swing's own grid; on the coarse one 48 swings reached within 0.035 mm of it.
    /// Of 24 swings over the range of E, ms of one core on 1.5 and 1.79 cells: near the rest 63 and 72, now 34 and 36;
    /// the rest 26 and 47, now 26 and 32; the swing 87 and 109.
    ///
    /// Damped ropes go the long way in double precision. What they remember of their strain has died out at rest, but in
    /// legs one of 0.9 MPa and 5 ms reached 0.4 mm less than from the true approach; why is not known.
    fn reach_in_legs(&self, scene: &Scene, young_pa: f64, poisson: f64) -> Result<Option<f64>, SimError> {
        let release_s = scene.score_from_s;
        let double = self.physics::<f64>(young_pa, poisson, LEAN_RAD);
        let single = self.physics::<f32>(young_pa, poisson, LEAN_RAD);
        let falling = self.physics::<f32>(young_pa, poisson, FIRST_LEAN_RAD);
        let there_s = arrival_s(scene, &double) + ARRIVAL_S;
        let calm_s = there_s + CALM_S;
        let finer_s = calm_s - FINER_S;
        let near = |scene: &Scene| -> Result<Vec<Placed>, SimError> {
            let first = Scene {
                duration_s: there_s,
                ..scene.clone()
            };
            let placed = simulate(&first, &falling)?.end;
            let calm = scene.leg(placed, there_s, finer_s);
            Ok(simulate(&calm, &single)?.end)
        };
        let mut coarse = scene.clone();
        coarse.lay_grid(COARSE_CELLS);
        let placed = match near(&coarse) {
            Ok(placed) => redivided(&placed, &coarse.layout(), &scene.layout()),
            // What a coarse grid cannot follow, its own may.
            Err(_) => near(scene)?,
        };
        let finer = scene.leg(placed, finer_s, calm_s);
        let placed = simulate(&finer, &single)?.end;
        let settling = scene.leg(placed, calm_s, release_s);
        // Newton's method need not find the rest; time comes near: 1 to 4 mm less reach on 1.5 to 3 cells. None of 210 swings
        // (E 0.3 to 3 MPa, seven releases, 1.5 to 2.7 cells) took it.
        let rest = match rest_near(&settling, &double, release_s - calm_s - OPENING_S) {
            Ok(rest) => rest,
            Err(_) => simulate(&settling, &double)?.end,
        };
        let swing = scene.leg(rest, release_s, scene.duration_s);
        Ok(simulate(&swing, &single)?.reach_m.map(f64::from))
    }

    /// The swing of a rope: with the robot's own approach where that leaves something in its material that is still there
    /// at the release, else with a quick one that ends at the same rest.
    fn scene(&self, physics: &Physics<f64>, release_m: [f64; 2]) -> Result<Scene, SimError> {
        let (rope, task, cells) = (self.rope, &self.task, self.resolution.cells);
        if physics.remembers_after(task.dwell_s) {
            return Scene::swing(rope, task, release_m, &MotionLimits::PAPER, cells);
        }
        Scene::swing_settled(rope, task, release_m, cells)
    }
}

/// Whether a rope is one for the task: a longer one would swing through its table.
///
/// # Errors
/// [`SwingRefusal::TooLong`].
pub fn swingable(rope: &RopeShape, task: &SwingTask) -> Result<(), SwingRefusal> {
    let (length_m, longest_m) = (rope.length_m, task.longest_rope_m(rope.diameter_m));
    if length_m > longest_m {
        return Err(SwingRefusal::TooLong { length_m, longest_m });
    }
    Ok(())
}

impl Swinger for SimulatedSwing {
    fn reach_m(&self, young_pa: f64, poisson: f64, release_m: [f64; 2]) -> Result<f64, SwingRefusal> {
        swingable(&self.rope, &self.task)?;
        let physics = self.physics::<f64>(young_pa, poisson, LEAN_RAD);
        let mut scene = self.scene(&physics, release_m).map_err(|error| refusal(&error))?;
        // A gripper that opens late shall not cut the swing short.
        scene.duration_s += physics.release_delay_s;
        let reach_m = if physics.remembers() {
            simulate(&scene, &physics).map(|rollout| rollout.reach_m)
        } else {
            self.reach_in_legs(&scene, young_pa, poisson)
        };
        reach_m
            .map_err(|error| refusal(&error))?
            .ok_or_else(|| SwingRefusal::Failed("the swing ended before the release".into()))
    }
}

/// When the gripper has come to where it opens, s: at the end of its path, or later where it lags behind that.
fn arrival_s(scene: &Scene, physics: &Physics<f64>) -> f64 {
    let release_s = scene.score_from_s;
    let places = |t_s: f64| -> Vec<_> {
        let motions = grip_motions(scene, physics, t_s, 0.0);
        motions
            .into_iter()
            .flatten()
            .map(|motion| motion.position_m)
            .collect()
    };
    let last = places(release_s - OPENING_S);
    let is_there = |t_s: f64| {
        let mut pairs = places(t_s).into_iter().zip(&last);
        pairs.all(|(here, end)| norm(sub(here, *end)) < THERE_M)
    };
    let knots = scene.grips[1].path.knots();
    // The last knot opens, the one before ends the motion.
    let mut t_s = knots[knots.len() - 2].t_s;
    while t_s < release_s - 2.0 * CALM_S && !is_there(t_s) {
        t_s += ARRIVAL_S;
    }
    t_s
}

fn refusal(error: &SimError) -> SwingRefusal {
    match error.cause {
        Cause::Unreachable {
            distance_m, length_m, ..
        } => SwingRefusal::Unreachable { distance_m, length_m },
        _ => SwingRefusal::Failed(error.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::collect::Design;

    /// The paper's rope with an effect, or without any.
    fn with(effect: Option<&str>, values: &[f64]) -> SimulatedSwing {
        let ids: Vec<String> = effect.into_iter().map(String::from).collect();
        SimulatedSwing {
            rope: RopeShape::of_density(0.25, 0.014, 1000.0),
            task: SwingTask::PAPER,
            structure: Structure::of_ids(&ids),
            effect_values: values.to_vec(),
            resolution: Resolution { cells: 1.5 },
        }
    }

    /// A quick approach bends a rope further than the robot's: what flows then, or has not relaxed by the release, would be
    /// another rope's.
    #[test]
    fn a_rope_that_remembers_its_way_is_swung_with_the_robots_own_approach() {
        let approach_s = |effect: &str, values: &[f64]| {
            let swing = with(Some(effect), values);
            let physics = swing.physics(0.9e6, 0.3, LEAN_RAD);
            let scene = swing.scene(&physics, [0.12, 0.2]).unwrap();
            let knots = scene.grips[1].path.knots();
            knots[knots.len() - 2].t_s
        };
        assert!(approach_s("tip_mass", &[0.009]) < 0.5);
        assert!(approach_s("internal_damping", &[0.05]) < 0.5);
        for (effect, values) in [("relaxation", vec![0.2, 0.1]), ("yield", vec![20.0])] {
            let took_s = approach_s(effect, &values);
            assert!(took_s > 1.0, "{effect}: {took_s} s");
        }
    }

    /// Seen on a foam rod of two metres: what every effect does to its swing, through the table, took twenty minutes.
    #[test]
    fn a_rope_that_lies_on_the_table_makes_no_swing() {
        let mut swing = with(None, &[]);
        swing.rope.length_m = SwingTask::PAPER.longest_rope_m(swing.rope.diameter_m) + 1e-3;
        let refusal = swing.reach_m(0.9e6, 0.3, [0.12, 0.10]).unwrap_err();
        assert!(matches!(refusal, SwingRefusal::TooLong { .. }), "{refusal}");
        swing.rope.length_m -= 2e-3;
        assert!(swing.reach_m(0.9e6, 0.3, [0.12, 0.10]).is_ok());
    }

    /// Seen on 2.7 cells, where nodes that one particle touches ran away: a search ended where no rope rests, and the swing
    /// from there reached 36 mm less; on 2.35 and 2.5 cells it ended nowhere.
    #[test]
    fn a_swing_begins_where_the_rope_rests_whatever_its_grid() {
        let reach_m = |cells: f64| {
            let mut swing = with(None, &[]);
            swing.resolution.cells = cells;
            swing.reach_m(0.9e6, 0.3, [0.12, 0.10]).expect("it swings")
        };
        let sound_m = reach_m(2.25);
        for cells in [2.35, 2.5, 2.7] {
            let here_m = reach_m(cells);
            assert!(
                (here_m - sound_m).abs() < 1.5e-3,
                "{cells} cells: {here_m} m, {sound_m} m"
            );
        }
    }

    /// A table more slippery than declared left nothing to swing: no policy, no advice.
    #[test]
    fn what_the_table_was_like_does_not_matter_in_the_air() {
        let reach_m = |swing: &SimulatedSwing| swing.reach_m(0.9e6, 0.3, [0.12, 0.10]).expect("it swings");
        let slippery = with(Some("table_friction"), &[-0.2]);
        assert_eq!(reach_m(&slippery), reach_m(&with(None, &[])));
    }

    /// The region of releases had its circle about the rope's top end, 40 mm too high: low releases that a rope reaches were
    /// none of it, and at the upper left it was stretched.
    #[test]
    fn the_simulator_refuses_what_the_task_says_is_out_of_a_ropes_reach() {
        let swing = with(None, &[]);
        let physics = swing.physics(0.9e6, 0.3, LEAN_RAD);
        let far_m = [0.05, 0.05];
        match swing.reach_m(0.9e6, 0.3, far_m) {
            Err(SwingRefusal::Unreachable { distance_m, length_m }) => {
                assert!(
                    (distance_m - swing.task.span_m(far_m)).abs() < 1e-9,
                    "{distance_m} m"
                );
                assert!((length_m - swing.free_length_m()).abs() < 1e-9, "{length_m} m");
            }
            other => panic!("{other:?}"),
        }
        let region = Design::region(&swing.task, swing.free_length_m());
        assert!(region.contains([0.15, 0.06]) && swing.scene(&physics, [0.15, 0.06]).is_ok());
        assert!(!region.contains([0.05, 0.30]), "stretched by a thousandth");
    }
}
