//! A case: what was expected, what came out, and whether that is within the tolerance; and the table.

use super::random::Outcomes;
use super::study::Study;
use crate::sim::SimError;
use serde::Serialize;

/// How an error is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Measure {
    /// |obtained / expected − 1|.
    Relative,
    /// |obtained − expected| in the case's unit.
    Absolute,
    /// What the obtained value exceeds the expected one by; below it is as good as equal.
    Excess,
    /// What the obtained value falls short of the expected one by.
    Shortfall,
}

/// One line of the table.
#[derive(Clone, Debug, Serialize)]
pub struct Case {
    /// Family.
    pub family: &'static str,
    /// What was measured.
    pub name: String,
    /// Unit of both values.
    pub unit: &'static str,
    /// Exact value, or bound.
    pub expected: f64,
    /// Value from the simulator.
    pub obtained: f64,
    /// How the error is measured.
    pub measure: Measure,
    /// Error, in its measure.
    pub error: f64,
    /// Largest error that passes.
    pub tolerance: f64,
    /// Whether it passes.
    pub passed: bool,
    /// Why there is no value, if a simulation stopped.
    pub stopped: Option<String>,
}

/// Builds the cases of one family.
#[derive(Clone, Copy)]
pub struct Of(pub &'static str);

impl Of {
    /// A relative error.
    pub fn relative(
        self,
        name: impl Into<String>,
        unit: &'static str,
        pair: [f64; 2],
        tolerance: f64,
    ) -> Case {
        self.case(name, unit, pair, Measure::Relative, tolerance)
    }

    /// An absolute error.
    pub fn absolute(
        self,
        name: impl Into<String>,
        unit: &'static str,
        pair: [f64; 2],
        tolerance: f64,
    ) -> Case {
        self.case(name, unit, pair, Measure::Absolute, tolerance)
    }

    /// A value that must not exceed a bound.
    pub fn at_most(self, name: impl Into<String>, unit: &'static str, obtained: f64, bound: f64) -> Case {
        self.case(name, unit, [bound, obtained], Measure::Excess, 0.0)
    }

    /// A value that must reach a bound.
    pub fn at_least(self, name: impl Into<String>, unit: &'static str, obtained: f64, bound: f64) -> Case {
        self.case(name, unit, [bound, obtained], Measure::Shortfall, 0.0)
    }

    /// Something that holds or does not.
    pub fn holds(self, name: impl Into<String>, holds: bool) -> Case {
        self.absolute(name, "1", [1.0, f64::from(u8::from(holds))], 0.0)
    }

    /// A case whose simulation stopped.
    pub fn stopped(self, name: impl Into<String>, error: &SimError) -> Case {
        let mut case = self.absolute(name, "", [f64::NAN, f64::NAN], 0.0);
        case.stopped = Some(error.to_string());
        case
    }

    /// The cases of a simulation, or the one that says why it stopped.
    pub fn each(self, name: &str, cases: Result<Vec<Case>, SimError>) -> Vec<Case> {
        cases.unwrap_or_else(|error| vec![self.stopped(name, &error)])
    }

    /// `pair` is (expected, obtained).
    fn case(
        self,
        name: impl Into<String>,
        unit: &'static str,
        [expected, obtained]: [f64; 2],
        measure: Measure,
        tolerance: f64,
    ) -> Case {
        let error = match measure {
            Measure::Relative => (obtained / expected - 1.0).abs(),
            Measure::Absolute => (obtained - expected).abs(),
            Measure::Excess => excess(obtained - expected),
            Measure::Shortfall => excess(expected - obtained),
        };
        Case {
            family: self.0,
            name: name.into(),
            unit,
            expected,
            obtained,
            measure,
            error,
            tolerance,
            // NaN does not pass.
            passed: error <= tolerance,
            stopped: None,
        }
    }
}

/// The positive part, NaN for NaN.
fn excess(value: f64) -> f64 {
    if value < 0.0 { 0.0 } else { value }
}

/// All cases and studies.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Report {
    /// Cases with a verdict.
    pub cases: Vec<Case>,
    /// Convergence studies.
    pub studies: Vec<Study>,
    /// Random scenes, if any were run.
    pub random: Option<Outcomes>,
}

impl Report {
    /// Number of cases that fail.
    pub fn failures(&self) -> usize {
        self.cases.iter().filter(|case| !case.passed).count()
    }
}

/// The report as text.
pub fn table(report: &Report) -> String {
    let mut text = format!(
        "{:<10} {:<58} {:>13} {:>13} {:>10} {:>10}\n",
        "family", "case", "expected", "obtained", "error", "tolerance"
    );
    for case in &report.cases {
        text += &line(case);
    }
    for study in &report.studies {
        text += &study.text();
    }
    if let Some(outcomes) = &report.random {
        text += &outcomes.text();
    }
    let failures = report.failures();
    text += &format!("{} cases, {failures} failed\n", report.cases.len());
    text
}

fn line(case: &Case) -> String {
    let verdict = if case.passed { "pass" } else { "FAIL" };
    let name = match case.unit {
        "1" | "" => case.name.clone(),
        unit => format!("{} [{unit}]", case.name),
    };
    if let Some(reason) = &case.stopped {
        return format!("{:<10} {name:<58} {reason} {verdict}\n", case.family);
    }
    let expected = match case.measure {
        Measure::Excess => format!("≤ {}", number(case.expected)),
        Measure::Shortfall => format!("≥ {}", number(case.expected)),
        _ => number(case.expected),
    };
    format!(
        "{:<10} {name:<58} {expected:>13} {:>13} {:>10} {:>10} {verdict}\n",
        case.family,
        number(case.obtained),
        format!("{:.1e}", case.error),
        format!("{:.1e}", case.tolerance),
    )
}

/// Six digits, without an exponent where that is readable.
fn number(value: f64) -> String {
    if value == 0.0 || (1e-3..1e6).contains(&value.abs()) {
        format!("{value:.6}")
    } else {
        format!("{value:.5e}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const F: Of = Of("test");

    #[test]
    fn a_value_off_by_more_than_the_tolerance_fails_and_so_does_nan() {
        assert!(F.relative("a", "m", [2.0, 2.1], 0.051).passed);
        assert!(!F.relative("a", "m", [2.0, 2.1], 0.049).passed);
        assert!(!F.absolute("a", "m", [0.0, -0.1], 0.09).passed);
        assert!(F.at_most("a", "m", -5.0, 1.0).passed && !F.at_most("a", "m", 1.1, 1.0).passed);
        assert!(F.at_least("a", "m", 5.0, 1.0).passed && !F.at_least("a", "m", 0.9, 1.0).passed);
        for case in [
            F.relative("a", "m", [1.0, f64::NAN], 1.0),
            F.at_most("a", "m", f64::NAN, 1.0),
            F.at_least("a", "m", f64::NAN, 1.0),
            F.holds("a", false),
        ] {
            assert!(!case.passed, "{case:?}");
        }
    }

    #[test]
    fn the_table_names_what_fails() {
        let report = Report {
            cases: vec![F.holds("good", true), F.relative("bad", "m", [1.0, 2.0], 0.1)],
            ..Report::default()
        };
        let text = table(&report);
        assert!(text.contains("bad [m]") && text.contains("FAIL") && text.contains("2 cases, 1 failed"));
    }
}
