//! Point clouds: reads PLY (ASCII and binary) and PCD, writes binary little-endian PLY with float x, y, z.

use super::DemoError;
use super::check::FARTHEST_M;
use ply_rs_bw::parser::{ParseError, Parser, Reader};
use ply_rs_bw::ply::{
    Addable, ElementDef, Encoding, Header, Ply, PropertyAccess, PropertyAccessResult, PropertyDef,
    PropertyType, ScalarType,
};
use ply_rs_bw::writer::Writer;
use std::io::{BufRead, BufReader};
use std::path::Path;

/// What to do about points that are not finite.
const WITHOUT_DEPTH: &str = "drop points without depth before writing the cloud";

const AXES: [&str; 3] = ["x", "y", "z"];

/// A vertex as the PLY crate fills it; other properties (colour, normals) are ignored.
#[derive(Debug, Default)]
struct Vertex([f64; 3]);

impl Vertex {
    fn set(&mut self, name: &str, value: f64) -> PropertyAccessResult {
        match AXES.iter().position(|axis| *axis == name) {
            Some(axis) => {
                self.0[axis] = value;
                PropertyAccessResult::Set
            }
            None => PropertyAccessResult::Ignored,
        }
    }
}

impl PropertyAccess for Vertex {
    fn new() -> Self {
        Self::default()
    }

    fn set_float(&mut self, name: &str, value: f32) -> PropertyAccessResult {
        self.set(name, f64::from(value))
    }

    fn set_double(&mut self, name: &str, value: f64) -> PropertyAccessResult {
        self.set(name, value)
    }

    fn get_float(&self, name: &str) -> Option<f32> {
        let axis = AXES.iter().position(|axis| *axis == name)?;
        Some(self.0[axis] as f32)
    }
}

const AGAIN: &str = "export the cloud again as a PLY file";

/// Reads a cloud, m: a PCD file by its ending, else a PLY file.
pub(super) fn read(file: &Path) -> Result<Vec<[f64; 3]>, DemoError> {
    if file
        .extension()
        .is_some_and(|ending| ending.eq_ignore_ascii_case("pcd"))
    {
        let points = super::pcd::read(file)?;
        check(file, &points)?;
        return Ok(points);
    }
    read_ply(file)
}

fn read_ply(file: &Path) -> Result<Vec<[f64; 3]>, DemoError> {
    let handle = std::fs::File::open(file).map_err(|e| DemoError::io(file, "opening", &e))?;
    let bad = |error| unreadable(file, &error);
    let parser = Parser::<Vertex>::new();
    let mut reader = Reader::new(BufReader::new(handle));
    let header = parser.read_header(&mut reader).map_err(bad)?;
    check_header(file, &header)?;
    let mut payload = parser.read_payload(&mut reader, &header).map_err(bad)?;
    if has_more(reader.into_inner()) {
        return Err(DemoError::new(
            file,
            "data follow after the header's last point",
            AGAIN,
        ));
    }
    let vertices = payload.swap_remove("vertex").unwrap_or_default();
    let points: Vec<[f64; 3]> = vertices.into_iter().map(|vertex| vertex.0).collect();
    check(file, &points)?;
    Ok(points)
}

fn unreadable(file: &Path, error: &ParseError) -> DemoError {
    if error.kind() == std::io::ErrorKind::UnexpectedEof {
        return DemoError::new(file, "the file ends before its header's last point", AGAIN);
    }
    if let Some(line) = error.line().filter(|&line| says_no_number(file, line)) {
        return DemoError::new(file, "a point is not finite", WITHOUT_DEPTH).at(line);
    }
    let text = error.to_string();
    // The parser's text goes on with its grammar, which helps nobody who made a cloud.
    let brief: Vec<&str> = text.lines().take(2).collect();
    let whole = DemoError::new(
        file,
        format!("not a readable PLY file ({})", brief.join(" ")),
        AGAIN,
    );
    match error.line() {
        Some(line) => whole.at(line),
        None => whole,
    }
}

/// Whether a line of text, counted from 1, holds NaN or infinity, for which the parser has no number.
fn says_no_number(file: &Path, line: usize) -> bool {
    let text = std::fs::read(file).unwrap_or_default();
    let line = text
        .split(|&byte| byte == b'\n')
        .nth(line - 1)
        .unwrap_or_default();
    String::from_utf8_lossy(line)
        .split_whitespace()
        .any(|word| word.parse::<f64>().is_ok_and(|value| !value.is_finite()))
}

/// Whether anything but white space is left.
fn has_more(rest: impl BufRead) -> bool {
    rest.bytes()
        .any(|byte| byte.is_ok_and(|b| !b.is_ascii_whitespace()))
}

fn check_header(file: &Path, header: &Header) -> Result<(), DemoError> {
    const REMEDY: &str = "write float or double x, y, z in metres";
    let Some(vertex) = header.elements.get("vertex") else {
        return Err(DemoError::new(file, "there is no element 'vertex'", REMEDY));
    };
    for axis in AXES {
        let kind = vertex.properties.get(axis).map(|property| &property.data_type);
        let real = matches!(
            kind,
            Some(PropertyType::Scalar(ScalarType::Float | ScalarType::Double))
        );
        if !real {
            let problem = format!("the vertices have no float or double '{axis}'");
            return Err(DemoError::new(file, problem, REMEDY));
        }
    }
    Ok(())
}

/// Checks that a cloud has points and that they lie on a table top.
pub(super) fn check(file: &Path, points: &[[f64; 3]]) -> Result<(), DemoError> {
    if points.is_empty() {
        return Err(DemoError::new(
            file,
            "the cloud is empty",
            "leave this frame out of clouds.csv",
        ));
    }
    for (index, point) in points.iter().enumerate() {
        if point.iter().any(|x| !x.is_finite()) {
            let problem = format!("point {index} is not finite");
            return Err(DemoError::new(file, problem, WITHOUT_DEPTH));
        }
        if point.iter().any(|x| x.abs() > FARTHEST_M) {
            let problem = format!("point {index} lies {:.0} m away along an axis", largest(point));
            return Err(DemoError::new(file, problem, "write metres, not millimetres"));
        }
    }
    Ok(())
}

fn largest(point: &[f64; 3]) -> f64 {
    point.iter().fold(0.0, |worst, x| x.abs().max(worst))
}

/// Writes a cloud; coordinates are rounded to single precision (0.1 µm at 1 m).
pub(super) fn write(file: &Path, points: &[[f64; 3]]) -> Result<(), DemoError> {
    let mut element = ElementDef::new("vertex".to_owned());
    for axis in AXES {
        let kind = PropertyType::Scalar(ScalarType::Float);
        element.properties.add(PropertyDef::new(axis.to_owned(), kind));
    }
    let mut ply = Ply::<Vertex>::new();
    ply.header.encoding = Encoding::BinaryLittleEndian;
    ply.header.elements.add(element);
    ply.payload
        .insert("vertex".to_owned(), points.iter().map(|p| Vertex(*p)).collect());
    let mut bytes = Vec::new();
    Writer::new()
        .write_ply(&mut bytes, &mut ply)
        .map_err(|e| DemoError::new(file, format!("writing failed ({e})"), "check the cloud"))?;
    std::fs::write(file, bytes).map_err(|e| DemoError::unwritten(file, "writing", &e))
}
