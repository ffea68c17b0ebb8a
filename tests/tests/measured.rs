//! Measured data of others: every data set imports, and what the fit says of real cables and wires.
//! The data are not part of the repository: `GENORM_DATA` names their folder, and without it these
//! tests say so and pass. The fits take minutes: `cargo test -p tests --release --test measured --
//! --ignored --nocapture`.

use offline::demo::{Demo, Observations, SceneKind, import, warnings};
use offline::fit::{FitOptions, Problem, Resolution, estimates, fit};
use offline::model::Structure;
use std::path::PathBuf;
use std::time::Instant;

/// The folder of a data set, if the data are here.
fn data(name: &str) -> Option<PathBuf> {
    let dir = std::env::var_os("GENORM_DATA").map(|root| PathBuf::from(root).join(name));
    let found = dir.filter(|dir| dir.is_dir());
    if found.is_none() {
        println!("skipped: GENORM_DATA names no folder with {name}");
    }
    found
}

/// Saved and loaded again, which checks everything that a folder has to obey.
fn round_trip(demos: &[Demo]) {
    let dir = tempfile::tempdir().unwrap();
    for demo in demos {
        let folder = dir.path().join(&demo.name);
        demo.save(&folder).unwrap();
        assert_eq!(&Demo::load(&folder).unwrap(), demo);
    }
}

#[test]
fn cables_import() {
    let Some(dir) = data("pac_cables") else { return };
    let demos = import::pac_cables(&dir).unwrap();
    assert_eq!(demos.len(), 11);
    round_trip(&demos);
    for demo in demos.iter().filter(|d| d.spec.scene == SceneKind::Static) {
        assert_eq!(warnings(demo), Vec::<String>::new(), "{}", demo.name);
        assert!(demo.spec.rope.end_mass_kg >= 0.03 && demo.spec.rope.assumed.is_empty());
    }
}

#[test]
fn wires_import() {
    let Some(dir) = data("wires") else { return };
    let demos = import::wires(&dir).unwrap();
    assert_eq!(demos.len(), 6);
    round_trip(&demos);
    for demo in &demos {
        assert_eq!(warnings(demo), Vec::<String>::new(), "{}", demo.name);
    }
}

#[test]
fn the_noodle_imports() {
    let Some(dir) = data("noodle") else { return };
    let demos = import::noodle(&dir, 25.0).unwrap();
    assert_eq!(demos.len(), 4);
    round_trip(&demos);
}

#[test]
fn ropes_held_at_both_ends_import() {
    let Some(dir) = data("deform") else { return };
    let demos = import::deform(&dir, 25.0).unwrap();
    assert!(demos.iter().all(|d| d.clamps.len() == 2));
    round_trip(&demos[..2]);
}

/// Every so many poses, as `GENORM_EVERY` says; all by default.
fn thinned(demo: &Demo) -> Demo {
    let every: usize = std::env::var("GENORM_EVERY").map_or(1, |n| n.parse().expect("a whole number"));
    let mut demo = demo.clone();
    let kept: Vec<f64> = demo.times_s().into_iter().step_by(every).collect();
    for path in &mut demo.clamps {
        path.retain(|sample| kept.contains(&sample.t_s));
    }
    if let Observations::Markers(markers) = &mut demo.observations {
        markers.retain(|marker| kept.contains(&marker.t_s));
    }
    demo
}

/// Fits one demonstration and prints its bending stiffness E I with the 95 % interval.
fn report(demo: &Demo, structure: &Structure) {
    let began = Instant::now();
    let problem = Problem::new(&[demo], Resolution { cells: 1.5 }).unwrap();
    let options = FitOptions {
        starts_pa: vec![1.0e6, 1.0e7],
        followed: 1,
        max_evaluations: 10,
    };
    match fit(&problem, structure, &options) {
        Ok(result) => {
            let list = estimates(&result.best, structure);
            let area_m4 = std::f64::consts::PI * demo.spec.rope.diameter_m.powi(4) / 64.0;
            let (young, half) = (list[0].value, 1.96 * list[0].standard_error);
            println!(
                "{}: E I = {:.4} [{:.4}, {:.4}] N m2, E = {:.3e} Pa, rms {:.2} mm, noise {:.2} mm, {:?}, \
                 {} evaluations, {:.0} s",
                demo.name,
                young * area_m4,
                (young - half) * area_m4,
                (young + half) * area_m4,
                young,
                1e3 * result.best.rms_m(),
                1e3 * result.best.floor_m(),
                result.stop,
                result.evaluations,
                began.elapsed().as_secs_f64()
            );
            for e in &list[1..] {
                println!(
                    "    {} = {:.4e} ± {:.1e} {}, identified {}",
                    e.name, e.value, e.standard_error, e.unit, e.identified
                );
            }
        }
        Err(error) => println!("{}: {error}", demo.name),
    }
}

/// Effects named in `GENORM_EFFECTS` (comma-separated) are fitted along.
fn structure() -> Structure {
    let named = std::env::var("GENORM_EFFECTS").unwrap_or_default();
    let names = named.split(',').filter(|name| !name.is_empty());
    Structure {
        effects: names
            .map(|n| offline::effects::find(n).expect("an effect of the registry"))
            .collect(),
    }
}

#[test]
#[ignore = "minutes; prints the figures of real cables"]
fn bending_stiffness_of_real_cables() {
    let Some(dir) = data("pac_cables") else { return };
    let demos = import::pac_cables(&dir).unwrap();
    for demo in demos.iter().filter(|d| d.spec.scene == SceneKind::Static) {
        report(&thinned(demo), &structure());
    }
}

#[test]
#[ignore = "minutes; prints the figures of real wires"]
fn bending_stiffness_of_real_wires() {
    let Some(dir) = data("wires") else { return };
    for demo in &import::wires(&dir).unwrap() {
        report(demo, &structure());
    }
}
