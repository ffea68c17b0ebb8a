//! Grid density of a point cloud, measured or simulated, and the paper's L1 loss on it.
//!
//! Every point gives its mass to the 27 nodes around it with the quadratic weights of the paper's
//! appendix, which are those of [`crate::sim::kernel`]. Densities are kept sparse: a rope meets a few
//! hundred of the 64³ nodes.

use crate::sim::Real;
use crate::sim::dual::Dual;
use crate::sim::kernel::weights;
use crate::sim::tensor::Vec3;

/// Nodes along each axis.
pub const NODES: usize = 64;

/// Weight of the density loss (appendix of the paper).
const LOSS_WEIGHT: f64 = 10.0;

/// Mass of the whole rope in the released code: 1000 particles of (dx/2)² each, dx = 1/64. It scales
/// the loss and no gradient step, which Adam divides by the gradient's size.
pub const TOTAL_MASS: f64 = 1000.0 / (128.0 * 128.0);

/// A cube of 64³ nodes in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DensityGrid {
    /// Position of the node (0, 0, 0), m.
    pub corner_m: [f64; 3],
    /// Distance of neighbouring nodes, m.
    pub spacing_m: f64,
}

/// Mass on the nodes that have any, in the order of their indices.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Density {
    /// (index of the node, mass).
    pub nodes: Vec<(u32, f64)>,
}

/// Cells between the points and the cube's faces.
const MARGIN_CELLS: f64 = 3.0;

impl DensityGrid {
    /// The paper's cube, twice as long as the rope, centred on the points of all frames; larger only
    /// where they would not fit.
    pub fn around<'a>(points_m: impl Iterator<Item = &'a [f64; 3]>, length_m: f64) -> Self {
        let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for p in points_m {
            for k in 0..3 {
                low[k] = low[k].min(p[k]);
                high[k] = high[k].max(p[k]);
            }
        }
        let widest = (0..3).map(|k| high[k] - low[k]).fold(0.0, f64::max);
        let usable = NODES as f64 - 2.0 * MARGIN_CELLS;
        let spacing_m = (2.0 * length_m / NODES as f64).max(widest / usable);
        Self {
            corner_m: std::array::from_fn(|k| 0.5 * (low[k] + high[k] - spacing_m * NODES as f64)),
            spacing_m,
        }
    }

    /// Calls `give` with every node and mass of `points`, each of mass `each`. A node outside the
    /// cube gets nothing.
    fn scatter<T: Real>(&self, points: &[Vec3<T>], each: f64, mut give: impl FnMut(usize, T)) {
        for point in points {
            let axes: [(i32, T, [T; 3]); 3] = std::array::from_fn(|k| {
                weights((point[k] - T::of(self.corner_m[k])).scale(1.0 / self.spacing_m))
            });
            let inside = |i: i32| usize::try_from(i).ok().filter(|&i| i < NODES);
            for (i, &wx) in (axes[0].0..).zip(&axes[0].2) {
                let Some(i) = inside(i) else { continue };
                for (j, &wy) in (axes[1].0..).zip(&axes[1].2) {
                    let Some(j) = inside(j) else { continue };
                    let wxy = (wx * wy).scale(each);
                    for (k, &wz) in (axes[2].0..).zip(&axes[2].2) {
                        let Some(k) = inside(k) else { continue };
                        give((i * NODES + j) * NODES + k, wxy * wz);
                    }
                }
            }
        }
    }

    /// Density of a cloud whose total mass is [`TOTAL_MASS`], however many points show it.
    pub fn density(&self, points_m: &[[f64; 3]]) -> Density {
        let mut mass = std::collections::BTreeMap::<u32, f64>::new();
        let each = TOTAL_MASS / points_m.len().max(1) as f64;
        self.scatter(points_m, each, |node, m: f64| {
            *mass.entry(node as u32).or_default() += m;
        });
        Density {
            nodes: mass.into_iter().collect(),
        }
    }
}

/// A loss and its derivatives with respect to the N inputs of the simulation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Loss<const N: usize> {
    /// Value.
    pub value: f64,
    /// Gradient.
    pub gradient: [f64; N],
}

/// The L1 loss of simulated frames against measured ones. Holds the dense scratch that makes adding up
/// cheap.
pub struct LossSum<const N: usize> {
    grid: DensityGrid,
    difference: Vec<f64>,
    slope: Vec<[f64; N]>,
    touched: Vec<u32>,
    total: Loss<N>,
}

impl<const N: usize> LossSum<N> {
    /// Nothing added yet.
    pub fn new(grid: DensityGrid) -> Self {
        Self {
            grid,
            difference: vec![0.0; NODES.pow(3)],
            slope: vec![[0.0; N]; NODES.pow(3)],
            touched: Vec::new(),
            total: Loss {
                value: 0.0,
                gradient: [0.0; N],
            },
        }
    }

    /// Adds 10 Σ |simulated − measured| over the nodes of one frame.
    pub fn add(&mut self, simulated: &[Vec3<Dual<f32, N>>], measured: &Density) {
        let Self {
            difference,
            slope,
            touched,
            ..
        } = self;
        for &(node, mass) in &measured.nodes {
            difference[node as usize] -= mass;
            touched.push(node);
        }
        let each = TOTAL_MASS / simulated.len().max(1) as f64;
        self.grid.scatter(simulated, each, |node, mass: Dual<f32, N>| {
            difference[node] += f64::from(mass.value);
            for n in 0..N {
                slope[node][n] += f64::from(mass.tangent[n]);
            }
            touched.push(node as u32);
        });
        touched.sort_unstable();
        touched.dedup();
        for node in touched.drain(..).map(|node| node as usize) {
            let d = difference[node];
            self.total.value += LOSS_WEIGHT * d.abs();
            // At exactly zero the loss has a kink, and zero is one of its subgradients.
            let sign = if d == 0.0 { 0.0 } else { d.signum() };
            for n in 0..N {
                self.total.gradient[n] += LOSS_WEIGHT * sign * slope[node][n];
            }
            difference[node] = 0.0;
            slope[node] = [0.0; N];
        }
    }

    /// The sum over all frames.
    pub fn total(&self) -> Loss<N> {
        self.total
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::real::Arithmetic;

    const GRID: DensityGrid = DensityGrid {
        corner_m: [-0.1, -0.2, 0.05],
        spacing_m: 0.5 / 64.0,
    };

    /// Some points well inside the cube.
    fn cloud(n: usize, shift_m: f64) -> Vec<[f64; 3]> {
        let along = |i: usize| 0.3 * i as f64 / n as f64;
        (0..n)
            .map(|i| [0.05 + along(i), 0.02 * (i as f64).sin(), 0.2 + shift_m * along(i)])
            .collect()
    }

    #[test]
    fn the_mass_and_its_centre_are_kept() {
        for n in [1, 37, 500] {
            let points = cloud(n, 0.3);
            let density = GRID.density(&points);
            let mass: f64 = density.nodes.iter().map(|(_, m)| m).sum();
            assert!((mass / TOTAL_MASS - 1.0).abs() < 1e-12);
            for k in 0..3 {
                let stride = [NODES * NODES, NODES, 1][k];
                let at =
                    |node: u32| GRID.corner_m[k] + GRID.spacing_m * (node as usize / stride % NODES) as f64;
                let centre: f64 = density.nodes.iter().map(|&(node, m)| m * at(node)).sum::<f64>() / mass;
                let expected = points.iter().map(|p| p[k]).sum::<f64>() / n as f64;
                assert!((centre - expected).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn a_cube_around_points_holds_their_mass() {
        for scale in [1.0, 4.0] {
            let points: Vec<_> = cloud(200, 0.5).iter().map(|p| p.map(|c| scale * c)).collect();
            let grid = DensityGrid::around(points.iter(), 0.25);
            let mass: f64 = grid.density(&points).nodes.iter().map(|(_, m)| m).sum();
            assert!((mass / TOTAL_MASS - 1.0).abs() < 1e-12);
            assert!(grid.spacing_m >= 0.5 / 64.0);
        }
    }

    #[test]
    fn a_cloud_has_no_loss_against_itself() {
        let points = cloud(50, 0.1);
        let mut sum = LossSum::<1>::new(GRID);
        let simulated: Vec<_> = points.iter().map(|p| p.map(Dual::of)).collect();
        sum.add(&simulated, &GRID.density(&points));
        // Single precision on one side: 1e-6 of the weighted mass.
        assert!(sum.total().value < 1e-5 * LOSS_WEIGHT * TOTAL_MASS);
    }

    /// The loss of points that a parameter moves, against central differences.
    #[test]
    fn the_gradient_is_that_of_differences() {
        let measured = [GRID.density(&cloud(300, 0.3)), GRID.density(&cloud(300, 0.0))];
        let loss = |shift: f64| {
            let mut sum = LossSum::<1>::new(GRID);
            for (frame, density) in measured.iter().enumerate() {
                let simulated: Vec<_> = cloud(200, 0.0)
                    .iter()
                    .map(|p| {
                        let lever = 1.0 + frame as f64;
                        let height = Dual::<f32, 1>::input(shift, 0).scale(lever * (p[0] - 0.05));
                        [Dual::of(p[0]), Dual::of(p[1]), Dual::of(p[2]) + height]
                    })
                    .collect();
                sum.add(&simulated, density);
            }
            sum.total()
        };
        let (here, h) = (loss(0.11), 3e-4);
        let difference = (loss(0.11 + h).value - loss(0.11 - h).value) / (2.0 * h);
        assert!(difference.abs() > 1e-2, "{difference}");
        // Kinks of |.| within ± h leave a per cent or so.
        assert!(
            (here.gradient[0] / difference - 1.0).abs() < 0.03,
            "{} {difference}",
            here.gradient[0]
        );
    }
}
