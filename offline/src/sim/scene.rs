//! Scenes: what is simulated, from when to when, on which grid. `lift` and `free` come from a
//! demonstration, `swing` from the task.

use super::clamp::{self, ClampPath, Knot, STIFFNESS};
use super::error::{Cause, SimError};
use super::grid::GridSpec;
use super::physics::Physics;
use super::real::{Arithmetic, Real};
use super::rollout::perpendicular;
use super::rope::{RopeLayout, RopeShape, Sampling};
use super::start::Start;
use super::tensor::{self, sub};
use crate::demo::{ClampSample, Demo, RopeEnd, StartState};
use shared::profile::{LineProfile, MotionLimits};
use shared::task::SwingTask;

/// The table: a half space below a height.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Table {
    /// Height of the surface, m.
    pub height_m: f64,
}

/// A gripped end.
#[derive(Clone, Debug)]
pub struct Grip {
    /// Which end.
    pub end: RopeEnd,
    /// Length of rope inside, m.
    pub length_m: f64,
    /// Pose of the rope's end point over time.
    pub path: ClampPath,
}

/// A time in which every velocity decays, to reach rest sooner than air and rope would.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settling {
    /// End of the settling phase, s; it starts at zero.
    pub until_s: f64,
    /// Rate of decay, 1/s.
    pub rate_per_s: f64,
    /// Speed below which the rope counts as at rest, m/s. Once nothing moves faster and the grips have arrived,
    /// the rest of the phase is left out; at zero it never is. Reverse mode leaves nothing out.
    pub still_m_s: f64,
}

/// Everything that a rollout needs besides the physics.
#[derive(Clone, Debug)]
pub struct Scene {
    /// The rope.
    pub rope: RopeShape,
    /// Position of s = 0 at the start, m.
    pub start_m: [f64; 3],
    /// Unit vector from s = 0 to s = length at the start.
    pub direction: [f64; 3],
    /// How the rope is at the start.
    pub start: Start,
    /// Gripped ends.
    pub grips: Vec<Grip>,
    /// The table, if any.
    pub table: Option<Table>,
    /// The grid.
    pub grid: GridSpec,
    /// The particles.
    pub sampling: Sampling,
    /// Share of the largest stable time step that is taken, at most 1.
    pub step_share: f64,
    /// Whether the rollout also keeps every particle at the recorded times, not only the centreline.
    pub keep_particles: bool,
    /// End of the simulation, s.
    pub duration_s: f64,
    /// Times at which the centreline is recorded, s, increasing.
    pub frame_times_s: Vec<f64>,
    /// Artificial settling at the start.
    pub settling: Option<Settling>,
    /// The tip's largest x counts from this time on, s.
    pub score_from_s: f64,
    /// How long a step is.
    pub step: StepLength,
}

/// How long a time step is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StepLength {
    /// As long as the parameters allow ([`Scene::time_step_s`]). It then changes with them, and what is
    /// simulated changes with it by the error of the time discretisation, of which tangents know
    /// nothing: they are those of a fixed step.
    Longest,
    /// This long, s, whatever the parameters; refused where it is not stable. Tangents are then the
    /// derivatives of exactly what is simulated.
    Fixed(f64),
}

/// The paper's rope is 0.028 units thick on a grid of 1/64 unit.
pub const PAPER_CELLS_PER_DIAMETER: f64 = 0.028 * 64.0;

/// Cells across the rope from which on bending stiffness is within 5 %, wherever the grid lies, in the
/// first two modes of a rope of twenty diameters (`offline verify`: 1.3 % and 3.9 % low here, 1.9 % and
/// 5.4 % at 1.25 cells, falling with the square of the spacing). Thinner ropes are refused, and this is
/// the spacing that the program chooses where nobody asks for a finer one.
pub const MIN_CELLS_PER_DIAMETER: f64 = 1.5;

/// Most steps times particles of one rollout: an hour at 180 ns for a particle's step. The usual rollout
/// has some ten million; long internal damping of a stiff rope, whose explicit step is thousands of
/// times shorter, would otherwise run for days without a word.
pub const MOST_PARTICLE_STEPS: f64 = 2e10;

impl Scene {
    /// The scene of a demonstration, on a grid with `cells` cells across the rope.
    pub fn of_demo(demo: &Demo, cells: f64) -> Result<Self, SimError> {
        let spec = &demo.spec;
        let rope = RopeShape::of_spec(&spec.rope);
        let path = |samples: &[ClampSample]| {
            let samples: Vec<clamp::Sample> = samples
                .iter()
                .map(|s| (s.t_s, pose_of(s.position_m, s.quaternion_xyzw), s.closed))
                .collect();
            match spec.start {
                StartState::Moving => ClampPath::from_samples_in_motion(&samples),
                StartState::Straight | StartState::Rest => ClampPath::from_samples(&samples),
            }
        };
        let grips: Vec<Grip> = spec
            .clamps
            .iter()
            .zip(&demo.clamps)
            .map(|(clamp, samples)| Grip {
                end: clamp.end,
                length_m: clamp.grip_m,
                path: path(samples),
            })
            .collect();
        let direction = tensor::direction(spec.rope.direction);
        let start_m = match grips.first() {
            Some(grip) => {
                let p = &grip.path.knots()[0].pose;
                let back = match grip.end {
                    RopeEnd::Start => 0.0,
                    RopeEnd::End => rope.length_m,
                };
                std::array::from_fn(|k| p[k] - back * direction[k])
            }
            None => {
                let floor_m = spec.table.as_ref().map_or(0.0, |table| table.height_m);
                [0.0, 0.0, floor_m + 0.5 * rope.diameter_m]
            }
        };
        let frame_times_s = demo.times_s();
        let table = spec.table.as_ref().map(|table| Table {
            height_m: table.height_m,
        });
        let mut scene = Self::unchecked(rope, start_m, direction, grips, table, cells, frame_times_s)?;
        scene.start = Start::of_demo(demo, &scene.rope, &scene.grips);
        scene.refuse_unreachable()?;
        Ok(scene)
    }

    /// The grip that may hold the point with undeformed coordinates (s, side, up), and where the
    /// point lies relative to the first pose of that grip, m.
    pub fn grip_offset(&self, material_m: [f64; 3]) -> Option<(usize, [f64; 3])> {
        let length_m = self.rope.length_m;
        let s = material_m[0];
        let index = self.grips.iter().position(|grip| match grip.end {
            RopeEnd::Start => s <= grip.length_m,
            RopeEnd::End => length_m - s <= grip.length_m,
        })?;
        Some((index, self.offset_in(index, material_m)))
    }

    /// Where the rope leaves each grip, and its end in there, relative to the first pose of the grip, m.
    pub(super) fn hinges_m(&self) -> Vec<[[f64; 3]; 2]> {
        let hinge = |(index, mouth_m): (usize, f64)| {
            let outer_m = match self.grips[index].end {
                RopeEnd::Start => 0.0,
                RopeEnd::End => self.rope.length_m,
            };
            [mouth_m, outer_m].map(|s| self.offset_in(index, [s, 0.0, 0.0]))
        };
        self.edges_m().into_iter().enumerate().map(hinge).collect()
    }

    fn offset_in(&self, index: usize, material_m: [f64; 3]) -> [f64; 3] {
        let grip = &self.grips[index];
        match self.start.hang() {
            Some(hang) => hang.grip_offset(index, grip, self.rope.length_m, material_m),
            None => sub(
                self.straight_m(material_m),
                position_of(&grip.path.knots()[0].pose),
            ),
        }
    }

    /// Where a point of the straight rope with undeformed coordinates (s, side, up) lies, m.
    pub fn straight_m(&self, [s, a, b]: [f64; 3]) -> [f64; 3] {
        let (side, up) = perpendicular(self.direction);
        std::array::from_fn(|k| self.start_m[k] + s * self.direction[k] + a * side[k] + b * up[k])
    }

    /// The swing task with the true motion of the robot: drag at `limits`, dwell, open.
    pub fn swing(
        rope: RopeShape,
        task: &SwingTask,
        release_m: [f64; 2],
        limits: &MotionLimits,
        cells: f64,
    ) -> Result<Self, SimError> {
        Self::swing_with(rope, task, release_m, limits, task.dwell_s, None, cells)
    }

    /// The swing task with a quick, damped approach that ends at rest, where the true one would come to rest. A
    /// rope that falls out of the plane needs a lean of gravity to begin.
    pub fn swing_settled(
        rope: RopeShape,
        task: &SwingTask,
        release_m: [f64; 2],
        cells: f64,
    ) -> Result<Self, SimError> {
        let quick = MotionLimits {
            speed_m_s: 1.5,
            acceleration_m_s2: 50.0,
            jerk_m_s3: 3000.0,
        };
        Self::swing_with(
            rope,
            task,
            release_m,
            &quick,
            SETTLE_S,
            Some(SETTLE_RATE_PER_S),
            cells,
        )
    }

    fn swing_with(
        rope: RopeShape,
        task: &SwingTask,
        release_m: [f64; 2],
        limits: &MotionLimits,
        dwell_s: f64,
        settle_rate_per_s: Option<f64>,
        cells: f64,
    ) -> Result<Self, SimError> {
        let top = [task.top_m[0], 0.0, task.top_m[1]];
        let tip = task.hanging_tip_m(rope.length_m);
        let drag = LineProfile::new([tip[0], 0.0, tip[1]], [release_m[0], 0.0, release_m[1]], limits);
        let release_s = drag.duration_s() + dwell_s;
        let mut knots: Vec<Knot> = (0..=(drag.duration_s() / KNOT_S) as usize)
            .map(|i| {
                let t_s = i as f64 * KNOT_S;
                knot(t_s, drag.position_m(t_s), drag.velocity_m_s(t_s), true)
            })
            .collect();
        let end = drag.position_m(drag.duration_s());
        if drag.duration_s() > knots[knots.len() - 1].t_s {
            knots.push(knot(drag.duration_s(), end, [0.0; 3], true));
        }
        knots.push(knot(release_s, end, [0.0; 3], false));
        let grips = vec![
            Grip {
                end: RopeEnd::Start,
                length_m: task.grip_m,
                path: ClampPath::fixed(top),
            },
            Grip {
                end: RopeEnd::End,
                length_m: task.grip_m,
                path: ClampPath::new(knots),
            },
        ];
        let mut scene = Self::new(rope, top, [0.0, 0.0, -1.0], grips, None, cells, Vec::new())?;
        scene.settling = settle_rate_per_s.map(|rate_per_s| Settling {
            until_s: release_s,
            rate_per_s,
            still_m_s: STILL_M_S,
        });
        scene.score_from_s = release_s;
        scene.duration_s = release_s + SWING_S;
        scene.refuse_unreachable()?;
        Ok(scene)
    }

    /// A scene from its parts: the rope straight from `start_m` along the unit vector `direction`.
    ///
    /// # Errors
    /// The rope is too thin for the grid, or the grips are further apart than it is long.
    pub fn new(
        rope: RopeShape,
        start_m: [f64; 3],
        direction: [f64; 3],
        grips: Vec<Grip>,
        table: Option<Table>,
        cells: f64,
        frame_times_s: Vec<f64>,
    ) -> Result<Self, SimError> {
        let scene = Self::unchecked(rope, start_m, direction, grips, table, cells, frame_times_s)?;
        scene.refuse_unreachable()?;
        Ok(scene)
    }

    fn unchecked(
        rope: RopeShape,
        start_m: [f64; 3],
        direction: [f64; 3],
        grips: Vec<Grip>,
        table: Option<Table>,
        cells: f64,
        frame_times_s: Vec<f64>,
    ) -> Result<Self, SimError> {
        if !cells.is_finite() || cells < MIN_CELLS_PER_DIAMETER {
            return Err(SimError::at_start(Cause::TooThin { cells }));
        }
        let mut scene = Self {
            rope,
            start_m,
            direction,
            start: Start::Straight,
            grips,
            table,
            grid: GridSpec {
                spacing_m: rope.diameter_m / cells,
                shift_cells: [0.0; 3],
            },
            sampling: Sampling::default(),
            step_share: 1.0,
            keep_particles: false,
            duration_s: frame_times_s.last().copied().unwrap_or(0.0),
            frame_times_s,
            settling: None,
            score_from_s: f64::INFINITY,
            step: StepLength::Longest,
        };
        scene.check()?;
        scene.lay_grid(cells);
        Ok(scene)
    }

    /// Lays the grid with at least `cells` cells across the rope, so that the edges of the grips lie in
    /// the middle between node planes: there the kernel smooths a clamp's edge evenly to both sides, and
    /// the clamp is found where it is. Measured on a cantilever of ten diameters, 1.5 cells thick: the sag
    /// is 0.2 % off with the edge in the middle, 1.7 % with the edge on a node plane, 2.7 % half-way
    /// between the two. With two grips the free length is a whole number of cells.
    pub fn lay_grid(&mut self, cells: f64) {
        let mut spacing_m = self.rope.diameter_m / cells;
        let edges = self.edges_m();
        if let [a, b] = edges[..] {
            let free_m = (a - b).abs();
            spacing_m = free_m / (free_m / spacing_m).ceil();
        }
        let shift = edges
            .first()
            .map_or(0.0, |edge| (0.5 - edge / spacing_m).rem_euclid(1.0));
        self.grid = GridSpec {
            spacing_m,
            shift_cells: [shift, 0.0, 0.0],
        };
    }

    /// Cells across the rope.
    pub fn cells_per_diameter(&self) -> f64 {
        self.rope.diameter_m / self.grid.spacing_m
    }

    /// Whether no clamp opens before the end.
    pub fn holds_throughout(&self) -> bool {
        let mut knots = self.grips.iter().flat_map(|grip| grip.path.knots());
        knots.all(|knot| knot.closed || knot.t_s > self.duration_s)
    }

    /// Arc lengths at which the grips end, m.
    pub(super) fn edges_m(&self) -> Vec<f64> {
        self.grips
            .iter()
            .map(|grip| match grip.end {
                RopeEnd::Start => grip.length_m,
                RopeEnd::End => self.rope.length_m - grip.length_m,
            })
            .collect()
    }

    /// The particles' layout; slices end where the grips end.
    pub fn layout(&self) -> RopeLayout {
        RopeLayout::new(self.rope, &self.edges_m(), self.grid.spacing_m, self.sampling)
    }

    /// Refuses paths on which two closed clamps are further apart than the rope between them, and says where they
    /// are furthest: in a swing, at the release point.
    fn refuse_unreachable(&self) -> Result<(), SimError> {
        let [a, b] = &self.grips[..] else { return Ok(()) };
        let length_m = self.rope.length_m - a.length_m - b.length_m;
        let mouth = |index: usize, t_s: f64| -> [f64; 3] {
            let grip = &self.grips[index];
            let sign = if grip.end == RopeEnd::Start { 1.0 } else { -1.0 };
            let direction = self
                .start
                .hang()
                .map_or(self.direction, |hang| hang.frames[index][0]);
            grip.path
                .motion(t_s)
                .place(direction.map(|d| sign * grip.length_m * d))
        };
        let mut worst = None;
        let mut worst_m = length_m * (1.0 + STRETCH_ALLOWED);
        for knot in a.path.knots().iter().chain(b.path.knots()) {
            let (pa, pb) = (mouth(0, knot.t_s), mouth(1, knot.t_s));
            let distance_m = (0..3).map(|k| (pa[k] - pb[k]).powi(2)).sum::<f64>().sqrt();
            let both_closed = a.path.closed(knot.t_s) && b.path.closed(knot.t_s);
            if both_closed && distance_m > worst_m {
                worst_m = distance_m;
                worst = Some(SimError::at_start(Cause::Unreachable {
                    t_s: knot.t_s,
                    distance_m,
                    length_m,
                }));
            }
        }
        worst.map_or(Ok(()), Err)
    }

    /// Refuses what no simulation can start from.
    ///
    /// # Errors
    /// A value is not finite or outside its range; the name says which.
    pub fn check(&self) -> Result<(), SimError> {
        let positive = |value: f64| value.is_finite() && value > 0.0;
        let rope = &self.rope;
        require("rope.length_m", rope.length_m, positive(rope.length_m))?;
        require("rope.diameter_m", rope.diameter_m, positive(rope.diameter_m))?;
        require("rope.mass_kg", rope.mass_kg, positive(rope.mass_kg))?;
        let spacing_m = self.grid.spacing_m;
        require("grid.spacing_m", spacing_m, positive(spacing_m))?;
        for (name, value) in [
            ("sampling.slice_cells", self.sampling.slice_cells),
            ("sampling.section_cells", self.sampling.section_cells),
            ("step_share", self.step_share),
        ] {
            require(name, value, positive(value) && value <= 1.0)?;
        }
        for x in self.start_m.into_iter().chain(self.grid.shift_cells) {
            require("start_m or grid.shift_cells", x, x.is_finite())?;
        }
        let norm = self.direction.iter().map(|c| c * c).sum::<f64>().sqrt();
        require("norm of direction", norm, (norm - 1.0).abs() < 1e-3)?;
        if let Some(table) = self.table {
            require("table.height_m", table.height_m, table.height_m.is_finite())?;
        }
        if let Some(Settling {
            until_s,
            rate_per_s,
            still_m_s,
        }) = self.settling
        {
            require("settling.until_s", until_s, until_s.is_finite())?;
            require("settling.still_m_s", still_m_s, still_m_s >= 0.0)?;
            require(
                "settling.rate_per_s",
                rate_per_s,
                rate_per_s.is_finite() && rate_per_s >= 0.0,
            )?;
        }
        self.check_times()?;
        self.check_grips()
    }

    fn check_times(&self) -> Result<(), SimError> {
        let last_s = self.duration_s;
        require("duration_s", last_s, last_s.is_finite() && last_s >= 0.0)?;
        let mut before_s = f64::NEG_INFINITY;
        for &t_s in &self.frame_times_s {
            let ordered = t_s >= 0.0 && t_s > before_s && t_s <= last_s;
            require("frame_times_s", t_s, ordered)?;
            before_s = t_s;
        }
        Ok(())
    }

    fn check_grips(&self) -> Result<(), SimError> {
        let mut free_m = self.rope.length_m;
        for (index, grip) in self.grips.iter().enumerate() {
            free_m -= grip.length_m;
            let held = grip.length_m > 0.0 && free_m > 0.0;
            require("grip.length_m", grip.length_m, held)?;
            let alone = self.grips[..index].iter().all(|other| other.end != grip.end);
            require("grip.end of grip", index as f64, alone)?;
            let mut before_s = f64::NEG_INFINITY;
            for knot in grip.path.knots() {
                require("knot.t_s", knot.t_s, knot.t_s.is_finite() && knot.t_s > before_s)?;
                before_s = knot.t_s;
                for x in knot.pose.into_iter().chain(knot.rate) {
                    require("knot.pose or knot.rate", x, x.is_finite())?;
                }
                let norm = knot.pose[3..].iter().map(|c| c * c).sum::<f64>().sqrt();
                require("norm of a knot's quaternion", norm, (norm - 1.0).abs() < 1e-2)?;
            }
        }
        Ok(())
    }

    /// What the cameras' clock shows above the simulation's, s: the robot's, by which ropes at rest begin to be moved. One that
    /// is first seen in motion begins where and when the cameras saw it: by their clock.
    pub fn clock_offset_s<T: Real>(&self, physics: &Physics<T>) -> T {
        match self.start {
            Start::Moving(_) => T::zero(),
            _ => physics.clock_offset_s(),
        }
    }

    /// Number of steps of `dt_s` to the end, or to the last frame if a camera takes it `late_s` after its
    /// time and that is later.
    ///
    /// # Errors
    /// They would not end within reason ([`MOST_PARTICLE_STEPS`]).
    pub fn steps(&self, dt_s: f64, late_s: f64, particles: usize) -> Result<usize, SimError> {
        let last_frame_s = self.frame_times_s.last().map_or(0.0, |t_s| t_s + late_s);
        let steps = (self.duration_s.max(last_frame_s) / dt_s).ceil();
        if steps.is_nan() || steps * particles as f64 > MOST_PARTICLE_STEPS {
            return Err(SimError::at_start(Cause::TooLong { steps, particles }));
        }
        Ok(steps as usize)
    }

    /// Stiffness of the clamps' springs over the mass of their particles, 1/s².
    pub fn clamp_per_kg<T: Arithmetic>(&self, young_pa: T) -> T {
        young_pa.scale(STIFFNESS / (self.rope.density_kg_m3() * self.grid.spacing_m.powi(2)))
    }
}

/// Stretch that the clamps may impose before a path counts as unreachable.
const STRETCH_ALLOWED: f64 = 0.02;
/// Distance of path knots in a swing, s; the period of the controller's stream.
const KNOT_S: f64 = 0.004;
/// Time of the swing that is simulated after release, s: the first forward swing is over by then.
const SWING_S: f64 = 0.75;
/// Longest damped rest before release, s: the robot's own dwell. At 11 of 18 releases spread over the range a
/// rope of 0.9 MPa falls out of the plane, by 18 to 54 mm, because its ends stand too near one another for it to
/// stay there; that takes up to a second. It comes to rest in one shape and its mirror image, which reach equally
/// far, whatever the way there.
///
/// Reach against that of the robot's way where it has come to rest (11 releases; E 0.3, 0.9 and 3 MPa; f64): within
/// 0.1 mm in 30 of 33, at most 0.42 mm, where a soft rope still falls after two seconds; the policy's rollouts find
/// the rest itself (`swing.rs`). The robot lets go while the rope still swings after its two seconds: up to 7 mm
/// off, by the moment at which it opens.
/// With a quarter of a second at 40/s for every rope it was 18 mm at worst; with half a second, 0.7 mm. In f32
/// fallen ropes never come to rest, and reach up to 2.4 mm further or less.
const SETTLE_S: f64 = 2.0;
/// Damping rate during the quick approach, 1/s. At 30/s soft ropes that hardly fall have not fallen in time.
const SETTLE_RATE_PER_S: f64 = 20.0;
/// Speed below which the rope has come to rest, m/s: a tenth of that at which the lean of `swing.rs` moves a rope
/// that nothing holds in its plane.
const STILL_M_S: f64 = 5e-5;

fn position_of(pose: &[f64; 7]) -> [f64; 3] {
    [pose[0], pose[1], pose[2]]
}

/// Refuses a parameter that is outside its range.
pub(super) fn require(name: &'static str, value: f64, holds: bool) -> Result<(), SimError> {
    if holds {
        return Ok(());
    }
    Err(SimError::at_start(Cause::BadParameter { name, value }))
}

fn pose_of(p: [f64; 3], q: [f64; 4]) -> [f64; 7] {
    [p[0], p[1], p[2], q[0], q[1], q[2], q[3]]
}

fn knot(t_s: f64, p: [f64; 3], v: [f64; 3], closed: bool) -> Knot {
    Knot {
        t_s,
        pose: [p[0], p[1], p[2], 0.0, 0.0, 0.0, 1.0],
        rate: [v[0], v[1], v[2], 0.0, 0.0, 0.0, 0.0],
        closed,
    }
}
