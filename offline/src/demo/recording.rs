//! Recordings of the controller as demonstrations: what the robot did during each swing, in the frame of
//! the task, so that deployment feeds the next identification. The recording holds its policy file, which
//! says where the task stands and what the rope measures; what cameras saw meanwhile can be added.

use super::read::read_observations;
use super::{ClampSample, Demo, DemoError, DemoSpec, MarkerSample, Observations};
use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use shared::arm::{self, FlangePose, Joints};
use shared::blob::{self, Blob, RopeEntry, TaskFrame};
use shared::messages::{Phase, Reason, degraded};
use shared::recording::{FRAME_BYTES, HEADER_BYTES, Header, Record, present};
use std::path::Path;

/// Standard deviation of the gripped end's place: joint encoders and a grip that is not exact, m.
const GRIP_NOISE_M: f64 = 0.001;

/// The gripped end is seen at about this rate where no cameras are given, Hz.
const GRIP_RATE_HZ: f64 = 25.0;

/// One demonstration for each goal of the recording `file` that was accepted and reached its release: time
/// zero is the start of the drag, the end is that of the retreat.
///
/// `seen` is a folder with `clouds.csv` or `markers.csv`, in the frame of the task, whose times are this
/// machine's CLOCK_MONOTONIC in s, as the controller's are. Without it the only thing seen of the rope
/// is its gripped end.
///
/// # Errors
/// The file is no recording, no goal in it reached its release, or nothing was seen during one.
pub fn recording(file: &Path, seen: Option<&Path>) -> Result<Vec<Demo>, DemoError> {
    let bytes = std::fs::read(file).map_err(|e| DemoError::io(file, "reading", &e))?;
    let run = Run::read(file, &bytes)?;
    let seen = seen.map(read_observations).transpose()?;
    let swings = run.swings();
    if swings.is_empty() {
        return Err(DemoError::new(
            file,
            "no goal in this recording reached its release",
            "record a run in which a goal is served",
        ));
    }
    let stem = file
        .file_stem()
        .map_or("recording".into(), |stem| stem.to_string_lossy());
    let mut demos = Vec::new();
    for (index, swing) in swings.iter().enumerate() {
        let name = format!("{stem}-{}", index + 1);
        demos.push(run.demo(file, swing, name, seen.as_ref())?);
    }
    Ok(demos)
}

/// A recording in memory.
struct Run {
    blob: Blob,
    records: Vec<Record>,
}

/// What the robot did from the start of the drag to the end of the goal.
struct Swing<'a> {
    rope: &'a RopeEntry,
    goal_x_m: f64,
    records: &'a [Record],
    begin_ns: u64,
    release_ns: u64,
}

impl Run {
    fn read(file: &Path, bytes: &[u8]) -> Result<Self, DemoError> {
        let wrong = |problem: &str| {
            DemoError::new(
                file,
                problem,
                "give a file that `controller --record` of this version wrote",
            )
        };
        let head = bytes.first_chunk::<HEADER_BYTES>().and_then(Header::from_bytes);
        let header = head.ok_or_else(|| wrong("this is not a recording"))?;
        if header.degraded & degraded::DRY_RUN != 0 {
            return Err(DemoError::new(
                file,
                "this is a dry run, whose arm was imagined",
                "record a run with an arm",
            ));
        }
        let rest = &bytes[HEADER_BYTES..];
        let policy_bytes = header.policy_bytes as usize;
        if rest.len() < policy_bytes {
            return Err(wrong("the recording ends within its policy file"));
        }
        let (policy, records) = rest.split_at(policy_bytes);
        let blob = blob::parse(policy).map_err(|error| wrong(&format!("its policy file: {error}")))?;
        // A last record that is cut off, as after a crash, is left out.
        let (frames, _) = records.as_chunks::<FRAME_BYTES>();
        let damaged = |at: usize| {
            DemoError::new(
                file,
                format!("record {} of {} is damaged", at + 1, frames.len()),
                "give a whole copy of the file",
            )
        };
        let records = frames.iter().enumerate();
        let records = records.map(|(at, frame)| Record::from_frame(frame).ok_or_else(|| damaged(at)));
        let records = records.collect::<Result<_, _>>()?;
        Ok(Self { blob, records })
    }

    /// The swings in the order of time.
    fn swings(&self) -> Vec<Swing<'_>> {
        let from_goal_to_goal = self.records.chunk_by(|_, next| !accepts(next));
        from_goal_to_goal
            .filter_map(|records| self.swing(records))
            .collect()
    }

    /// The swing of the goal that the first of these records accepts. Only the id of the goal accepted last is
    /// forbidden, so an id may have been refused before and may come back: it names this goal only from here
    /// until a target is another's or nobody's.
    fn swing<'a>(&'a self, records: &'a [Record]) -> Option<Swing<'a>> {
        let goal = &records.first().filter(|first| accepts(first))?.goal;
        let rope = self.blob.ropes.get(goal.rope as usize)?;
        let is_of_another = |record: &Record| has_target(record) && record.target.goal_id != goal.id;
        let end = records.iter().position(is_of_another);
        let served = &records[..end.unwrap_or(records.len())];
        let first = served.iter().position(is_from_drag_on)?;
        let last = served.iter().rposition(is_from_drag_on)?;
        let records = &served[first..=last];
        let is_release =
            |record: &&Record| has_target(record) && record.target.phase == Phase::Release.code();
        let release = records.iter().find(is_release)?;
        Some(Swing {
            rope,
            goal_x_m: goal.x_m,
            records,
            begin_ns: records[0].now_ns,
            release_ns: release.now_ns,
        })
    }

    fn demo(
        &self,
        file: &Path,
        swing: &Swing,
        name: String,
        seen: Option<&Observations>,
    ) -> Result<Demo, DemoError> {
        let commanded = swing.path(&self.blob.frame, |record| {
            record
                .has(present::TARGET)
                .then_some((record.now_ns, record.target.q_rad))
        });
        let measured = swing.path(&self.blob.frame, |record| {
            record
                .has(present::ROBOT)
                .then_some((record.robot.stamp_ns, record.robot.q_rad))
        });
        if measured.is_empty() {
            return Err(DemoError::new(
                file,
                "the recording holds no measured joints",
                "record a run with an arm",
            ));
        }
        let observations = match seen {
            Some(seen) => swing.during(file, seen)?,
            None => swing.gripped_end(&measured),
        };
        let [top_x, top_z] = self.blob.task.top_m;
        let top = ClampSample {
            t_s: 0.0,
            position_m: [top_x, 0.0, top_z],
            quaternion_xyzw: [0.0, 0.0, 0.0, 1.0],
            closed: true,
        };
        Ok(Demo {
            spec: self.spec(file, swing, seen.is_some())?,
            clamps: vec![vec![top], measured],
            commanded: vec![None, Some(commanded)],
            observations,
            name,
        })
    }

    fn spec(&self, file: &Path, swing: &Swing, with_cameras: bool) -> Result<DemoSpec, DemoError> {
        let rope = swing.rope;
        let what = if with_cameras {
            "Seen by cameras."
        } else {
            "No camera was given: only the gripped end is seen, which says nothing of the stiffness."
        };
        let grip_m = self.blob.task.grip_m;
        // A name may hold quotes, which TOML has to be told of.
        let notes = toml::Value::from(format!(
            "Swing of rope '{}' for the goal x = {} m, recorded by the controller. {what}",
            rope.name, swing.goal_x_m
        ));
        let text = format!(
            "format = \"{}\"\nscene = \"swing\"\nnoise_m = {GRIP_NOISE_M}\n\
             notes = {notes}\n\
             [rope]\nlength_m = {}\ndiameter_m = {}\nmass_kg = {}\nend_mass_kg = {}\ndirection = [0.0, 0.0, -1.0]\n\
             [table]\nheight_m = 0.0\n\
             [[clamps]]\nend = \"start\"\ngrip_m = {grip_m}\n[[clamps]]\nend = \"end\"\ngrip_m = {grip_m}\n",
            super::FORMAT,
            rope.length_m,
            rope.diameter_m,
            rope.mass_kg,
            rope.end_mass_kg,
        );
        // As text, because a demonstration is what its file says.
        toml::from_str(&text)
            .map_err(|error| DemoError::new(file, error.message(), "give a recording of a sound policy file"))
    }
}

impl Swing<'_> {
    /// Seconds since the start of the drag; `None` for what lies before.
    fn seconds(&self, stamp_ns: u64) -> Option<f64> {
        stamp_ns.checked_sub(self.begin_ns).map(|ns| ns as f64 * 1e-9)
    }

    fn end_s(&self) -> f64 {
        let last = self.records.last().map_or(self.begin_ns, |record| record.now_ns);
        (last - self.begin_ns) as f64 * 1e-9
    }

    /// The gripped end along joint angles that `joints` finds in the records.
    fn path(&self, frame: &TaskFrame, joints: impl Fn(&Record) -> Option<(u64, Joints)>) -> Vec<ClampSample> {
        let mut path: Vec<ClampSample> = Vec::new();
        for (stamp_ns, q_rad) in self.records.iter().filter_map(joints) {
            let Some(t_s) = self.seconds(stamp_ns) else {
                continue;
            };
            // The newest state of the arm may stand in more than one cycle.
            if path.last().is_some_and(|last| last.t_s >= t_s) {
                continue;
            }
            let (position_m, quaternion_xyzw) = in_task(frame, &arm::flange(&q_rad));
            path.push(ClampSample {
                t_s,
                position_m,
                quaternion_xyzw,
                closed: stamp_ns < self.release_ns,
            });
        }
        path
    }

    /// Where the gripper held the rope's end.
    fn gripped_end(&self, measured: &[ClampSample]) -> Observations {
        let mut samples: Vec<MarkerSample> = Vec::new();
        for sample in measured.iter().filter(|sample| sample.closed) {
            let due = samples
                .last()
                .is_none_or(|last| sample.t_s >= last.t_s + 1.0 / GRIP_RATE_HZ);
            if due {
                samples.push(MarkerSample {
                    t_s: sample.t_s,
                    marker: "gripped-end".to_string(),
                    s_m: self.rope.length_m,
                    position_m: sample.position_m,
                });
            }
        }
        Observations::Markers(samples)
    }

    /// What was seen during the swing, on its clock.
    fn during(&self, file: &Path, seen: &Observations) -> Result<Observations, DemoError> {
        let begin_s = self.begin_ns as f64 * 1e-9;
        let inside = |t_s: f64| (0.0..=self.end_s()).contains(&(t_s - begin_s));
        let (found, empty) = match seen {
            Observations::Clouds(frames) => {
                let mut frames = frames.clone();
                frames.retain(|frame| inside(frame.t_s));
                frames.iter_mut().for_each(|frame| frame.t_s -= begin_s);
                let empty = frames.is_empty();
                (Observations::Clouds(frames), empty)
            }
            Observations::Markers(samples) => {
                let mut samples = samples.clone();
                samples.retain(|sample| inside(sample.t_s));
                samples.iter_mut().for_each(|sample| sample.t_s -= begin_s);
                let empty = samples.is_empty();
                (Observations::Markers(samples), empty)
            }
        };
        if empty {
            let problem = format!(
                "nothing was seen from {begin_s:.3} s to {:.3} s of CLOCK_MONOTONIC",
                begin_s + self.end_s()
            );
            let remedy = "give the times of clouds.csv or markers.csv on that clock, as the controller's are";
            return Err(DemoError::new(file, problem, remedy));
        }
        Ok(found)
    }
}

/// Whether a goal was accepted in this cycle.
fn accepts(record: &Record) -> bool {
    let status = &record.status;
    record.has(present::GOAL | present::STATUS)
        && status.judged_goal_id == record.goal.id
        && status.judged_reason == Reason::Accepted.code()
}

fn has_target(record: &Record) -> bool {
    record.has(present::TARGET)
}

/// Whether the target moves the gripped end, or the gripper away from it.
fn is_from_drag_on(record: &Record) -> bool {
    let dragged = Phase::Drag.code()..=Phase::Retreat.code();
    has_target(record) && dragged.contains(&record.target.phase)
}

/// A flange pose as position and orientation in the frame of the task; the level tool is the identity.
fn in_task(frame: &TaskFrame, pose: &FlangePose) -> ([f64; 3], [f64; 4]) {
    let back = Rotation3::from_axis_angle(&Vector3::z_axis(), -frame.yaw_rad);
    let position_m = back * (pose.position_m - Vector3::from(frame.origin_m));
    let level = FlangePose::level([0.0; 3], 0.0).rotation;
    let turn = Rotation3::from_matrix_unchecked(back.matrix() * pose.rotation * level.transpose());
    let quaternion = UnitQuaternion::from_rotation_matrix(&turn);
    (position_m.into(), quaternion.coords.into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::freeze;
    use shared::messages::{Goal, JointTarget, RobotState};

    const HEADER: Header = Header {
        cycle_ns: 4_000_000,
        cycles_per_target: 1,
        degraded: 0,
        silent_cycles_max: 50,
        gripper_lead_ns: 0,
        policy_bytes: 100,
    };

    /// A recording, cycle by cycle, of an arm that follows at once.
    #[derive(Default)]
    struct Cycles(Vec<Record>);

    impl Cycles {
        fn target(&mut self, goal_id: u64, phase: Phase) {
            let cycle = self.0.len() as u64 + 1;
            let now_ns = cycle * HEADER.cycle_ns;
            self.0.push(Record {
                cycle,
                now_ns,
                present: present::TARGET | present::ROBOT,
                target: JointTarget {
                    goal_id,
                    phase: phase.code(),
                    ..JointTarget::default()
                },
                robot: RobotState {
                    stamp_ns: now_ns,
                    ..RobotState::default()
                },
                ..Record::default()
            });
        }

        /// Judges a goal in the newest cycle.
        fn judge(&mut self, goal: Goal, reason: Reason) {
            let record = self.0.last_mut().unwrap();
            record.present |= present::GOAL | present::STATUS;
            record.goal = goal;
            record.status.judged_goal_id = goal.id;
            record.status.judged_reason = reason.code();
        }

        fn refused(&mut self, goal: Goal) {
            self.target(0, Phase::Idle);
            self.judge(goal, Reason::OutOfRange);
        }

        /// A goal that is accepted and done, with so many cycles of drag.
        fn done(&mut self, goal: Goal, drags: usize) {
            self.target(goal.id, Phase::Homing);
            self.judge(goal, Reason::Accepted);
            for _ in 0..drags {
                self.target(goal.id, Phase::Drag);
            }
            for phase in [Phase::Dwell, Phase::Release, Phase::Retreat] {
                self.target(goal.id, phase);
            }
            self.target(0, Phase::Idle);
        }

        /// The file, with a policy file that holds two ropes.
        fn bytes(&self, degraded: u32) -> Vec<u8> {
            let mut policy = freeze::tests::blob();
            let mut second = policy.ropes[0].clone();
            second.name = freeze::short("rope", "the \"blue\" one").unwrap();
            second.length_m = 0.24;
            policy.ropes.push(second).unwrap();
            let mut buffer = vec![0; blob::MAX_BLOB_BYTES];
            let policy = blob::write(&policy, &mut buffer).unwrap();
            let header = Header {
                degraded,
                policy_bytes: policy.len() as u64,
                ..HEADER
            };
            let mut bytes = header.to_bytes().to_vec();
            bytes.extend(policy);
            bytes.extend(self.0.iter().flat_map(Record::to_frame));
            bytes
        }
    }

    fn goal(id: u64, x_m: f64, rope: u32) -> Goal {
        Goal {
            id,
            x_m,
            rope,
            ..Goal::default()
        }
    }

    /// Its measured joints are the targets themselves: a demonstration of a perfect arm that nobody has.
    #[test]
    fn a_dry_run_is_no_demonstration() {
        let mut cycles = Cycles::default();
        cycles.done(goal(7, 0.40, 0), 2);
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("run.rec");
        std::fs::write(&file, cycles.bytes(degraded::DRY_RUN)).unwrap();
        let refused = recording(&file, None).unwrap_err().to_string();
        assert!(refused.contains("record a run with an arm"), "{refused}");
    }

    /// Only the id of the goal accepted last is forbidden: a refused one is sent again under its id, and an id
    /// comes back after another goal.
    #[test]
    fn every_accepted_goal_is_a_swing_of_its_own_whatever_its_id() {
        let mut cycles = Cycles::default();
        cycles.refused(goal(7, 0.30, 0));
        cycles.done(goal(7, 0.40, 0), 2);
        cycles.done(goal(8, 0.41, 1), 3);
        cycles.refused(goal(7, 0.31, 0));
        cycles.done(goal(7, 0.42, 0), 4);
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("run.rec");
        std::fs::write(&file, cycles.bytes(0)).unwrap();
        let demos = recording(&file, None).unwrap();
        let expected = [("0.4 m", 0.25, 2), ("0.41 m", 0.24, 3), ("0.42 m", 0.25, 4)];
        assert_eq!(demos.len(), expected.len());
        for (k, (demo, (x, length_m, drags))) in demos.iter().zip(expected).enumerate() {
            assert_eq!(demo.name, format!("run-{}", k + 1));
            let notes = &demo.spec.notes;
            assert!(notes.contains(&format!("x = {x}")), "{notes}");
            let rope = &demo.spec.rope;
            assert_eq!((rope.length_m, rope.end_mass_kg), (length_m, 0.004));
            // Drag and dwell hold, release and retreat do not.
            let closed: Vec<bool> = demo.clamps[1].iter().map(|sample| sample.closed).collect();
            let mut wanted = vec![true; drags + 1];
            wanted.extend([false; 2]);
            assert_eq!(closed, wanted);
        }
    }

    /// A flipped bit would move the gripper of a demonstration, which a fit takes for the rope's doing.
    #[test]
    fn a_damaged_recording_is_no_demonstration() {
        let mut cycles = Cycles::default();
        cycles.done(goal(7, 0.40, 0), 2);
        let mut bytes = cycles.bytes(0);
        let end = bytes.len();
        bytes[end - 2 * FRAME_BYTES + 300] ^= 1;
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("run.rec");
        std::fs::write(&file, &bytes).unwrap();
        let refused = recording(&file, None).unwrap_err().to_string();
        let record = cycles.0.len() - 1;
        assert!(
            refused.contains(&format!("record {record} of {}", cycles.0.len())),
            "{refused}"
        );
        // As after a crash.
        std::fs::write(&file, &cycles.bytes(0)[..end - 1]).unwrap();
        assert_eq!(recording(&file, None).unwrap().len(), 1);
    }

    #[test]
    fn the_task_frame_is_undone() {
        let frame = TaskFrame {
            origin_m: [0.3, -0.1, 0.12],
            yaw_rad: 0.7,
        };
        let pose = FlangePose::level(frame.flange_m([0.1, 0.2]), frame.yaw_rad);
        let (position_m, quaternion_xyzw) = in_task(&frame, &pose);
        for (found, expected) in position_m.iter().zip([0.1, 0.0, 0.2]) {
            assert!((found - expected).abs() < 1e-12, "{position_m:?}");
        }
        for (found, expected) in quaternion_xyzw.iter().zip([0.0, 0.0, 0.0, 1.0]) {
            assert!((found - expected).abs() < 1e-12, "{quaternion_xyzw:?}");
        }
    }

    #[test]
    fn other_files_are_refused_in_one_line() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("run.rec");
        for bytes in [&b"GENREC1\n"[..], b"", &[0; 100]] {
            std::fs::write(&file, bytes).unwrap();
            let error = recording(&file, None).unwrap_err().to_string();
            assert!(
                error.contains("run.rec") && error.contains("not a recording"),
                "{error}"
            );
        }
        std::fs::write(&file, HEADER.to_bytes()).unwrap();
        let error = recording(&file, None).unwrap_err().to_string();
        assert!(error.contains("within its policy file"), "{error}");
    }
}
