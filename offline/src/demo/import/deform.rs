//! `deform`: motion-captured ropes held at both ends (DEFORM; Chen et al., arXiv 2406.05931).
//!
//! Markers 0 and 1 sit on the first gripped piece, the last two on the other: they are the clamps'
//! paths (position and tangent; the roll about the tangent is unknown and taken as none). The
//! markers between them are the observations.

use super::npy::Array;
use super::{Follower, MASS_AND_DIAMETER, Source, assumed_mass_kg, sample, stride};
use crate::demo::table::Table;
use crate::demo::{
    ClampSample, ClampSpec, Demo, DemoError, MarkerSample, RopeEnd, RopeSpec, SceneKind, StartState,
};
use nalgebra::Vector3;
use std::collections::BTreeMap;
use std::path::Path;

/// The source states no diameter. Where nothing but bending stiffness and mass moves a rope, a thicker one of the same
/// moves alike: the rope of DLO3_043 with 20 in place of 10 mm lay 19.0 in place of 19.2 mm from the markers, and took a
/// sixth of the time.
const ASSUMED_DIAMETER_M: f64 = 0.02;
/// The source states no mass: as much as of a rope of 10 mm and 1000 kg/m³.
const ASSUMED_DENSITY_KG_M3: f64 = 250.0;
/// Standard deviation of a marker about the axis: markers are balls beside it; distances of
/// neighbours vary by 0.4 to 3 mm.
const NOISE_M: f64 = 0.002;
const RECORDED_HZ: f64 = 100.0;
/// Second differences above this are tracking faults (the source's manifest), m/s².
const JUMP_M_S2: f64 = 300.0;
/// Arc lengths are this quantile of the distance of neighbours over time: a chord is never longer
/// than its arc, and the very longest are noise.
const ARC_QUANTILE: f64 = 0.9;

/// One frame: all markers, m.
type Frame = Vec<Vector3<f64>>;

/// Chunks that follow each other without a gap.
struct Recording {
    name: String,
    /// Which of the ropes it shows.
    rope: String,
    frames: Vec<Frame>,
}

/// One demonstration per recording without a gap; observed frames are thinned to about `rate_hz`.
///
/// # Errors
/// A file is missing or malformed, or files of one rope differ in how many markers they have.
pub fn deform(dir: &Path, rate_hz: f64) -> Result<Vec<Demo>, DemoError> {
    let recordings = recordings(dir)?;
    // A rope is as long in every recording of it.
    let mut frames = BTreeMap::<&str, Vec<&Frame>>::new();
    for recording in &recordings {
        frames
            .entry(&recording.rope)
            .or_default()
            .extend(&recording.frames);
    }
    let arcs: BTreeMap<&str, Vec<f64>> = frames
        .iter()
        .map(|(rope, frames)| (*rope, arcs(frames)))
        .collect();
    let demo = |recording: &Recording| one(recording, &arcs[recording.rope.as_str()], rate_hz);
    Ok(recordings.iter().map(demo).collect())
}

fn recordings(dir: &Path) -> Result<Vec<Recording>, DemoError> {
    let columns = [
        "file",
        "dlo",
        "chunk",
        "upstream_split",
        "markers",
        "continues_previous_chunk",
        "max_acc_m_s2",
        "jump_frames",
        "min_z_m",
        "upstream_path",
    ];
    let manifest = Table::read(&dir.join("manifest.csv"), &columns, &[])?;
    let mut list: Vec<Recording> = Vec::new();
    let mut firsts = BTreeMap::new();
    let mut before = ("", f64::NAN);
    for row in 0..manifest.len() {
        let file = manifest.text(row, "file");
        let path = dir.join(file);
        let array = Array::read(&path, 3)?;
        let markers = array.shape[1];
        if array.shape[0] == 0 || markers < 6 || array.shape[2] != 3 {
            let problem = format!("the shape is {:?}, not (frames, markers, 3)", array.shape);
            return Err(DemoError::new(
                &path,
                problem,
                "at least one frame and six markers are needed",
            ));
        }
        let frames = (0..array.shape[0]).map(|k| frame_of(array.row(k)));
        let (rope, chunk) = (manifest.text(row, "dlo"), manifest.number(row, "chunk")?);
        // Arc lengths are those of a rope, from all its files.
        let (first, expected) = *firsts.entry(rope).or_insert((file, markers));
        if markers != expected {
            let problem = format!("{markers} markers, but {first} of the same dlo {rope} has {expected}");
            let remedy = "give it another dlo in manifest.csv, or save both with the same markers";
            return Err(DemoError::new(&path, problem, remedy));
        }
        let follows = manifest.flag(row, "continues_previous_chunk")? && before == (rope, chunk - 1.0);
        before = (rope, chunk);
        match list.last_mut() {
            Some(open) if follows => open.frames.extend(frames),
            _ => list.push(Recording {
                name: file.trim_end_matches(".npy").to_owned(),
                rope: rope.to_owned(),
                frames: frames.collect(),
            }),
        }
    }
    Ok(list)
}

fn frame_of(numbers: &[f32]) -> Frame {
    let points = numbers.as_chunks::<3>().0.iter();
    points.map(|p| Vector3::from(*p).cast()).collect()
}

/// Whether marker `m` may be at fault in frame `k`: its second difference there is impossible. One wrong
/// sample makes that so in its own frame and in both neighbours.
fn jumps(frames: &[Frame], k: usize, m: usize) -> bool {
    if frames.len() < 3 {
        return false;
    }
    let k = k.clamp(1, frames.len() - 2);
    let second = frames[k + 1][m] - 2.0 * frames[k][m] + frames[k - 1][m];
    second.norm() * RECORDED_HZ * RECORDED_HZ > JUMP_M_S2
}

/// Arc length of every marker from the first, m.
fn arcs(frames: &[&Frame]) -> Vec<f64> {
    let mut arcs = vec![0.0];
    for m in 1..frames[0].len() {
        let mut gaps: Vec<f64> = frames.iter().map(|f| (f[m] - f[m - 1]).norm()).collect();
        gaps.sort_by(f64::total_cmp);
        arcs.push(arcs[m - 1] + gaps[((gaps.len() - 1) as f64 * ARC_QUANTILE) as usize]);
    }
    arcs
}

/// Path of the clamp whose outer marker is `outer` and whose inner one is `inner`. `sense` is 1 where
/// the rope starts there and -1 where it ends.
fn clamp(frames: &[Frame], outer: usize, inner: usize, sense: f64) -> Vec<ClampSample> {
    let mut follower: Option<Follower> = None;
    let mut path = Vec::new();
    for (k, frame) in frames.iter().enumerate() {
        if jumps(frames, k, outer) || jumps(frames, k, inner) {
            continue;
        }
        let direction = sense * (frame[inner] - frame[outer]);
        let follower = follower.get_or_insert_with(|| Follower::new(direction));
        let turn = follower.follow(direction);
        path.push(sample(
            k as f64 / RECORDED_HZ,
            frame[outer],
            0.0,
            direction.normalize(),
            turn,
        ));
    }
    path
}

fn one(recording: &Recording, arcs: &[f64], rate_hz: f64) -> Demo {
    let frames = &recording.frames;
    let count = frames[0].len();
    let stride = stride(RECORDED_HZ, rate_hz);
    let length_m = arcs[count - 1];
    let mut markers = Vec::new();
    for k in (0..frames.len()).step_by(stride) {
        for m in (2..count - 2).filter(|&m| !jumps(frames, k, m)) {
            markers.push(MarkerSample {
                t_s: k as f64 / RECORDED_HZ,
                marker: format!("m{m:02}"),
                s_m: arcs[m],
                position_m: frames[k][m].into(),
            });
        }
    }
    let direction = |a: usize, b: usize| -> [f64; 3] { (frames[0][b] - frames[0][a]).normalize().into() };
    let grip = |end, grip_m, direction| ClampSpec {
        end,
        grip_m,
        direction: Some(direction),
    };
    let first = direction(0, 1);
    let last = direction(count - 2, count - 1);
    let source = Source {
        scene: SceneKind::Free,
        start: StartState::Moving,
        noise_m: NOISE_M,
        planar: false,
        notes: format!(
            "{}: rope held at both ends, motion capture (DEFORM). Arc lengths are the {ARC_QUANTILE} quantile of \
                 the markers' distances in all recordings of the rope; samples with a second difference above {JUMP_M_S2} m/s2 are left out; one \
                 frame in {stride} kept. Diameter, mass and noise_m are assumed, the clamps' roll is unknown.",
            recording.name
        ),
        rope: RopeSpec {
            length_m,
            diameter_m: ASSUMED_DIAMETER_M,
            mass_kg: assumed_mass_kg(length_m, ASSUMED_DIAMETER_M, ASSUMED_DENSITY_KG_M3),
            direction: first,
            end_mass_kg: 0.0,
            roll_rad: 0.0,
            assumed: MASS_AND_DIAMETER.to_vec(),
        },
        clamps: vec![
            (grip(RopeEnd::Start, arcs[1], first), clamp(frames, 0, 1, 1.0)),
            (
                grip(RopeEnd::End, length_m - arcs[count - 2], last),
                clamp(frames, count - 1, count - 2, -1.0),
            ),
        ],
        markers,
        name: recording.name.clone(),
    };
    source.demo()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::demo::Observations;

    /// Files r0.npy, r1.npy and so on of one rope, with so many frames and markers 0.1 m apart.
    fn data_set(shapes: &[[usize; 2]]) -> tempfile::TempDir {
        let dir = tempfile::tempdir().unwrap();
        let mut manifest = "file,dlo,chunk,upstream_split,markers,continues_previous_chunk,max_acc_m_s2,\
                            jump_frames,min_z_m,upstream_path\n"
            .to_owned();
        for (k, &[frames, markers]) in shapes.iter().enumerate() {
            manifest += &format!("r{k}.npy,rope,0,train,{markers},0,0,0,1,r{k}\n");
            let header =
                format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({frames}, {markers}, 3), }}\n");
            let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
            bytes.extend((header.len() as u16).to_le_bytes());
            bytes.extend(header.as_bytes());
            for m in (0..frames).flat_map(|_| 0..markers) {
                let point = [0.1 * m as f32, 0.0, 1.0];
                bytes.extend(point.iter().flat_map(|x| x.to_le_bytes()));
            }
            std::fs::write(dir.path().join(format!("r{k}.npy")), bytes).unwrap();
        }
        std::fs::write(dir.path().join("manifest.csv"), manifest).unwrap();
        dir
    }

    #[test]
    fn files_without_a_frame_or_with_other_markers_than_their_ropes_are_refused() {
        let good = data_set(&[[3, 8], [2, 8]]);
        assert_eq!(deform(good.path(), 100.0).unwrap().len(), 2);
        for (shapes, file, why) in [
            (&[[3, 8], [0, 8]], "r1.npy", "at least one frame"),
            (&[[3, 8], [3, 7]], "r1.npy", "7 markers, but r0.npy"),
            (&[[3, 7], [3, 8]], "r1.npy", "8 markers, but r0.npy"),
        ] {
            let bad = data_set(shapes);
            let error = deform(bad.path(), 100.0).unwrap_err().to_string();
            assert!(
                error.contains(file) && error.contains(why) && !error.contains('\n'),
                "{error}"
            );
        }
    }

    /// Seven markers 0.1 m apart in a straight line that moves sideways; marker 3 jumps once.
    #[test]
    fn a_jump_of_one_marker_loses_that_marker_alone() {
        let frames: Vec<Frame> = (0..9)
            .map(|k| {
                (0..7)
                    .map(|m| {
                        let fault = if k == 4 && m == 3 { 0.05 } else { 0.0 };
                        Vector3::new(0.1 * m as f64, 0.01 * k as f64, 1.0 + fault)
                    })
                    .collect()
            })
            .collect();
        let recording = Recording {
            name: "r".into(),
            rope: "1".into(),
            frames,
        };
        let arcs = arcs(&recording.frames.iter().collect::<Vec<_>>());
        let demo = one(&recording, &arcs, 100.0);
        let Observations::Markers(markers) = &demo.observations else {
            panic!("markers");
        };
        let at = |k: usize| markers.iter().filter(|m| m.t_s == k as f64 / 100.0).count();
        // A second difference at k uses k - 1 to k + 1, so the two frames around the fault are suspect too.
        assert_eq!([at(2), at(3), at(4), at(5), at(6)], [3, 2, 2, 2, 3]);
        assert!((demo.spec.rope.length_m - 0.6).abs() < 1e-9);
        assert_eq!(demo.clamps[1].len(), 9);
        assert_eq!(demo.clamps[1][0].position_m, [0.6000000000000001, 0.0, 1.0]);
    }
}
