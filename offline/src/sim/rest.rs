//! How a rest state is searched for: from a first guess, by Newton's method that begins as a heavily damped fall; from
//! a shape near it, with a matrix that is factorised anew only where the old one does not help any more. A rope that finds
//! no rest by its own forces alone falls once more, propped (`props.rs`); one that was followed until near its rest is
//! propped first, and then let go.

use super::clamp::Hermite;
use super::error::{Cause, SimError};
use super::grid::{Grid, STENCIL};
use super::legs::Placed;
use super::physics::Physics;
use super::props::Props;
use super::real::Real;
use super::rope::RopeLayout;
use super::scene::Scene;
use super::start::Start;
use super::statics::{Advance, Hold, Nodes, Pose, Statics, gather};
use super::tensor::{Mat3, Vec3, add, matvec, norm, scaled, sub};
use crate::observe::bracket;
use rayon::prelude::*;
use std::cell::OnceCell;

/// Inertia of the first step of a fall and below which there is none any more, in units of a pendulum's squared
/// frequency.
const FIRST_INERTIA: f64 = 100.0;
const LAST_INERTIA: f64 = 0.1;
/// What a step that needs no shortening leaves of the inertia.
const INERTIA_DECAY: f64 = 0.1;
/// Most steps of a fall.
const FALL_STEPS: usize = 120;
/// Steps of a fall that may move some node by more than the rope's length: where more do, nodes that hardly anything holds
/// run away.
const RUNAWAY_STEPS: usize = 12;
/// Most steps from a shape near by.
const MAX_STEPS: usize = 60;
/// A step that moves no node by more than this share of a cell ends the search.
const TOLERANCE_CELLS: f64 = 1e-4;
/// How a pose is searched for from where a rope much like it rests: as accurately as by the fall, whose last step is
/// the square of the one before, where steps with a kept matrix shrink by a factor; and only while that takes much
/// less than the fall's dozen of matrices.
const FROM_NEAR: Patience = Patience {
    tolerance_cells: 1e-6,
    matrices: 4,
};
/// How a rope is searched for whose motion was followed until it had nearly come to rest.
const FROM_MOTION: Patience = Patience {
    tolerance_cells: TOLERANCE_CELLS,
    matrices: MAX_STEPS,
};
/// How it goes on from there without props.
const FROM_PROPPED: Patience = Patience {
    tolerance_cells: TOLERANCE_CELLS,
    matrices: 6,
};
/// Two rests are one where no particle is further off than so many cells.
const SAME_REST_CELLS: f64 = 0.1;
/// As [`TOLERANCE_CELLS`] for tangents, as a share of the largest one.
const TANGENT_TOLERANCE: f64 = 1e-4;
/// Passes from particles to nodes.
const PASSES: usize = 12;
/// Steps that shrink less than by this factor take a new matrix.
const SHRINKS: f64 = 0.4;

/// A rest state that was found.
#[derive(Clone, Debug)]
pub struct Near {
    layout: RopeLayout,
    /// Undeformed coordinates of the nodes, m, and where they are.
    material_m: Vec<Vec3<f64>>,
    nodes_m: Nodes<f64>,
    placed: Vec<Placed>,
    /// Whether it took props.
    propped: bool,
}

impl Near {
    fn new(statics: &Statics<f64>, (nodes_m, propped): (Nodes<f64>, bool)) -> Self {
        let placed = (0..statics.layout.particles()).map(|p| placed(&statics.grid, &nodes_m, p));
        Self {
            layout: statics.layout.clone(),
            material_m: statics.grid.nodes_material_m(&statics.layout),
            placed: placed.collect(),
            nodes_m,
            propped,
        }
    }

    /// Where the nodes of a rope would be, which may be divided in another way.
    fn nodes<T: Real>(&self, statics: &Statics<T>) -> Nodes<f64> {
        let Statics { grid, layout, .. } = statics;
        if grid.nodes_material_m(layout) == self.material_m {
            return self.nodes_m.clone();
        }
        nodes_of(statics, &redivided(&self.placed, &self.layout, layout))
    }
}

/// The particles of a rope that is divided as `layout` says, where they are in one whose particles are known: between two
/// slices on the cubic curve through the members next to them, beside those to first order.
pub fn redivided(placed: &[Placed], known: &RopeLayout, layout: &RopeLayout) -> Vec<Placed> {
    let arcs_m: Vec<f64> = known.slices.iter().map(|slice| slice.arc_m).collect();
    let members = known.section_m.len();
    let place = |p: usize| {
        let [arc_m, side_m, up_m] = layout.material_m(p);
        let away_m = |at: &[f64; 2]| (at[0] - side_m).hypot(at[1] - up_m);
        let member = least(known.section_m.iter().map(away_m));
        let [side, up] = known.section_m[member];
        let (low, share) = bracket(&arcs_m, arc_m);
        let beside = |slice: usize| {
            let next = placed[slice * members + member];
            let further = matvec(&next.deformation_gradient, [0.0, side_m - side, up_m - up]);
            (add(next.position_m, further), next.deformation_gradient)
        };
        between(beside(low), beside(low + 1), arcs_m[low + 1] - arcs_m[low], share)
    };
    (0..layout.particles()).map(place).collect()
}

/// Between two points of one fibre `length_m` apart: the cubic with their places and slopes along the rope.
fn between(
    (from_m, from): (Vec3<f64>, Mat3<f64>),
    (to_m, to): (Vec3<f64>, Mat3<f64>),
    length_m: f64,
    t: f64,
) -> Placed {
    let slopes = [from, to].map(|f| f.map(|row| row[0]));
    let cubic = |[at_from, along_from, at_to, along_to]: [f64; 4]| -> Vec3<f64> {
        std::array::from_fn(|a| {
            let along = length_m * (along_from * slopes[0][a] + along_to * slopes[1][a]);
            at_from * from_m[a] + at_to * to_m[a] + along
        })
    };
    let w = Hermite::at(t, 1.0);
    let position_m = cubic([1.0 - w.along, w.start_rate, w.along, w.end_rate]);
    let slope = scaled(
        cubic([
            6.0 * t * (t - 1.0),
            (1.0 - t) * (1.0 - 3.0 * t),
            6.0 * t * (1.0 - t),
            t * (3.0 * t - 2.0),
        ]),
        1.0 / length_m,
    );
    let across = |a: usize, b: usize| (1.0 - t) * from[a][b] + t * to[a][b];
    Placed {
        position_m,
        deformation_gradient: [0, 1, 2].map(|a| [slope[a], across(a, 1), across(a, 2)]),
    }
}

/// Index of the least number.
fn least(numbers: impl Iterator<Item = f64>) -> usize {
    let least = numbers.enumerate().min_by(|a, b| a.1.total_cmp(&b.1));
    least.map_or(0, |(index, _)| index)
}

/// When a search from near by ends.
struct Patience {
    /// A step that moves no node by more than this share of a cell ends it.
    tolerance_cells: f64,
    /// Most matrices to be factorised.
    matrices: usize,
}

impl<T: Real> Statics<'_, T> {
    /// Finds a pose.
    ///
    /// # Errors
    /// No rest state was found, the rope turned inside out on the way, lies on the table or would yield.
    pub fn solve(&self, pose: &Pose) -> Result<Nodes<T>, Cause> {
        self.search(pose).map(|(nodes, _)| nodes)
    }

    /// The same, and whether it took props.
    fn search(&self, pose: &Pose) -> Result<(Nodes<T>, bool), Cause> {
        let motions = &self.motions(pose.t_s);
        let pins = &self.pin_rows(&pose.pins)[..];
        let props = OnceCell::new();
        let hold = |propped: bool| Hold {
            motions,
            pins,
            props: propped.then(|| props.get_or_init(|| Props::new(self))),
        };
        let from_near = pose.near.as_ref().and_then(|near| {
            let nodes = near.nodes(self).into_iter().map(|y| y.map(T::of)).collect();
            let found = settle(self, nodes, &hold(near.propped), &FROM_NEAR);
            found.ok().map(|nodes| (nodes, near.propped))
        });
        let fallen = || {
            let material_m = self.grid.nodes_material_m(&self.layout).into_iter();
            let guess: Nodes<T> = material_m.map(|m| pose.guess.place(m).map(T::of)).collect();
            match self.fall(guess.clone(), &hold(false)) {
                Ok(nodes) => Ok((nodes, false)),
                // Why it took props says more than why they did not help.
                Err(cause) => self
                    .fall(guess, &hold(true))
                    .map_or(Err(cause), |nodes| Ok((nodes, true))),
            }
        };
        let (nodes, propped) = from_near.map_or_else(fallen, Ok)?;
        self.above_table(&nodes)?;
        self.below_yield(&nodes)?;
        Ok((nodes, propped))
    }

    /// The way to rest from afar. Inertia makes a step one of a heavily damped fall: small while the rope is far from
    /// rest, so that it follows the way that a rope would take, and none at the end, where Newton's method is fast.
    fn fall(&self, mut nodes: Nodes<T>, hold: &Hold<T>) -> Result<Nodes<T>, Cause> {
        let swing = self.swing_per_s2();
        let mut inertia = FIRST_INERTIA * swing;
        let (mut moved_m, mut runaways) = (f64::INFINITY, 0);
        let mut matrices = self.matrices();
        for _ in 0..FALL_STEPS {
            let forces = self.forces(&nodes, hold)?;
            self.factorise(&mut matrices, (&nodes, hold), &mut inertia, swing)?;
            let taken = self.advance(&mut nodes, &matrices, &forces);
            let calm = inertia == 0.0 && taken.share == 1.0;
            inertia = match (taken.share < 1.0, inertia < LAST_INERTIA * swing) {
                (true, _) => (3.0 * inertia).max(LAST_INERTIA * swing),
                (false, true) => 0.0,
                (false, false) => INERTIA_DECAY * inertia,
            };
            moved_m = taken.moved_m;
            if calm
                && moved_m < TOLERANCE_CELLS * self.grid.spacing_m
                && tangents_settled(&nodes, &taken.step)
            {
                return Ok(nodes);
            }
            runaways += usize::from(moved_m > self.scene.rope.length_m);
            if runaways > RUNAWAY_STEPS {
                break;
            }
        }
        Err(Cause::NoRest { moved_m })
    }
}

/// Lets the search for every pose of a scene begin where this rope rests.
///
/// # Errors
/// No rest state was found.
pub fn settle_poses(scene: &mut Scene, physics: &Physics<f64>) -> Result<(), SimError> {
    let Some(hang) = scene.start.hang() else {
        return Ok(());
    };
    let statics = Statics::new(scene, physics);
    let find = |pose: &Pose| match statics.search(pose) {
        Ok(found) => Ok(Near::new(&statics, found)),
        Err(cause) => Err(SimError::of_pose(pose.t_s, cause)),
    };
    let found: Vec<Near> = hang.poses.par_iter().map(find).collect::<Result<_, _>>()?;
    let poses = scene
        .start
        .hang_mut()
        .into_iter()
        .flat_map(|hang| &mut hang.poses);
    for (pose, near) in poses.zip(found) {
        pose.near = Some(near);
    }
    Ok(())
}

/// The rope at rest as its clamps stand at `t_s`, from where the scene says that its particles are. It is searched for
/// propped, because on some grids nodes at the surface of a rope between two clamps run away, and the search then ends
/// nowhere or, worse, far from any rest. From there it goes on without props, which move the reach of a swing by up to
/// 0.2 mm; where that leads away from the propped rest, that is the answer.
///
/// # Errors
/// No rest state was found, or the rope turned inside out on the way.
///
/// # Panics
/// The scene says nothing about its particles.
pub fn rest_near(scene: &Scene, physics: &Physics<f64>, t_s: f64) -> Result<Vec<Placed>, SimError> {
    let Start::Placed(start) = &scene.start else {
        panic!("the scene says where its particles are");
    };
    let statics = Statics::new(scene, physics);
    let motions = statics.motions(t_s);
    let props = Props::new(&statics);
    let hold = |props| Hold {
        motions: &motions,
        pins: &[],
        props,
    };
    let particles = |nodes: &Nodes<f64>| -> Vec<Placed> {
        let each = 0..statics.layout.particles();
        each.map(|p| placed(&statics.grid, nodes, p)).collect()
    };
    let nodes = nodes_of(&statics, start);
    let nodes = settle(&statics, nodes, &hold(Some(&props)), &FROM_MOTION).map_err(SimError::at_start)?;
    let propped = particles(&nodes);
    let free = settle(&statics, nodes, &hold(None), &FROM_PROPPED).map(|nodes| particles(&nodes));
    let is_near = |free: &Vec<Placed>| {
        let mut pairs = free.iter().zip(&propped);
        pairs.all(|(a, b)| norm(sub(a.position_m, b.position_m)) < SAME_REST_CELLS * statics.grid.spacing_m)
    };
    Ok(free.ok().filter(is_near).unwrap_or(propped))
}

fn placed(grid: &Grid<f64>, nodes: &[Vec3<f64>], p: usize) -> Placed {
    let (position_m, deformation_gradient) = gather(grid, nodes, p);
    Placed {
        position_m,
        deformation_gradient,
    }
}

/// The way to rest from near by.
fn settle<T: Real>(
    statics: &Statics<T>,
    mut nodes: Nodes<T>,
    hold: &Hold<T>,
    patience: &Patience,
) -> Result<Nodes<T>, Cause> {
    let least_inertia = statics.swing_per_s2();
    let mut matrices = statics.matrices();
    let (mut inertia, mut helps, mut before_m) = (0.0, false, f64::INFINITY);
    let mut matrices_left = patience.matrices;
    for _ in 0..MAX_STEPS {
        let forces = statics.forces(&nodes, hold)?;
        if !helps {
            if matrices_left == 0 {
                break;
            }
            matrices_left -= 1;
            statics.factorise(&mut matrices, (&nodes, hold), &mut inertia, least_inertia)?;
        }
        let Advance { share, moved_m, step } = statics.advance(&mut nodes, &matrices, &forces);
        if inertia == 0.0 && share == 1.0 {
            let still = moved_m < patience.tolerance_cells * statics.grid.spacing_m;
            if still && tangents_settled(&nodes, &step) {
                return Ok(nodes);
            }
            helps = still || moved_m < SHRINKS * before_m;
        } else {
            helps = false;
            inertia = if inertia < 0.1 * least_inertia {
                0.0
            } else {
                0.3 * inertia
            };
        }
        before_m = moved_m;
    }
    Err(Cause::NoRest { moved_m: before_m })
}

/// Whether the last step changed the tangents by next to nothing.
fn tangents_settled<T: Real>(nodes: &[Vec3<T>], step: &[Vec3<T>]) -> bool {
    (0..T::TANGENTS).all(|t| {
        let largest = |list: &[Vec3<T>]| {
            let numbers = list.iter().flatten().map(|x| x.tangent(t).abs());
            numbers.fold(0.0, f64::max)
        };
        largest(step) <= TANGENT_TOLERANCE * largest(nodes)
    })
}

/// Positions of the nodes that give the particles what they have: what is missing is spread to the nodes by
/// mass, time and again.
fn nodes_of<T: Real>(statics: &Statics<T>, placed: &[Placed]) -> Nodes<f64> {
    let grid = &statics.grid;
    let mut nodes = vec![[0.0; 3]; grid.mass_kg.len()];
    for _ in 0..PASSES {
        let missing: Vec<_> = (0..placed.len())
            .map(|p| {
                let (position_m, gradient) = gather(grid, &nodes, p);
                let rows = [0, 1, 2].map(|a| sub(placed[p].deformation_gradient[a], gradient[a]));
                (sub(placed[p].position_m, position_m), rows)
            })
            .collect();
        for (p, (link, (offset_m, gradient))) in grid.links.iter().zip(&missing).enumerate() {
            for entry in 0..STENCIL {
                let there = add(*offset_m, matvec(gradient, grid.offset_m(p, entry)));
                let node = link.slots[entry] as usize;
                let share = link.weights[entry] * statics.masses_kg[p].value() / grid.mass_kg[node];
                nodes[node] = add(nodes[node], scaled(there, share));
            }
        }
    }
    nodes
}
