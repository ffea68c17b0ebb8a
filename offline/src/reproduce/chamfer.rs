//! Chamfer distance of two point clouds, as the paper's tables mean it.

/// Mean distance from each point of `a` to its nearest in `b` plus the mean from `b` to `a`, not
/// squared, in the unit of the points. Infinite where a cloud is empty.
pub fn chamfer(a: &[[f64; 3]], b: &[[f64; 3]]) -> f64 {
    one_way(a, b) + one_way(b, a)
}

fn one_way(from: &[[f64; 3]], to: &[[f64; 3]]) -> f64 {
    let nearest = |p: &[f64; 3]| {
        let square = |q: &[f64; 3]| (0..3).map(|k| (p[k] - q[k]).powi(2)).sum::<f64>();
        to.iter().map(square).fold(f64::INFINITY, f64::min).sqrt()
    };
    if from.is_empty() {
        return f64::INFINITY;
    }
    from.iter().map(nearest).sum::<f64>() / from.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_directions_count() {
        let a = [[0.0, 0.0, 0.0], [3.0, 0.0, 0.0]];
        let b = [[0.0, 1.0, 0.0]];
        // From a: 1 and √10, mean of both; from b: 1.
        let expected = 0.5 * (1.0 + 10f64.sqrt()) + 1.0;
        assert!((chamfer(&a, &b) - expected).abs() < 1e-12);
        assert_eq!(chamfer(&a, &a), 0.0);
        assert!(chamfer(&a, &[]).is_infinite());
    }
}
