//! Quadratic B-spline weights of the grid transfer (Steffen et al. 2008; Jiang et al. 2016, eq. 123).

use super::real::Real;

/// Index of the lowest of the three nodes that a particle touches along one axis, and the weights.
///
/// `cells` is the particle's coordinate in cells from the grid's origin. With f = cells − base in
/// [0.5, 1.5): w = ½(1.5 − f)², ¾ − (f − 1)², ½(f − 0.5)².
#[inline(always)]
pub fn weights<T: Real>(cells: T) -> (i32, T, [T; 3]) {
    let base = (cells.value() - 0.5).floor();
    let f = cells - T::of(base);
    let a = T::of(1.5) - f;
    let b = f - T::one();
    let c = f - T::of(0.5);
    (
        base as i32,
        f,
        [(a * a).scale(0.5), T::of(0.75) - b * b, (c * c).scale(0.5)],
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_sum_to_one_and_reproduce_the_position() {
        for i in 0..200 {
            let x = 3.0 + i as f64 * 0.013;
            let (base, _, w) = weights(x);
            let sum: f64 = w.iter().sum();
            let mean: f64 = (0..3).map(|k| w[k] * (base as f64 + k as f64)).sum();
            assert!((sum - 1.0).abs() < 1e-12);
            assert!((mean - x).abs() < 1e-12);
            assert!(w.iter().all(|&w| w >= 0.0));
        }
    }
}
