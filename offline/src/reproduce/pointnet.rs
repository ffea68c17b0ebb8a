//! PointNet++ as the paper's baseline: from the last state's points straight to (E, ν).
//!
//! Layers of the paper's appendix (Qi et al. 2017, "PointNet++", single-scale grouping): 512 centres with
//! 32 neighbours and [64, 64, 128], 128 with 64 and [128, 128, 256], all with [256, 512, 1024], then
//! [256, 128] and two outputs; Adam with step 10⁻³, batches of 16, norm clipped to 0.1. Twice: as the
//! released code has it, without any non-linearity and with radius 0.02 in both layers, and fair, with
//! rectifiers, coordinates of zero mean and unit spread, and radii in the reference's proportion to the
//! cloud. Targets are standardised in both; the source does not say how they were scaled.

use super::adam::Parameters;
use super::data::{WHOLE_RANGE, draw, last_state};
use super::scene::Discretisation;
use super::sim2sim::{Baseline, PointNetEffort};
use crate::collect::stream;
use crate::paper_units::METRES_PER_UNIT;
use crate::run_files::{Fnv64, made_by, read_sealed, seal, write_whole};
use crate::train::net::{
    Activation, Adam, Batch, LayerValues, Mlp, batch, beside, pool_largest, rows_at, value, values,
};
use rand::RngExt;
use rayon::prelude::*;
use std::path::Path;

/// Which of the two networks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Variant {
    /// Without non-linearity, radius 0.02 twice.
    AsPublished,
    /// Rectifiers, normalised coordinates, radii that hold neighbours.
    Fair,
}

/// Centres and neighbours of the two grouping layers.
const CENTRES: [usize; 2] = [512, 128];
const NEIGHBOURS: [usize; 2] = [32, 64];
const RATE: f32 = 1e-3;
const CLIP_NORM: f32 = 0.1;
const BATCH: usize = 16;
/// Layers up to the end of each part in the joined network.
const PARTS: [usize; 5] = [0, 3, 6, 9, 12];
const KIND: &[u8; 8] = b"ptnet/01";

impl Variant {
    /// Radii of the two grouping layers, paper units.
    fn radii(self) -> [f64; 2] {
        match self {
            Self::AsPublished => [0.02, 0.02],
            // The reference's 0.2 and 0.4 of a cloud's radius, which is 0.25 here.
            Self::Fair => [0.05, 0.1],
        }
    }

    fn activation(self) -> Activation {
        match self {
            Self::AsPublished => Activation::Identity,
            Self::Fair => Activation::Relu,
        }
    }

    fn slug(self) -> &'static str {
        match self {
            Self::AsPublished => "as-published",
            Self::Fair => "fair",
        }
    }
}

/// A trained network.
pub struct PointNet {
    variant: Variant,
    thinning: usize,
    scale: Scale,
    network: Mlp,
}

/// Affine maps of coordinates and targets.
#[derive(Clone, Copy, Debug)]
struct Scale {
    mean: [f64; 3],
    spread: [f64; 3],
}

/// A cloud cut into groups: what both grouping layers take.
struct Grouped {
    /// Coordinates of the first layer's neighbours relative to their centre, group by group.
    near: Vec<[f32; 3]>,
    /// Centres that the second layer's neighbours are, group by group.
    members: Vec<usize>,
    /// Their coordinates relative to the second layer's centres.
    far: Vec<[f32; 3]>,
    /// Coordinates of the second layer's centres.
    centres: Vec<[f32; 3]>,
}

impl PointNet {
    /// Reads the network from `out`, or simulates demonstrations over the whole range and trains it.
    ///
    /// # Errors
    /// A simulation stopped, or the file could not be written.
    pub fn trained(
        variant: Variant,
        effort: &PointNetEffort,
        fitter: &Discretisation,
        seed: u64,
        out: &Path,
        say: &(dyn Fn(&str) + Sync),
    ) -> anyhow::Result<Self> {
        let key = format!("{} {effort:?} {fitter:?} {seed}", made_by());
        let name = format!(
            "pointnet-{}-{:016x}.bin",
            variant.slug(),
            Fnv64::of(key.as_bytes())
        );
        let path = out.join(name);
        let samples: Vec<(Parameters, Vec<[f64; 3]>)> = (0..effort.demonstrations)
            .into_par_iter()
            .map(|index| {
                let truth = draw(WHOLE_RANGE, seed ^ TRAIN_SEED, index);
                Ok((truth, last_state(truth, fitter)?))
            })
            .collect::<anyhow::Result<_>>()?;
        let mut net = Self::new(variant, effort.thinning, Scale::of(variant, &samples), seed);
        let kept = read_sealed(KIND, &path)
            .ok()
            .and_then(|bytes| postcard::from_bytes::<Vec<LayerValues>>(&bytes).ok());
        if kept.is_some_and(|kept| net.network.set_layer_values(&kept)) {
            return Ok(net);
        }
        net.learn(&samples, effort.epochs, seed, say);
        let bytes = postcard::to_allocvec(&net.network.layer_values())?;
        write_whole(&path, &seal(KIND, &bytes))?;
        Ok(net)
    }

    fn new(variant: Variant, thinning: usize, scale: Scale, seed: u64) -> Self {
        let mut rng = stream(seed ^ TRAIN_SEED, WEIGHT_STREAM);
        let sizes: [&[usize]; 4] = [
            &[3, 64, 64, 128],
            &[3 + 128, 128, 128, 256],
            &[3 + 256, 256, 512, 1024],
            &[1024, 256, 128, 2],
        ];
        let activation = variant.activation();
        let parts = sizes.map(|sizes| Mlp::new(sizes, activation, &mut rng));
        Self {
            variant,
            thinning: thinning.max(1),
            scale,
            network: Mlp::joined(parts.into(), activation),
        }
    }

    fn learn(
        &mut self,
        samples: &[(Parameters, Vec<[f64; 3]>)],
        epochs: usize,
        seed: u64,
        say: &(dyn Fn(&str) + Sync),
    ) {
        let grouped: Vec<Grouped> = samples.par_iter().map(|(_, cloud)| self.group(cloud)).collect();
        let mut adam = Adam::new(&self.network, CLIP_NORM);
        let mut rng = stream(seed ^ TRAIN_SEED, ORDER_STREAM);
        let mut order: Vec<usize> = (0..samples.len()).collect();
        for epoch in 0..epochs {
            for last in (1..order.len()).rev() {
                order.swap(last, rng.random_range(0..=last));
            }
            let (mut sum, mut batches) = (0.0, 0);
            for chosen in order.chunks(BATCH) {
                let clouds: Vec<&Grouped> = chosen.iter().map(|&i| &grouped[i]).collect();
                let targets: Vec<[f32; 2]> = chosen.iter().map(|&i| standardised(samples[i].0)).collect();
                let error = self.outputs(&clouds) - batch(&targets);
                let loss = (error.clone() * error).mean();
                sum += value(loss.clone());
                batches += 1;
                adam.step(&mut self.network, &loss, RATE);
            }
            let mean = sum / batches as f32;
            say(&format!(
                "PointNet++ {}: epoch {} of {epochs}, mean square {mean:.4}",
                self.variant.slug(),
                epoch + 1
            ));
        }
    }

    /// Standardised (E, ν) for some clouds.
    fn outputs(&self, clouds: &[&Grouped]) -> Batch {
        let joined = |part: fn(&Grouped) -> &Vec<[f32; 3]>| -> Batch {
            batch(&clouds.iter().flat_map(|c| part(c)).copied().collect::<Vec<_>>())
        };
        let [first, second] = CENTRES.map(|n| n / self.thinning);
        let members: Vec<usize> = clouds
            .iter()
            .enumerate()
            .flat_map(|(cloud, c)| c.members.iter().map(move |&m| cloud * first + m))
            .collect();
        let net = &self.network;
        let near = net.forward_through(PARTS[0]..PARTS[1], joined(|c| &c.near));
        let near = rows_at(pool_largest(near, NEIGHBOURS[0]), &members);
        let far = net.forward_through(PARTS[1]..PARTS[2], beside(joined(|c| &c.far), near));
        let far = pool_largest(far, NEIGHBOURS[1]);
        let whole = net.forward_through(PARTS[2]..PARTS[3], beside(joined(|c| &c.centres), far));
        net.forward_to_linear(PARTS[3]..PARTS[4], pool_largest(whole, second))
    }

    fn group(&self, cloud_m: &[[f64; 3]]) -> Grouped {
        let points: Vec<[f64; 3]> = cloud_m.iter().map(|p| p.map(|c| c / METRES_PER_UNIT)).collect();
        let [first, second] = CENTRES.map(|n| n / self.thinning);
        let radii = self.variant.radii();
        let relative = |p: [f64; 3], centre: [f64; 3]| -> [f32; 3] {
            std::array::from_fn(|k| ((p[k] - centre[k]) / self.scale.spread[k]) as f32)
        };
        let centres: Vec<[f64; 3]> = farthest_points(&points, first)
            .iter()
            .map(|&i| points[i])
            .collect();
        let mut grouped = Grouped {
            near: Vec::with_capacity(first * NEIGHBOURS[0]),
            members: Vec::with_capacity(second * NEIGHBOURS[1]),
            far: Vec::with_capacity(second * NEIGHBOURS[1]),
            centres: Vec::with_capacity(second),
        };
        for &centre in &centres {
            let inside = ball(&points, centre, radii[0], NEIGHBOURS[0]);
            grouped
                .near
                .extend(inside.iter().map(|&i| relative(points[i], centre)));
        }
        for &index in &farthest_points(&centres, second) {
            let inside = ball(&centres, centres[index], radii[1], NEIGHBOURS[1]);
            let far = inside.iter().map(|&i| relative(centres[i], centres[index]));
            grouped.far.extend(far);
            grouped.members.extend(&inside);
            grouped.centres.push(relative(centres[index], self.scale.mean));
        }
        grouped
    }
}

impl Baseline for PointNet {
    fn row(&self) -> String {
        match self.variant {
            Variant::AsPublished => "PointNet++, as published".into(),
            Variant::Fair => "PointNet++, fair".into(),
        }
    }

    fn estimate(&self, last_m: &[[f64; 3]]) -> Parameters {
        let output = values(self.outputs(&[&self.group(last_m)]));
        std::array::from_fn(|k| {
            let [low, high] = WHOLE_RANGE[k];
            0.5 * (low + high) + f64::from(output[k]) * (high - low) / 12f64.sqrt()
        })
    }
}

/// Seeds and streams of training, apart from those of truths and starts.
const TRAIN_SEED: u64 = 0x7074_6e65;
const WEIGHT_STREAM: u64 = 1 << 40;
const ORDER_STREAM: u64 = WEIGHT_STREAM + 1;

/// Parameters with mean zero and variance one over the range that is drawn from.
fn standardised(parameters: Parameters) -> [f32; 2] {
    std::array::from_fn(|k| {
        let [low, high] = WHOLE_RANGE[k];
        ((parameters[k] - 0.5 * (low + high)) / (high - low) * 12f64.sqrt()) as f32
    })
}

impl Scale {
    fn of(variant: Variant, samples: &[(Parameters, Vec<[f64; 3]>)]) -> Self {
        let points = || samples.iter().flat_map(|(_, cloud)| cloud);
        let n = points().count().max(1) as f64;
        let mean_m: [f64; 3] = std::array::from_fn(|k| points().map(|p| p[k]).sum::<f64>() / n);
        if variant == Variant::AsPublished {
            return Self {
                mean: [0.0; 3],
                spread: [1.0; 3],
            };
        }
        let variance = (0..3)
            .map(|k| points().map(|p| (p[k] - mean_m[k]).powi(2)).sum::<f64>() / n)
            .fold(0.0, f64::max);
        Self {
            mean: mean_m.map(|m| m / METRES_PER_UNIT),
            spread: [variance.sqrt() / METRES_PER_UNIT; 3],
        }
    }
}

/// Indices of `count` points of which each is farthest from all before it (Eldar et al. 1997), from the
/// first point on. A cloud of fewer points repeats some.
pub fn farthest_points(points: &[[f64; 3]], count: usize) -> Vec<usize> {
    let mut nearest = vec![f64::INFINITY; points.len()];
    let mut chosen = Vec::with_capacity(count);
    let mut next = 0;
    while chosen.len() < count {
        chosen.push(next);
        let from = points[next];
        let mut farthest = (0, f64::NEG_INFINITY);
        for (i, p) in points.iter().enumerate() {
            nearest[i] = nearest[i].min(square(p, &from));
            if nearest[i] > farthest.1 {
                farthest = (i, nearest[i]);
            }
        }
        next = farthest.0;
    }
    chosen
}

/// Indices of the first `count` points within `radius` of `centre`, filled up with the first of them.
pub fn ball(points: &[[f64; 3]], centre: [f64; 3], radius: f64, count: usize) -> Vec<usize> {
    let near = |i: &usize| square(&points[*i], &centre) <= radius * radius;
    let mut inside: Vec<usize> = (0..points.len()).filter(near).take(count).collect();
    let first = inside.first().copied().unwrap_or(0);
    inside.resize(count, first);
    inside
}

fn square(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    (0..3).map(|k| (a[k] - b[k]).powi(2)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn farthest_points_spread_and_balls_hold_neighbours() {
        let line: Vec<[f64; 3]> = (0..11).map(|i| [0.1 * f64::from(i), 0.0, 0.0]).collect();
        assert_eq!(farthest_points(&line, 3), [0, 10, 5]);
        assert_eq!(farthest_points(&line[..2], 3).len(), 3);
        assert_eq!(ball(&line, line[4], 0.11, 5), [3, 4, 5, 3, 3]);
        assert_eq!(ball(&line, line[4], 0.11, 2), [3, 4]);
    }

    /// A cloud whose shape says what its parameters are is learnt, by the fair network.
    #[test]
    fn a_plain_dependence_is_learnt() {
        let cloud = |truth: Parameters| -> Vec<[f64; 3]> {
            let [a, b] = standardised(truth).map(f64::from);
            (0..60)
                .map(|i| {
                    let s = f64::from(i) / 60.0;
                    [0.25 * s, 0.02 * b * s, 0.05 * a * s * s]
                })
                .collect()
        };
        let samples: Vec<_> = (0..48)
            .map(|i| draw(WHOLE_RANGE, 3, i))
            .map(|truth| (truth, cloud(truth)))
            .collect();
        let mut net = PointNet::new(Variant::Fair, 32, Scale::of(Variant::Fair, &samples), 3);
        let error = |net: &PointNet| -> f64 {
            let miss = |(truth, cloud): &(Parameters, Vec<[f64; 3]>)| {
                (net.estimate(cloud)[0] - truth[0]).abs() / samples.len() as f64
            };
            samples.iter().map(miss).sum()
        };
        let before = error(&net);
        net.learn(&samples, 40, 3, &|_| ());
        let after = error(&net);
        // A constant answer misses by 2500 on average.
        assert!(after < 1250.0 && after < 0.5 * before, "{before} {after}");
    }
}
