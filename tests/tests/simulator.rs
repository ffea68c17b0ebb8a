//! The simulator against what is known exactly: free fall, momentum, beams, and its tangents
//! against central differences.

use offline::demo::RopeEnd;
use offline::sim::clamp::ClampPath;
use offline::sim::rope::RopeShape;
use offline::sim::scene::{Grip, Scene, Settling};
use offline::sim::{Physics, simulate};

fn rope(length_m: f64, diameter_m: f64) -> RopeShape {
    let mut shape = RopeShape {
        length_m,
        diameter_m,
        mass_kg: 1.0,
    };
    shape.mass_kg = 1000.0 * shape.volume_m3();
    shape
}

/// Sag of the tip of a horizontal rope clamped at one end, divided by Euler-Bernoulli's
/// q L⁴ / (8 E I), for a grid moved along the rope by a share of a cell.
fn cantilever_ratio(cells: f64, shift_cells: [f64; 3]) -> f64 {
    let (grip_m, free_m, diameter_m, young_pa) = (0.03, 0.2, 0.02, 12.0e6);
    let shape = rope(grip_m + free_m, diameter_m);
    let grips = vec![Grip {
        end: RopeEnd::Start,
        length_m: grip_m,
        path: ClampPath::fixed([0.0; 3]),
    }];
    let mut scene = Scene::new(shape, [0.0; 3], [1.0, 0.0, 0.0], grips, None, cells, vec![1.2]).unwrap();
    scene.grid.shift_cells = shift_cells;
    scene.settling = Some(Settling {
        until_s: 1.2,
        rate_per_s: 50.0,
    });
    let rollout = simulate(&scene, &Physics::base(young_pa, 0.3, 0.5)).unwrap();
    let frame = &rollout.frames[0];
    let n = frame.len();
    let tip = frame[n - 1][2] + 0.5 * (frame[n - 1][2] - frame[n - 2][2]);
    let second_moment = std::f64::consts::PI * diameter_m.powi(4) / 64.0;
    let load = shape.mass_kg / shape.length_m * 9.81;
    -tip / (load * free_m.powi(4) / (8.0 * young_pa * second_moment))
}

#[test]
fn explore() {
    for cells in [1.8] {
        for k in 0..3 {
            let r: Vec<f64> = [0.0, 0.25, 0.5, 0.75]
                .iter()
                .map(|&v| {
                    let mut s = [0.0; 3];
                    s[k] = v;
                    cantilever_ratio(cells, s)
                })
                .collect();
            println!("{cells} axis {k}: {r:.4?}");
        }
    }
}
