//! The world in motion: rod, table, clamps and effects, stepped with symplectic Euler.

use crate::contact::Table;
use crate::effects::{Piece, WorldEffects};
use crate::motion::ClampPath;
use crate::rod::{BentSection, Rod, RodSpec};
use nalgebra::Vector3;
use offline::demo::{RopeEnd, RopeSpec};

/// Largest time step, s.
const STEP_S: f64 = 1e-5;
/// Poisson's ratio of every rope, that of [`BentSection::SOLID`].
const POISSON: f64 = 0.3;
/// Arc lengths closer than this are equal, m.
const SAME_M: f64 = 1e-9;

/// A clamp and what it does.
#[derive(Clone, Debug)]
pub struct ClampMotion {
    /// Which end it grips.
    pub end: RopeEnd,
    /// Length of rope inside it, m; the nodes in it move with it.
    pub grip_m: f64,
    /// Where the rope's end point goes.
    pub path: ClampPath,
    /// When it opens, s; never where this is none.
    pub opens_at_s: Option<f64>,
}

/// The rope and its material.
#[derive(Clone, Debug)]
pub struct Material {
    /// The bare rope.
    pub rope: RopeSpec,
    /// Young's modulus, Pa.
    pub young_pa: f64,
    /// Number of segments. A lift with 25 is within 0.5 mm of one with 50, and many times faster
    /// where a damping effect shortens the time step.
    pub segments: usize,
    /// Retardation time, s: small, it only quiets the shortest waves.
    pub retardation_s: f64,
}

/// A rod between clamps above a table.
#[derive(Clone, Debug)]
pub struct World {
    /// The rod.
    pub rod: Rod,
    table: Option<Table>,
    effects: WorldEffects,
    grips: Vec<Grip>,
    gravity: Vector3<f64>,
    diameter_m: f64,
    free_bending: Vec<f64>,
    force: Vec<Vector3<f64>>,
    step_s: f64,
    t_s: f64,
}

/// A clamp's present state.
#[derive(Clone, Debug)]
struct Grip {
    motion: ClampMotion,
    /// Nodes inside, and their place against the rope's end point, m.
    nodes: Vec<(usize, Vector3<f64>)>,
    /// Unit vector along the gripped piece, out of the clamp.
    outwards: Vector3<f64>,
    /// Where the clamp really is: behind its command where the gripper lags.
    position: Vector3<f64>,
    closed: bool,
}

impl World {
    /// A straight rope at rest with its start at `start_m`.
    pub fn new(
        material: &Material,
        start_m: [f64; 3],
        table: Option<Table>,
        clamps: &[ClampMotion],
        effects: &WorldEffects,
    ) -> Self {
        let rope = &material.rope;
        let spec = rod_spec(material, effects);
        let direction = Vector3::from(rope.direction);
        let mut rod = Rod::straight(&spec, Vector3::from(start_m), direction);
        apply_to_rope(&mut rod, rope.length_m, effects);
        let table = table.map(|table| Table {
            friction: table.friction + effects.friction_change,
            ..table
        });
        let grips = clamps
            .iter()
            .map(|motion| Grip::new(motion, &rod, rope.length_m))
            .collect();
        let mut world = Self {
            force: vec![Vector3::zeros(); rod.x.len()],
            free_bending: rod.bending.clone(),
            rod,
            table,
            effects: effects.clone(),
            grips,
            gravity: effects.gravity(),
            diameter_m: rope.diameter_m,
            step_s: STEP_S,
            t_s: 0.0,
        };
        world.stiffen_at_grips();
        world.step_s = STEP_S.min(world.rod.stable_step_s());
        world
    }

    /// Present time, s.
    pub fn time_s(&self) -> f64 {
        self.t_s
    }

    /// Moves on to time `t_s`, s, in equal steps no longer than the stable one.
    pub fn advance_to(&mut self, t_s: f64) {
        let steps = ((t_s - self.t_s) / self.step_s - 1e-9).ceil().max(0.0);
        let start = self.t_s;
        for step in 0..steps as u64 {
            let from = start + (t_s - start) * step as f64 / steps;
            let to = start + (t_s - start) * (step + 1) as f64 / steps;
            self.step(to, to - from);
        }
    }

    fn step(&mut self, t_s: f64, dt: f64) {
        self.force.fill(Vector3::zeros());
        self.rod.add_forces(&mut self.force);
        if self.effects.has_air() {
            self.add_air();
        }
        let radius = 0.5 * self.diameter_m;
        for i in 0..self.rod.x.len() {
            let mass = self.rod.mass[i];
            let mut v = self.rod.v[i] + (self.force[i] / mass + self.gravity) * dt;
            if let Some(table) = &self.table {
                let normal = table.normal_force(&self.rod.x[i], &self.rod.v[i], mass, radius);
                if normal > 0.0 {
                    v.z += normal / mass * dt;
                    v = table.after_friction(&v, normal, mass, dt);
                }
            }
            self.rod.v[i] = v;
            self.rod.x[i] += v * dt;
        }
        self.rod.turn(dt);
        self.t_s = t_s;
        self.move_grips(dt);
    }

    fn add_air(&mut self) {
        let last = self.rod.x.len() - 1;
        for i in 0..=last {
            let along = self.rod.x[(i + 1).min(last)] - self.rod.x[i.saturating_sub(1)];
            let piece = Piece {
                position: self.rod.x[i],
                velocity: self.rod.v[i],
                tangent: along.normalize(),
                length_m: self.rod.share_m[i],
                diameter_m: self.diameter_m,
                mass_kg: self.rod.mass[i],
            };
            self.force[i] += self.effects.air_force(&piece);
        }
    }

    /// Puts the gripped nodes where the clamps are; opens those whose time has come.
    fn move_grips(&mut self, dt: f64) {
        let mut opened = false;
        for (index, grip) in self.grips.iter_mut().enumerate() {
            if !grip.closed {
                continue;
            }
            let late_s = self.effects.release_delay_s;
            if grip.motion.opens_at_s.is_some_and(|at| self.t_s >= at + late_s) {
                grip.closed = false;
                opened = true;
                continue;
            }
            let before = grip.position;
            grip.follow(self.t_s, dt, self.effects.gripper_lag_s);
            let mut slip_speed = 0.0;
            let mut slip = 0.0;
            if let Some(event) = self.effects.grip_slip.filter(|_| index == 0) {
                let share = ((self.t_s - event.at_s) / event.for_s).clamp(0.0, 1.0);
                slip = event.by_m * share;
                slip_speed = if share > 0.0 && share < 1.0 {
                    event.by_m / event.for_s
                } else {
                    0.0
                };
            }
            let velocity = (grip.position - before) / dt + grip.outwards * slip_speed;
            for (node, place) in &grip.nodes {
                self.rod.x[*node] = grip.position + place + grip.outwards * slip;
                self.rod.v[*node] = velocity;
            }
            for pair in grip.nodes.windows(2) {
                let [(segment, from), (_, to)] = [pair[0], pair[1]];
                self.rod.hold(segment, (to - from).normalize());
            }
        }
        if opened {
            self.stiffen_at_grips();
        }
    }

    /// The last gripped node's bend stands for half a segment only (the other half is rigid), so it
    /// is twice as stiff; this puts the wall of a cantilever exactly at the grip's end. A clamp that
    /// gives is a spring in series there.
    fn stiffen_at_grips(&mut self) {
        self.rod.bending.copy_from_slice(&self.free_bending);
        self.rod.bend_m.fill(self.rod.rest_m);
        self.rod.bend_share.fill(1.0);
        for grip in self.grips.iter().filter(|grip| grip.closed) {
            let inmost = match grip.motion.end {
                RopeEnd::Start => grip.nodes.last(),
                RopeEnd::End => grip.nodes.first(),
            };
            if let Some((node, _)) = inmost {
                let stiffness = 2.0 * self.rod.bending[*node];
                let share = 1.0 / (1.0 + self.effects.clamp_compliance * stiffness);
                self.rod.bending[*node] = stiffness * share;
                self.rod.bend_share[*node] = share;
                self.rod.bend_m[*node] = 0.5 * self.rod.rest_m;
            }
        }
    }
}

impl Grip {
    fn new(motion: &ClampMotion, rod: &Rod, length_m: f64) -> Self {
        let last = rod.x.len() - 1;
        let (end, next) = match motion.end {
            RopeEnd::Start => (0, 1),
            RopeEnd::End => (last, last - 1),
        };
        let from_end = |i: usize| match motion.end {
            RopeEnd::Start => i as f64 * rod.rest_m,
            RopeEnd::End => length_m - i as f64 * rod.rest_m,
        };
        let inside = (0..=last).filter(|i| from_end(*i) <= motion.grip_m + SAME_M);
        Self {
            motion: motion.clone(),
            nodes: inside.map(|i| (i, rod.x[i] - rod.x[end])).collect(),
            outwards: (rod.x[next] - rod.x[end]).normalize(),
            position: motion.path.position_m(0.0),
            closed: true,
        }
    }

    /// Moves towards the command: at once, or with dy/dt = (command − y)/lag.
    fn follow(&mut self, t_s: f64, dt: f64, lag_s: f64) {
        let command = self.motion.path.position_m(t_s);
        let share = if lag_s > 0.0 { -(-dt / lag_s).exp_m1() } else { 1.0 };
        self.position += (command - self.position) * share;
    }
}

fn rod_spec(material: &Material, effects: &WorldEffects) -> RodSpec {
    let rope = &material.rope;
    RodSpec {
        length_m: rope.length_m,
        diameter_m: rope.diameter_m,
        mass_kg: rope.mass_kg,
        young_pa: material.young_pa,
        poisson: POISSON,
        section: BentSection::SOLID,
        segments: material.segments,
        retardation_s: material.retardation_s + effects.damping_s,
    }
}

/// Effects that change the rope itself.
fn apply_to_rope(rod: &mut Rod, length_m: f64, effects: &WorldEffects) {
    let last = rod.x.len() - 1;
    rod.stiffening = effects.stiffening;
    for i in 0..=last {
        let s = i as f64 * rod.rest_m;
        rod.natural_per_m[i] = effects.rest_curvature_per_m + effects.curvature_growth_per_m2 * s;
        rod.bending[i] *= 1.0 + effects.bending_change;
        rod.mass[i] *= 1.0 + effects.density_slope * (s / length_m - 0.5);
        if let Some(piece) = effects.stiff_piece
            && (piece.from_m..=piece.to_m).contains(&s)
        {
            rod.bending[i] *= piece.factor;
        }
    }
    rod.mass[last] += effects.tip_mass_kg;
}
