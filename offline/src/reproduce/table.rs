//! The tables: mean and spread per row, beside what the paper prints.

use crate::paper_units::young_pa;
use serde::Serialize;
use std::fmt::Write;

/// A mean with its sample standard deviation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Spread {
    /// Mean.
    pub mean: f64,
    /// Standard deviation with n − 1, zero for one value.
    pub deviation: f64,
    /// Number of values.
    pub n: usize,
}

impl Spread {
    /// Of some values; NaN without any.
    pub fn of(values: &[f64]) -> Self {
        let n = values.len();
        let mean = values.iter().sum::<f64>() / n as f64;
        let square = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
        Self {
            mean,
            deviation: if n > 1 {
                (square / (n - 1) as f64).sqrt()
            } else {
                0.0
            },
            n,
        }
    }

    /// As people write it, with so many digits after the point; one value has no spread.
    pub(super) fn shown(&self, digits: usize) -> String {
        let mean = format!("{:.digits$}", self.mean);
        if self.n == 1 {
            return mean;
        }
        format!("{mean} ± {:.digits$}", self.deviation)
    }
}

/// What the paper prints in a row: E (paper units), ν and Chamfer distance, each mean and spread.
pub type Printed = [&'static str; 3];

/// Table 1 of the paper (sim2sim): the start of a row's name and its values.
pub const PRINTED_SIM2SIM: [(&str, Printed); 3] = [
    (
        "gradient, all steps",
        ["11.69 ± 8.28", "0.0032 ± 0.0074", "0.0004 ± 0.0005"],
    ),
    (
        "gradient, last step",
        ["13.74 ± 6.75", "0.0067 ± 0.0098", "0.0004 ± 0.0004"],
    ),
    (
        "PointNet++",
        ["173.51 ± 200.14", "0.029 ± 0.024", "0.0025 ± 0.0016"],
    ),
];

/// One row.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Name.
    pub name: String,
    /// E or |ΔE|, paper units.
    pub young_units: Spread,
    /// ν or |Δν|.
    pub poisson: Spread,
    /// Chamfer distance of the last state, paper length units.
    pub chamfer_units: Spread,
    /// What the paper prints.
    pub printed: Option<Printed>,
}

/// A table with a heading.
#[derive(Clone, Debug, Serialize)]
pub struct Table {
    /// What it shows and how it was made.
    pub title: String,
    /// Rows.
    pub rows: Vec<Row>,
    /// Whether the columns are errors against a truth, else estimates.
    pub errors: bool,
    /// Density for Pa, kg/m³.
    pub density_kg_m3: f64,
    /// Remarks on rows and settings.
    pub notes: Vec<String>,
}

/// What the paper prints for a row of the sim2sim table.
pub fn printed(name: &str) -> Option<Printed> {
    PRINTED_SIM2SIM
        .iter()
        .find(|(start, _)| name.starts_with(start))
        .map(|(_, values)| *values)
}

impl Table {
    /// As Markdown.
    pub fn markdown(&self) -> String {
        let (e, nu) = if self.errors {
            ("|ΔE|", "|Δν|")
        } else {
            ("E", "ν")
        };
        let mut text = format!("{}\n\n", self.title);
        let head = [
            "method".to_string(),
            "n".into(),
            format!("{e}, paper units"),
            format!("{e}, kPa"),
            nu.into(),
            "Chamfer, paper units".into(),
            format!("paper: {e}"),
            format!("paper: {nu}"),
            "paper: Chamfer".into(),
        ];
        let _ = writeln!(
            text,
            "| {} |",
            head.join(" | ")
                .replace("|ΔE|", "\\|ΔE\\|")
                .replace("|Δν|", "\\|Δν\\|")
        );
        let _ = writeln!(text, "|{}", "---|".repeat(head.len()));
        for row in &self.rows {
            let kilopascals = young_pa(1e-3, self.density_kg_m3);
            let pressure = Spread {
                mean: row.young_units.mean * kilopascals,
                deviation: row.young_units.deviation * kilopascals,
                ..row.young_units
            };
            let printed = row.printed.unwrap_or(["–"; 3]);
            let _ = writeln!(
                text,
                "| {} | {} | {} | {} | {} | {} | {} |",
                row.name,
                row.young_units.n,
                row.young_units.shown(2),
                pressure.shown(2),
                row.poisson.shown(5),
                row.chamfer_units.shown(6),
                printed.join(" | ")
            );
        }
        for note in &self.notes {
            let _ = writeln!(text, "\n- {note}");
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_shows_mean_and_spread_beside_the_paper() {
        let spread = Spread::of(&[1.0, 3.0]);
        assert!((spread.mean - 2.0).abs() < 1e-12 && (spread.deviation - 2f64.sqrt()).abs() < 1e-12);
        assert_eq!(Spread::of(&[4.0]).shown(1), "4.0");
        let name = "gradient, last step, E step 10 (paper), best iterate";
        let table = Table {
            title: "T".into(),
            rows: vec![Row {
                name: name.into(),
                young_units: spread,
                poisson: spread,
                chamfer_units: spread,
                printed: printed(name),
            }],
            errors: true,
            density_kg_m3: 1000.0,
            notes: vec!["a note".into()],
        };
        let text = table.markdown();
        assert!(
            text.contains("2.00 ± 1.41") && text.contains("13.74 ± 6.75"),
            "{text}"
        );
        // 2 paper units are 817.5 Pa at 1000 kg/m³.
        assert!(
            text.contains("0.82 ± 0.58") && text.contains("- a note"),
            "{text}"
        );
        assert!(printed("ours").is_none());
    }
}
