//! `offline bench-diagnosis`: how often the diagnosis is right.

use super::output::print;
use super::progress::Reporter;
use super::runs::set_threads;
use super::{BenchDiagnosisArguments, WrongUse};
use anyhow::Context;
use offline::bench_diagnosis::cells::{Cell, Extent};
use offline::bench_diagnosis::{chosen, counted, questions, run, table};
use offline::run_files::{prepare_folder, write_whole};

/// Diagnoses what is asked for and not yet there, counts all answers of the folder, prints and writes the
/// tables.
pub fn run(arguments: &BenchDiagnosisArguments, json: bool) -> anyhow::Result<()> {
    set_threads(arguments.threads)?;
    let reporter = Reporter::new();
    let extent = Extent {
        quick: arguments.quick,
        seeds: arguments.seeds,
        first_seed: arguments.first_seed,
        alone: arguments.alone,
        clouds: arguments.clouds,
    };
    let mut chosen = chosen(questions(&arguments.out, &extent)?, &arguments.only);
    if chosen.is_empty() {
        return Err(WrongUse(format!(
            "no cell's name contains any of {:?}: look at the names with --list",
            arguments.only
        ))
        .into());
    }
    if arguments.list {
        let names: Vec<String> = chosen.iter().map(Cell::name).collect();
        return print(if json {
            serde_json::to_string_pretty(&names)?
        } else {
            names.join("\n")
        });
    }
    if arguments.count {
        let out = &arguments.out;
        let rest;
        (chosen, rest) = chosen.into_iter().partition::<Vec<Cell>, _>(|cell| {
            run::answered(out, cell).is_some() || run::was_left_out(out, cell)
        });
        let others = rest.iter().filter(|cell| run::file(out, cell).exists()).count();
        if others > 0 {
            reporter.say(&format!(
                "{others} answers are of another version of the program, or to truths that are there no more, and not counted"
            ));
        }
    }
    if arguments.count && chosen.is_empty() {
        anyhow::bail!(
            "{} holds no answers to these cells: leave --count out to make them, or name their folder with --out",
            arguments.out.display()
        );
    }
    if chosen.iter().all(|cell| cell.world == "g2") {
        reporter.say(
            "no cells of the independent rod (G3): its program writes what happened, see offline bench-diagnosis --help",
        );
    }
    prepare_folder(&arguments.out)?;
    let answers = run::run(&chosen, &arguments.out, &|line| reporter.say(line))?;
    let tallies = counted(&answers);
    let text = table::text(&tallies);
    let machine = serde_json::to_string_pretty(&tallies).context("tallies can be written")?;
    write_whole(&arguments.out.join("bench-diagnosis.txt"), text.as_bytes())?;
    write_whole(&arguments.out.join("bench-diagnosis.json"), machine.as_bytes())?;
    print(if json { &machine } else { &text })
}
