//! Multilayer perceptrons that can be trained: the only file that knows the deep-learning crate.
//!
//! Weights start and batches are drawn from our own random streams, and burn's flex backend gives
//! equal bits for any number of threads, so training repeats exactly on one kind of processor.

use burn::tensor::{Device, Gradients, Int, Tensor, TensorData, activation};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Decay of Adam's mean of gradients (Kingma and Ba 2015).
const BETA_MEAN: f32 = 0.9;
/// Decay of Adam's mean of squared gradients.
const BETA_SQUARE: f32 = 0.999;
/// Keeps Adam's division finite.
const EPSILON: f32 = 1e-8;

/// What lies between two layers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Activation {
    /// max(0, x).
    Relu,
    /// x / (1 + exp(−x)): smooth, for a network whose slope is used.
    Silu,
    /// x: several layers are then one linear map.
    Identity,
}

impl Activation {
    fn apply<const D: usize>(self, signal: Tensor<D>) -> Tensor<D> {
        match self {
            Self::Relu => activation::relu(signal),
            Self::Silu => activation::silu(signal),
            Self::Identity => signal,
        }
    }
}

/// One number on the training device.
pub type Scalar = Tensor<1>;

/// A batch of rows on the training device.
pub type Batch = Tensor<2>;

struct Dense {
    weight: Tensor<2>,
    bias: Tensor<1>,
}

/// A multilayer perceptron with a linear last layer.
pub struct Mlp {
    layers: Vec<Dense>,
    activation: Activation,
}

/// Weights (input-major) and biases of one layer.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct LayerValues {
    /// Inputs times outputs values, row by row.
    pub weight: Vec<f32>,
    /// Outputs values.
    pub bias: Vec<f32>,
}

/// The device of all training: a CPU with gradients.
pub fn device() -> Device {
    Device::flex().autodiff()
}

/// `rows` as a batch.
pub fn batch<const N: usize>(rows: &[[f32; N]]) -> Batch {
    Tensor::from_data(TensorData::new(rows.concat(), [rows.len(), N]), &device())
}

/// The only value of a batch of one number.
pub fn value(number: Scalar) -> f32 {
    values(number)[0]
}

/// All values of a tensor, row by row.
pub fn values<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor
        .into_data()
        .try_to_vec::<f32>()
        .expect("training tensors hold f32")
}

impl Mlp {
    /// A network with layers of the given `sizes`, inputs first. Weights are uniform with the variance
    /// 2 / inputs that keeps rectified signals from growing or dying (He et al. 2015); biases are zero.
    pub fn new(sizes: &[usize], activation: Activation, rng: &mut ChaCha8Rng) -> Self {
        let layers = sizes
            .windows(2)
            .map(|pair| {
                let (inputs, outputs) = (pair[0], pair[1]);
                let bound = (6.0 / inputs as f32).sqrt();
                let weight = (0..inputs * outputs).map(|_| bound * (2.0 * rng.random::<f32>() - 1.0));
                Dense {
                    weight: Tensor::from_data(
                        TensorData::new(weight.collect(), [inputs, outputs]),
                        &device(),
                    ),
                    bias: Tensor::zeros([outputs], &device()),
                }
                .trainable()
            })
            .collect();
        Self { layers, activation }
    }

    /// Outputs for a batch of inputs.
    pub fn forward(&self, input: Batch) -> Batch {
        let last = self.layers.len() - 1;
        let hidden = self.forward_through(0..last, input);
        self.layers[last].apply(hidden)
    }

    /// Signals of a batch after some of the layers, each followed by the activation.
    pub fn forward_through(&self, layers: std::ops::Range<usize>, input: Batch) -> Batch {
        let through = |signal, layer: &Dense| self.activation.apply(layer.apply(signal));
        self.layers[layers].iter().fold(input, through)
    }

    /// Signals after some of the layers with the activation between, but not behind, them.
    pub fn forward_to_linear(&self, layers: std::ops::Range<usize>, input: Batch) -> Batch {
        let last = layers.end - 1;
        let hidden = self.forward_through(layers.start..last, input);
        self.layers[last].apply(hidden)
    }

    /// Several networks as one list of layers, which one optimiser steps.
    pub fn joined(parts: Vec<Self>, activation: Activation) -> Self {
        Self {
            layers: parts.into_iter().flat_map(|part| part.layers).collect(),
            activation,
        }
    }

    /// Sets all weights to values of a network of the same shape; false if the shape differs.
    pub fn set_layer_values(&mut self, values: &[LayerValues]) -> bool {
        let fits = |(layer, values): (&Dense, &LayerValues)| {
            let [inputs, outputs] = layer.weight.dims();
            values.weight.len() == inputs * outputs && values.bias.len() == outputs
        };
        if self.layers.len() != values.len() || !self.layers.iter().zip(values).all(fits) {
            return false;
        }
        for (layer, values) in self.layers.iter_mut().zip(values) {
            let shape = layer.weight.dims();
            let weight = TensorData::new(values.weight.clone(), shape);
            let bias = TensorData::new(values.bias.clone(), [shape[1]]);
            *layer = Dense {
                weight: Tensor::from_data(weight, &device()),
                bias: Tensor::from_data(bias, &device()),
            }
            .trainable();
        }
        true
    }

    /// A copy whose weights are constants: gradients flow through it but not into it.
    pub fn frozen(&self) -> Self {
        let layers = self.layers.iter().map(|layer| Dense {
            weight: layer.weight.clone().detach(),
            bias: layer.bias.clone().detach(),
        });
        Self {
            layers: layers.collect(),
            activation: self.activation,
        }
    }

    /// Weights and biases, first layer first.
    pub fn layer_values(&self) -> Vec<LayerValues> {
        let layers = self.layers.iter().map(|layer| LayerValues {
            weight: values(layer.weight.clone()),
            bias: values(layer.bias.clone()),
        });
        layers.collect()
    }
}

/// For every group of `size` successive rows, the largest value of each column.
pub fn pool_largest(rows: Batch, size: usize) -> Batch {
    let [count, columns] = rows.dims();
    let groups = count / size;
    let pooled: Tensor<3> = rows.reshape([groups, size, columns]).max_dim(1);
    pooled.reshape([groups, columns])
}

/// Rows of a batch by their indices.
pub fn rows_at(rows: Batch, indices: &[usize]) -> Batch {
    let indices: Vec<i64> = indices.iter().map(|&i| i as i64).collect();
    let count = indices.len();
    let indices = Tensor::<1, Int>::from_data(TensorData::new(indices, [count]), &device());
    rows.select(0, indices)
}

/// Two batches side by side.
pub fn beside(left: Batch, right: Batch) -> Batch {
    Tensor::cat(vec![left, right], 1)
}

impl Dense {
    fn apply(&self, signal: Batch) -> Batch {
        signal.matmul(self.weight.clone()) + self.bias.clone().unsqueeze()
    }

    fn trainable(self) -> Self {
        Self {
            weight: self.weight.detach().require_grad(),
            bias: self.bias.detach().require_grad(),
        }
    }
}

/// Running means of one tensor's gradient and of its square.
struct Moments<const D: usize> {
    mean: Tensor<D>,
    square: Tensor<D>,
}

impl<const D: usize> Moments<D> {
    fn zeros(like: &Tensor<D>) -> Self {
        let zeros = like.clone().detach().inner().zeros_like();
        Self {
            mean: zeros.clone(),
            square: zeros,
        }
    }

    /// The parameter after one step along the scaled gradient.
    fn step(&mut self, parameter: &Tensor<D>, gradient: Tensor<D>, rates: &Rates) -> Tensor<D> {
        let gradient = gradient.mul_scalar(rates.clip);
        let blend = |old: &Tensor<D>, new: Tensor<D>, beta: f32| {
            old.clone().mul_scalar(beta) + new.mul_scalar(1.0 - beta)
        };
        self.mean = blend(&self.mean, gradient.clone(), BETA_MEAN);
        self.square = blend(&self.square, gradient.clone() * gradient, BETA_SQUARE);
        let spread = self
            .square
            .clone()
            .sqrt()
            .mul_scalar(rates.square)
            .add_scalar(EPSILON);
        let change = self.mean.clone().mul_scalar(rates.step) / spread;
        let moved = parameter.clone().detach().inner() - change;
        Tensor::from_inner(moved).require_grad()
    }
}

/// Factors of one step that all tensors share.
struct Rates {
    clip: f32,
    step: f32,
    square: f32,
}

/// Adam (Kingma and Ba 2015) with the norm of the whole gradient clipped, as the paper trains.
pub struct Adam {
    moments: Vec<(Moments<2>, Moments<1>)>,
    steps: i32,
    clip_norm: f32,
}

impl Adam {
    /// An optimiser for `network` that clips the gradient's norm to `clip_norm`.
    pub fn new(network: &Mlp, clip_norm: f32) -> Self {
        let moments = network.layers.iter();
        Self {
            moments: moments
                .map(|l| (Moments::zeros(&l.weight), Moments::zeros(&l.bias)))
                .collect(),
            steps: 0,
            clip_norm,
        }
    }

    /// One step of `network` down the gradient of `loss`, with the given learning rate.
    pub fn step(&mut self, network: &mut Mlp, loss: &Scalar, rate: f32) {
        let gradients = loss.backward();
        let pairs: Vec<_> = network
            .layers
            .iter()
            .map(|layer| layer_gradients(layer, &gradients))
            .collect();
        self.steps += 1;
        let rates = Rates {
            clip: self.clip(&pairs),
            step: rate / (1.0 - BETA_MEAN.powi(self.steps)),
            square: 1.0 / (1.0 - BETA_SQUARE.powi(self.steps)).sqrt(),
        };
        for ((layer, moments), (weight, bias)) in network.layers.iter_mut().zip(&mut self.moments).zip(pairs)
        {
            layer.weight = moments.0.step(&layer.weight, weight, &rates);
            layer.bias = moments.1.step(&layer.bias, bias, &rates);
        }
    }

    /// The factor that brings the norm over all gradients down to the limit. (burn's own clipping
    /// treats each tensor alone, which is not what the paper's `clipnorm` and this factor mean.)
    fn clip(&self, pairs: &[(Tensor<2>, Tensor<1>)]) -> f32 {
        let square = |weight: &Tensor<2>, bias: &Tensor<1>| {
            let weight = weight.clone() * weight.clone();
            let bias = bias.clone() * bias.clone();
            f64::from(value(weight.sum())) + f64::from(value(bias.sum()))
        };
        let norm = pairs.iter().map(|(w, b)| square(w, b)).sum::<f64>().sqrt() as f32;
        if norm > self.clip_norm {
            self.clip_norm / norm
        } else {
            1.0
        }
    }
}

fn layer_gradients(layer: &Dense, gradients: &Gradients) -> (Tensor<2>, Tensor<1>) {
    let missing = "the loss depends on every layer";
    (
        layer.weight.grad(gradients).expect(missing),
        layer.bias.grad(gradients).expect(missing),
    )
}
