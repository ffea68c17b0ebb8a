//! The recorded path of a grip, with its shift, as the laws see it that disturb it: where it is, and how far behind something
//! is that follows it with a lag.

use super::clamp::{ClampPath, Hermite, KnotShift, Span};
use super::dual::Dual;
use super::physics::Pose;
use super::real::{Arithmetic, Real};

/// Lags after which nothing is left of the past: e⁻²⁵ is 1e-11.
const LAGS_REMEMBERED: f64 = 25.0;
/// Pieces of up to so many lags are summed as a series, of so many terms: the last is 1e-16 of the first.
const SHORT: f64 = 1.0;
const SERIES: usize = 17;

/// A number with its slope along the lag.
type OfLag = Dual<f64, 1>;
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

    /// The first pose, without its change and with it.
    pub fn first(&self) -> (Pose<f64>, Pose<T>) {
        let first = self.path.knots()[0].pose;
        let changed = match self.shift {
            Some(shift) => {
                let by = shift(0);
                std::array::from_fn(|k| T::of(first[k]) + by.pose[k])
            }
            None => first.map(T::of),
        };
        (first, changed)
    }

    /// Pose at time `t_s`.
    pub fn pose(&self, t_s: f64) -> Pose<T> {
        self.pose_at(T::of(t_s))
    }

    fn pose_at(&self, t: T) -> Pose<T> {
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

    /// Where something is at time `t_s` that follows the path p with a lag, minus where p is: y − p of T y' = p(t) − y for
    /// T = `lag_s`. What follows a path that moves at first is behind it already: by as far as the path goes in a time T from
    /// there, which is T p' but for the path's bend, and no larger than its jitter where it stands.
    ///
    /// It is −∫ p'(s) e^(−(t−s)/T) ds, to which every cubic piece of the path gives its part in closed form. None is larger
    /// than the piece, however short that is, so nothing cancels.
    pub fn behind(&self, lag_s: T, t_s: f64) -> Pose<T> {
        let mut behind = [T::zero(); 7];
        if let Some(left) = self.left_of_start(t_s, OfLag::input(lag_s.value(), 0)) {
            let left = linear(left, lag_s);
            let (_, first) = self.first();
            let ahead = self.pose_at(T::of(self.path.knots()[0].t_s) + lag_s);
            for (k, behind) in behind.iter_mut().enumerate() {
                *behind -= left * (ahead[k] - first[k]);
            }
        }
        for (weights, part) in self.past(lag_s, t_s) {
            let w = weights.map(|w| linear(w, lag_s));
            let own = part.of(&|i| self.path.knots()[i].as_shift());
            for (k, behind) in behind.iter_mut().enumerate() {
                *behind -=
                    w[0].scale(own.step[k]) + w[1].scale(own.rates[0][k]) + w[2].scale(own.rates[1][k]);
            }
            let Some(shift) = self.shift else { continue };
            let by = part.of(shift);
            for (k, behind) in behind.iter_mut().enumerate() {
                *behind -= w[0] * by.step[k] + w[1] * by.rates[0][k] + w[2] * by.rates[1][k];
            }
        }
        behind
    }

    /// What is left at time `t_s` of how far behind something was at the first knot, from there on: e^(−(t−t₀)/T); none
    /// where it is forgotten or the path stands still at first.
    fn left_of_start(&self, t_s: f64, lag: OfLag) -> Option<OfLag> {
        let first = &self.path.knots()[0];
        let since_s = t_s - first.t_s;
        if first.rate == [0.0; 7] || since_s > LAGS_REMEMBERED * lag.value {
            None
        } else if since_s <= 0.0 {
            Some(OfLag::of(1.0))
        } else {
            Some((OfLag::of(-since_s) / lag).exp())
        }
    }

    /// The parts of the path before time `t_s` that are remembered, newest first, with the weights of their steps and of
    /// the rates at their ends.
    fn past(&self, lag_s: T, t_s: f64) -> impl Iterator<Item = ([OfLag; 3], Part<'a>)> {
        let path = self.path;
        let lag = OfLag::input(lag_s.value(), 0);
        let newest = path.knots().partition_point(|knot| knot.t_s < t_s);
        let parts = (1..=newest)
            .rev()
            .filter_map(move |piece| Part::new(path, piece, t_s));
        parts
            .take_while(move |part| t_s - part.end_s <= LAGS_REMEMBERED * lag.value)
            .map(move |part| {
                let since_s = t_s - part.end_s;
                let left = if since_s > 0.0 {
                    (OfLag::of(-since_s) / lag).exp()
                } else {
                    OfLag::of(1.0)
                };
                (weights(part.span_s, lag).map(|w| left * w), part)
            })
    }
}

/// A number that depends on the lag, in the numbers of the lag.
fn linear<T: Real>(of_lag: OfLag, lag_s: T) -> T {
    T::of(of_lag.value) + (lag_s - T::of(lag_s.value())).scale(of_lag.tangent[0])
}

/// A piece of a path, up to its end or to now.
struct Part<'a> {
    path: &'a ClampPath,
    /// Index of the knot at which the piece ends.
    piece: usize,
    end_s: f64,
    span_s: f64,
}

/// How a part runs: a cubic.
struct Cubic<T> {
    /// How far it leads.
    step: Pose<T>,
    /// Rates at its start and its end, 1/s.
    rates: [Pose<T>; 2],
}

impl<'a> Part<'a> {
    /// None where the path stands still or the piece takes no time.
    fn new(path: &'a ClampPath, piece: usize, t_s: f64) -> Option<Self> {
        let knots = path.knots();
        let start = &knots[piece - 1];
        let end_s = knots.get(piece).map_or(t_s, |knot| knot.t_s.min(t_s));
        let span_s = end_s - start.t_s;
        let stands = piece == knots.len() && start.closed;
        (span_s > 0.0 && !stands).then_some(Self {
            path,
            piece,
            end_s,
            span_s,
        })
    }

    /// The part between knots at the same times that are as `knot` says.
    fn of<T: Real>(&self, knot: &dyn Fn(usize) -> KnotShift<T>) -> Cubic<T> {
        let start = knot(self.piece - 1);
        let Some(next) = self.path.knots().get(self.piece) else {
            return Cubic {
                step: start.rate.map(|rate| rate.scale(self.span_s)),
                rates: [start.rate; 2],
            };
        };
        let end = knot(self.piece);
        let h = next.t_s - self.path.knots()[self.piece - 1].t_s;
        let w = Hermite::at(Dual::<f64, 1>::input(self.span_s / h, 0), h);
        let weighed = |of: &dyn Fn(Dual<f64, 1>) -> f64| -> Pose<T> {
            std::array::from_fn(|k| {
                (end.pose[k] - start.pose[k]).scale(of(w.along))
                    + start.rate[k].scale(of(w.start_rate))
                    + end.rate[k].scale(of(w.end_rate))
            })
        };
        Cubic {
            step: weighed(&|w| w.value),
            rates: [start.rate, weighed(&|w| w.tangent[0] / h)],
        }
    }
}

/// ∫ p'(s) e^(−(b−s)/T) ds over a cubic p from a to b = a + h: weights of p(b) − p(a), of p'(a) and of p'(b), in 1, s and s.
/// With u the share of the way, p' = 6 (u − u²) (p(b) − p(a))/h + (1 − 4u + 3u²) p'(a) + (3u² − 2u) p'(b).
fn weights(h: f64, lag_s: OfLag) -> [OfLag; 3] {
    let [m0, m1, m2] = moments(h, lag_s);
    [
        (m1 - m2).scale(6.0),
        (m0 - m1.scale(4.0) + m2.scale(3.0)).scale(h),
        (m2.scale(3.0) - m1.scale(2.0)).scale(h),
    ]
}

/// ∫ u^k e^(−(1−u) h/T) du from 0 to 1, for k = 0, 1, 2.
fn moments(h: f64, lag_s: OfLag) -> [OfLag; 3] {
    let one = OfLag::of(1.0);
    if h < SHORT * lag_s.value {
        // By parts M₂ = Σ (−x)^n 2/(n+3)!, and then Mₖ₋₁ = (1 − x Mₖ)/k.
        let x = OfLag::of(h) / lag_s;
        let (mut term, mut m2) = (OfLag::of(1.0 / 3.0), OfLag::of(0.0));
        for n in 0..SERIES {
            m2 += term;
            term = (term * x).scale(-1.0 / (n + 4) as f64);
        }
        let m1 = (one - x * m2).scale(0.5);
        return [one - x * m1, m1, m2];
    }
    let share = lag_s.scale(1.0 / h);
    let left = if h > LAGS_REMEMBERED * lag_s.value {
        OfLag::of(0.0)
    } else {
        (OfLag::of(-h) / lag_s).exp()
    };
    let m0 = share * (one - left);
    let m1 = share * (one - m0);
    [m0, m1, share * (one - m1.scale(2.0))]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::clamp::Knot;

    /// A path of uneven knots whose rate jumps where it starts and where it ends.
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

    /// y at time `t_s` by fine steps of the exact solution for a straight piece of path.
    fn stepped(path: &ClampPath, lag_s: f64, t_s: f64) -> Pose<f64> {
        let steps = 100_000;
        let from = path.knots()[0].t_s;
        let mut before = path.pose(from);
        let ahead = path.pose(from + lag_s);
        let mut y: Pose<f64> = std::array::from_fn(|k| before[k] - (ahead[k] - before[k]));
        if t_s <= from {
            return y;
        }
        let dt = (t_s - from) / f64::from(steps);
        let left = (-dt / lag_s).exp();
        for step in 1..=steps {
            let now = path.pose(from + f64::from(step) * dt);
            for k in 0..7 {
                let trails = (now[k] - before[k]) / dt * lag_s;
                y[k] = now[k] - trails + left * (y[k] - before[k] + trails);
            }
            before = now;
        }
        y
    }

    #[test]
    fn what_lags_behind_solves_its_differential_equation() {
        for open in [false, true] {
            let path = path(open);
            for lag_s in [0.002, 0.02, 0.1, 0.3] {
                for t_s in [0.05, 0.12, 0.2, 0.3, 0.52, 0.7, 0.9, 1.1] {
                    let behind = Recorded::<f64>::new(&path, None).behind(lag_s, t_s);
                    let (here, expected) = (path.pose(t_s), stepped(&path, lag_s, t_s));
                    for k in 0..7 {
                        let error = here[k] + behind[k] - expected[k];
                        assert!(error.abs() < 1e-6, "{lag_s} s at {t_s} s: {error}");
                    }
                }
            }
        }
    }

    /// A drag of 0.18000000000000002 s has knots at 0.18 s and at its end.
    #[test]
    fn pieces_of_no_length_to_speak_of_change_nothing() {
        let whole = path(false);
        for (after, span_s) in [(2, 1e-6), (3, 1e-9), (3, 3e-17), (5, 1e-16)] {
            let mut knots = whole.knots().to_vec();
            let mut more = knots[after];
            more.t_s += span_s;
            if more.t_s == knots[after].t_s {
                more.t_s = knots[after].t_s.next_up();
            }
            more.pose = whole.pose(more.t_s);
            knots.insert(after + 1, more);
            let divided = ClampPath::new(knots);
            for lag_s in [0.005, 0.1, 0.3] {
                let behind = |path| Recorded::<f32>::new(path, None).behind(lag_s, 0.95);
                for (one, other) in behind(&whole).iter().zip(behind(&divided)) {
                    assert!(
                        (one - other).abs() < 1e-4,
                        "{one}, {other}: {span_s} s after knot {after}"
                    );
                }
            }
        }
    }

    #[test]
    fn without_a_lag_nothing_is_behind_and_it_begins_to_be_by_the_rate_then() {
        let path = path(false);
        let behind = |t_s: f64| Recorded::new(&path, None).behind(Dual::<f64, 1>::input(0.0, 0), t_s);
        for t_s in [0.0, 0.1, 0.15, 0.2, 0.8, 2.0] {
            let before = 1e-7;
            let rate = |k: usize| match t_s {
                ..=0.1 => path.knots()[0].rate[k],
                _ => (path.pose(t_s)[k] - path.pose(t_s - before)[k]) / before,
            };
            for (k, x) in behind(t_s).iter().enumerate() {
                assert_eq!(x.value, 0.0);
                assert!((x.tangent[0] + rate(k)).abs() < 1e-5, "at {t_s} s");
            }
        }
    }

    /// Slopes along the lag and along the path's knots, in both precisions.
    #[test]
    fn slopes_of_what_lags_behind_are_its_differences() {
        let path = path(true);
        let behind = |lag_s: f64, by: f64| {
            let shift = |i: usize| KnotShift {
                pose: [by * (1.0 + i as f64); 7],
                rate: [by * (2.0 - i as f64); 7],
            };
            Recorded::new(&path, Some(&shift)).behind(lag_s, 0.7)
        };
        let step = 1e-5;
        let along_lag = [0.1 + step, 0.1 - step].map(|lag_s| behind(lag_s, 0.0));
        let along_shift = [step, -step].map(|by| behind(0.1, by));
        let input = |value: f64, k: usize| Dual::<f32, 2>::input(value, k);
        let by = input(0.0, 1);
        let shift = |i: usize| KnotShift {
            pose: [by.scale(1.0 + i as f64); 7],
            rate: [by.scale(2.0 - i as f64); 7],
        };
        let got = Recorded::new(&path, Some(&shift)).behind(input(0.1, 0), 0.7);
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
