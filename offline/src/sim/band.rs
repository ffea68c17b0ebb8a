//! Cholesky factor of a symmetric positive definite band matrix, and solutions with it.

use super::widest::on_widest;

/// A symmetric matrix of which only entries near the diagonal are not zero. Row i holds the columns
/// i − band to i.
#[derive(Clone, Debug)]
pub struct Band {
    size: usize,
    band: usize,
    rows: Vec<f64>,
}

impl Band {
    /// Zeros.
    pub fn new(size: usize, band: usize) -> Self {
        Self {
            size,
            band,
            rows: vec![0.0; size * (band + 1)],
        }
    }

    /// Adds to the entry (i, j) and its mirror image; |i − j| is at most the band.
    #[inline(always)]
    pub fn add(&mut self, i: usize, j: usize, value: f64) {
        let (i, j) = if i >= j { (i, j) } else { (j, i) };
        assert!(i - j <= self.band, "outside the band");
        self.rows[i * (self.band + 1) + self.band - (i - j)] += value;
    }

    /// Adds to the entries (i, j), (i, j + 1) and so on, none of which is right of the diagonal.
    #[inline(always)]
    pub fn add_row(&mut self, i: usize, j: usize, values: &[f64]) {
        assert!(i - j <= self.band, "outside the band");
        let first = i * (self.band + 1) + self.band - (i - j);
        for (entry, value) in self.rows[first..first + values.len()].iter_mut().zip(values) {
            *entry += value;
        }
    }

    /// The diagonal entry i.
    pub fn diagonal(&self, i: usize) -> f64 {
        self.rows[i * (self.band + 1) + self.band]
    }

    /// Zeros again.
    pub fn clear(&mut self) {
        self.rows.fill(0.0);
    }
}

/// Sixteen sums at once, which the compiler turns into vector registers.
#[inline(always)]
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; 16];
    let (a16, a_rest) = a.as_chunks::<16>();
    let (b16, b_rest) = b.as_chunks::<16>();
    for (x, y) in a16.iter().zip(b16) {
        for k in 0..16 {
            sums[k] += x[k] * y[k];
        }
    }
    let mut fours = [0.0; 4];
    let (a4, a_rest) = a_rest.as_chunks::<4>();
    let (b4, b_rest) = b_rest.as_chunks::<4>();
    for (x, y) in a4.iter().zip(b4) {
        for k in 0..4 {
            fours[k] += x[k] * y[k];
        }
    }
    for k in 0..4 {
        fours[k] += (sums[k] + sums[k + 4]) + (sums[k + 8] + sums[k + 12]);
    }
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(x, y)| x * y).sum();
    fours[0] + fours[1] + fours[2] + fours[3] + rest
}

/// The factor L of a matrix A = L Lᵀ, in memory that is used again.
#[derive(Clone, Debug)]
pub struct Factor(Band);

impl Factor {
    /// Room for the factor of a matrix.
    pub fn new(size: usize, band: usize) -> Self {
        Self(Band::new(size, band))
    }

    /// Factorises a matrix with `more(i)` added to its diagonal. Returns whether that is positive definite; where
    /// it is not there is no factor.
    #[must_use]
    pub fn factorise(&mut self, matrix: &Band, more: impl Fn(usize) -> f64) -> bool {
        let (rows, width) = (&mut self.0.rows, self.0.band + 1);
        rows.copy_from_slice(&matrix.rows);
        for (i, diagonal) in rows.iter_mut().skip(width - 1).step_by(width).enumerate() {
            *diagonal += more(i);
        }
        on_widest!(cholesky(rows: &mut [f64], width: usize) -> bool)
    }

    /// Solves L Lᵀ x = b in place.
    pub fn solve(&self, x: &mut [f64]) {
        let Band { size, band, rows } = &self.0;
        let (size, band, width) = (*size, *band, *band + 1);
        for i in 0..size {
            let first = i.saturating_sub(band);
            let row = &rows[i * width..(i + 1) * width];
            x[i] = (x[i] - dot(&row[first + band - i..band], &x[first..i])) / row[band];
        }
        for i in (0..size).rev() {
            let first = i.saturating_sub(band);
            let row = &rows[i * width..(i + 1) * width];
            x[i] /= row[band];
            let known = x[i];
            for (entry, l) in x[first..i].iter_mut().zip(&row[first + band - i..band]) {
                *entry -= l * known;
            }
        }
    }
}

/// Replaces a band matrix, rows of `width`, by its factor; returns whether it was positive definite.
#[inline(always)]
fn cholesky(rows: &mut [f64], width: usize) -> bool {
    let band = width - 1;
    let size = rows.len() / width;
    // The first column of each row that is not zero stays the first in the factor.
    let mut firsts = Vec::with_capacity(size);
    for i in 0..size {
        let row = &rows[i * width..(i + 1) * width];
        let zeros = row.iter().position(|x| *x != 0.0).unwrap_or(band);
        let first = (i + zeros).saturating_sub(band);
        firsts.push(first);
        let (above, from_i) = rows.split_at_mut(i * width);
        let row_i = &mut from_i[..width];
        for j in first..i {
            let start = first.max(firsts[j]);
            let row_j = &above[j * width..(j + 1) * width];
            let a = &row_i[start + band - i..j + band - i];
            let b = &row_j[start + band - j..band];
            row_i[j + band - i] = (row_i[j + band - i] - dot(a, b)) / row_j[band];
        }
        let before = &row_i[first + band - i..band];
        let pivot = row_i[band] - dot(before, before);
        if pivot.is_nan() || pivot <= 1e-14 * row_i[band] {
            return false;
        }
        row_i[band] = pivot.sqrt();
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_band_system_is_solved_and_an_indefinite_one_refused() {
        let (size, band) = (23, 6);
        let mut a = Band::new(size, band);
        let mut full = vec![vec![0.0; size]; size];
        for i in 0..size {
            for j in i.saturating_sub(band)..=i {
                let value = if i == j {
                    20.0
                } else {
                    ((7 * i + 3 * j) % 5) as f64 - 2.0
                };
                a.add(i, j, value);
                full[i][j] = value;
                full[j][i] = value;
            }
        }
        let truth: Vec<f64> = (0..size).map(|i| (i as f64).sin()).collect();
        let mut x: Vec<f64> = (0..size).map(|i| dot(&full[i], &truth)).collect();
        let mut negative = a.clone();
        negative.add(9, 9, -40.0);
        let mut factor = Factor::new(size, band);
        assert!(!factor.factorise(&negative, |_| 0.0));
        assert!(factor.factorise(&negative, |i| if i == 9 { 40.0 } else { 0.0 }));
        factor.solve(&mut x);
        for (x, truth) in x.iter().zip(&truth) {
            assert!((x - truth).abs() < 1e-12);
        }
    }
}
