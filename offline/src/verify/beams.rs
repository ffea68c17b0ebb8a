//! Rest shapes: a level cantilever, small and large deflection, and a rope that hangs and stretches.

use super::case::{Case, Of};
use super::reference::{Rod, hanging_elongation_m, heavy_elastica};
use super::setup::{DENSITY_KG_M3, DIAMETER_M, G_M_S2, elastic, knot, rope, scene, start_grip, tip};
use super::study::{Study, on_grid};
use super::{Extent, Findings};
use crate::sim::clamp::ClampPath;
use crate::sim::scene::Settling;
use crate::sim::{SimError, simulate};

const FAMILY: Of = Of("statics");
/// What the program promises of bending.
const SAG: f64 = 0.05;
/// Tip of a large deflection, as a share of the free length.
const TIP: f64 = 0.02;
/// Stretch: the clamp's springs give by (EA/k)^½ = 0.16 cells at either side of its edge, 2 % of this
/// rope's elongation on the coarsest grid.
const STRETCH: f64 = 0.03;
/// A clamp's edge is found to a share of a cell: first order; half an order is left for the change of
/// the number of particles from grid to grid.
const CLAMPED_ORDER: f64 = 0.5;

/// A millimetre between two ways to the same rest shape.
const LIFTED_M: f64 = 1e-3;

/// Length of rope in the clamp, in diameters.
const GRIP_DIAMETERS: f64 = 1.5;
/// ω t until which a critically damped rope settles: (1 + ω t) e^{−ω t} is then 8e-5.
const SETTLED: f64 = 12.0;

pub(super) fn verify(extent: Extent) -> Findings {
    let mut found = Findings::default();
    let studies = [
        ("sag", small_sag(extent), SAG),
        ("elastica", elastica(extent), TIP),
        ("stretch", stretch(extent), STRETCH),
    ];
    for (name, study, tolerance) in studies {
        match study {
            Ok(study) => {
                found.cases.extend(study.cases(FAMILY, tolerance, CLAMPED_ORDER));
                found.studies.push(study);
            }
            Err(error) => found.cases.push(FAMILY.stopped(name, &error)),
        }
    }
    found.cases.extend(FAMILY.each("lifted", lifted()));
    found
}

/// Where the tip comes to rest below a level clamp does not depend on a lift by `lift_m` before; the
/// updated-Lagrangian form of the method was 27 mm off here (`sim/grid.rs`).
fn lifted() -> Result<Vec<Case>, SimError> {
    let tip_below = |lift_m: f64| -> Result<f64, SimError> {
        let end_s = 2.4;
        let path = ClampPath::new(vec![
            knot(0.0, [0.0; 3], [0.0; 3], true),
            knot(0.8, [0.0, 0.0, lift_m], [0.0; 3], true),
        ]);
        let shape = rope(0.25, DIAMETER_M);
        let mut scene = scene(shape, [1.0, 0.0, 0.0], start_grip(0.02, path), None, 1.5, end_s)?;
        scene.settling = Some(Settling {
            until_s: end_s,
            rate_per_s: 18.0,
            still_m_s: 0.0,
        });
        Ok(tip(&scene, &simulate(&scene, &elastic(0.9e6))?.frames[0])[2] - lift_m)
    };
    let pair = [tip_below(0.0)?, tip_below(0.3)?];
    Ok(vec![FAMILY.absolute(
        "tip of a rope at rest after a lift, as without it",
        "m",
        pair,
        LIFTED_M,
    )])
}

/// Tip of a rope clamped at its start in the direction given, at rest, relative to the clamp's edge.
fn rest_tip_m(
    free_m: f64,
    young_pa: f64,
    direction: [f64; 3],
    slowest_rad_s: f64,
    cells: f64,
    shift_cells: [f64; 3],
) -> Result<[f64; 3], SimError> {
    let grip_m = GRIP_DIAMETERS * DIAMETER_M;
    let grips = start_grip(grip_m, ClampPath::fixed([0.0; 3]));
    let end_s = SETTLED / slowest_rad_s;
    let shape = rope(grip_m + free_m, DIAMETER_M);
    let mut scene = on_grid(
        scene(shape, direction, grips, None, 1.5, end_s)?,
        cells,
        shift_cells,
    );
    scene.settling = Some(Settling {
        until_s: end_s,
        rate_per_s: 2.0 * slowest_rad_s,
        still_m_s: 0.0,
    });
    let end = tip(&scene, &simulate(&scene, &elastic(young_pa))?.frames[0]);
    Ok(std::array::from_fn(|k| end[k] - grip_m * direction[k]))
}

/// First bending mode of a cantilever, rad/s: 3.516 (EI/ρA)^½/L².
fn cantilever_rad_s(rod: &Rod) -> f64 {
    3.516 * (rod.bending_n_m2 / rod.mass_kg_m).sqrt() / rod.length_m.powi(2)
}

/// A cantilever of ten diameters that sags by 1 % of its length.
fn small_sag(extent: Extent) -> Result<Study, SimError> {
    let length_m = 10.0 * DIAMETER_M;
    let young_pa = 2.0 * DENSITY_KG_M3 * G_M_S2 * length_m.powi(3) / (0.01 * DIAMETER_M.powi(2));
    let rod = Rod::round(length_m, DIAMETER_M, young_pa);
    let (spacings, alignments) = Study::plan(extent);
    Study::run(
        "sag of a cantilever",
        "m",
        rod.sag_m(),
        spacings,
        alignments,
        |cells, shift| {
            let slowest = cantilever_rad_s(&rod);
            Ok(-rest_tip_m(length_m, young_pa, [1.0, 0.0, 0.0], slowest, cells, shift)?[2])
        },
    )
}

/// The paper's rope in its middle stiffness, clamped level: the tip hangs two thirds of its length low.
/// The study's quantity is the free length plus the tip's miss, so that errors are shares of the length.
fn elastica(extent: Extent) -> Result<Study, SimError> {
    const FREE_M: f64 = 0.23;
    const YOUNG_PA: f64 = 0.9e6;
    let rod = Rod::round(FREE_M, DIAMETER_M, YOUNG_PA);
    let exact = heavy_elastica(&rod).tip_m;
    let (spacings, alignments) = Study::plan(extent);
    Study::run(
        "elastica, L plus miss of the tip",
        "m",
        FREE_M,
        spacings,
        alignments,
        |cells, shift| {
            let slowest = cantilever_rad_s(&rod);
            let tip = rest_tip_m(FREE_M, YOUNG_PA, [1.0, 0.0, 0.0], slowest, cells, shift)?;
            Ok(FREE_M + (tip[0] - exact[0]).hypot(tip[2] - exact[1]))
        },
    )
}

/// A rope hangs straight down and stretches by half a percent.
fn stretch(extent: Extent) -> Result<Study, SimError> {
    let length_m = 12.0 * DIAMETER_M;
    let young_pa = 100.0 * DENSITY_KG_M3 * G_M_S2 * length_m;
    let expected = hanging_elongation_m(length_m, young_pa);
    let rod = Rod::round(length_m, DIAMETER_M, young_pa);
    let slowest = std::f64::consts::FRAC_PI_2 * (rod.axial_n / rod.mass_kg_m).sqrt() / length_m;
    let (spacings, alignments) = Study::plan(extent);
    Study::run(
        "stretch of a hanging rope",
        "m",
        expected,
        spacings,
        alignments,
        |cells, shift| {
            let tip = rest_tip_m(length_m, young_pa, [0.0, 0.0, -1.0], slowest, cells, shift)?;
            Ok(-tip[2] - length_m)
        },
    )
}
