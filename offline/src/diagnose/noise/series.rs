//! What frames at rest, or recordings that repeat each other, tell of the noise: series of places, and how alike neighbours in
//! time and along the rope are in them.

use crate::observe::Row;

/// Correlations that are tried: 0, 0.01, … up to this one.
pub(super) const MOST_ALIKE: f64 = 0.95;

/// Measured places of one station along one direction over the frames at rest, or what places differ by.
pub(super) struct Series {
    pub(super) station: usize,
    /// Its first frame.
    pub(super) first: usize,
    pub(super) direction: [f64; 3],
    /// Over the declared standard errors.
    pub(super) places: Vec<f64>,
    /// One over the declared standard errors, 1/m: what a metre of the unknown mean adds to each; zero where the mean is known
    /// to be nothing.
    pub(super) per_metre: Vec<f64>,
}

impl Series {
    fn has_unknown_mean(&self) -> bool {
        self.per_metre.iter().any(|&per_metre| per_metre != 0.0)
    }

    /// Values less the mean that is found from them.
    pub(super) fn free(&self) -> f64 {
        self.places.len() as f64 - f64::from(u8::from(self.has_unknown_mean()))
    }
}

/// Least share of a direction that the offsets of a frame must measure.
const SEEN: f64 = 0.5;

/// Series of the stations that are seen in every frame at rest; `scale` is what the rows' standard errors are over the
/// declared ones.
pub(super) fn rest_series(rows: &[Row], (frames, stations): (usize, usize), scale: f64) -> Vec<Series> {
    let mut found = Vec::new();
    for station in 0..stations {
        let at: Vec<&Row> = rows
            .iter()
            .filter(|r| r.station == station && r.frame < frames)
            .collect();
        let Some(first) = at.first() else { continue };
        let axes: Vec<&&Row> = at.iter().filter(|r| r.frame == first.frame).collect();
        for axis in axes {
            let seen: Vec<(f64, f64)> = (0..frames).filter_map(|frame| place(&at, axis, frame)).collect();
            if seen.len() == frames {
                let per_metre: Vec<f64> = seen.iter().map(|(_, sigma_m)| scale / sigma_m).collect();
                let places = seen.iter().zip(&per_metre).map(|((place_m, _), w)| place_m * w);
                found.push(Series {
                    station,
                    first: 0,
                    direction: axis.direction,
                    places: places.collect(),
                    per_metre,
                });
            }
        }
    }
    found
}

/// Where a station was measured along an axis in a frame, and the standard error of that, m; none where it was not seen along
/// it. What was measured, not how far it lies from the model: a simulated rope that settles meanwhile is no noise.
fn place(at: &[&Row], axis: &Row, frame: usize) -> Option<(f64, f64)> {
    let (offset_m, variance) = offset_along(at, &axis.direction, frame)?;
    let predicted = in_frame(at, frame).first()?;
    let predicted_m = alike(&predicted.position_m, &axis.direction);
    Some((predicted_m + offset_m, variance.sqrt()))
}

/// The offset of a station, whose rows these are, along a direction in a frame, m, and the square of its standard error; none
/// where it was not seen along it. Offsets are added as vectors, for directions may turn a little from frame to frame.
pub(super) fn offset_along(at: &[&Row], direction: &[f64; 3], frame: usize) -> Option<(f64, f64)> {
    let (mut offset_m, mut variance, mut seen) = (0.0, 0.0, 0.0);
    for row in in_frame(at, frame) {
        let share = alike(&row.direction, direction);
        offset_m += row.offset_m * share;
        variance += (row.sigma_m * share).powi(2);
        seen += share * share;
    }
    (seen > SEEN).then_some((offset_m, variance))
}

/// Those of some rows, in the order of their frames as measured, that are of one frame.
pub(super) fn in_frame<'s, 'r>(at: &'s [&'r Row], frame: usize) -> &'s [&'r Row] {
    let from = at.partition_point(|row| row.frame < frame);
    let to = at.partition_point(|row| row.frame <= frame);
    &at[from..to]
}

pub(super) fn alike(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    (0..3).map(|k| a[k] * b[k]).sum()
}

/// Independent parts of an autoregressive series about its best mean, and how well they tell that mean, 1/m²; about nothing
/// where that is the mean.
fn innovations(series: &Series, r: f64) -> (Vec<f64>, f64) {
    let spread = (1.0 - r * r).sqrt();
    let independent = |values: &[f64]| -> Vec<f64> {
        let rest = values.windows(2).map(|two| (two[1] - r * two[0]) / spread);
        std::iter::once(values[0]).chain(rest).collect()
    };
    let (parts, ones) = (independent(&series.places), independent(&series.per_metre));
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
    let precision = dot(&ones, &ones);
    let mean_m = if precision > 0.0 {
        dot(&ones, &parts) / precision
    } else {
        0.0
    };
    let about_mean = parts.iter().zip(&ones).map(|(part, one)| part - mean_m * one);
    (about_mean.collect(), precision)
}

/// A correlation in time that is tried.
pub(super) struct Candidate {
    pub(super) in_time: f64,
    /// Variance that fits best with it.
    pub(super) variance: f64,
    /// Logarithm of the restricted likelihood.
    pub(super) likelihood: f64,
}

pub(super) fn candidates(series: &[Series]) -> Vec<Candidate> {
    let steps = (MOST_ALIKE * 100.0) as usize;
    let correlations = (0..=steps).map(|k| k as f64 / 100.0);
    correlations.map(|r| restricted_likelihood(series, r)).collect()
}

/// Mean and variance of the logarithm of the noise's variance over the correlations in time, each as likely as it makes the
/// data, of which `alone` are worth an independent one: twelve frames do not tell it well, and noise that is taken for less
/// alike than it is looks smaller. From the likeliest correlation alone, a 95 % interval of the size held it in 89 % of sets
/// like the benchmark's, and in 76 % from six frames; so in 97 % of either.
pub(super) fn over_correlations(candidates: &[Candidate], alone: f64) -> (f64, f64) {
    let most = candidates
        .iter()
        .map(|c| c.likelihood)
        .fold(f64::NEG_INFINITY, f64::max);
    let weighed: Vec<(f64, f64)> = candidates
        .iter()
        .map(|c| {
            let weight = (alone * (c.likelihood - most)).exp();
            (c.variance.max(f64::MIN_POSITIVE).ln(), weight)
        })
        .collect();
    let whole: f64 = weighed.iter().map(|(_, weight)| weight).sum();
    let mean = |of: &dyn Fn(f64) -> f64| weighed.iter().map(|(ln, w)| w * of(*ln)).sum::<f64>() / whole;
    let centre = mean(&|ln| ln);
    (centre, mean(&|ln| (ln - centre).powi(2)))
}

/// Variance that fits best at a correlation, and the restricted likelihood there.
fn restricted_likelihood(series: &[Series], r: f64) -> Candidate {
    let (mut square, mut free, mut determinants) = (0.0, 0.0, 0.0);
    for s in series {
        let n = s.places.len() as f64;
        let (parts, precision) = innovations(s, r);
        square += parts.iter().map(|u| u * u).sum::<f64>();
        free += s.free();
        // ln det R = (n - 1) ln(1 - r²) of an AR(1) series.
        determinants += (n - 1.0) * (1.0 - r * r).ln();
        if s.has_unknown_mean() {
            determinants += precision.ln();
        }
    }
    let variance = square / free;
    Candidate {
        in_time: r,
        variance,
        likelihood: -0.5 * (free * variance.max(f64::MIN_POSITIVE).ln() + determinants),
    }
}

/// Correlation of the innovations of neighbouring stations, compared as vectors: directions across a rope are those in
/// which it was seen best and worst, and their order and signs mean nothing.
pub(super) fn neighbours(series: &[Series], in_time: f64) -> f64 {
    let parts: Vec<Vec<f64>> = series.iter().map(|s| innovations(s, in_time).0).collect();
    let (mut product, mut norm) = (0.0, 0.0);
    for (i, a) in series.iter().enumerate() {
        let beside = |b: &Series| b.station == a.station + 1 && b.first == a.first;
        for j in (0..series.len()).filter(|&j| beside(&series[j])) {
            let alike = alike(&a.direction, &series[j].direction);
            for (u, v) in parts[i].iter().zip(&parts[j]) {
                product += u * v * alike;
                norm += 0.5 * (u * u + v * v) * alike * alike;
            }
        }
    }
    if norm > 0.0 {
        (product / norm).clamp(0.0, MOST_ALIKE)
    } else {
        0.0
    }
}
