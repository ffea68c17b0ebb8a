//! Point clouds as PCD files (Point Cloud Library, version 0.7): ASCII, binary and compressed binary.

use super::DemoError;
use std::path::Path;

const AGAIN: &str = "export the cloud again as a PCD or PLY file with float x, y, z in metres";

struct Field {
    offset: usize,
    size: usize,
    kind: char,
    count: usize,
}

struct Header {
    names: Vec<String>,
    fields: Vec<Field>,
    points: usize,
    encoding: String,
    /// Where the data begin.
    body: usize,
}

/// Reads the points of a PCD file, m. Points without depth (NaN) are left out, as PCD marks them so.
pub(super) fn read(file: &Path) -> Result<Vec<[f64; 3]>, DemoError> {
    let bytes = std::fs::read(file).map_err(|e| DemoError::io(file, "reading", &e))?;
    let bad = |problem: String| DemoError::new(file, problem, AGAIN);
    let header = header(&bytes).map_err(bad)?;
    let axes = axes(&header).map_err(bad)?;
    let body = &bytes[header.body..];
    let points = match header.encoding.as_str() {
        "ascii" => ascii(body, &header, axes),
        "binary" => binary(body, &header, axes),
        "binary_compressed" => compressed(body, &header, axes),
        other => Err(format!("DATA is '{other}'")),
    };
    let seen = |p: &[f64; 3]| !p.iter().any(|x| x.is_nan());
    Ok(points.map_err(bad)?.into_iter().filter(seen).collect())
}

fn header(bytes: &[u8]) -> Result<Header, String> {
    let mut header = Header {
        names: Vec::new(),
        fields: Vec::new(),
        points: 0,
        encoding: String::new(),
        body: 0,
    };
    let (mut sizes, mut kinds, mut counts) = (Vec::new(), Vec::new(), Vec::new());
    while header.encoding.is_empty() {
        let rest = &bytes[header.body..];
        let end = rest
            .iter()
            .position(|b| *b == b'\n')
            .ok_or("the header is cut short")?;
        let line = std::str::from_utf8(&rest[..end]).map_err(|_| "the header is no text")?;
        header.body += end + 1;
        let mut words = line.split_whitespace();
        let key = words.next().unwrap_or("#");
        let numbers = || -> Result<Vec<usize>, String> {
            let list = line.split_whitespace().skip(1).map(str::parse);
            list.collect::<Result<_, _>>()
                .map_err(|_| format!("'{line}' holds no whole numbers"))
        };
        match key {
            "FIELDS" | "COLUMNS" => header.names = words.map(str::to_owned).collect(),
            "SIZE" => sizes = numbers()?,
            "TYPE" => kinds = words.filter_map(|w| w.chars().next()).collect(),
            "COUNT" => counts = numbers()?,
            "POINTS" => header.points = numbers()?.first().copied().unwrap_or(0),
            "DATA" => header.encoding = words.next().unwrap_or("nothing").to_owned(),
            _ => {}
        }
    }
    if counts.is_empty() {
        counts = vec![1; sizes.len()];
    }
    let count = header.names.len();
    if count == 0 || sizes.len() != count || kinds.len() != count || counts.len() != count {
        return Err("FIELDS, SIZE, TYPE and COUNT do not name the same fields".into());
    }
    let mut offset = 0usize;
    for i in 0..count {
        let size = sizes[i];
        if !matches!(size, 1 | 2 | 4 | 8) {
            return Err(format!("SIZE {size} is not 1, 2, 4 or 8"));
        }
        header.fields.push(Field {
            offset,
            size,
            kind: kinds[i],
            count: counts[i],
        });
        let end = size.checked_mul(counts[i]).and_then(|n| offset.checked_add(n));
        offset = end.ok_or("COUNT makes a point longer than any file")?;
    }
    Ok(header)
}

/// The fields x, y, z.
fn axes(header: &Header) -> Result<[usize; 3], String> {
    let mut axes = [0; 3];
    for (axis, name) in axes.iter_mut().zip(["x", "y", "z"]) {
        let index = header.names.iter().position(|n| n == name);
        *axis = index.ok_or_else(|| format!("there is no field '{name}'"))?;
        let field = &header.fields[*axis];
        if field.kind != 'F' || field.count != 1 || !matches!(field.size, 4 | 8) {
            return Err(format!("the field '{name}' is no float or double"));
        }
    }
    Ok(axes)
}

/// Bytes of a point; a header with more than can be counted is refused.
fn stride(header: &Header) -> usize {
    header.fields.iter().map(|f| f.size * f.count).sum()
}

fn ascii(body: &[u8], header: &Header, axes: [usize; 3]) -> Result<Vec<[f64; 3]>, String> {
    let text = std::str::from_utf8(body).map_err(|_| "the points are no text")?;
    let lines: Vec<&str> = text.lines().filter(|line| !line.trim().is_empty()).collect();
    if lines.len() != header.points {
        return Err(format!(
            "{} points, the header says {}",
            lines.len(),
            header.points
        ));
    }
    let column = |axis: usize| header.fields[..axis].iter().map(|f| f.count).sum::<usize>();
    let columns = axes.map(column);
    let parse = |line: &&str| {
        let words: Vec<&str> = line.split_whitespace().collect();
        let mut point = [0.0; 3];
        for (x, column) in point.iter_mut().zip(columns) {
            let word = words.get(column).and_then(|w| w.parse().ok());
            *x = word.ok_or_else(|| format!("'{line}' is no point"))?;
        }
        Ok(point)
    };
    lines.iter().map(parse).collect()
}

fn number(bytes: &[u8], size: usize) -> f64 {
    // The caller hands over exactly 4 or 8 bytes.
    match bytes.first_chunk::<8>() {
        Some(all) if size == 8 => f64::from_le_bytes(*all),
        _ => bytes
            .first_chunk::<4>()
            .map_or(f64::NAN, |b| f64::from(f32::from_le_bytes(*b))),
    }
}

fn binary(body: &[u8], header: &Header, axes: [usize; 3]) -> Result<Vec<[f64; 3]>, String> {
    let stride = stride(header);
    if header.points.checked_mul(stride) != Some(body.len()) {
        return Err(format!(
            "{} bytes are not {} points of {stride}",
            body.len(),
            header.points
        ));
    }
    let point = |record: &[u8]| {
        axes.map(|axis| {
            let field = &header.fields[axis];
            number(&record[field.offset..field.offset + field.size], field.size)
        })
    };
    Ok(body.chunks_exact(stride).map(point).collect())
}

/// Two sizes, then all values of the first field, of the second and so on, compressed by LZF.
fn compressed(body: &[u8], header: &Header, axes: [usize; 3]) -> Result<Vec<[f64; 3]>, String> {
    let sizes: &[u8; 8] = body.first_chunk().ok_or("the file is cut short")?;
    let size =
        |at: usize| u32::from_le_bytes([sizes[at], sizes[at + 1], sizes[at + 2], sizes[at + 3]]) as usize;
    let (packed, unpacked) = (size(0), size(4));
    let input = body.get(8..8 + packed).ok_or("the file is cut short")?;
    if header.points.checked_mul(stride(header)) != Some(unpacked) {
        return Err(format!(
            "{unpacked} unpacked bytes are not {} points",
            header.points
        ));
    }
    let bytes = lzf(input, unpacked).ok_or("the compressed data are damaged")?;
    let value = |axis: usize, point: usize| {
        let field = &header.fields[axis];
        let start = field.offset * header.points + point * field.size;
        number(&bytes[start..start + field.size], field.size)
    };
    let points = 0..header.points;
    Ok(points.map(|p| axes.map(|axis| value(axis, p))).collect())
}

/// LZF (Marc Lehmann): a control byte below 32 starts a run of that many literals and one; else its
/// upper three bits are the length of a copy less two (seven: one more byte), and its lower five with
/// the next byte how far back it starts.
fn lzf(input: &[u8], size: usize) -> Option<Vec<u8>> {
    let mut out = Vec::with_capacity(size);
    let mut bytes = input.iter().map(|b| usize::from(*b));
    while let Some(control) = bytes.next() {
        if control < 32 {
            for _ in 0..=control {
                out.push(bytes.next()? as u8);
            }
            continue;
        }
        let mut length = control >> 5;
        if length == 7 {
            length += bytes.next()?;
        }
        let back = ((control & 31) << 8) + bytes.next()? + 1;
        let start = out.len().checked_sub(back)?;
        for k in 0..length + 2 {
            out.push(out[start + k]);
        }
    }
    (out.len() == size).then_some(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    const POINTS: [[f32; 3]; 3] = [[0.1, 0.2, 0.3], [-0.5, 0.25, 1.5], [0.0, 0.0, 0.125]];

    fn head(data: &str, points: usize) -> Vec<u8> {
        format!(
            "# .PCD v0.7\nVERSION 0.7\nFIELDS rgb x y z\nSIZE 4 4 4 4\nTYPE U F F F\nCOUNT 1 1 1 1\n\
             WIDTH {points}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {points}\nDATA {data}\n"
        )
        .into_bytes()
    }

    fn read_bytes(bytes: &[u8]) -> Result<Vec<[f64; 3]>, DemoError> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), bytes).unwrap();
        read(file.path())
    }

    fn expected() -> Vec<[f64; 3]> {
        POINTS.map(|p| p.map(f64::from)).to_vec()
    }

    #[test]
    fn text_binary_and_compressed_clouds_are_the_same() {
        let mut text = head("ascii", 4);
        text.extend("7 0.1 0.2 0.3\n7 -0.5 0.25 1.5\n7 0 0 0.125\n7 nan nan nan\n".bytes());
        let got = read_bytes(&text).unwrap();
        for (a, b) in got.iter().flatten().zip(expected().iter().flatten()) {
            assert!((a - b).abs() < 1e-7);
        }
        let mut plain = head("binary", 3);
        for p in POINTS {
            plain.extend(7u32.to_le_bytes());
            plain.extend(p.iter().flat_map(|x| x.to_le_bytes()));
        }
        assert_eq!(read_bytes(&plain).unwrap(), expected());
        // By hand: the three equal colours as one literal run and a copy, the rest as literals.
        let mut packed = vec![3];
        packed.extend(7u32.to_le_bytes());
        packed.extend([(6 << 5), 3]);
        for axis in 0..3 {
            packed.push(11);
            packed.extend(POINTS.iter().flat_map(|p| p[axis].to_le_bytes()));
        }
        let mut squeezed = head("binary_compressed", 3);
        squeezed.extend((packed.len() as u32).to_le_bytes());
        squeezed.extend(48u32.to_le_bytes());
        squeezed.extend(packed);
        assert_eq!(read_bytes(&squeezed).unwrap(), expected());
    }

    #[test]
    fn a_truncated_or_strange_cloud_is_refused_with_one_line() {
        let mut short = head("binary", 3);
        short.extend([0; 40]);
        let strange = head("zip", 0);
        let flat = b"FIELDS x y\nSIZE 4 4\nTYPE F F\nPOINTS 0\nDATA ascii\n".to_vec();
        for (bytes, why) in [(short, "40 bytes"), (strange, "'zip'"), (flat, "no field 'z'")] {
            let error = read_bytes(&bytes).expect_err("refused").to_string();
            assert!(error.contains(why) && !error.contains('\n'), "{error}");
        }
    }

    /// Sizes and counts that wrap round would make a point of a few bytes with a field far outside it.
    #[test]
    fn sizes_and_counts_that_no_point_can_have_are_refused_with_one_line() {
        let endless = format!("1 1 1 {}", usize::MAX);
        for (sizes, counts, why) in [
            ("4 4 4 18446744073709551608", "1 1 1 1", "18446744073709551608"),
            ("4 4 4 0", "1 1 1 1", "SIZE 0 "),
            ("4 4 4 3", "1 1 1 1", "SIZE 3 "),
            ("4 4 4 8", endless.as_str(), "COUNT"),
            ("4 4 4 1", endless.as_str(), "COUNT"),
        ] {
            for data in ["ascii", "binary", "binary_compressed"] {
                let mut bytes = format!(
                    "FIELDS x y z w\nSIZE {sizes}\nTYPE F F F F\nCOUNT {counts}\nPOINTS 3\nDATA {data}\n"
                )
                .into_bytes();
                bytes.extend([0; 12]);
                let error = read_bytes(&bytes).expect_err("refused").to_string();
                assert!(error.contains(why) && !error.contains('\n'), "{error}");
            }
        }
    }
}
