//! What a result must not depend on: place, heading, and the number of threads.

use super::case::{Case, Of};
use super::golden::{bits, lift};
use super::setup::{DIAMETER_M, SOFT_PA, elastic, free_scene, knot, rope, start_grip};
use super::{Extent, Findings, Stepper};
use crate::sim::clamp::ClampPath;
use crate::sim::scene::{Scene, Table};
use crate::sim::{Physics, SimError, simulate};
use nalgebra::{Matrix3, Rotation3, Vector3};
use rayon::prelude::*;

const FAMILY: Of = Of("invariance");
/// Rounding of some thousand steps of a rope whose free motion is not chaotic.
const ROUNDING_M: f64 = 1e-9;

pub(super) fn verify(_extent: Extent) -> Findings {
    let mut cases = FAMILY.each("turned world", turned_world());
    cases.extend(FAMILY.each("turned lift", turned_lift()));
    cases.push(threads());
    cases.into()
}

/// The same state in a turned and moved world, gravity turned with it, steps the same way.
fn turned_world() -> Result<Vec<Case>, SimError> {
    let scene = free_scene([1.0, 0.0, 0.0], None);
    let gradient = Matrix3::new(2.0, 5.0, -9.0, -5.0, 0.0, 1.0, 12.0, 0.0, 0.0);
    let turn = Rotation3::from_euler_angles(0.4, -1.1, 2.3).into_inner();
    let shift = Vector3::new(0.31, -0.17, 1.93);
    let (level, mut turned) = (elastic(SOFT_PA), elastic(SOFT_PA));
    turned.gravity_m_s2 = (turn * Vector3::from(level.gravity_m_s2)).into();
    let mut here = Stepper::new(&scene, &level);
    here.set_motion(Vector3::new(0.2, 0.1, 0.0), gradient);
    let mut there = Stepper::new(&scene, &turned);
    there.set_motion(Vector3::new(0.2, 0.1, 0.0), gradient);
    there.place(&turn, &shift);
    here.advance(1500)?;
    there.advance(1500)?;
    let off = |(p, q): (&[f64; 3], &[f64; 3])| (turn * Vector3::from(*p) + shift - Vector3::from(*q)).norm();
    let pairs = here.particles.iter().zip(&there.particles);
    let worst = pairs
        .map(|(p, q)| off((&p.position_m, &q.position_m)))
        .fold(0.0, f64::max);
    Ok(vec![FAMILY.absolute(
        "flight in a turned and moved world",
        "m",
        [0.0, worst],
        ROUNDING_M,
    )])
}

/// A whole rollout with a moving grip and a table, turned about the vertical and moved.
fn turned_lift() -> Result<Vec<Case>, SimError> {
    let lifted = |angle: f64, shift: Vector3<f64>| -> Result<Vec<Vector3<f64>>, SimError> {
        let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), angle);
        let at = |x: f64, y: f64, z: f64| -> [f64; 3] { (turn * Vector3::new(x, y, z) + shift).into() };
        let path = ClampPath::new(vec![
            knot(0.0, at(0.0, 0.0, 0.0), [0.0; 3], true),
            knot(0.25, at(0.02, 0.03, 0.06), [0.0; 3], true),
        ]);
        let direction = (turn * Vector3::x()).into();
        let table = Some(Table {
            height_m: shift.z - 0.5 * DIAMETER_M,
        });
        let grips = start_grip(0.02, path);
        let shape = rope(0.12, DIAMETER_M);
        let scene = Scene::new(shape, shift.into(), direction, grips, table, 1.5, vec![0.4])?;
        let rollout = simulate(&scene, &elastic(SOFT_PA))?;
        let back = |p: &[f64; 3]| turn.inverse() * (Vector3::from(*p) - shift);
        Ok(rollout.frames[0].iter().map(back).collect())
    };
    let here = lifted(0.0, Vector3::zeros())?;
    let there = lifted(0.65, Vector3::new(-0.4, 0.23, 0.81))?;
    let pairs = here.iter().zip(&there);
    let worst = pairs.map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
    Ok(vec![FAMILY.absolute(
        "lift off a table, turned and moved",
        "m",
        [0.0, worst],
        ROUNDING_M,
    )])
}

/// Rollouts in single and in double precision on one, two and five threads: the same bits.
fn threads() -> Case {
    const NAME: &str = "same bits on 1, 2 and 5 threads";
    let run = |threads: usize| -> Option<Vec<u64>> {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .ok()?;
        let hashes = pool.install(|| {
            (0..10u32)
                .into_par_iter()
                .map(|k| {
                    let young_pa = SOFT_PA * (1.0 + f64::from(k / 2));
                    let scene = lift(0.05).ok()?;
                    if k % 2 == 0 {
                        let physics = elastic(young_pa);
                        return Some(bits(&simulate(&scene, &physics).ok()?));
                    }
                    let physics = Physics::base(young_pa as f32, 0.3f32, 0.5);
                    Some(bits(&simulate(&scene, &physics).ok()?))
                })
                .collect::<Vec<Option<u64>>>()
        });
        hashes.into_iter().collect()
    };
    let [one, two, five] = [1, 2, 5].map(run);
    let differ = |hashes: &[u64]| hashes.windows(2).any(|pair| pair[0] != pair[1]);
    let same = one.as_deref().is_some_and(differ) && one == two && one == five;
    FAMILY.holds(NAME, same)
}
