//! What `offline bench-diagnosis` promises of its runs: killed ones go on where they stopped, finished
//! answers are never made again, and the same cell gives the same answer.

use offline::bench_diagnosis::cells::{Cell, Extent, matrix};
use offline::bench_diagnosis::reality::Reality;
use offline::bench_diagnosis::run::{Answer, Said, file, run};
use offline::bench_diagnosis::{chosen, counted, table, truth};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;
use tests::reality::Rod;

/// A rope without any cause under so much noise that nothing but noise is left: the shortest diagnosis.
fn noisy(seed: u64) -> Cell {
    let extent = Extent {
        quick: true,
        seeds: 1,
        first_seed: seed,
        alone: false,
        clouds: false,
    };
    Cell {
        noise_mm: 10.0,
        ..matrix(&Rod.repertoire(), &extent)[0].clone()
    }
}

fn without_time(answer: &Answer) -> Answer {
    Answer {
        wall_s: 0.0,
        ..answer.clone()
    }
}

#[test]
fn a_whole_name_chooses_its_cell_alone_and_a_part_all_that_contain_it() {
    let extent = Extent {
        quick: true,
        seeds: 1,
        first_seed: 15,
        alone: false,
        clouds: false,
    };
    let names = |only: &str| {
        let cells = chosen(matrix(&Rod.repertoire(), &extent), &[only.to_owned()]);
        cells.iter().map(Cell::name).collect::<Vec<_>>()
    };
    let whole = "g3-tip_mass-5f-1mm-s15";
    assert_eq!(names(whole), [whole]);
    let part = names("g3-tip_mass-5f");
    assert!(part.len() > 1 && part.contains(&whole.to_owned()), "{part:?}");
}

#[test]
fn finished_answers_stay_and_missing_ones_are_made_the_same_again() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path();
    let cells = [noisy(2001), noisy(2002)];
    let make = |cell: &Cell| truth::make(&Rod, &cell.truth(), &out.join("truths")).unwrap();
    let [_, other] = [&cells[0], &cells[1]].map(make);
    let first = run(&cells[..1], out, &|_| {}).unwrap().answers.remove(0);
    assert_eq!(first.said, Said::Nothing, "{first:?}");

    // The other cell has an answer that tells whether it is kept; the first one's is cut short, as no write
    // of ours leaves it, and has to be made again.
    let marked = Answer {
        cell: cells[1].clone(),
        truth: other.fingerprint(),
        words: "kept".into(),
        ..first.clone()
    };
    std::fs::write(file(out, &marked.cell), serde_json::to_vec(&marked).unwrap()).unwrap();
    let whole = std::fs::read(file(out, &first.cell)).unwrap();
    std::fs::write(file(out, &first.cell), &whole[..whole.len() / 2]).unwrap();

    let second = run(&cells, out, &|_| {}).unwrap();
    assert_eq!(without_time(&second.answers[0]), without_time(&first));
    assert_eq!(second.answers[1].words, "kept");

    let text = table::text(&counted(&second));
    assert!(text.contains("G3, the independent rod"), "{text}");
    assert!(text.contains("0 of 2)"), "{text}");
}

/// Contents of the truths written so far; every one of them must be whole.
fn truths(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let Ok(entries) = std::fs::read_dir(folder.join("truths")) else {
        return BTreeMap::new();
    };
    let paths = entries.map(|entry| entry.unwrap().path());
    paths
        .filter(|path| path.extension().is_some_and(|e| e == "json"))
        .map(|path| {
            let bytes = std::fs::read(&path).unwrap();
            serde_json::from_slice::<truth::Truth>(&bytes)
                .unwrap_or_else(|error| panic!("{} is not whole: {error}", path.display()));
            (path, bytes)
        })
        .collect()
}

/// Starts the program that plays the rod, waits for more than `count` truths and kills it.
fn play_and_kill(folder: &Path, count: usize) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut child = Command::new(env!("CARGO_BIN_EXE_twin-truths"))
        .args(["--quick", "--out"])
        .arg(folder)
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    while truths(folder).len() <= count {
        assert!(child.try_wait().unwrap().is_none(), "it ended by itself");
        std::thread::sleep(Duration::from_millis(50));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    truths(folder)
}

#[test]
fn a_killed_run_goes_on_where_it_stopped() {
    let folder = tempfile::tempdir().unwrap();
    let before = play_and_kill(folder.path(), 1);
    let after = play_and_kill(folder.path(), before.len());
    assert!(after.len() > before.len());
    for (path, bytes) in &before {
        assert_eq!(&after[path], bytes, "{} was made again", path.display());
    }
}
