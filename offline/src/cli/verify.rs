//! `offline verify`: the simulator against what is known exactly.

use super::VerifyArguments;
use super::output::print;
use super::progress::Reporter;
use anyhow::Context;
use offline::plot::svg;
use offline::run_files::{prepare_folder, write_whole};
use offline::verify::{Extent, panels, random, table, verify};

/// Runs the suite, prints its table, writes it with its plots, and fails when a case does.
pub fn run(arguments: &VerifyArguments, json: bool) -> anyhow::Result<()> {
    let extent = if arguments.quick {
        Extent::Quick
    } else {
        Extent::Full
    };
    if let Some(out) = &arguments.out {
        prepare_folder(out)?;
    }
    let reporter = Reporter::new();
    reporter.say("comparing the simulator with what is known exactly");
    let mut report = verify(extent, &|line| reporter.say(line));
    if arguments.random > 0 {
        let progress = |progress| reporter.advance(progress);
        let outcomes = random::run(arguments.random, arguments.seed, &progress);
        report.cases.extend(outcomes.cases());
        report.random = Some(outcomes);
    }
    let text = serde_json::to_string_pretty(&report).context("a report can be written")?;
    if let Some(out) = &arguments.out {
        write_whole(&out.join("verify.json"), text.as_bytes())?;
        write_whole(&out.join("verify.txt"), table(&report).as_bytes())?;
        let plots = panels(&report.studies);
        if !plots.is_empty() {
            write_whole(&out.join("convergence.svg"), svg(&plots).as_bytes())?;
        }
    }
    if json {
        print(&text)?;
    } else {
        print(table(&report).trim_end())?;
    }
    let failures = report.failures();
    anyhow::ensure!(
        failures == 0,
        "{failures} of {} cases fail: see the lines that end in FAIL",
        report.cases.len()
    );
    Ok(())
}
