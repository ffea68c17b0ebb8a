//! Where a rope comes to rest from a shape near it: Newton's method, which factorises its matrix anew only where
//! the old one does not help any more.

use super::error::{Cause, SimError};
use super::grid::STENCIL;
use super::legs::Placed;
use super::physics::Physics;
use super::scene::Scene;
use super::start::Start;
use super::statics::{Advance, Nodes, Statics};
use super::tensor::{add, matvec, scaled, sub};

/// Most steps.
const MAX_STEPS: usize = 60;
/// A step that moves no node by more than this share of a cell ends the search.
const TOLERANCE_CELLS: f64 = 1e-4;
/// Passes from particles to nodes.
const PASSES: usize = 12;
/// Steps that shrink less than by this factor take a new matrix.
const SHRINKS: f64 = 0.4;

/// The rope at rest as its clamps stand at first, from where the scene says that its particles are.
///
/// # Errors
/// No rest state was found, or the rope turned inside out on the way.
///
/// # Panics
/// The scene says nothing about its particles.
pub fn rest_near(scene: &Scene, physics: &Physics<f64>) -> Result<Vec<Placed>, SimError> {
    let Start::Placed(placed) = &scene.start else {
        panic!("the scene says where its particles are");
    };
    let statics = Statics::new(scene, physics);
    let nodes = rest_of_nodes(&statics, placed).map_err(SimError::at_start)?;
    let particle = |p: usize| {
        let (position_m, deformation_gradient) = statics.particle(&nodes, p);
        Placed {
            position_m,
            deformation_gradient,
        }
    };
    Ok((0..placed.len()).map(particle).collect())
}

fn rest_of_nodes(statics: &Statics<f64>, placed: &[Placed]) -> Result<Nodes<f64>, Cause> {
    let held = statics.held(0.0);
    let mut nodes = nodes_of(statics, placed);
    let least_inertia = statics.swing_per_s2();
    let mut matrices = statics.matrices();
    let (mut inertia, mut helps, mut before_m) = (0.0, false, f64::INFINITY);
    for _ in 0..MAX_STEPS {
        let forces = statics.forces(&nodes, &held, &[])?;
        if !helps {
            statics.factorise(&mut matrices, (&nodes, &held, &[]), &mut inertia, least_inertia)?;
        }
        let Advance { share, moved_m, .. } = statics.advance(&mut nodes, &matrices, &forces);
        if inertia == 0.0 && share == 1.0 {
            if moved_m < TOLERANCE_CELLS * statics.grid.spacing_m {
                return Ok(nodes);
            }
            helps = moved_m < SHRINKS * before_m;
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

/// Positions of the nodes that give the particles what they have: what is missing is spread to the nodes by
/// mass, time and again.
fn nodes_of(statics: &Statics<f64>, placed: &[Placed]) -> Nodes<f64> {
    let grid = &statics.grid;
    let mut nodes = vec![[0.0; 3]; grid.mass_kg.len()];
    for _ in 0..PASSES {
        let missing: Vec<_> = (0..placed.len())
            .map(|p| {
                let (position_m, gradient) = statics.particle(&nodes, p);
                let rows = [0, 1, 2].map(|a| sub(placed[p].deformation_gradient[a], gradient[a]));
                (sub(placed[p].position_m, position_m), rows)
            })
            .collect();
        for (p, (link, (offset_m, gradient))) in grid.links.iter().zip(&missing).enumerate() {
            for entry in 0..STENCIL {
                let there = add(*offset_m, matvec(gradient, grid.offset_m(p, entry)));
                let node = link.slots[entry] as usize;
                let share = link.weights[entry] * statics.masses_kg[p] / grid.mass_kg[node];
                nodes[node] = add(nodes[node], scaled(there, share));
            }
        }
    }
    nodes
}
