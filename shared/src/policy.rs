//! The trained policy: a fixed-size network from (goal, ln E, ν) to a release point (x, z), with its
//! normaliser and the region that its answers are kept in. One forward pass, used by training's own
//! check, by evaluation and by the controller.
//!
//! The network is the paper's, 3-256-128-32-2 with ReLU and a linear output, in `f32`. Stiffness
//! enters as its natural logarithm because ropes differ by factors, not by sums. Multiplications and
//! additions happen in a fixed order and Rust neither fuses nor reorders them, so equal inputs give
//! equal bits on every machine. A [`Policy`] is about 150 KB by value: keep it in a `static`, a box or
//! on an ordinary 8 MB stack, and pass it by reference.

use crate::task::{Interval, SwingTask};
use serde::de::{Error as _, SeqAccess, Visitor};
use serde::ser::SerializeTuple;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Inputs: goal, ln E, ν.
pub const INPUTS: usize = 3;
/// Units of the three hidden layers.
pub const HIDDEN: [usize; 3] = [256, 128, 32];
/// Outputs: x and z of the release point.
pub const OUTPUTS: usize = 2;

/// Bytes of one weight in a payload.
const VALUE_BYTES: usize = 4;

/// Halvings of the bisection in [`ReleaseRegion::project`]: down to the resolution of an f64 share.
const PROJECTION_STEPS: usize = 53;

/// Why a policy cannot be built or used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PolicyError {
    /// A layer got another number of weights or biases than its size asks for.
    #[error(
        "layer of {inputs} inputs and {outputs} outputs got {weights} weights and {biases} biases: export the network again"
    )]
    Shape {
        /// Inputs of the layer.
        inputs: usize,
        /// Outputs of the layer.
        outputs: usize,
        /// Weights given.
        weights: usize,
        /// Biases given.
        biases: usize,
    },
    /// A weight or bias is NaN or infinite.
    #[error(
        "the network holds a weight that is not a finite number: train again with a smaller learning rate"
    )]
    Weights,
    /// A mean or scale of the normaliser is not usable.
    #[error("the normaliser of `{0}` is not finite and positive: train again on data that vary in it")]
    Normaliser(&'static str),
    /// A training range is empty or not finite.
    #[error("the training range of `{0}` is empty or not finite: train again on valid data")]
    Range(&'static str),
    /// The region of release points is empty or not finite.
    #[error("the region of release points is empty: the rope must reach the task's release ranges")]
    Region,
}

/// One dense layer, weights input-major: `weights[i][o]` multiplies input `i` into output `o`.
/// Each input then adds a multiple of one contiguous row, which the compiler turns into vector code.
#[derive(Clone, Debug, PartialEq)]
pub struct Layer<const I: usize, const O: usize> {
    weights: [[f32; O]; I],
    bias: [f32; O],
}

impl<const I: usize, const O: usize> Layer<I, O> {
    /// From `weights`, I rows of O values one after the other, and O biases.
    pub fn from_rows(weights: &[f32], bias: &[f32]) -> Result<Self, PolicyError> {
        if weights.len() != I * O || bias.len() != O {
            return Err(PolicyError::Shape {
                inputs: I,
                outputs: O,
                weights: weights.len(),
                biases: bias.len(),
            });
        }
        let mut layer = Self::ZERO;
        for (row, values) in layer.weights.iter_mut().zip(weights.chunks_exact(O)) {
            row.copy_from_slice(values);
        }
        layer.bias.copy_from_slice(bias);
        Ok(layer)
    }

    /// Fills the layer with the values at the front of `bytes` and returns the rest.
    fn fill<'a>(&mut self, bytes: &'a [u8]) -> Option<&'a [u8]> {
        let (values, rest) = bytes.split_at_checked(VALUE_BYTES * (I * O + O))?;
        let slots = self.weights.iter_mut().flatten().chain(&mut self.bias);
        for (slot, value) in slots.zip(values.chunks_exact(VALUE_BYTES)) {
            *slot = f32::from_le_bytes([value[0], value[1], value[2], value[3]]);
        }
        Some(rest)
    }

    const ZERO: Self = Self {
        weights: [[0.0; O]; I],
        bias: [0.0; O],
    };

    /// Weights and biases times `input`, before any activation.
    fn apply(&self, input: &[f32; I]) -> [f32; O] {
        let mut output = self.bias;
        for (row, &value) in self.weights.iter().zip(input) {
            for (sum, &weight) in output.iter_mut().zip(row) {
                *sum += weight * value;
            }
        }
        output
    }

    /// The same through max(0, ·). A NaN stays a NaN, so that a bad input is seen at the output.
    fn apply_relu(&self, input: &[f32; I]) -> [f32; O] {
        let mut output = self.apply(input);
        for value in &mut output {
            if *value < 0.0 {
                *value = 0.0;
            }
        }
        output
    }

    fn is_finite(&self) -> bool {
        self.weights
            .iter()
            .flatten()
            .chain(&self.bias)
            .all(|value| value.is_finite())
    }
}

/// As a tuple of all weights, row by row, then all biases: serde has no arrays above 32 of its own.
impl<const I: usize, const O: usize> Serialize for Layer<I, O> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut tuple = serializer.serialize_tuple(I * O + O)?;
        for value in self.weights.iter().flatten().chain(&self.bias) {
            tuple.serialize_element(value)?;
        }
        tuple.end()
    }
}

impl<'de, const I: usize, const O: usize> Deserialize<'de> for Layer<I, O> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_tuple(I * O + O, LayerVisitor)
    }
}

struct LayerVisitor<const I: usize, const O: usize>;

impl<'de, const I: usize, const O: usize> Visitor<'de> for LayerVisitor<I, O> {
    type Value = Layer<I, O>;

    fn expecting(&self, formatter: &mut core::fmt::Formatter) -> core::fmt::Result {
        write!(formatter, "{} weights and {O} biases", I * O)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut values: A) -> Result<Self::Value, A::Error> {
        let mut layer = Layer::ZERO;
        for (at, slot) in layer
            .weights
            .iter_mut()
            .flatten()
            .chain(&mut layer.bias)
            .enumerate()
        {
            *slot = values
                .next_element()?
                .ok_or_else(|| A::Error::invalid_length(at, &"a whole layer"))?;
        }
        Ok(layer)
    }
}

/// The four layers of the network.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Network {
    /// Inputs to the first hidden layer.
    pub first: Layer<INPUTS, { HIDDEN[0] }>,
    /// First to second hidden layer.
    pub second: Layer<{ HIDDEN[0] }, { HIDDEN[1] }>,
    /// Second to third hidden layer.
    pub third: Layer<{ HIDDEN[1] }, { HIDDEN[2] }>,
    /// Third hidden layer to the outputs.
    pub last: Layer<{ HIDDEN[2] }, OUTPUTS>,
}

impl Network {
    /// Normalised outputs for normalised inputs.
    pub fn forward(&self, input: &[f32; INPUTS]) -> [f32; OUTPUTS] {
        let first = self.first.apply_relu(input);
        let second = self.second.apply_relu(&first);
        let third = self.third.apply_relu(&second);
        self.last.apply(&third)
    }

    /// Fills the network with the values at the front of `bytes` and returns the rest.
    fn fill<'a>(&mut self, bytes: &'a [u8]) -> Option<&'a [u8]> {
        let rest = self.first.fill(bytes)?;
        let rest = self.second.fill(rest)?;
        let rest = self.third.fill(rest)?;
        self.last.fill(rest)
    }

    const ZERO: Self = Self {
        first: Layer::ZERO,
        second: Layer::ZERO,
        third: Layer::ZERO,
        last: Layer::ZERO,
    };

    fn is_finite(&self) -> bool {
        self.first.is_finite() && self.second.is_finite() && self.third.is_finite() && self.last.is_finite()
    }
}

/// Mean and spread of one quantity over the training data.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Scale {
    /// What maps to 0.
    pub mean: f64,
    /// The distance from the mean that maps to 1.
    pub scale: f64,
}

impl Scale {
    /// The normalised value.
    pub fn normalise(&self, value: f64) -> f64 {
        (value - self.mean) / self.scale
    }

    /// The value whose normalised value is `normalised`.
    pub fn restore(&self, normalised: f64) -> f64 {
        self.mean + self.scale * normalised
    }

    fn is_usable(&self) -> bool {
        self.mean.is_finite() && self.scale.is_finite() && self.scale > 0.0
    }
}

/// How quantities enter and leave the network.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Normaliser {
    /// Goal, m.
    pub goal_x: Scale,
    /// Natural logarithm of Young's modulus in Pa.
    pub log_young: Scale,
    /// Poisson's ratio.
    pub poisson: Scale,
    /// Release point, x in m.
    pub release_x: Scale,
    /// Release point, z in m.
    pub release_z: Scale,
}

impl Normaliser {
    /// The network's inputs.
    pub fn inputs(&self, goal_x_m: f64, young_pa: f64, poisson: f64) -> [f32; INPUTS] {
        [
            self.goal_x.normalise(goal_x_m) as f32,
            self.log_young.normalise(libm::log(young_pa)) as f32,
            self.poisson.normalise(poisson) as f32,
        ]
    }

    /// The release point (x, z) in m that the network's outputs mean, not yet kept in any region.
    pub fn release_m(&self, outputs: [f32; OUTPUTS]) -> [f64; 2] {
        [
            self.release_x.restore(f64::from(outputs[0])),
            self.release_z.restore(f64::from(outputs[1])),
        ]
    }

    fn check(&self) -> Result<(), PolicyError> {
        let named = [
            ("goal", self.goal_x),
            ("ln E", self.log_young),
            ("Poisson's ratio", self.poisson),
            ("release x", self.release_x),
            ("release z", self.release_z),
        ];
        match named.iter().find(|(_, scale)| !scale.is_usable()) {
            Some((name, _)) => Err(PolicyError::Normaliser(name)),
            None => Ok(()),
        }
    }
}

/// What the policy was trained on; outside these it guesses.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrainingRanges {
    /// Goals, m.
    pub goal_x_m: Interval,
    /// Young's modulus, Pa.
    pub young_pa: Interval,
    /// Poisson's ratio.
    pub poisson: Interval,
}

impl TrainingRanges {
    /// Whether all three lie inside; never for NaN.
    pub fn contain(&self, goal_x_m: f64, young_pa: f64, poisson: f64) -> bool {
        self.goal_x_m.contains(goal_x_m) && self.contain_rope(young_pa, poisson)
    }

    /// Whether a rope lies inside; never for NaN.
    pub fn contain_rope(&self, young_pa: f64, poisson: f64) -> bool {
        self.young_pa.contains(young_pa) && self.poisson.contains(poisson)
    }

    fn check(&self) -> Result<(), PolicyError> {
        let named = [
            ("goal", self.goal_x_m),
            ("Young's modulus", self.young_pa),
            ("Poisson's ratio", self.poisson),
        ];
        match named.iter().find(|(_, range)| !is_interval(range)) {
            Some((name, _)) => Err(PolicyError::Range(name)),
            None if self.young_pa.low <= 0.0 => Err(PolicyError::Range("Young's modulus")),
            None => Ok(()),
        }
    }
}

/// Where the rope may be released: the task's ranges, and the gripper not farther from the fixed clamp than the rope
/// between them is long.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReleaseRegion {
    /// x, m.
    pub x_m: Interval,
    /// z, m.
    pub z_m: Interval,
    /// Where the rope's bottom end is when clamp and gripper touch, (x, z) in m.
    pub centre_m: [f64; 2],
    /// Largest distance from there, m: of the rope between clamp and gripper.
    pub radius_m: f64,
}

impl ReleaseRegion {
    /// The release points of `task` that a rope reaches of which `radius_m` between clamp and gripper can be stretched
    /// out.
    pub fn new(task: &SwingTask, radius_m: f64) -> Self {
        Self {
            x_m: task.release_x_m,
            z_m: task.release_z_m,
            centre_m: task.touching_m(),
            radius_m,
        }
    }

    /// Whether a point lies inside; never for NaN.
    pub fn contains(&self, point_m: [f64; 2]) -> bool {
        self.x_m.contains(point_m[0])
            && self.z_m.contains(point_m[1])
            && self.distance(point_m) <= self.radius_m
    }

    /// The nearest point inside; NaN stays NaN.
    ///
    /// The nearest point of a box cut with a disc is `clamp(p + t (centre − p))` for the smallest `t` in
    /// 0..1 that lies in the disc (the stationarity condition of the projection, with multiplier
    /// t / (1 − t)); its distance from the centre falls with `t`, so bisection finds it.
    pub fn project(&self, point_m: [f64; 2]) -> [f64; 2] {
        let boxed = self.towards_centre(point_m, 0.0);
        if self.distance(boxed) > self.radius_m {
            self.pull_into_disc(point_m)
        } else {
            boxed
        }
    }

    fn pull_into_disc(&self, point_m: [f64; 2]) -> [f64; 2] {
        let (mut outside, mut inside) = (0.0, 1.0);
        for _ in 0..PROJECTION_STEPS {
            let middle = 0.5 * (outside + inside);
            if self.distance(self.towards_centre(point_m, middle)) > self.radius_m {
                outside = middle;
            } else {
                inside = middle;
            }
        }
        self.towards_centre(point_m, inside)
    }

    fn towards_centre(&self, point_m: [f64; 2], share: f64) -> [f64; 2] {
        let along = |k: usize| point_m[k] + share * (self.centre_m[k] - point_m[k]);
        [self.x_m.clamp(along(0)), self.z_m.clamp(along(1))]
    }

    fn distance(&self, point_m: [f64; 2]) -> f64 {
        let (dx, dz) = (point_m[0] - self.centre_m[0], point_m[1] - self.centre_m[1]);
        libm::sqrt(dx * dx + dz * dz)
    }

    fn check(&self) -> Result<(), PolicyError> {
        let finite = is_interval(&self.x_m) && is_interval(&self.z_m) && self.radius_m.is_finite();
        let centre = self.centre_m.iter().all(|value| value.is_finite());
        if finite && centre && self.contains(self.towards_centre(self.centre_m, 0.0)) {
            Ok(())
        } else {
            Err(PolicyError::Region)
        }
    }
}

fn is_interval(range: &Interval) -> bool {
    range.low.is_finite() && range.high.is_finite() && range.low <= range.high
}

/// A trained policy.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Policy {
    network: Network,
    normaliser: Normaliser,
    ranges: TrainingRanges,
    region: ReleaseRegion,
}

impl Policy {
    /// All zeros: a place for [`Policy::fill`] to write to, and no usable policy.
    pub(crate) const ZERO: Self = {
        let nothing = Scale {
            mean: 0.0,
            scale: 0.0,
        };
        let empty = Interval { low: 0.0, high: 0.0 };
        Self {
            network: Network::ZERO,
            normaliser: Normaliser {
                goal_x: nothing,
                log_young: nothing,
                poisson: nothing,
                release_x: nothing,
                release_z: nothing,
            },
            ranges: TrainingRanges {
                goal_x_m: empty,
                young_pa: empty,
                poisson: empty,
            },
            region: ReleaseRegion {
                x_m: empty,
                z_m: empty,
                centre_m: [0.0; 2],
                radius_m: 0.0,
            },
        }
    };

    /// Decodes what serde encoded into postcard, in place, and returns the rest of the bytes; the result
    /// is not yet checked. Postcard writes an `f32` as its four bytes, so the network is copied straight
    /// in; serde's own way returns each layer by value several times and takes over 1 MB of stack.
    pub(crate) fn fill<'a>(&mut self, bytes: &'a [u8]) -> Option<&'a [u8]> {
        let rest = self.network.fill(bytes)?;
        let (parts, rest) = postcard::take_from_bytes(rest).ok()?;
        (self.normaliser, self.ranges, self.region) = parts;
        Some(rest)
    }

    /// From its parts, checked: finite weights, usable scales, non-empty ranges and region.
    pub fn from_parts(
        network: Network,
        normaliser: Normaliser,
        ranges: TrainingRanges,
        region: ReleaseRegion,
    ) -> Result<Self, PolicyError> {
        let policy = Self {
            network,
            normaliser,
            ranges,
            region,
        };
        policy.check()?;
        Ok(policy)
    }

    /// What [`Policy::from_parts`] checks, for a policy that came from bytes.
    pub fn check(&self) -> Result<(), PolicyError> {
        if !self.network.is_finite() {
            return Err(PolicyError::Weights);
        }
        self.normaliser.check()?;
        self.ranges.check()?;
        self.region.check()
    }

    /// Where to release a rope of modulus `young_pa` (Pa) and Poisson's ratio `poisson` so that its tip
    /// swings out to `goal_x_m`: (x, z) in m, always inside [`Policy::region`]. NaN in gives NaN out.
    pub fn release_point_m(&self, goal_x_m: f64, young_pa: f64, poisson: f64) -> [f64; 2] {
        let inputs = self.normaliser.inputs(goal_x_m, young_pa, poisson);
        let outputs = self.network.forward(&inputs);
        self.region.project(self.normaliser.release_m(outputs))
    }

    /// The network.
    pub fn network(&self) -> &Network {
        &self.network
    }

    /// The normaliser.
    pub fn normaliser(&self) -> &Normaliser {
        &self.normaliser
    }

    /// What the policy was trained on.
    pub fn ranges(&self) -> &TrainingRanges {
        &self.ranges
    }

    /// Where its answers lie.
    pub fn region(&self) -> &ReleaseRegion {
        &self.region
    }
}

#[cfg(test)]
#[path = "policy_tests.rs"]
mod tests;
