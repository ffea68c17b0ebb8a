//! The tallies as text.

use super::tally::{Figure, Line, Tally};
use std::fmt::Write;

/// Columns of the words.
const WIDTH: usize = 76;

/// Everything that was counted, target beside value.
pub fn text(tallies: &[Tally]) -> String {
    let mut out = String::new();
    for tally in tallies {
        let source = match tally.world.as_str() {
            "g2" => "G2, the simulator on a finer grid with other particles and half the step",
            _ => "G3, the independent rod",
        };
        let judge = match tally.alone {
            true => "one recording, judged by parts of it that are not fitted",
            false => "one recording, judged by another",
        };
        let seen = match tally.clouds {
            true => "clouds of two depth cameras",
            false => "labelled points",
        };
        let _ = writeln!(out, "{source}; {judge}; {seen}\n");
        lines(&mut out, &tally.lines);
        let _ = writeln!(out, "\nWith parts of the method left out:");
        lines(&mut out, &tally.ablations);
        let _ = writeln!(out, "\nTrue cause, and how often what was named:");
        for (truth, named) in &tally.confusion {
            let counts: Vec<String> = named.iter().map(|(name, n)| format!("{name} {n}")).collect();
            let _ = writeln!(out, "  {truth:32} {}", counts.join(", "));
        }
        out.push('\n');
    }
    out
}

fn lines(out: &mut String, lines: &[Line]) {
    for line in lines {
        let met = match (line.met, line.sure) {
            (None, _) => "not measured",
            (Some(true), true) => "met",
            (Some(false), true) => "missed",
            (Some(true), false) => "met by these, too few to tell",
            (Some(false), false) => "missed by these, too few to tell",
        };
        let judged = match &line.target {
            None => "counted".into(),
            Some(target) => format!("target {target}: {met}"),
        };
        let _ = writeln!(out, "  {:WIDTH$} {:34} {judged}", line.what, figure(&line.figure));
    }
}

fn figure(figure: &Figure) -> String {
    match figure {
        Figure::Rate(rate) => match (rate.share(), rate.wilson()) {
            (Some(share), Some([low, high])) => format!(
                "{:5.1} % ({:.1} to {:.1}, {} of {})",
                100.0 * share,
                100.0 * low,
                100.0 * high,
                rate.hits,
                rate.of
            ),
            _ => "-".into(),
        },
        Figure::Number(Some(value), n) => format!("{value:7.3} (n = {n})"),
        Figure::Number(None, _) => "-".into(),
        Figure::Count(count) => format!("{count:7}"),
    }
}

#[cfg(test)]
mod tests {
    use super::super::tally::tally;
    use super::super::tally::tests::answer;
    use super::*;

    #[test]
    fn targets_stand_beside_values_and_misses_are_said() {
        let answers = [
            answer(&[], 0.0, &["air_drag"], &[]),
            answer(&["tip_mass"], 5.0, &["tip_mass"], &[]),
        ];
        let text = text(&[tally("g2", &answers, &[], 0.1)]);
        let line = |start: &str| {
            text.lines()
                .find(|l| l.trim_start().starts_with(start))
                .unwrap()
                .to_owned()
        };
        assert!(line("no effect").contains("100.0 % (20.7 to 100.0, 1 of 1)"));
        assert!(
            line("no effect").ends_with("target at most 5 %: missed"),
            "20.7 % are too many as well"
        );
        assert!(line("single effect, 2").ends_with(": met by these, too few to tell"));
        assert!(line("mean size").ends_with("at most 1.5: met"));
        assert!(line("the proposed").ends_with(": not measured"));
        assert!(line("tip_mass").ends_with("tip_mass 1"));
    }
}
