//! The sim2sim table once more, with the data made by the twin rod, whose physics is another:
//! `cargo test --release -p tests --test twin_reproduce -- --ignored --nocapture our_row`, without `our_row`
//! with the paper's estimator, which takes hours.

use offline::demo::Demo;
use offline::paper_units::{METRES_PER_UNIT, young_pa};
use offline::reproduce::data::{STARTS, draw};
use offline::reproduce::gradient::Steps;
use offline::reproduce::method::{Effort, Method, StepSizes};
use offline::reproduce::real2sim::{case_of, last_state};
use offline::reproduce::table::{Row, Spread, Table, printed};
use offline::reproduce::{chamfer::chamfer, ours};
use offline::sim::scene::MIN_CELLS_PER_DIAMETER;
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

/// The twin's rope with the given stiffness, lifted before two cameras that err by 0.1 mm.
fn recording(young_paper_units: f64, index: u64) -> Demo {
    let mut material = material();
    material.young_pa = young_pa(young_paper_units, DENSITY_KG_M3);
    let mut spec = lift("twin", material, &[leg([0.0, 0.0, 0.225], 0.5)]);
    spec.sensor.noise_m = 1e-4;
    spec.sensor.quantum_m = 1e-6;
    spec.sensor.dropout = 0.0;
    spec.sensor.most_points = 1000;
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
        let case = case_of(&recording(truth, index), MIN_CELLS_PER_DIAMETER).unwrap();
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
