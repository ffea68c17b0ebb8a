//! The noise of measured offsets, learnt from the frames in which the rope lies at rest and hence without
//! the model: its size against what is declared, and how alike neighbours in time and along the rope are.
//!
//! Noise that hangs together looks like a signal to a test that believes its offsets independent; such
//! tests find an effect in nearly all perfect data. So residuals and tangents are whitened before they
//! are compared: from each offset what its predecessor in time lets expect is taken away, then what
//! its neighbour along the rope does. That is exact for noise that is autoregressive in both
//! directions, R_time ⊗ R_arc, on a full grid of frames and stations.

use crate::fit::{Evaluation, Problem};
use crate::observe::{Row, station_arcs_m};
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};
use std::collections::HashMap;

/// Fewest frames at rest from which noise is measured.
const MIN_REST_FRAMES: usize = 4;
/// Correlations that are tried: 0, 0.01, … up to this one.
const MOST_ALIKE: f64 = 0.95;

/// Least share of the declared noise that frames at rest can prove: what lies still is seen the same way time and
/// again, so rounding, blur and the offset of a pixel's middle do not show there, and a simulated rope has no noise
/// at all.
pub const LEAST_NOISE_SCALE: f64 = 0.1;

/// Size and correlation of the noise.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Noise {
    /// Measured over declared standard deviation.
    pub scale: f64,
    /// Correlation of an offset with that of the frame before.
    pub in_time: f64,
    /// Correlation with that of the neighbouring station.
    pub along_rope: f64,
    /// Independent values from which its size is known; infinitely many where it is declared.
    pub values: f64,
}

impl Noise {
    /// Noise as it is declared, every offset on its own.
    pub const DECLARED: Self = Self {
        scale: 1.0,
        in_time: 0.0,
        along_rope: 0.0,
        values: f64::INFINITY,
    };

    /// From the frames at rest of an evaluation of a problem; none where its demonstrations show too few. Not from those
    /// that are held out: how well a rope is seen hangs on where it rests, and with the sample rope's held-out recordings
    /// its noise came out as 0.91 of the declared, without them as 1.19 (when some circles were still found on the wrong side
    /// of their points).
    ///
    /// Each station's measured places are an autoregressive series about an unknown mean, so what the model predicts does
    /// not matter. Correlation and size maximise the restricted likelihood (Patterson
    /// and Thompson 1971), which does not take a mean from few and like frames for the truth.
    pub fn at_rest(problem: &Problem, evaluation: &Evaluation) -> Option<Self> {
        let mut series = Vec::new();
        for ((demo, scene), rows) in problem.demos.iter().zip(&problem.scenes).zip(&evaluation.rows) {
            let frames = demo.rest_frames(&scene.frame_times_s);
            if frames >= MIN_REST_FRAMES {
                let stations = station_arcs_m(demo).len();
                series.extend(rest_series(rows, (frames, stations), problem.noise_scale));
            }
        }
        Self::of_series(&series)
    }

    fn of_series(series: &[Series]) -> Option<Self> {
        if series.is_empty() {
            return None;
        }
        let steps = (MOST_ALIKE * 100.0) as usize;
        let candidates = (0..=steps).map(|k| k as f64 / 100.0);
        let (in_time, variance, _) = candidates
            .map(|r| {
                let (variance, likelihood) = restricted_likelihood(series, r);
                (r, variance, likelihood)
            })
            .max_by(|a, b| a.2.total_cmp(&b.2))?;
        let free: f64 = series.iter().map(|s| s.places.len() as f64 - 1.0).sum();
        if variance.sqrt() < LEAST_NOISE_SCALE {
            // What is left there is rounding or creep: how it hangs together says nothing of the noise.
            return Some(Self {
                scale: LEAST_NOISE_SCALE,
                values: free,
                ..Self::DECLARED
            });
        }
        let along_rope = neighbours(series, in_time);
        Some(Self {
            scale: variance.sqrt(),
            in_time,
            along_rope,
            // The correlation in time is found from the same values, which makes the size as uncertain as if they were
            // not told apart.
            values: independent_squares(free, in_time, along_rope),
        })
    }

    /// The same with every offset on its own.
    pub fn as_if_independent(self) -> Self {
        Self {
            in_time: 0.0,
            along_rope: 0.0,
            values: self.values / independent_squares(1.0, self.in_time, self.along_rope),
            ..self
        }
    }

    /// By how much of its square the noise floor may lie too low under so many offsets before a right model is called
    /// wrong. The upper end of a one-sided 99 % interval: such a model is asked more than once, where fitted and where held
    /// out, and one in twenty would be a stand-in by chance.
    pub fn doubt(&self, rows: usize) -> f64 {
        2.326 * self.uncertainty(rows)
    }

    /// The same before other causes are not looked for, which costs nothing but time: a curl that left 1.19 mm where the
    /// floor was 0.92 would else have been the first and last to be tried of a rope on a table that leaned.
    pub fn slight_doubt(&self, rows: usize) -> f64 {
        self.uncertainty(rows)
    }

    /// Standard deviation of a noise floor's square under so many offsets, as a share of it: both mean squares are of few
    /// independent values.
    fn uncertainty(&self, rows: usize) -> f64 {
        let seen = independent_squares(rows as f64, self.in_time, self.along_rope);
        (2.0 / self.values + 2.0 / seen).sqrt()
    }

    /// The operator that makes this noise white on the rows of an evaluation.
    pub fn whitener(&self, evaluation: &Evaluation) -> Whitener {
        let mut first = 0;
        let (mut in_time, mut along_rope) = (Vec::new(), Vec::new());
        for rows in &evaluation.rows {
            in_time.extend(predecessors(rows, first, self.in_time, |row| {
                Some((row.frame.checked_sub(1)?, row.station))
            }));
            along_rope.extend(predecessors(rows, first, self.along_rope, |row| {
                Some((row.frame, row.station.checked_sub(1)?))
            }));
            first += rows.len();
        }
        Whitener {
            passes: [in_time, along_rope],
        }
    }
}

/// How many of so many values, autoregressive in time and along the rope, count as independent in their mean square.
pub(super) fn independent_squares(values: f64, in_time: f64, along_rope: f64) -> f64 {
    let share = |correlation: f64| {
        let square = correlation * correlation;
        (1.0 - square) / (1.0 + square)
    };
    values * share(in_time) * share(along_rope)
}

/// Measured places of one station along one direction over the frames at rest.
struct Series {
    station: usize,
    direction: [f64; 3],
    /// Over the declared standard errors.
    places: Vec<f64>,
    /// One over the declared standard errors, 1/m: what a metre of the unknown mean adds to each.
    per_metre: Vec<f64>,
}

/// Least share of a direction that the offsets of a frame must measure.
const SEEN: f64 = 0.5;

/// Series of the stations that are seen in every frame at rest; `scale` is what the rows' standard errors are over the
/// declared ones.
fn rest_series(rows: &[Row], (frames, stations): (usize, usize), scale: f64) -> Vec<Series> {
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
/// it. What was measured, not how far it lies from the model: a simulated rope that settles meanwhile is no noise. Offsets are
/// added as vectors, for directions may turn a little from frame to frame.
fn place(at: &[&Row], axis: &Row, frame: usize) -> Option<(f64, f64)> {
    let here = || at.iter().filter(|r| r.frame == frame);
    let predicted_m = alike(&here().next()?.position_m, &axis.direction);
    let (mut place_m, mut variance, mut seen) = (predicted_m, 0.0, 0.0);
    for row in here() {
        let share = alike(&row.direction, &axis.direction);
        place_m += row.offset_m * share;
        variance += (row.sigma_m * share).powi(2);
        seen += share * share;
    }
    (seen > SEEN).then(|| (place_m, variance.sqrt()))
}

fn alike(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    (0..3).map(|k| a[k] * b[k]).sum()
}

/// Independent parts of an autoregressive series about its best mean, and how well they tell that mean, 1/m².
fn innovations(series: &Series, r: f64) -> (Vec<f64>, f64) {
    let spread = (1.0 - r * r).sqrt();
    let independent = |values: &[f64]| -> Vec<f64> {
        let rest = values.windows(2).map(|two| (two[1] - r * two[0]) / spread);
        std::iter::once(values[0]).chain(rest).collect()
    };
    let (parts, ones) = (independent(&series.places), independent(&series.per_metre));
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
    let precision = dot(&ones, &ones);
    let mean_m = dot(&ones, &parts) / precision;
    let about_mean = parts.iter().zip(&ones).map(|(part, one)| part - mean_m * one);
    (about_mean.collect(), precision)
}

/// Variance that fits best at a correlation, and the logarithm of the restricted likelihood there.
fn restricted_likelihood(series: &[Series], r: f64) -> (f64, f64) {
    let (mut square, mut free, mut determinants) = (0.0, 0.0, 0.0);
    for s in series {
        let n = s.places.len() as f64;
        let (parts, precision) = innovations(s, r);
        square += parts.iter().map(|u| u * u).sum::<f64>();
        free += n - 1.0;
        // ln det R = (n - 1) ln(1 - r²) of an AR(1) series.
        determinants += (n - 1.0) * (1.0 - r * r).ln() + precision.ln();
    }
    let variance = square / free;
    (
        variance,
        -0.5 * (free * variance.max(f64::MIN_POSITIVE).ln() + determinants),
    )
}

/// Correlation of the innovations of neighbouring stations, compared as vectors: directions across a rope are those in
/// which it was seen best and worst, and their order and signs mean nothing.
fn neighbours(series: &[Series], in_time: f64) -> f64 {
    let parts: Vec<Vec<f64>> = series.iter().map(|s| innovations(s, in_time).0).collect();
    let (mut product, mut norm) = (0.0, 0.0);
    for (i, a) in series.iter().enumerate() {
        // Series are in the order of their stations, at most three of each.
        let next = (i + 1..series.len().min(i + 6)).filter(|&j| series[j].station == a.station + 1);
        for j in next {
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

/// For each row what its predecessor lets expect: weights of other rows, and what is left over.
struct Expected {
    from: Vec<(usize, f64)>,
    spread: f64,
}

/// Takes the expected part out of whitened residuals and columns of tangents alike.
pub struct Whitener {
    passes: [Vec<Expected>; 2],
}

impl Whitener {
    /// Whitens every column, which is over the rows' standard errors already.
    pub fn apply(&self, columns: &DMatrix<f64>) -> DMatrix<f64> {
        let mut now = columns.clone();
        for pass in &self.passes {
            let before = now.clone();
            for (i, expected) in pass.iter().enumerate() {
                for k in 0..now.ncols() {
                    let guess: f64 = expected.from.iter().map(|&(j, w)| w * before[(j, k)]).sum();
                    now[(i, k)] = (before[(i, k)] - guess) / expected.spread;
                }
            }
        }
        now
    }
}

fn predecessors(
    rows: &[Row],
    first: usize,
    correlation: f64,
    before: impl Fn(&Row) -> Option<(usize, usize)>,
) -> Vec<Expected> {
    let mut places: HashMap<(usize, usize), Vec<usize>> = HashMap::new();
    for (i, row) in rows.iter().enumerate() {
        places.entry((row.frame, row.station)).or_default().push(i);
    }
    rows.iter()
        .map(|row| {
            let there = before(row).and_then(|place| places.get(&place));
            let Some(there) = there.filter(|_| correlation > 0.0) else {
                return Expected {
                    from: Vec::new(),
                    spread: 1.0,
                };
            };
            let weight = |&j: &usize| (first + j, correlation * alike(&row.direction, &rows[j].direction));
            let from: Vec<(usize, f64)> = there.iter().map(weight).collect();
            let known: f64 = from.iter().map(|(_, w)| w * w).sum();
            Expected {
                spread: (1.0 - known.min(MOST_ALIKE * MOST_ALIKE)).sqrt(),
                from,
            }
        })
        .collect()
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::bench_diagnosis::noise::{CORRELATION, correlated};
    use nalgebra::DVector;

    /// The benchmark's noise, of the size that is declared.
    pub const LIKE_THE_BENCHMARKS: Noise = Noise {
        in_time: CORRELATION[0],
        along_rope: CORRELATION[1],
        ..Noise::DECLARED
    };

    const FRAMES: usize = 60;
    const STATIONS: usize = 16;

    /// What is seen of a rope in its first frames under this noise.
    pub fn rows_of(noise: &[Vec<[f64; 3]>], frames: usize) -> Vec<Row> {
        let mut rows = Vec::new();
        for (frame, stations) in noise.iter().take(frames).enumerate() {
            for (station, offset) in stations.iter().enumerate() {
                for k in 0..3 {
                    let mut direction = [0.0; 3];
                    direction[k] = 1.0;
                    rows.push(Row {
                        frame,
                        station,
                        arc_m: 0.01 * station as f64,
                        position_m: [0.0; 3],
                        direction,
                        offset_m: offset[k],
                        sigma_m: 0.001,
                    });
                }
            }
        }
        rows
    }

    /// The same beside a mean that nobody knows, per station.
    fn at_rest(noise: &[Vec<[f64; 3]>], frames: usize) -> Vec<Row> {
        let mut rows = rows_of(noise, frames);
        rows.iter_mut()
            .for_each(|row| row.offset_m += 0.003 * row.station as f64);
        rows
    }

    /// Noise of twice the declared size with correlations 0.6 and 0.7: twelve frames at rest give them
    /// back within three of their own scatters, however large the unknown mean.
    #[test]
    fn size_and_correlation_are_found_at_rest() {
        let (mut scales, mut times, mut alongs) = (0.0, 0.0, 0.0);
        const SETS: u64 = 40;
        for seed in 0..SETS {
            let noise = correlated(FRAMES, STATIONS, 0.002, [0.6, 0.7], seed);
            let rows = at_rest(&noise, 12);
            let series = rest_series(&rows, (12, STATIONS), 1.0);
            let best = (0..=95)
                .map(|k| k as f64 / 100.0)
                .map(|r| (r, restricted_likelihood(&series, r)))
                .max_by(|a, b| a.1.1.total_cmp(&b.1.1))
                .unwrap();
            times += best.0 / SETS as f64;
            scales += best.1.0.sqrt() / SETS as f64;
            alongs += neighbours(&series, best.0) / SETS as f64;
        }
        assert!((times - 0.6).abs() < 0.03, "{times}");
        assert!((scales - 2.0).abs() < 0.1, "{scales}");
        assert!((alongs - 0.7).abs() < 0.03, "{alongs}");
    }

    /// Clouds tell a station now well and now badly: how far the rope lies from where the model puts it is still no noise.
    #[test]
    fn noise_at_rest_does_not_hang_on_where_the_model_puts_the_rope() {
        const SETS: u64 = 40;
        let found = |seed: u64, off_m: f64| {
            let mut rows = rows_of(&correlated(FRAMES, STATIONS, 0.001, CORRELATION, seed), 12);
            for row in &mut rows {
                let worse = 1.0 + 0.6 * (7.0 * row.frame as f64 + 3.0 * row.station as f64).sin();
                row.sigma_m *= worse;
                row.offset_m = row.offset_m * worse + off_m;
            }
            Noise::of_series(&rest_series(&rows, (12, STATIONS), 1.0)).expect("frames at rest")
        };
        let (mut scale, mut in_time) = (0.0, 0.0);
        for seed in 0..SETS {
            let [plain, off] = [found(seed, 0.0), found(seed, 0.005)];
            assert!((off.scale / plain.scale - 1.0).abs() < 1e-9, "{off:?} {plain:?}");
            assert_eq!(off.in_time, plain.in_time);
            scale += plain.scale / SETS as f64;
            in_time += plain.in_time / SETS as f64;
        }
        assert!((scale - 1.0).abs() < 0.05, "{scale}");
        assert!((in_time - CORRELATION[0]).abs() < 0.03, "{in_time}");
    }

    /// Directions across the rope as a measurement has them: turned at every station, in any order and of any sign.
    #[test]
    fn correlation_along_the_rope_does_not_hang_on_the_choice_of_directions() {
        let noise = correlated(FRAMES, STATIONS, 0.002, [0.6, 0.7], 11);
        let straight = at_rest(&noise, 12);
        let turned: Vec<Row> = straight
            .chunks(3)
            .flat_map(|point| {
                let offset: [f64; 3] = std::array::from_fn(|k| point[k].offset_m);
                let station = point[0].station;
                let (sin, cos) = (0.9 * station as f64).sin_cos();
                let axes = [[-cos, -sin, 0.0], [0.0, 0.0, 1.0], [-sin, cos, 0.0]];
                let row = |axis: &[f64; 3]| Row {
                    direction: *axis,
                    offset_m: alike(axis, &offset),
                    ..point[0]
                };
                axes.map(|axis| row(&axis))
            })
            .collect();
        let found = |rows: &[Row]| neighbours(&rest_series(rows, (12, STATIONS), 1.0), 0.6);
        let [plain, other] = [found(&straight), found(&turned)];
        assert!((plain - other).abs() < 0.02 && plain > 0.6, "{plain} {other}");
    }

    /// A rope that is seen at rest without any noise is no proof that it is seen so in motion.
    #[test]
    fn rest_proves_no_less_than_a_tenth_of_the_declared_noise() {
        let found = |noise_m: f64, drift_m: f64| {
            let mut noise = correlated(FRAMES, STATIONS, noise_m, [0.0, 0.0], 3);
            for (frame, stations) in noise.iter_mut().enumerate() {
                stations
                    .iter_mut()
                    .for_each(|offset| offset[0] += drift_m * frame as f64);
            }
            Noise::of_series(&rest_series(&at_rest(&noise, 12), (12, STATIONS), 1.0)).expect("frames at rest")
        };
        assert_eq!(found(1e-6, 0.0).scale, 0.1);
        let creep = found(0.0, 1e-9);
        assert_eq!([creep.scale, creep.in_time, creep.along_rope], [0.1, 0.0, 0.0]);
        let scale = |noise_m: f64| found(noise_m, 0.0).scale;
        assert!((scale(0.0005) - 0.5).abs() < 0.05);
    }

    /// Noise alone leaves more than the floor with its doubt in one of twenty sets.
    #[test]
    fn noise_alone_seldom_exceeds_its_floor_beyond_doubt() {
        const SETS: u64 = 200;
        let exceeds = |seed: &u64| {
            let noise = correlated(FRAMES, STATIONS, 0.001, [0.6, 0.7], *seed);
            let found = Noise::of_series(&rest_series(&at_rest(&noise, 12), (12, STATIONS), 1.0)).unwrap();
            let offsets: Vec<f64> = noise.into_iter().flatten().flatten().collect();
            let square = offsets.iter().map(|x| (x / 0.001).powi(2)).sum::<f64>() / offsets.len() as f64;
            square > found.scale.powi(2) * (1.0 + found.doubt(offsets.len()))
        };
        let count = (0..SETS).filter(exceeds).count();
        println!("{count} of {SETS}");
        assert!((1..=8).contains(&count), "{count}");
    }

    /// After whitening with the true correlations the noise has unit variance and no neighbours alike.
    #[test]
    fn whitened_noise_is_white() {
        let noise = correlated(FRAMES, STATIONS, 0.001, [0.6, 0.7], 5);
        let evaluation = Evaluation {
            theta: Vec::new(),
            rows: vec![rows_of(&noise, FRAMES)],
            most_rows: FRAMES * STATIONS,
            huber: f64::INFINITY,
            jacobian: DMatrix::zeros(0, 0),
        };
        let raw = evaluation.whitened();
        let column = DMatrix::from_columns(&[raw]);
        let white: DVector<f64> = LIKE_THE_BENCHMARKS
            .whitener(&evaluation)
            .apply(&column)
            .column(0)
            .into_owned();
        let n = white.len() as f64;
        // Standard error of a variance from 2880 independent numbers: 2.6 %; four of them.
        assert!((white.norm_squared() / n - 1.0).abs() < 0.11);
        let lag = 3 * STATIONS;
        let next: f64 = (lag..white.len()).map(|i| white[i] * white[i - lag]).sum::<f64>() / n;
        let beside: f64 = (3..white.len()).map(|i| white[i] * white[i - 3]).sum::<f64>() / n;
        assert!(next.abs() < 0.08 && beside.abs() < 0.08, "{next} {beside}");
    }
}
