//! Arrays as NumPy writes them: format version 1.0, little-endian single precision, C order.

use crate::demo::DemoError;
use std::path::Path;

const AGAIN: &str = "save it with numpy.save as a little-endian float32 array in C order";

/// An array with its shape; the last axis is contiguous.
pub(super) struct Array {
    pub(super) shape: Vec<usize>,
    values: Vec<f32>,
}

impl Array {
    /// Reads a file whose array has `axes` axes.
    pub(super) fn read(file: &Path, axes: usize) -> Result<Self, DemoError> {
        let bytes = std::fs::read(file).map_err(|e| DemoError::io(file, "reading", &e))?;
        let bad = |problem: &str| DemoError::new(file, problem, AGAIN);
        let head: &[u8; 10] = bytes.first_chunk().ok_or_else(|| bad("the file is cut short"))?;
        if &head[..8] != b"\x93NUMPY\x01\x00" {
            return Err(bad("this is no NumPy file of version 1.0"));
        }
        let start = 10 + usize::from(u16::from_le_bytes([head[8], head[9]]));
        let header = bytes.get(10..start).and_then(|h| std::str::from_utf8(h).ok());
        let header = header.ok_or_else(|| bad("the header is cut short"))?;
        if !header.contains("'<f4'") || !header.contains("'fortran_order': False") {
            return Err(bad("the array is not little-endian float32 in C order"));
        }
        let shape = shape_in(header).ok_or_else(|| bad("the header names no shape"))?;
        if shape.len() != axes {
            return Err(bad(&format!("the array has {} axes, not {axes}", shape.len())));
        }
        let body = &bytes[start..];
        if Some(body.len()) != shape.iter().try_fold(4usize, |n, &k| n.checked_mul(k)) {
            return Err(bad("the file does not hold as many numbers as its header says"));
        }
        let values = body.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b));
        Ok(Self {
            shape,
            values: values.collect(),
        })
    }

    /// The numbers of row `row` of the first axis.
    pub(super) fn row(&self, row: usize) -> &[f32] {
        let size: usize = self.shape[1..].iter().product();
        &self.values[row * size..(row + 1) * size]
    }
}

fn shape_in(header: &str) -> Option<Vec<usize>> {
    let (_, rest) = header.split_once("'shape': (")?;
    let (inside, _) = rest.split_once(')')?;
    let numbers = inside.split(',').map(str::trim).filter(|n| !n.is_empty());
    numbers.map(|n| n.parse().ok()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(header: &str, values: &[f32]) -> tempfile::NamedTempFile {
        let file = tempfile::NamedTempFile::new().unwrap();
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((header.len() as u16).to_le_bytes());
        bytes.extend(header.as_bytes());
        bytes.extend(values.iter().flat_map(|v| v.to_le_bytes()));
        std::fs::write(file.path(), bytes).unwrap();
        file
    }

    #[test]
    fn an_array_reads_back_and_a_truncated_or_transposed_one_is_refused() {
        let header = "{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3), }\n";
        let good = file(header, &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
        let array = Array::read(good.path(), 2).unwrap();
        assert_eq!(array.shape, [2, 3]);
        assert_eq!(array.row(1), [4.0, 5.0, 6.0]);
        for (header, count) in [(header.to_owned(), 5), (header.replace("False", "True"), 6)] {
            let bad = file(&header, &vec![0.0; count]);
            let error = Array::read(bad.path(), 2).err().expect("refused").to_string();
            assert!(error.contains("numpy.save"), "{error}");
        }
    }
}
