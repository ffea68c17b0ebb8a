//! What cannot be true of a rope: scales, axes, clamps and cameras that contradict each other.

use super::rest::has_moved;
use super::straight::{straight_markers, straight_start};
use super::summary::{Frame, distance, fastest, frames, known_s, share_under_table, usual_gap_s};
use super::{ClampSample, Demo, DemoError, MarkerSample, Observations, RopeEnd, SceneKind, StartState};
use crate::words::significant;
use std::path::Path;

/// Stretch and error of arc lengths that a chord may show.
const CHORD_ALLOWED: f64 = 1.05;
/// If no two neighbouring markers ever come nearer to being stretched out than this share of the rope
/// between them, the scale is too small.
const CHORD_LEAST: f64 = 0.9;
/// Share of rows, frames or points that may break a rule before it is said.
pub(super) const FEW: f64 = 0.05;

/// Latest begin of a recording and longest one, s: a rope does not hang still for a minute before its demonstration,
/// nor is it moved for an hour.
const LATEST_BEGIN_S: f64 = 60.0;
const LONGEST_S: f64 = 3600.0;
/// A clamp that moves, but never so fast, m/s, before a camera that takes so long from frame to frame, s: the times are
/// hardly in seconds.
const SLOWEST_M_S: f64 = 1e-3;
const SLOWEST_FRAMES_S: f64 = 2.0;
/// No gripper is faster, m/s: an arm's flange moves at 1 m/s, a hand at a few, a whip's tip at hundreds.
const FASTEST_M_S: f64 = 30.0;
/// Share of frames or points from which on nearly all of them break a rule.
const NEARLY_ALL: f64 = 1.0 - FEW;
/// Share of frames that may lie outside the time for which a clamp's path is known.
const UNKNOWN_FRAMES: f64 = 0.1;

/// What keeps a demonstration's clock from being simulated, and what to do: simulations begin at zero.
pub fn clock_problem(demo: &Demo) -> Option<[String; 2]> {
    let Span { first_s, last_s } = span(demo);
    // A rope that moves at first does so at zero, which has been seen to; its clamps may have been recorded before.
    let moves = demo.spec.start == StartState::Moving;
    let offset = first_s < 0.0 && !moves || first_s > LATEST_BEGIN_S && !demo.spec.is_static();
    if last_s - first_s > LONGEST_S && !demo.spec.is_static() {
        Some([
            format!(
                "its times go from {} to {} s, which is more than an hour",
                significant(first_s),
                significant(last_s)
            ),
            "give all of them in seconds and by one clock".into(),
        ])
    } else if offset {
        Some([
            format!("its times begin at {first_s} s, simulations at 0"),
            "let `offline demo cut FOLDER --out NEW` shift them".into(),
        ])
    } else {
        None
    }
}

/// What cannot be true of any rope, or cannot be simulated, and what to do about it.
pub(super) fn impossibility(demo: &Demo, frames: &[Frame<'_>]) -> Option<[String; 2]> {
    let moves = !demo.spec.is_static();
    clock_problem(demo)
        .or_else(|| leap(demo).filter(|_| moves))
        .or_else(|| slow_motion(demo, frames).filter(|_| moves))
        .or_else(|| path_ends_early(demo, frames).filter(|_| moves))
        .or_else(|| under_the_table(demo, frames))
        .or_else(|| out_of_reach(demo, frames))
}

fn leap(demo: &Demo) -> Option<[String; 2]> {
    // Where an open gripper goes is of no concern.
    let held =
        |path: &Vec<ClampSample>| fastest(path.split(|sample| !sample.closed).next().unwrap_or_default());
    let speeds = demo.clamps.iter().map(held);
    let (index, fastest_m_s) = speeds.enumerate().find(|(_, speed)| *speed > FASTEST_M_S)?;
    Some([
        format!("clamp {index} moves at up to {} m/s", significant(fastest_m_s)),
        "give its path in metres and its times in seconds, without leaps".into(),
    ])
}

fn slow_motion(demo: &Demo, frames: &[Frame<'_>]) -> Option<[String; 2]> {
    let fastest_m_s = demo.clamps.iter().map(|path| fastest(path)).fold(0.0, f64::max);
    let frame_s = usual_gap_s(frames)?;
    (fastest_m_s > 0.0 && fastest_m_s < SLOWEST_M_S && frame_s > SLOWEST_FRAMES_S).then(|| {
        [
            format!(
                "its frames are {frame_s:.1} s apart and its clamp moves at {fastest_m_s:.1e} m/s at most"
            ),
            "give all times in seconds".into(),
        ]
    })
}

fn path_ends_early(demo: &Demo, frames: &[Frame<'_>]) -> Option<[String; 2]> {
    let unknown = |path: &Vec<ClampSample>| {
        let (known, opened) = (known_s(path), path.last().is_some_and(|last| !last.closed));
        let lacks = |t_s: f64| t_s < *known.start() || t_s > *known.end() && !opened;
        let out = frames.iter().filter(|frame| lacks(frame.t_s)).count();
        (out as f64 > UNKNOWN_FRAMES * frames.len() as f64).then_some(out)
    };
    let (index, out) = demo
        .clamps
        .iter()
        .enumerate()
        .find_map(|(index, path)| Some((index, unknown(path)?)))?;
    Some([
        format!(
            "{out} of {} frames lie outside the time for which the path of clamp {index} is known",
            frames.len()
        ),
        "give the whole path, by the clock of the frames, or let `offline demo cut` leave those frames out"
            .into(),
    ])
}

fn under_the_table(demo: &Demo, frames: &[Frame<'_>]) -> Option<[String; 2]> {
    let under = share_under_table(demo, frames)?;
    (under > NEARLY_ALL).then(|| {
        [
            format!("{:.0} % of the points lie under the table", 100.0 * under),
            "correct table.height_m, m, and see that z points up".into(),
        ]
    })
}

/// No point of a rope is farther from a clamp that holds it than the rope is long.
fn out_of_reach(demo: &Demo, frames: &[Frame<'_>]) -> Option<[String; 2]> {
    let length_m = demo.spec.rope.length_m + 5.0 * demo.spec.noise_m;
    let far = |path: &Vec<ClampSample>| {
        let nearest = nearest_to_clamp(path, frames);
        let far = nearest
            .iter()
            .filter(|&&distance_m| distance_m > length_m)
            .count();
        !nearest.is_empty() && far as f64 > NEARLY_ALL * nearest.len() as f64
    };
    let index = demo.clamps.iter().position(far)?;
    Some([
        format!("nothing is ever seen within the rope's length of clamp {index}"),
        "give points, clamp paths and length_m in metres and in one frame".into(),
    ])
}

/// How near the nearest point of each frame is to a clamp while it is closed, m.
fn nearest_to_clamp(path: &[ClampSample], frames: &[Frame<'_>]) -> Vec<f64> {
    let nearest = |frame: &Frame<'_>| {
        let pose = clamp_at(path, frame.t_s)?;
        let distances = frame.points.iter().map(|p| distance(p, &pose.position_m));
        Some(distances.fold(f64::INFINITY, f64::min))
    };
    frames.iter().filter_map(nearest).collect()
}

impl Demo {
    /// As [`Self::load`], for a simulation.
    ///
    /// # Errors
    /// Also where it [cannot be simulated](Self::for_a_simulation).
    pub fn load_to_simulate(dir: impl AsRef<Path>) -> Result<Self, DemoError> {
        Self::load(&dir)?.for_a_simulation(dir)
    }

    /// Itself, as it was read from a folder, in the plane where it is planar.
    ///
    /// # Errors
    /// It cannot be true of any rope, or no simulation begins with its clock.
    pub fn for_a_simulation(self, dir: impl AsRef<Path>) -> Result<Self, DemoError> {
        let demo = self.in_plane();
        match impossibility(&demo, &frames(&demo)) {
            Some([problem, remedy]) => Err(DemoError::new(dir.as_ref(), problem, remedy)),
            None => Ok(demo),
        }
    }

    /// Where only x and z were measured, whatever stands for y is made that of the first clamp, or zero.
    pub(super) fn in_plane(mut self) -> Self {
        if !self.spec.planar {
            return self;
        }
        let first = self.clamps.first().and_then(|path| path.first());
        let y_m = first.map_or(0.0, |sample| sample.position_m[1]);
        let commanded = self.commanded.iter_mut().flatten();
        let samples = self.clamps.iter_mut().chain(commanded).flatten();
        samples.for_each(|sample| sample.position_m[1] = y_m);
        match &mut self.observations {
            Observations::Markers(samples) => samples.iter_mut().for_each(|m| m.position_m[1] = y_m),
            Observations::Clouds(frames) => {
                let points = frames.iter_mut().flat_map(|frame| &mut frame.points_m);
                points.for_each(|point| point[1] = y_m);
            }
        }
        self
    }
}

/// First and last time of clamps and frames.
pub(super) struct Span {
    pub(super) first_s: f64,
    pub(super) last_s: f64,
}

pub(super) fn span(demo: &Demo) -> Span {
    let of_clamps = demo.clamps.iter().flatten().map(|sample| sample.t_s);
    let times = || of_clamps.clone().chain(demo.times_s());
    Span {
        first_s: times().fold(f64::INFINITY, f64::min),
        last_s: times().fold(f64::NEG_INFINITY, f64::max),
    }
}

/// Everything that contradicts itself, one line each.
pub(super) fn contradictions(demo: &Demo, frames: &[Frame<'_>]) -> Vec<String> {
    let mut found: Vec<String> = impossibility(demo, frames)
        .map(|said| said.join("; "))
        .into_iter()
        .collect();
    match &demo.observations {
        Observations::Markers(samples) => {
            found.extend(chords(demo, samples));
            found.extend(markers_off_clamps(demo, samples));
        }
        Observations::Clouds(_) => found.extend(clouds_off_clamps(demo, frames)),
    }
    let straight = demo.spec.start == StartState::Straight;
    if straight && matches!(demo.spec.scene, SceneKind::Lift | SceneKind::Swing) {
        found.extend(match &demo.observations {
            Observations::Clouds(_) => straight_start(demo, frames),
            Observations::Markers(samples) => straight_markers(demo, samples).into_iter().collect(),
        });
    }
    let last_s = frames.last().map_or(0.0, |frame| frame.t_s);
    for (index, path) in demo.clamps.iter().enumerate() {
        found.extend(gripping(path, last_s).map(|wrong| format!("clamp {index} {wrong}")));
    }
    found
}

/// What is odd in when a clamp holds, as far as it is simulated: one that holds the rope opens once, or never, and grips what
/// lies where it stood at first.
fn gripping(path: &[ClampSample], last_s: f64) -> Option<String> {
    if !path.iter().any(|sample| sample.closed) {
        return Some("never holds the rope; give closed = 1 for as long as it does".into());
    }
    let elsewhere =
        |sample: &ClampSample| has_moved(sample, &path[0]) && (0.0..=last_s).contains(&sample.t_s);
    let mut pairs = path.windows(2);
    let again = pairs.find(|pair| !pair[0].closed && pair[1].closed && elsewhere(&pair[1]))?;
    Some(format!(
        "closes at {:.2} s where it did not stand at first, and would drag there what it holds then; `offline demo cut` keeps \
         what is before (--to) or after (--from), and closed = 1 means that it holds",
        again[1].t_s
    ))
}

/// Sample of a clamp before or at a time, the first before that.
pub(super) fn sample_at(path: &[ClampSample], t_s: f64) -> &ClampSample {
    let after = path.partition_point(|sample| sample.t_s <= t_s + 1e-9);
    &path[after.saturating_sub(1)]
}

/// The same while the clamp holds; none while it is open.
fn clamp_at(path: &[ClampSample], t_s: f64) -> Option<&ClampSample> {
    Some(sample_at(path, t_s)).filter(|sample| sample.closed)
}

/// A chord is never longer than its arc, and somewhere, some time, almost as long.
fn chords(demo: &Demo, samples: &[MarkerSample]) -> Vec<String> {
    let slack = 5.0 * demo.spec.noise_m;
    let (mut pairs, mut long, mut straightest) = (0usize, 0usize, 0f64);
    for group in samples.chunk_by(|a, b| a.t_s == b.t_s) {
        let mut group: Vec<&MarkerSample> = group.iter().collect();
        group.sort_by(|a, b| a.s_m.total_cmp(&b.s_m));
        for pair in group.windows(2) {
            let arc = pair[1].s_m - pair[0].s_m;
            let chord = distance(&pair[0].position_m, &pair[1].position_m);
            if arc > 2.0 * slack {
                pairs += 1;
                long += usize::from(chord > CHORD_ALLOWED * arc + slack);
                straightest = straightest.max((chord + slack) / arc);
            }
        }
    }
    let mut found = Vec::new();
    if long as f64 > FEW * pairs as f64 {
        found.push(format!(
            "{:.0} % of neighbouring markers are farther apart than the rope between them is long; \
             check the scale (metres) and the markers' s_m",
            100.0 * long as f64 / pairs as f64
        ));
    }
    if pairs > 0 && straightest < CHORD_LEAST {
        found.push(format!(
            "neighbouring markers are never farther apart than {:.0} % of the rope between them; \
             check the scale (metres) and the markers' s_m",
            100.0 * straightest
        ));
    }
    found
}

/// A marker is never farther from a clamp than the rope between them is long.
fn markers_off_clamps(demo: &Demo, samples: &[MarkerSample]) -> Vec<String> {
    let slack = 5.0 * demo.spec.noise_m;
    let mut found = Vec::new();
    for (index, (clamp, path)) in demo.spec.clamps.iter().zip(&demo.clamps).enumerate() {
        let s_clamp = match clamp.end {
            RopeEnd::Start => 0.0,
            RopeEnd::End => demo.spec.rope.length_m,
        };
        let (mut all, mut far) = (0usize, 0usize);
        for marker in samples {
            if let Some(pose) = clamp_at(path, marker.t_s) {
                let arc = (marker.s_m - s_clamp).abs();
                all += 1;
                far +=
                    usize::from(distance(&marker.position_m, &pose.position_m) > CHORD_ALLOWED * arc + slack);
            }
        }
        if far as f64 > FEW * all as f64 {
            found.push(format!(
                "{:.0} % of the markers are farther from clamp {index} than the rope between them is long; \
                 does the clamp's path touch the rope? check axes, scale, clock and which end is gripped",
                100.0 * far as f64 / all as f64
            ));
        }
    }
    found
}

/// Some part of the rope is seen near every closed clamp in almost every frame.
fn clouds_off_clamps(demo: &Demo, frames: &[Frame<'_>]) -> Vec<String> {
    let mut found = Vec::new();
    for (index, (clamp, path)) in demo.spec.clamps.iter().zip(&demo.clamps).enumerate() {
        let allowed = clamp.grip_m + 2.0 * demo.spec.rope.diameter_m + 5.0 * demo.spec.noise_m;
        let nearest = nearest_to_clamp(path, frames);
        let (all, off) = (nearest.len(), nearest.iter().filter(|&&d| d > allowed).count());
        if off as f64 > FEW * all as f64 {
            found.push(format!(
                "in {:.0} % of the frames no point lies within {:.0} mm of clamp {index}: its path does not touch \
                 the rope; check its axes, its offset and the clocks",
                100.0 * off as f64 / all as f64,
                1e3 * allowed
            ));
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::demo::straight::upside_down;
    use crate::demo::warnings;
    use nalgebra::Vector3;
    use std::path::Path;

    fn shipped() -> Demo {
        let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("demos/sample-rope/fit");
        Demo::load(dir).expect("the shipped demo loads")
    }

    fn warned(demo: &Demo, of: &str) {
        let found = warnings(demo);
        assert!(found.iter().any(|warning| warning.contains(of)), "{found:?}");
    }

    fn clouds(demo: &mut Demo) -> impl Iterator<Item = &mut [f64; 3]> {
        let Observations::Clouds(frames) = &mut demo.observations else {
            panic!("the shipped demo has clouds");
        };
        frames.iter_mut().flat_map(|frame| &mut frame.points_m)
    }

    /// Points on the half of the rope's side that looks at the first camera come from it, about.
    #[test]
    fn one_camera_upside_down_is_named() {
        let mut demo = shipped();
        let camera = demo.spec.cameras[0].clone();
        let y = demo.clamps[0][0].position_m[1];
        for point in clouds(&mut demo).filter(|p| p[1] > y) {
            *point = upside_down(&camera, &Vector3::from(*point)).into();
        }
        warned(&demo, &format!("camera '{}'", camera.name));
        warned(&demo, "upside down");
    }

    #[test]
    fn a_wrong_scale_is_noticed_in_either_direction() {
        for scale in [0.5, 1.1, 2.0] {
            let mut demo = shipped();
            let start = demo.clamps[0][0].position_m;
            for point in clouds(&mut demo) {
                *point = std::array::from_fn(|k| start[k] + scale * (point[k] - start[k]));
            }
            warned(&demo, "check the scale");
        }
    }

    fn refused(spoil: impl Fn(&mut Demo), of: &str) {
        let mut demo = shipped();
        spoil(&mut demo);
        let [problem, remedy] = impossibility(&demo, &frames(&demo)).expect("it cannot be true");
        assert!(problem.contains(of), "{problem}");
        assert!(!remedy.is_empty());
        warned(&demo, of);
    }

    #[test]
    fn what_cannot_be_true_of_a_rope_is_no_demonstration() {
        let sound = shipped();
        assert_eq!(impossibility(&sound, &frames(&sound)), None);
        let slower = |demo: &mut Demo| {
            let Observations::Clouds(frames) = &mut demo.observations else {
                panic!("the shipped demo has clouds");
            };
            frames.iter_mut().for_each(|frame| frame.t_s *= 1e3);
            demo.clamps[0].iter_mut().for_each(|sample| sample.t_s *= 1e3);
        };
        refused(slower, "s apart and its clamp moves at");
        let leaps = |demo: &mut Demo| demo.clamps[0][50].position_m[0] += 1.0;
        refused(leaps, "clamp 0 moves at up to");
        let cut = |demo: &mut Demo| demo.clamps[0].truncate(49);
        refused(cut, "the path of clamp 0 is known");
        let high = |demo: &mut Demo| demo.spec.table.as_mut().unwrap().height_m = 7.5;
        refused(high, "100 % of the points lie under the table");
        let far = |demo: &mut Demo| clouds(demo).for_each(|p| *p = p.map(|x| 39.37 * x));
        refused(far, "within the rope's length of clamp 0");
    }

    /// Once the gripper is open, where it goes is of no use.
    #[test]
    fn a_path_may_end_when_the_clamp_opens() {
        let mut demo = shipped();
        let half = demo.clamps[0].len() / 2;
        demo.clamps[0].truncate(half);
        demo.clamps[0][half - 1].closed = false;
        assert_eq!(impossibility(&demo, &frames(&demo)), None);
    }

    #[test]
    fn a_clamp_path_that_leaves_the_rope_is_noticed() {
        let mut demo = shipped();
        let count = demo.clamps[0].len();
        for (k, sample) in demo.clamps[0].iter_mut().enumerate() {
            sample.position_m[1] += 0.3 * k as f64 / count as f64;
        }
        warned(&demo, "does not touch");
    }

    /// Five markers along the lifted rope's start, straight.
    fn marked() -> Demo {
        let mut demo = shipped();
        let start = demo.clamps[0][0].position_m;
        let marker = |k: usize| MarkerSample {
            t_s: 0.0,
            marker: format!("m{k}"),
            s_m: 0.05 * k as f64,
            position_m: [start[0] + 0.05 * k as f64, start[1], start[2]],
        };
        demo.observations = Observations::Markers((1..5).map(marker).collect());
        demo
    }

    #[test]
    fn a_gripper_that_never_holds_or_closes_again_is_noticed() {
        let mut demo = shipped();
        let first = demo.clamps[0][0].position_m;
        let still = |sample: &&ClampSample| sample.position_m == first;
        let stands = demo.clamps[0].iter().take_while(still).count();
        for sample in &mut demo.clamps[0][..stands - 1] {
            sample.closed = false;
        }
        let said = warnings(&demo);
        let closes = |warning: &String| warning.contains("closes");
        assert!(!said.iter().any(closes), "gripped before it is lifted: {said:?}");
        let half = demo.clamps[0].len() / 2;
        for sample in &mut demo.clamps[0][..half] {
            sample.closed = false;
        }
        warned(&demo, "clamp 0 closes at");
        demo.clamps[0].iter_mut().for_each(|sample| sample.closed = false);
        warned(&demo, "clamp 0 never holds");
    }

    #[test]
    fn markers_that_lie_in_another_direction_than_the_rope_are_noticed() {
        let mut demo = marked();
        demo.spec.rope.direction = [0.0, 1.0, 0.0];
        warned(
            &demo,
            "4 of the first 4 markers lie off the straight rope, by up to 283 mm",
        );
        let Observations::Markers(samples) = &mut demo.observations else {
            panic!("markers");
        };
        samples.iter_mut().for_each(|marker| marker.t_s = 2.0);
        let said = warnings(&demo);
        assert!(
            !said.iter().any(|warning| warning.contains("straight")),
            "seen late: {said:?}"
        );
    }

    /// What a camera makes of the depth that it does not see is no reason to refuse a recording.
    #[test]
    fn of_a_planar_recording_y_says_nothing() {
        let mut demo = marked();
        let Observations::Markers(samples) = &mut demo.observations else {
            panic!("markers");
        };
        samples.iter_mut().for_each(|m| m.position_m[1] += 7.0);
        let said = |demo: &Demo| contradictions(demo, &frames(demo)).len();
        assert!(said(&demo) > 0);
        demo.spec.planar = true;
        let plain = warnings(&marked());
        assert_eq!(warnings(&demo), plain);
        assert!(demo.for_a_simulation("here").is_ok());
    }

    #[test]
    fn markers_of_a_wrong_scale_or_far_from_the_clamp_are_noticed() {
        let spoiled = |turn: &dyn Fn([f64; 3]) -> [f64; 3]| {
            let mut demo = marked();
            let Observations::Markers(samples) = &mut demo.observations else {
                panic!("markers");
            };
            samples.iter_mut().for_each(|m| m.position_m = turn(m.position_m));
            demo
        };
        let plain = contradictions(&marked(), &[]);
        assert!(plain.is_empty(), "{plain:?}");
        warned(&spoiled(&|p| p.map(|x| 2.0 * x)), "farther apart than the rope");
        warned(&spoiled(&|p| p.map(|x| 0.5 * x)), "never farther apart");
        warned(&spoiled(&|[x, y, z]| [x, y + 0.5, z]), "farther from clamp 0");
    }
}
