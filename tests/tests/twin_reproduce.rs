//! The sim2sim table once more, with the data made by the twin rod, whose physics is another:
//! `cargo test --release -p tests --test twin_reproduce -- --ignored --nocapture our_row`, without `our_row`
//! with the paper's estimator, which takes hours. With `intervals` how often the 95 % interval of E holds the rod's.

use offline::demo::Demo;
use offline::paper_units::{METRES_PER_UNIT, young_pa};
use offline::reproduce::coverage::Intervals;
use offline::reproduce::data::{STARTS, WHOLE_RANGE, draw};
use offline::reproduce::gradient::Steps;
use offline::reproduce::method::{Effort, Method, StepSizes};
use offline::reproduce::ours::{Fitted, Predicted, fit_clouds};
use offline::reproduce::real2sim::{case_of, last_state};
use offline::reproduce::table::{Row, Spread, Table, printed};
use offline::reproduce::{chamfer::chamfer, ours};
use offline::sim::scene::MIN_CELLS_PER_DIAMETER;
use tests::camera::SensorSpec;
use tests::effects::WorldEffects;
use tests::sample_rope::{leg, lift, material};
use tests::world::record_demo;

const SEED: u64 = 1;
const DENSITY_KG_M3: f64 = 1000.0;
const METHODS: [Method; 3] = [
    Method::Gradient {
        steps: Steps::All,
        sizes: StepSizes::Released,
    },
    Method::Gradient {
        steps: Steps::Last,
        sizes: StepSizes::Released,
    },
    Method::Ours,
];

/// Cameras that err by 0.1 mm.
const NEARLY_RIGHT: SensorSpec = SensorSpec {
    noise_m: 1e-4,
    quantum_m: 1e-6,
    dropout: 0.0,
    most_points: 1000,
};
/// Cameras that err by 2 mm, in steps of 1 mm, and lose one pixel in ten.
const NOISY: SensorSpec = SensorSpec {
    noise_m: 2e-3,
    quantum_m: 1e-3,
    dropout: 0.1,
    most_points: 1000,
};

/// The twin's rope with the given stiffness, lifted before two cameras.
fn recording(young_paper_units: f64, sensor: SensorSpec, index: u64) -> Demo {
    let mut material = material();
    material.young_pa = young_pa(young_paper_units, DENSITY_KG_M3);
    let mut spec = lift("twin", material, &[leg([0.0, 0.0, 0.225], 0.5)]);
    spec.sensor = sensor;
    record_demo(&spec, &WorldEffects::default(), index)
}

#[test]
#[ignore = "hours; prints a table"]
fn the_table_on_the_twins_data() {
    print_table(&METHODS);
}

#[test]
#[ignore = "minutes; prints a table"]
fn our_row_on_the_twins_data() {
    print_table(&[Method::Ours]);
}

/// The target of the issue: 5 % of the twin's bending stiffness.
fn print_table(methods: &[Method]) {
    let effort = Effort {
        iterations: 40,
        starts: ours::STARTS,
        seed: SEED,
        real: false,
    };
    let mut errors: Vec<(String, [Vec<f64>; 3])> = Vec::new();
    for index in 0..5 {
        let truth = draw(STARTS, SEED ^ 0x7477, index)[0];
        let case = case_of(&recording(truth, NEARLY_RIGHT, index), MIN_CELLS_PER_DIAMETER).unwrap();
        for &method in methods {
            for found in method.estimate(&case, &effort, index).unwrap() {
                let state_m = last_state(&case, found.parameters).unwrap();
                let distance = chamfer(&state_m, &case.last_m) / METRES_PER_UNIT;
                let miss = found.parameters[0] - truth;
                println!(
                    "{}: E {truth:.0}, off by {:.2} %, {:?}",
                    found.row,
                    100.0 * miss / truth,
                    found.fit
                );
                let at = errors.iter().position(|(row, _)| *row == found.row);
                let at = at.unwrap_or_else(|| {
                    errors.push((found.row.clone(), Default::default()));
                    errors.len() - 1
                });
                let values = [miss.abs(), found.parameters[1], distance];
                for (list, value) in errors[at].1.iter_mut().zip(values) {
                    list.push(value);
                }
            }
        }
    }
    let rows = errors.iter().map(|(name, [young, poisson, distance])| Row {
        name: name.clone(),
        young_units: Spread::of(young),
        poisson: Spread::of(poisson),
        chamfer_units: Spread::of(distance),
        printed: printed(name),
    });
    let table = Table {
        title: format!("Sim2sim on the twin rod's data, seed {SEED}"),
        rows: rows.collect(),
        errors: true,
        density_kg_m3: DENSITY_KG_M3,
        notes: vec![
            "The twin rod has Poisson's ratio 0.3 in its shear alone: its column shows the estimate itself."
                .into(),
            "Chamfer: the twin's visible surface against particles that fill the rope.".into(),
        ],
    };
    println!("{}", table.markdown());
}

/// Ropes whose intervals are asked.
const ROPES: u64 = 40;
/// Poisson's ratio of the rod, which has it in its shear alone.
const POISSON: f64 = 0.3;

/// What `offline reproduce coverage` asks of ropes that the simulator made, asked of the rod's before noisy cameras: the issue
/// wants 90 to 98 %. It fails where they hold too rarely; that they are too wide the README says.
#[test]
#[ignore = "a quarter of an hour; prints a table"]
fn intervals_on_the_twins_data() {
    let fit = |index: u64| {
        let truth = draw(WHOLE_RANGE, SEED ^ 0x696e, index)[0];
        let case = case_of(&recording(truth, NOISY, index), MIN_CELLS_PER_DIAMETER).unwrap();
        let fit = fit_clouds(
            &case.demo,
            &case.scene,
            case.section,
            (index, 2),
            Predicted::FinerGrid,
        )
        .unwrap();
        println!("{index}: E {truth:.0}: {fit:?}");
        ([truth, POISSON], fit)
    };
    let fits: Vec<([f64; 2], Fitted)> = (0..ROPES).map(fit).collect();
    let found = Intervals::of(&fits);
    println!("{}", found.markdown());
    let held = found.covered[0];
    let [_, high] = held.wilson().unwrap();
    assert!(high >= 0.9, "{} of {}", held.hits, held.of);
}
