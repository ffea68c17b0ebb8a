//! Random demonstrations: what is saved loads again, with every number as it was.

use super::*;
use proptest::prelude::*;

fn coordinate() -> impl Strategy<Value = f64> {
    (-2.0f32..2.0).prop_map(f64::from)
}

fn point() -> impl Strategy<Value = [f64; 3]> {
    [coordinate(), coordinate(), coordinate()]
}

fn turn() -> impl Strategy<Value = [f64; 4]> {
    [-1.0f64..1.0, -1.0f64..1.0, -1.0f64..1.0, 0.1f64..1.0].prop_map(|q: [f64; 4]| {
        let norm = q.iter().map(|x| x * x).sum::<f64>().sqrt();
        q.map(|x| x / norm)
    })
}

fn times(count: usize) -> impl Strategy<Value = Vec<f64>> {
    prop::collection::vec(1e-4f64..0.1, count).prop_map(|steps| {
        let mut t = -0.05;
        let next = |step: f64| {
            t += step;
            t
        };
        steps.into_iter().map(next).collect()
    })
}

fn path() -> impl Strategy<Value = Vec<ClampSample>> {
    let rest = prop::collection::vec((point(), turn(), any::<bool>()), 4);
    (times(4), rest).prop_map(|(times, rest)| {
        let join = |(t_s, (position_m, quaternion_xyzw, closed)): (f64, _)| ClampSample {
            t_s,
            position_m,
            quaternion_xyzw,
            closed,
        };
        let mut path: Vec<ClampSample> = times.into_iter().zip(rest).map(join).collect();
        path[0].closed = true;
        path
    })
}

fn clouds() -> impl Strategy<Value = Observations> {
    let points = prop::collection::vec(prop::collection::vec(point(), 1..20), 3);
    (times(3), points).prop_map(|(times, points)| {
        let join = |(t_s, points_m)| CloudFrame { t_s, points_m };
        Observations::Clouds(times.into_iter().zip(points).map(join).collect())
    })
}

fn markers() -> impl Strategy<Value = Observations> {
    (times(3), prop::collection::vec(point(), 6), 0.0f64..0.25).prop_map(|(times, points, s)| {
        let sample = |index: usize, position_m: [f64; 3]| MarkerSample {
            t_s: times[index / 2],
            marker: format!("m{}", index % 2),
            s_m: if index.is_multiple_of(2) { s } else { 0.25 },
            position_m,
        };
        Observations::Markers(
            points
                .into_iter()
                .enumerate()
                .map(|(i, p)| sample(i, p))
                .collect(),
        )
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn what_is_saved_loads_again(
        path in path(),
        commanded in prop::option::of(path()),
        observations in prop_oneof![clouds(), markers()],
        notes in "[ -~äµ\n\"]{0,40}",
        friction in 0.0f64..2.0,
        noise_m in 1e-6f64..0.02,
        direction in turn(),
    ) {
        let mut demo = cloud_demo();
        demo.spec.notes = notes;
        demo.spec.table.as_mut().expect("it lies on a table").friction = friction;
        demo.spec.noise_m = noise_m;
        demo.spec.cameras[0].quaternion_xyzw = direction;
        demo.clamps = vec![path];
        demo.commanded = vec![commanded];
        demo.observations = observations;
        let (_parent, dir) = saved(&demo);
        let loaded = Demo::load(&dir).expect("it was saved");
        demo.clamps.iter_mut().for_each(|path| same_signs(path));
        demo.commanded.iter_mut().flatten().for_each(|path| same_signs(path));
        prop_assert_eq!(loaded, demo);
    }
}
