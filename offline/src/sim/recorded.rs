//! The recorded path of a grip, with its shift, as the laws see it that disturb it: where the path is, and where something
//! is that trails behind it.

use super::clamp::{ClampPath, KnotShift, Span};
use super::dual::Dual;
use super::physics::Pose;
use super::real::Real;

/// First to third derivative of a path with respect to time, in 1/s, 1/s² and 1/s³.
pub(super) type Derivatives<T> = [Pose<T>; 3];

/// Lags after which nothing is left of the past: e⁻³⁰ of it is 1e-13.
const LAGS_REMEMBERED: f64 = 30.0;

/// How knots are changed, by index.
type Shift<'a, T> = Option<&'a dyn Fn(usize) -> KnotShift<T>>;

/// A path and how its knots are changed.
#[derive(Clone, Copy)]
pub struct Recorded<'a, T> {
    path: &'a ClampPath,
    shift: Shift<'a, T>,
}

impl<'a, T: Real> Recorded<'a, T> {
    /// The path as it is where nothing shifts it.
    pub fn new(path: &'a ClampPath, shift: Shift<'a, T>) -> Self {
        Self { path, shift }
    }

    /// Pose at time `t_s`.
    pub fn pose(&self, t_s: f64) -> Pose<T> {
        let t = T::of(t_s);
        let pose = self.path.pose(t);
        let Some(shift) = self.shift else { return pose };
        match self.path.span(t) {
            Span::At(i) => {
                let by = shift(i);
                std::array::from_fn(|k| pose[k] + by.pose[k])
            }
            Span::Beyond(i, since) => {
                let by = shift(i);
                std::array::from_fn(|k| pose[k] + by.pose[k] + since * by.rate[k])
            }
            Span::After(i, w) => {
                let (a, b) = (shift(i), shift(i + 1));
                std::array::from_fn(|k| {
                    pose[k]
                        + a.pose[k]
                        + w.along * (b.pose[k] - a.pose[k])
                        + w.start_rate * a.rate[k]
                        + w.end_rate * b.rate[k]
                })
            }
        }
    }

    /// Where y is minus where the path p is at time `t_s`, with T y' = p(t) − y for T = `lag_s`, and y = p before the first
    /// knot.
    ///
    /// Of the solution y(t) = ∫ p(s) e^(−(t−s)/T)/T ds each cubic piece gives, by parts, e^(−(t−s)/T) (p − T p' + T² p'' −
    /// T³ p''') between its ends. So y is that at t, and at every knot before what the derivatives jump by. The path's own
    /// part is summed in f64 in any precision: where knots lie closer than T, its terms are many times their sum.
    pub fn trail(&self, lag_s: T, t_s: f64) -> Pose<T> {
        let path = self.path;
        let knots = path.knots();
        let piece = knots.partition_point(|knot| knot.t_s < t_s);
        let oldest_s = t_s - LAGS_REMEMBERED * lag_s.value();
        let oldest = knots.partition_point(|knot| knot.t_s <= oldest_s);
        let past = || (oldest..piece).map(|i| (t_s - knots[i].t_s, i));

        let lag = Dual::<f64, 1>::input(lag_s.value(), 0);
        let now = path.derivatives(piece, t_s);
        let jumps = past().map(|(since_s, i)| (since_s, in_numbers(path.jump(i))));
        let own = behind(lag, &in_numbers(&now), jumps);
        let change = lag_s - T::of(lag_s.value());
        let own = own.map(|x| T::of(x.value) + change.scale(x.tangent[0]));
        let Some(shift) = self.shift else { return own };
        let now = path.derivatives_of(shift, piece, t_s);
        let jumps = past().map(|(since_s, i)| (since_s, path.jump_of(shift, i)));
        let of_shift = behind(lag_s, &now, jumps);
        std::array::from_fn(|k| own[k] + of_shift[k])
    }
}

fn in_numbers<T: Real>(of: &Derivatives<f64>) -> Derivatives<T> {
    of.map(|pose| pose.map(T::of))
}

/// y − p from the derivatives of p now and their jumps so long ago, s.
fn behind<T: Real>(
    lag_s: T,
    now: &Derivatives<T>,
    jumps: impl Iterator<Item = (f64, Derivatives<T>)>,
) -> Pose<T> {
    let square = lag_s * lag_s;
    let weights = [-lag_s, square, -square * lag_s];
    let weighted = |of: &Derivatives<T>, k: usize| {
        let [first, second, third] = std::array::from_fn(|order| weights[order] * of[order][k]);
        first + second + third
    };
    let mut behind: Pose<T> = std::array::from_fn(|k| weighted(now, k));
    for (since_s, jump) in jumps {
        let left = (T::of(-since_s) / lag_s).exp();
        for (k, behind) in behind.iter_mut().enumerate() {
            *behind -= left * weighted(&jump, k);
        }
    }
    behind
}

impl ClampPath {
    /// Derivatives at time `t_s` of piece `piece`, which ends at the knot of that index.
    fn derivatives(&self, piece: usize, t_s: f64) -> Derivatives<f64> {
        self.derivatives_of(&|i| self.knots()[i].shift_from_nothing(), piece, t_s)
    }

    /// Those of a path through knots at the same times, which are `knot`.
    fn derivatives_of<T: Real>(
        &self,
        knot: &dyn Fn(usize) -> KnotShift<T>,
        piece: usize,
        t_s: f64,
    ) -> Derivatives<T> {
        let knots = self.knots();
        let still = [[T::zero(); 7]; 3];
        let Some(before) = piece.checked_sub(1) else {
            return still;
        };
        if piece == knots.len() {
            return if knots[before].closed {
                still
            } else {
                [knot(before).rate, still[1], still[2]]
            };
        }
        let h = knots[piece].t_s - knots[before].t_s;
        let u = (t_s - knots[before].t_s) / h;
        let (a, b) = (knot(before), knot(piece));
        // Derivatives of the weights of cubic Hermite interpolation, over h, h² and h³.
        let order = |along: f64, start_rate: f64, end_rate: f64, per: f64| -> Pose<T> {
            std::array::from_fn(|k| {
                ((b.pose[k] - a.pose[k]).scale(along)
                    + a.rate[k].scale(start_rate * h)
                    + b.rate[k].scale(end_rate * h))
                .scale(1.0 / per)
            })
        };
        [
            order(
                6.0 * u * (1.0 - u),
                (3.0 * u - 4.0) * u + 1.0,
                (3.0 * u - 2.0) * u,
                h,
            ),
            order(6.0 - 12.0 * u, 6.0 * u - 4.0, 6.0 * u - 2.0, h * h),
            order(-12.0, 6.0, 6.0, h * h * h),
        ]
    }

    /// What the derivatives jump by at knot `i`.
    pub(super) fn own_jump(&self, i: usize) -> Derivatives<f64> {
        self.jump_of(&|i| self.knots()[i].shift_from_nothing(), i)
    }

    /// The same of a path through knots at the same times.
    fn jump_of<T: Real>(&self, knot: &dyn Fn(usize) -> KnotShift<T>, i: usize) -> Derivatives<T> {
        let t_s = self.knots()[i].t_s;
        let [before, after] = [i, i + 1].map(|piece| self.derivatives_of(knot, piece, t_s));
        std::array::from_fn(|order| std::array::from_fn(|k| after[order][k] - before[order][k]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::clamp::Knot;
    use crate::sim::real::Arithmetic;

    /// A path of uneven knots that starts and ends with a jump of its rate.
    fn path(open: bool) -> ClampPath {
        let knot = |(i, t_s): (usize, f64)| Knot {
            t_s,
            pose: std::array::from_fn(|k| (1.3 * t_s * t_s + k as f64).sin()),
            rate: std::array::from_fn(|k| (3.0 * t_s + k as f64).cos()),
            closed: !open || i < 5,
        };
        let times = [0.1, 0.13, 0.2, 0.5, 0.55, 0.9];
        ClampPath::new(times.into_iter().enumerate().map(knot).collect())
    }

    fn pose(path: &ClampPath, t_s: f64) -> Pose<f64> {
        path.pose(t_s)
    }

    /// y at time `t_s` by fine steps of the exact solution for a straight piece of path.
    fn stepped(path: &ClampPath, lag_s: f64, t_s: f64) -> Pose<f64> {
        let steps = 100_000;
        let from = path.knots()[0].t_s;
        let dt = (t_s - from) / f64::from(steps);
        let left = (-dt / lag_s).exp();
        let mut y = pose(path, from);
        let mut before = y;
        for step in 1..=steps {
            let now = pose(path, from + f64::from(step) * dt);
            for k in 0..7 {
                let trails = (now[k] - before[k]) / dt * lag_s;
                y[k] = now[k] - trails + left * (y[k] - before[k] + trails);
            }
            before = now;
        }
        y
    }

    #[test]
    fn what_trails_solves_its_differential_equation() {
        for open in [false, true] {
            let path = path(open);
            for (lag_s, t_s) in [(0.02, 0.3), (0.1, 0.7), (0.3, 0.52), (0.05, 1.1), (0.3, 0.9)] {
                let behind = Recorded::<f64>::new(&path, None).trail(lag_s, t_s);
                let (here, expected) = (pose(&path, t_s), stepped(&path, lag_s, t_s));
                for k in 0..7 {
                    let error = here[k] + behind[k] - expected[k];
                    assert!(error.abs() < 1e-7, "{lag_s} s at {t_s} s: {error}");
                }
            }
        }
    }

    #[test]
    fn without_a_lag_nothing_trails_and_it_begins_to_by_the_rate_then() {
        let path = path(false);
        let slope = |t_s: f64| Recorded::new(&path, None).trail(Dual::<f64, 1>::input(0.0, 0), t_s);
        for t_s in [0.0, 0.1, 0.15, 0.2, 0.8, 2.0] {
            let rate = path.derivatives(path.knots().partition_point(|knot| knot.t_s < t_s), t_s)[0];
            for (x, rate) in slope(t_s).iter().zip(rate) {
                assert_eq!((x.value, x.tangent[0]), (0.0, -rate), "at {t_s} s");
            }
        }
    }

    /// Slopes along the lag and along the path's knots, in both precisions.
    #[test]
    fn slopes_of_what_trails_are_its_differences() {
        let path = path(true);
        let trail = |lag_s: f64, by: f64| {
            let shift = |i: usize| KnotShift {
                pose: [by * (1.0 + i as f64); 7],
                rate: [by * (2.0 - i as f64); 7],
            };
            Recorded::new(&path, Some(&shift)).trail(lag_s, 0.7)
        };
        let step = 1e-5;
        let along_lag = [0.1 + step, 0.1 - step].map(|lag_s| trail(lag_s, 0.0));
        let along_shift = [step, -step].map(|by| trail(0.1, by));
        let input = |value: f64, k: usize| Dual::<f32, 2>::input(value, k);
        let by = input(0.0, 1);
        let shift = |i: usize| KnotShift {
            pose: [by.scale(1.0 + i as f64); 7],
            rate: [by.scale(2.0 - i as f64); 7],
        };
        let got = Recorded::new(&path, Some(&shift)).trail(input(0.1, 0), 0.7);
        for k in 0..7 {
            let differences = [along_lag, along_shift].map(|[up, down]| (up[k] - down[k]) / (2.0 * step));
            for (slope, difference) in got[k].tangent.into_iter().zip(differences) {
                assert!(
                    (f64::from(slope) - difference).abs() < 1e-5,
                    "{slope}, {difference}"
                );
            }
        }
    }
}
