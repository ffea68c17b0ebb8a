//! Cholesky factor of a symmetric positive definite band matrix, and solutions with it.
//!
//! Columns lie one after another, and the factor is made of four of them at a time: a tile of rows of four columns stays in
//! registers while what the columns before give it is taken away. Each entry's sum runs in the order of the columns, on
//! registers of every width.

use super::widest::on_widest;

/// A symmetric matrix of which only entries near the diagonal are not zero. Column j holds the rows j to j + band, and
/// zeros as far as a tile may reach beyond.
#[derive(Clone, Debug)]
pub struct Band {
    size: usize,
    band: usize,
    columns: Vec<f64>,
}

/// Columns and rows of a tile.
const WIDE: usize = 4;
const TALL: usize = 16;
/// Rows by which a tile that begins in the band of its last column may reach beyond that of its first.
const BEYOND: usize = TALL + WIDE - 2;

/// From one column to the next.
fn stride(band: usize) -> usize {
    band + 1 + BEYOND
}

impl Band {
    /// Zeros.
    pub fn new(size: usize, band: usize) -> Self {
        Self {
            size,
            band,
            columns: vec![0.0; size.next_multiple_of(WIDE) * stride(band)],
        }
    }

    /// Where the entry (i, j) lies, which is not right of the diagonal.
    #[inline(always)]
    fn place(&self, i: usize, j: usize) -> usize {
        assert!(i - j <= self.band, "outside the band");
        j * stride(self.band) + (i - j)
    }

    /// Adds to the entry (i, j) and its mirror image; |i − j| is at most the band.
    #[inline(always)]
    pub fn add(&mut self, i: usize, j: usize, value: f64) {
        let place = self.place(i.max(j), i.min(j));
        self.columns[place] += value;
    }

    /// Adds to the entries (i, j), (i + 1, j) and so on, none of which is right of the diagonal.
    #[inline(always)]
    pub fn add_column(&mut self, i: usize, j: usize, values: &[f64]) {
        let first = self.place(i, j);
        for (entry, value) in self.columns[first..first + values.len()].iter_mut().zip(values) {
            *entry += value;
        }
    }

    /// The entry (i, j), which is not right of the diagonal.
    pub fn entry(&self, i: usize, j: usize) -> f64 {
        self.columns[self.place(i, j)]
    }

    /// Zeros again.
    pub fn clear(&mut self) {
        self.columns.fill(0.0);
    }
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
        let (factor, stride) = (&mut self.0.columns[..], stride(matrix.band));
        let added = |i: usize| if i < matrix.size { more(i) } else { 1.0 };
        let added: Vec<f64> = (0..matrix.size.next_multiple_of(WIDE)).map(added).collect();
        let (matrix, added) = (&matrix.columns[..], &added[..]);
        on_widest!(cholesky(matrix: &[f64], added: &[f64], factor: &mut [f64], stride: usize) -> bool)
    }

    /// Solves L Lᵀ x = b in place.
    pub fn solve(&self, x: &mut [f64]) {
        let (columns, stride) = (&self.0.columns[..], stride(self.0.band));
        on_widest!(solve(columns: &[f64], stride: usize, x: &mut [f64]) -> ());
    }
}

#[inline(always)]
fn solve(columns: &[f64], stride: usize, x: &mut [f64]) {
    for (j, column) in columns.chunks_exact(stride).enumerate().take(x.len()) {
        let (known, later) = x[j..].split_first_mut().expect("a row of its own");
        *known /= column[0];
        for (entry, l) in later.iter_mut().zip(&column[1..]) {
            *entry -= l * *known;
        }
    }
    for (j, column) in columns.chunks_exact(stride).enumerate().take(x.len()).rev() {
        let (entry, later) = x[j..].split_first_mut().expect("a row of its own");
        *entry = (*entry - dot(&column[1..], later)) / column[0];
    }
}

/// Sixteen sums at once, which the compiler turns into vector registers.
#[inline(always)]
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let count = a.len().min(b.len());
    let (a, a_rest) = a[..count].as_chunks::<16>();
    let (b, b_rest) = b[..count].as_chunks::<16>();
    let mut sums = [0.0; 16];
    for (x, y) in a.iter().zip(b) {
        for k in 0..16 {
            sums[k] += x[k] * y[k];
        }
    }
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(x, y)| x * y).sum();
    sums.iter().sum::<f64>() + rest
}

/// Makes the factor of a band matrix with another diagonal, both in columns of `stride`; returns whether there is one.
#[inline(always)]
fn cholesky(matrix: &[f64], added: &[f64], factor: &mut [f64], stride: usize) -> bool {
    let mut reach = Reach::default();
    let mut first = 0;
    for j in (0..added.len()).step_by(WIDE) {
        let columns = matrix[j * stride..].chunks_exact(stride).take(WIDE);
        columns.for_each(|column| reach.push(column));
        first = reach.first(first, j);
        let mut upper = tile(matrix, factor, stride, ([j, j], first));
        let own: [f64; WIDE] = std::array::from_fn(|c| {
            upper[c][c] += added[j + c];
            matrix[(j + c) * stride] + added[j + c]
        });
        if !corner(factor, stride, j, (upper, &own)) {
            return false;
        }
        let (mut i, mut first) = (j + TALL, first);
        while i <= reach.last() {
            first = reach.first(first, i).min(j);
            let lower = tile(matrix, factor, stride, ([i, j], first));
            below(factor, stride, [i, j], lower);
            i += TALL;
        }
        for c in j..j + WIDE {
            factor[c * stride..][..stride][(i - c).min(stride)..].fill(0.0);
        }
    }
    true
}

/// How far down the columns of a factor reach: as far as those before them.
#[derive(Default)]
struct Reach(Vec<usize>);

impl Reach {
    /// Takes in a column of the matrix.
    #[inline(always)]
    fn push(&mut self, column: &[f64]) {
        let own = column.iter().rposition(|entry| *entry != 0.0).unwrap_or(0);
        self.0.push(self.last().max(self.0.len() + own));
    }

    /// The first column, from one that comes no later on, that reaches row `i`.
    #[inline(always)]
    fn first(&self, from: usize, i: usize) -> usize {
        from + self.0[from..].iter().take_while(|reach| **reach < i).count()
    }

    /// The last row that is reached.
    fn last(&self) -> usize {
        self.0.last().copied().unwrap_or(0)
    }
}

/// Some rows of some columns, column by column.
type Tile = [[f64; TALL]; WIDE];

/// The tile of a matrix from the entry (i, j) on, less what columns of the factor from `first` on give to it; nothing right of
/// the diagonal means anything.
#[inline(always)]
fn tile(matrix: &[f64], factor: &[f64], stride: usize, ([i, j], first): ([usize; 2], usize)) -> Tile {
    let mut tile = [[0.0; TALL]; WIDE];
    for c in 0..WIDE {
        let above = (j + c).saturating_sub(i);
        let from = (j + c) * stride + (i + above) - (j + c);
        tile[c][above..].copy_from_slice(&matrix[from..from + TALL - above]);
    }
    // The next entry of a row lies one less than a column further on.
    let before = factor[first * (stride - 1) + j..].chunks_exact(stride - 1);
    for column in before.take(j - first) {
        let factors: [f64; WIDE] = std::array::from_fn(|c| column[c]);
        let rows: [f64; TALL] = std::array::from_fn(|r| column[i - j..][r]);
        for c in 0..WIDE {
            for r in 0..TALL {
                tile[c][r] -= rows[r] * factors[c];
            }
        }
    }
    tile
}

/// Takes from a tile's column `c` what the columns before it in the tile give to it, as they are on the diagonal from column
/// `j` of the factor on.
#[inline(always)]
fn take_before(tile: &mut Tile, c: usize, factor: &[f64], stride: usize, j: usize) {
    for k in 0..c {
        let by = factor[(j + k) * stride + c - k];
        for r in 0..TALL {
            tile[c][r] -= tile[k][r] * by;
        }
    }
}

/// Factorises the tile on the diagonal from column `j` on, where the matrix has `own`; returns whether it is positive
/// definite.
#[inline(always)]
fn corner(factor: &mut [f64], stride: usize, j: usize, (mut tile, own): (Tile, &[f64; WIDE])) -> bool {
    for c in 0..WIDE {
        take_before(&mut tile, c, factor, stride, j);
        let pivot = tile[c][c];
        if pivot.is_nan() || pivot <= 1e-14 * own[c] {
            return false;
        }
        let over_root = 1.0 / pivot.sqrt();
        for r in 0..TALL {
            tile[c][r] *= over_root;
        }
        let column = (j + c) * stride;
        factor[column..column + TALL - c].copy_from_slice(&tile[c][c..]);
    }
    true
}

/// Factorises the tile from the entry (i, j) on, below one on the diagonal.
#[inline(always)]
fn below(factor: &mut [f64], stride: usize, [i, j]: [usize; 2], mut tile: Tile) {
    for c in 0..WIDE {
        take_before(&mut tile, c, factor, stride, j);
        let over_root = 1.0 / factor[(j + c) * stride];
        for r in 0..TALL {
            tile[c][r] *= over_root;
        }
        factor[(j + c) * stride + i - j - c..][..TALL].copy_from_slice(&tile[c]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};
    use proptest::prelude::*;

    /// A matrix of which each row begins somewhere in the band, and the same in full.
    fn matrices(size: usize, band: usize, seed: usize) -> (Band, DMatrix<f64>) {
        let (mut a, mut full) = (Band::new(size, band), DMatrix::zeros(size, size));
        for i in 0..size {
            let begins = (i * seed + i / 3) % (band + 1);
            for j in i.saturating_sub(begins)..=i {
                let value = if i == j {
                    4.0 * band as f64 + 1.0
                } else {
                    ((7 * i + 3 * j + seed) % 5) as f64 - 2.0
                };
                a.add(i, j, value);
                (full[(i, j)], full[(j, i)]) = (value, value);
            }
        }
        (a, full)
    }

    proptest! {
        /// Whatever the size, the band and where rows begin; also in memory that held the factor of a fuller matrix.
        #[test]
        fn a_band_system_is_solved(size in 1usize..90, band in 0usize..50, seeds in [0usize..1000, 0..1000]) {
            let mut factor = Factor::new(size, band);
            for seed in [seeds[0], seeds[1]] {
                let (a, full) = matrices(size, band, seed);
                let truth = DVector::from_fn(size, |i, _| (i as f64).sin());
                let mut x = &full * &truth;
                prop_assert!(factor.factorise(&a, |_| 0.0));
                factor.solve(x.as_mut_slice());
                prop_assert!((x - truth).amax() < 1e-12);
            }
        }
    }

    #[test]
    fn an_indefinite_matrix_is_refused_until_enough_is_added() {
        let (size, band) = (23, 6);
        let (mut a, full) = matrices(size, band, 5);
        a.add(9, 9, -60.0);
        let mut factor = Factor::new(size, band);
        assert!(!factor.factorise(&a, |_| 0.0));
        assert!(factor.factorise(&a, |i| if i == 9 { 60.0 } else { 0.0 }));
        let truth = DVector::from_fn(size, |i, _| (i as f64).cos());
        let mut x = full * &truth;
        factor.solve(x.as_mut_slice());
        assert!((x - truth).amax() < 1e-12);
    }
}
