//! Derivatives of rollouts, checked: tangents against differences, gradients against tangents, and the
//! family of models in which everything that can be differentiated is a parameter.

use crate::scenes::{knot, rope, start_grip};
use offline::demo::RopeEnd;
use offline::effects::{self, ALL};
use offline::sim::Laned;
use offline::sim::adjoint::{Cotangent, Differentiated, Family, Precision, differentiate};
use offline::sim::clamp::{ClampPath, KnotShift, PathShift};
use offline::sim::physics::ForceField;
use offline::sim::real::Arithmetic;
use offline::sim::rope::RopeShape;
use offline::sim::scene::{Grip, Scene, Settling, StepLength, Table};
use offline::sim::{Dual, Physics, Real, Rollout, SimError, simulate};
use offline::verify::setup::DIAMETER_M;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use shared::profile::MotionLimits;
use shared::task::SwingTask;

/// How a tangent compares with a central difference, over all points of some frames.
#[derive(Clone, Copy, Debug)]
pub struct Slope {
    /// Root of the sum of squares of the difference quotient.
    pub size: f64,
    /// The same of what the tangent is off by, as a share of the size.
    pub error: f64,
}

/// Compares tangent number `lane` over some frames with the quotient of two rollouts whose input is `h`
/// less and more.
///
/// # Panics
/// The two rollouts have different time steps: the step must not depend on the input.
pub fn slope<const N: usize>(
    (dual, lane): (&Rollout<Dual<f64, N>>, usize),
    frames: std::ops::Range<usize>,
    [less, more]: &[Rollout<f64>; 2],
    h: f64,
) -> Slope {
    assert!(less.dt_s == more.dt_s, "the step must not depend on the input");
    let (mut wrong, mut size) = (0.0, 0.0);
    for f in frames {
        for (p, point) in dual.frames[f].iter().enumerate() {
            for c in 0..3 {
                let slope = (more.frames[f][p][c] - less.frames[f][p][c]) / (2.0 * h);
                wrong += (point[c].tangent[lane] - slope).powi(2);
                size += slope * slope;
            }
        }
    }
    Slope {
        size: f64::sqrt(size),
        error: f64::sqrt(wrong / size),
    }
}

/// A family in which everything is a parameter: θ = (ln E, ν, friction, the parameters of effects, and
/// an amplitude for each given direction of the paths and of the force field).
#[derive(Clone, Debug, Default)]
pub struct Everything {
    /// Effects of the registry.
    pub effects: Vec<usize>,
    /// Directions in which paths move, each with values for every knot.
    pub shifts: Vec<PathShift<f64>>,
    /// Directions of the force field, all with the same blocks.
    pub fields: Vec<ForceField<f64>>,
}

/// Effects of which `wanted` holds for the physics that they alone make.
fn effects_where(wanted: impl Fn(&Physics<f64>) -> bool) -> Vec<usize> {
    let alone = |&effect: &usize| {
        let values: Vec<f64> = ALL[effect]
            .parameters
            .iter()
            .map(|p| p.smallest_of_interest)
            .collect();
        let mut physics = Physics::base(4e5, 0.3, 0.4);
        effects::add_to(effect, &values, &mut physics);
        wanted(&physics)
    };
    (0..ALL.len()).filter(alone).collect()
}

/// Effects that reverse mode knows and that have slopes everywhere: their laws act on one particle at a
/// time and forget, none of them is a jump in time, and the rope need not hang.
fn smooth_particle_effects() -> Vec<usize> {
    effects_where(|p| {
        let elsewhere = p.changes_material() || !p.observation_laws.is_empty();
        !elsewhere && p.release_delay_s == 0.0 && p.grip_tilt.is_none()
    })
}

/// Entries of θ before the effects'.
const BASE: usize = 3;

impl Everything {
    /// Every effect with a smooth law of single particles and a random direction of each path, drawn from `seed` on. A path
    /// of one knot holds the rope where it is, wherever that knot lies.
    pub fn smooth(scene: &Scene, seed: u64) -> Self {
        let moves = |g: &usize| scene.grips[*g].path.knots().len() > 1;
        let grips = (0..scene.grips.len()).filter(moves);
        Self {
            effects: smooth_particle_effects(),
            shifts: grips.map(|g| random_shift(scene, g, seed + g as u64)).collect(),
            fields: Vec::new(),
        }
    }

    /// What the entries of θ are called.
    pub fn names(&self) -> Vec<String> {
        let mut names: Vec<String> = ["young", "poisson", "friction"].map(String::from).into();
        for &effect in &self.effects {
            let spec = &ALL[effect];
            names.extend(spec.parameters.iter().map(|p| format!("{}.{}", spec.id, p.name)));
        }
        names.extend((0..self.shifts.len()).map(|k| format!("path {k}")));
        names.extend((0..self.fields.len()).map(|k| format!("force {k}")));
        names
    }

    /// θ at the given base, effects at `scale` of what is of interest, no shift and no force.
    pub fn theta(&self, base: [f64; BASE], scale: f64) -> Vec<f64> {
        let mut theta = base.to_vec();
        for &effect in &self.effects {
            theta.extend(ALL[effect].parameters.iter().map(|p| {
                let side = if p.high > p.vanishes_at { 1.0 } else { -1.0 };
                p.vanishes_at + side * scale * p.smallest_of_interest
            }));
        }
        theta.resize(theta.len() + self.shifts.len() + self.fields.len(), 0.0);
        theta
    }

    /// Sizes of change that matter, one per entry of θ.
    pub fn sizes(&self) -> Vec<f64> {
        let mut sizes = vec![0.02, 0.02, 0.1];
        for &effect in &self.effects {
            sizes.extend(ALL[effect].parameters.iter().map(|p| p.smallest_of_interest));
        }
        sizes.resize(sizes.len() + self.shifts.len(), 1e-3);
        sizes.resize(sizes.len() + self.fields.len(), 0.01);
        sizes
    }
}

impl Family for Everything {
    fn physics<T: Real>(&self, theta: &[T]) -> Physics<T> {
        let mut physics = Physics::base(theta[0].exp(), theta[1], theta[2]);
        let mut rest = &theta[BASE..];
        for &effect in &self.effects {
            let (values, after) = rest.split_at(ALL[effect].parameters.len());
            effects::add_to(effect, values, &mut physics);
            rest = after;
        }
        let (shifts, fields) = rest.split_at(self.shifts.len());
        for (shift, &amplitude) in self.shifts.iter().zip(shifts) {
            let grip = shift.grip;
            let moved = |knot: &KnotShift<f64>| KnotShift {
                pose: knot.pose.map(|x| amplitude.scale(x)),
                rate: knot.rate.map(|x| amplitude.scale(x)),
            };
            let knots: Vec<KnotShift<T>> = shift.knots.iter().map(moved).collect();
            match physics.path_shifts.iter_mut().find(|s| s.grip == grip) {
                None => physics.path_shifts.push(PathShift { grip, knots }),
                Some(sum) => {
                    for (a, b) in sum.knots.iter_mut().zip(knots) {
                        for k in 0..7 {
                            a.pose[k] += b.pose[k];
                            a.rate[k] += b.rate[k];
                        }
                    }
                }
            }
        }
        for (field, &amplitude) in self.fields.iter().zip(fields) {
            let force = |v: &[f64; 3]| v.map(|x| amplitude.scale(x));
            let blocks: Vec<Vec<[T; 3]>> = field
                .force_n_m
                .iter()
                .map(|block| block.iter().map(force).collect())
                .collect();
            match &mut physics.force_field {
                None => {
                    physics.force_field = Some(ForceField {
                        block_s: field.block_s,
                        force_n_m: blocks,
                    })
                }
                Some(sum) => {
                    for (a, b) in sum.force_n_m.iter_mut().flatten().zip(blocks.iter().flatten()) {
                        for k in 0..3 {
                            a[k] += b[k];
                        }
                    }
                }
            }
        }
        physics
    }
}

/// A derivative of a result as a sum over frames and reach.
#[derive(Clone, Copy, Debug)]
pub struct Contracted {
    /// The sum.
    pub value: f64,
    /// The sum of the terms' absolute values: rounding goes with this, not with what is left of it.
    pub gross: f64,
}

fn contracted<F: Precision, const N: usize>(
    rollout: &Rollout<Dual<F, N>>,
    cotangent: &Cotangent,
    lane: usize,
) -> Contracted {
    let reach = rollout.reach_m.map_or(0.0, |r| r.tangent[lane].value());
    let points = rollout.frames.iter().flatten().flatten();
    let weights = cotangent.frames.iter().flatten().flatten();
    let terms = points.zip(weights).map(|(x, w)| x.tangent[lane].value() * w);
    let (value, gross) = terms
        .chain([cotangent.reach * reach])
        .fold((0.0, 0.0), |(sum, size), term| (sum + term, size + term.abs()));
    Contracted { value, gross }
}

/// Tangents that one rollout carries: one number for nearly all tests, because for each the simulator is
/// compiled anew.
pub const LANES: usize = 10;

/// Rollouts with the tangents of every entry of θ, ten at a time.
pub struct Tangents<F: Precision>(Vec<Rollout<Dual<F, LANES>>>);

impl<F: Precision> Tangents<F>
where
    Dual<F, LANES>: Laned,
{
    /// Simulates a scene at θ.
    ///
    /// # Errors
    /// As [`simulate`].
    pub fn new<M: Family>(scene: &Scene, family: &M, theta: &[f64]) -> Result<Self, SimError> {
        let with_inputs = |start: usize| {
            let input = |(k, &x): (usize, &f64)| match k.checked_sub(start) {
                Some(lane) if lane < LANES => Dual::input(x, lane),
                _ => Dual::of(x),
            };
            let inputs: Vec<Dual<F, LANES>> = theta.iter().enumerate().map(input).collect();
            simulate(scene, &family.physics(&inputs))
        };
        (0..theta.len())
            .step_by(LANES)
            .map(with_inputs)
            .collect::<Result<_, _>>()
            .map(Self)
    }

    /// The rollout that carries the tangent of an entry of θ, and in which lane.
    pub fn of_entry(&self, entry: usize) -> (&Rollout<Dual<F, LANES>>, usize) {
        (&self.0[entry / LANES], entry % LANES)
    }
}

/// The derivative of a result with respect to every entry of θ, by forward mode.
///
/// # Errors
/// As [`simulate`].
pub fn forward_gradient<F: Precision, M: Family>(
    scene: &Scene,
    family: &M,
    theta: &[f64],
    cotangent: &Cotangent,
) -> Result<Vec<Contracted>, SimError>
where
    Dual<F, LANES>: Laned,
{
    let tangents = Tangents::<F>::new(scene, family, theta)?;
    let of_entry = |entry| {
        let (rollout, lane) = tangents.of_entry(entry);
        contracted(rollout, cotangent, lane)
    };
    Ok((0..theta.len()).map(of_entry).collect())
}

/// The same by reverse mode.
///
/// # Errors
/// As [`differentiate`].
pub fn reverse_gradient<F: Precision, M: Family>(
    scene: &Scene,
    family: &M,
    theta: &[f64],
    cotangent: &Cotangent,
    budget_bytes: usize,
) -> Result<Differentiated<F>, SimError> {
    differentiate::<F, M>(scene, family, theta, budget_bytes, |_| cotangent.clone())
}

/// Smooth weights for every point of every frame and, where there is one, the reach.
pub fn smooth_cotangent(scene: &Scene) -> Cotangent {
    let slices = scene.layout().slices.len();
    let weight = |frame: usize, slice: usize| {
        let along = slice as f64 / slices as f64;
        let share = 1.0 / (slices * scene.frame_times_s.len()) as f64;
        [0.6 + along, 0.8 - 0.3 * along, 1.0 + 0.1 * frame as f64].map(|w| w * share)
    };
    Cotangent {
        frames: (0..scene.frame_times_s.len())
            .map(|f| (0..slices).map(|s| weight(f, s)).collect())
            .collect(),
        reach: if scene.score_from_s.is_finite() { 1.0 } else { 0.0 },
    }
}

/// A direction in which the whole path of a grip moves, rates included, drawn at random.
pub fn random_shift(scene: &Scene, grip: usize, seed: u64) -> PathShift<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let knots = scene.grips[grip].path.knots();
    let mut draw = |size: f64| std::array::from_fn(|_| rng.random_range(-size..size));
    PathShift {
        grip,
        knots: knots
            .iter()
            .map(|_| KnotShift {
                pose: draw(1.0),
                rate: draw(1.0),
            })
            .collect(),
    }
}

/// A direction of a force along rope and time, drawn at random.
pub fn random_field(scene: &Scene, blocks: usize, seed: u64) -> ForceField<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let slices = scene.layout().slices.len();
    let mut force = || std::array::from_fn(|_| rng.random_range(-1.0..1.0));
    ForceField {
        block_s: scene.duration_s / blocks as f64,
        force_n_m: (0..blocks)
            .map(|_| (0..slices).map(|_| force()).collect())
            .collect(),
    }
}

/// A soft rope.
pub fn soft_rope(length_m: f64) -> RopeShape {
    rope(length_m, DIAMETER_M)
}

/// ln E, ν and friction of the soft rope.
pub const SOFT: [f64; BASE] = [12.9, 0.3, 0.4];

/// Step of the scenes here, s, shorter than any that their parameters ask for: differences must not change it.
const STEP: StepLength = StepLength::Fixed(1.5e-4);

/// A quick lift of one end off the table, a part of the rope still sliding on it.
pub fn lift() -> Scene {
    let path = ClampPath::new(vec![
        knot(0.0, [0.0; 3], true),
        knot(0.2, [0.02, 0.0, 0.04], true),
    ]);
    let grips = start_grip(0.02, path);
    let table = Some(Table { height_m: -0.007 });
    let times = vec![0.06, 0.12, 0.18, 0.24];
    let scene = Scene::new(
        soft_rope(0.16),
        [0.0; 3],
        [1.0, 0.0, 0.0],
        grips,
        table,
        1.5,
        times,
    );
    Scene {
        step: STEP,
        ..scene.unwrap()
    }
}

/// A rope carried and turned by both ends above a table; one end is let go, falls and touches down.
pub fn free() -> Scene {
    let level = 0.045;
    let turned = [0.0, (0.15f64).sin(), 0.0, (0.15f64).cos()];
    let mut last = knot(0.12, [0.01, 0.01, level + 0.01], true);
    last.pose[3..].copy_from_slice(&turned);
    let start = ClampPath::new(vec![knot(0.0, [0.0, 0.0, level], true), last]);
    let end = ClampPath::new(vec![
        knot(0.0, [0.14, 0.0, level], true),
        knot(0.06, [0.13, 0.01, level - 0.01], true),
        knot(0.1, [0.12, 0.01, level - 0.005], false),
    ]);
    let grip = |end, path| Grip {
        end,
        length_m: 0.02,
        path,
    };
    let grips = vec![grip(RopeEnd::Start, start), grip(RopeEnd::End, end)];
    let table = Some(Table { height_m: 0.0 });
    let times = vec![0.05, 0.1, 0.15, 0.2, 0.25];
    let scene = Scene::new(
        soft_rope(0.14),
        [0.0, 0.0, level],
        [1.0, 0.0, 0.0],
        grips,
        table,
        1.5,
        times,
    );
    Scene {
        step: STEP,
        ..scene.unwrap()
    }
}

/// A short rope on the swing task, at the size of the rope.
pub fn swing(release_m: [f64; 2]) -> Scene {
    let task = SwingTask {
        top_m: [0.15, 0.2],
        dwell_s: 0.25,
        ..SwingTask::PAPER
    };
    let quick = MotionLimits {
        speed_m_s: 1.5,
        acceleration_m_s2: 50.0,
        jerk_m_s3: 3000.0,
    };
    let mut scene = Scene::swing(soft_rope(0.12), &task, release_m, &quick, 1.5).unwrap();
    let release_s = scene.score_from_s;
    scene.settling = Some(Settling {
        until_s: release_s,
        rate_per_s: 40.0,
        still_m_s: 0.0,
    });
    scene.frame_times_s = [-0.3, -0.01, 0.05, 0.15, 0.3].map(|t| release_s + t).into();
    scene.duration_s = release_s + 0.3;
    scene.step = STEP;
    scene
}

/// Where [`swing`] lets go.
pub const RELEASE_M: [f64; 2] = [0.09, 0.14];
