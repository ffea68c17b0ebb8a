//! A recording as `ros2 bag record` writes it (MCAP, messages in CDR): clouds, and the clamp as a pose
//! or as the joints of the arm that holds it.

use crate::demo::export::{EPOCH_KEY, SPEC_NAME};
use crate::demo::ros::{
    self, Bool, FLOAT32, FLOAT64, Header, JointState, Message, PointCloud2, PointField, PoseStamped,
};
use crate::demo::{ClampSample, CloudFrame, Demo, DemoError, DemoSpec, Observations, make_continuous};
use mcap::records::Record;
use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use shared::arm::{JOINTS, flange};
use shared::blob::TaskFrame;
use std::path::Path;

/// Which topics of a recording are what.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct McapTopics {
    /// `sensor_msgs/msg/PointCloud2`, the rope alone.
    pub cloud: String,
    /// `geometry_msgs/msg/PoseStamped` of the rope's end in each clamp, in the order of `[[clamps]]`.
    pub clamps: Vec<String>,
    /// `sensor_msgs/msg/JointState` of the arm that is the only clamp, in place of `clamps`.
    pub joints: Option<String>,
    /// `std_msgs/msg/Bool` per clamp, true while it holds; without it clamps hold throughout. It has no stamp: its
    /// times are the recorder's, less what these are ahead of the clamp's stamps.
    pub closed: Vec<String>,
}

/// Clocks that differ by less, ns, are one: messages are under way that long at most.
const ONE_CLOCK_NS: i128 = 250_000_000;

/// A recording as a demonstration.
#[derive(Clone, Debug, PartialEq)]
pub struct FromMcap {
    /// The demonstration.
    pub demo: Demo,
    /// Clouds left out because they hold no point: the rope was out of sight.
    pub empty_clouds: usize,
}

/// Reads a recording. `spec` declares rope, clamps and cameras; the recording's own attachment does
/// where it is left out. `frame` says where the arm stands, for joints only.
///
/// # Errors
/// The file is no recording, a topic is not there or of another type, frames of reference differ, all clouds are
/// empty, there are more or fewer topics of closed clamps than clamps, or when a clamp opens cannot be told.
pub fn mcap(
    file: &Path,
    topics: &McapTopics,
    spec: Option<DemoSpec>,
    frame: &TaskFrame,
    name: &str,
) -> Result<FromMcap, DemoError> {
    let bytes = std::fs::read(file).map_err(|e| DemoError::io(file, "reading", &e))?;
    let recording = Recording { file, bytes };
    let spec = match spec {
        Some(spec) => spec,
        None => recording.spec()?,
    };
    let clouds: Vec<Stamped<PointCloud2>> = recording.messages(&topics.cloud)?;
    let joints: Option<Vec<Stamped<JointState>>> = topics
        .joints
        .as_ref()
        .map(|topic| recording.messages(topic))
        .transpose()?;
    let poses: Vec<Vec<Stamped<PoseStamped>>> = topics
        .clamps
        .iter()
        .map(|topic| recording.messages(topic))
        .collect::<Result<_, _>>()?;
    for path in &poses {
        recording.same_frame(&clouds[0].message.header, &path[0].message.header)?;
    }
    let firsts = poses.iter().map(|path| path[0].stamp_ns);
    let firsts = firsts.chain(joints.iter().map(|path| path[0].stamp_ns));
    let clock = recording.clock(firsts.fold(clouds[0].stamp_ns, i128::min))?;

    let of_arm = |path: &Vec<Stamped<JointState>>| -> Result<Vec<ClampSample>, DemoError> {
        path.iter()
            .map(|m| recording.of_joints(m, &clock, frame))
            .collect()
    };
    let mut clamps: Vec<Vec<ClampSample>> = joints.iter().map(of_arm).collect::<Result<_, _>>()?;
    clamps.extend(
        poses
            .iter()
            .map(|path| path.iter().map(|m| of_pose(m, &clock)).collect()),
    );
    clamps.iter_mut().for_each(|path| make_continuous(path));
    let mut lags: Vec<Lag> = joints.iter().map(|path| Lag::of(path)).collect();
    lags.extend(poses.iter().map(|path| Lag::of(path)));
    recording.close(&mut clamps, &lags, &clock, &topics.closed)?;
    let frames: Result<Vec<CloudFrame>, DemoError> =
        clouds.iter().map(|m| recording.of_cloud(m, &clock)).collect();
    let mut frames = frames?;
    frames.retain(|frame| !frame.points_m.is_empty());
    if frames.is_empty() {
        return Err(recording.error(
            format!("no cloud of {} holds a point", topics.cloud),
            "record the rope alone, but record it",
        ));
    }
    Ok(FromMcap {
        empty_clouds: clouds.len() - frames.len(),
        demo: Demo {
            name: name.to_owned(),
            spec,
            commanded: vec![None; clamps.len()],
            clamps,
            observations: Observations::Clouds(frames),
        },
    })
}

/// A message with when it was measured or, where it does not say so, recorded: ns of the recording's clock.
struct Stamped<M> {
    stamp_ns: i128,
    /// When it was recorded, ns of the recorder's clock.
    logged_ns: i128,
    message: M,
}

/// How far the recorder's clock is ahead of the stamps of a clamp's path, with the time that messages are under
/// way: the clamp's state is recorded beside its path and is about as late.
struct Lag {
    median_ns: i128,
    /// From quartile to quartile.
    scatter_ns: i128,
}

impl Lag {
    /// Of messages, of which there is at least one.
    fn of<M>(path: &[Stamped<M>]) -> Self {
        let mut lags: Vec<i128> = path.iter().map(|m| m.logged_ns - m.stamp_ns).collect();
        lags.sort_unstable();
        let quartile = |k: usize| lags[(lags.len() - 1) * k / 4];
        Self {
            median_ns: quartile(2),
            scatter_ns: quartile(3) - quartile(1),
        }
    }
}

/// From the recording's clock to the demonstration's.
struct Clock {
    /// Time of t = 0, ns.
    epoch_ns: i128,
}

impl Clock {
    fn t_s<M>(&self, stamped: &Stamped<M>) -> f64 {
        seconds(stamped.stamp_ns - self.epoch_ns)
    }
}

/// Messages that may say themselves when they were measured.
trait Timed: Message {
    fn header(&self) -> Option<&Header>;
}

macro_rules! timed {
    ($($message:ty),*) => {$(
        impl Timed for $message {
            fn header(&self) -> Option<&Header> {
                Some(&self.header)
            }
        }
    )*};
}

timed!(PointCloud2, PoseStamped, JointState);

impl Timed for Bool {
    fn header(&self) -> Option<&Header> {
        None
    }
}

struct Recording<'a> {
    file: &'a Path,
    bytes: Vec<u8>,
}

impl Recording<'_> {
    fn error(&self, problem: impl Into<String>, remedy: &str) -> DemoError {
        DemoError::new(self.file, problem, remedy)
    }

    fn unreadable(&self, error: &mcap::McapError) -> DemoError {
        self.error(
            format!("not a readable MCAP recording ({error})"),
            "give an uncompressed .mcap file; `ros2 bag convert` makes one from others",
        )
    }

    /// The attached `demo.toml`.
    fn spec(&self) -> Result<DemoSpec, DemoError> {
        let records = mcap::read::LinearReader::new(&self.bytes).map_err(|e| self.unreadable(&e))?;
        for record in records {
            if let Record::Attachment { header, data, .. } = record.map_err(|e| self.unreadable(&e))?
                && header.name == SPEC_NAME
            {
                let text = String::from_utf8_lossy(&data);
                let fix = "name a whole one with --spec";
                return toml::from_str(&text).map_err(|e: toml::de::Error| {
                    self.error(format!("attached {SPEC_NAME}: {}", e.message()), fix)
                });
            }
        }
        Err(self.error(
            "the recording does not say what the rope is",
            "name a demo.toml that declares rope and clamps with --spec",
        ))
    }

    /// The clock of an exported demonstration, else one that begins at `first_ns`.
    fn clock(&self, first_ns: i128) -> Result<Clock, DemoError> {
        for message in mcap::MessageStream::new(&self.bytes).map_err(|e| self.unreadable(&e))? {
            let message = message.map_err(|e| self.unreadable(&e))?;
            let epoch = message.channel.metadata.get(EPOCH_KEY);
            if let Some(epoch_ns) = epoch.and_then(|e| e.parse().ok()) {
                return Ok(Clock { epoch_ns });
            }
        }
        Ok(Clock { epoch_ns: first_ns })
    }

    /// Writes into the paths of the clamps when each holds, where there are topics that say so.
    fn close(
        &self,
        clamps: &mut [Vec<ClampSample>],
        lags: &[Lag],
        clock: &Clock,
        topics: &[String],
    ) -> Result<(), DemoError> {
        if !topics.is_empty() && topics.len() != clamps.len() {
            return Err(self.error(
                format!(
                    "{} topics say whether a clamp holds, but there are {} clamps",
                    topics.len(),
                    clamps.len()
                ),
                "name one for each clamp with --closed-topic, in the order of the clamps, or none",
            ));
        }
        for ((path, lag), topic) in clamps.iter_mut().zip(lags).zip(topics) {
            let states = self.states(topic, lag)?;
            let late_s = clock.t_s(&states[0]) - path[0].t_s;
            // On one clock, the first state holds before it as well: topics begin one after the other. Else the
            // recorder's clock may have been set meanwhile, or the clamp tells its state only when it changes.
            if lag.median_ns.abs() > ONE_CLOCK_NS && late_s > seconds(ONE_CLOCK_NS) {
                return Err(self.error(
                    format!(
                        "the first state on {topic} comes {late_s:.2} s after the clamp's first pose, and the \
                         recorder's clock (log_time) is {:.2} s ahead of the clamp's stamps",
                        seconds(lag.median_ns)
                    ),
                    "publish the state before the recording begins and often, or leave out --closed-topic",
                ));
            }
            for sample in path {
                let after = states.partition_point(|state| clock.t_s(state) <= sample.t_s + 1e-9);
                sample.closed = states[after.saturating_sub(1)].message.data;
            }
        }
        Ok(())
    }

    /// What a topic says of a clamp, on the clock of the clamp's stamps.
    fn states(&self, topic: &str, lag: &Lag) -> Result<Vec<Stamped<Bool>>, DemoError> {
        if lag.scatter_ns > ONE_CLOCK_NS {
            return Err(self.error(
                format!(
                    "when {topic} was true cannot be told: it has no stamps, and how far the recorder's clock \
                     (log_time) is ahead of the clamp's stamps scatters by {:.2} s",
                    seconds(lag.scatter_ns)
                ),
                "record on the clock of the stamps (`ros2 bag record --use-sim-time`), or leave out --closed-topic",
            ));
        }
        let mut states: Vec<Stamped<Bool>> = self.messages(topic)?;
        for state in &mut states {
            state.stamp_ns -= lag.median_ns;
        }
        Ok(states)
    }

    fn messages<M: Timed>(&self, topic: &str) -> Result<Vec<Stamped<M>>, DemoError> {
        let mut list: Vec<Stamped<M>> = Vec::new();
        let mut there = std::collections::BTreeSet::new();
        for message in mcap::MessageStream::new(&self.bytes).map_err(|e| self.unreadable(&e))? {
            let message = message.map_err(|e| self.unreadable(&e))?;
            there.insert(message.channel.topic.clone());
            if message.channel.topic != topic {
                continue;
            }
            let kind = message
                .channel
                .schema
                .as_ref()
                .map_or("unknown", |s| s.name.as_str());
            if kind != M::NAME {
                return Err(self.error(
                    format!("topic {topic} holds {kind}, not {}", M::NAME),
                    "name another topic",
                ));
            }
            let decoded: M = ros::decode(&message.data).map_err(|problem| {
                self.error(format!("a message of {topic}: {problem}"), "record it again")
            })?;
            let logged_ns = i128::from(message.log_time);
            let stamp_ns = decoded.header().map_or(logged_ns, |h| {
                i128::from(h.stamp.sec) * 1_000_000_000 + i128::from(h.stamp.nanosec)
            });
            list.push(Stamped {
                stamp_ns,
                logged_ns,
                message: decoded,
            });
        }
        if list.is_empty() {
            let there: Vec<String> = there.into_iter().collect();
            return Err(self.error(
                format!("there is no topic {topic}, only {}", there.join(", ")),
                "name one that is there",
            ));
        }
        list.sort_by_key(|message| message.stamp_ns);
        Ok(list)
    }

    fn same_frame(&self, a: &Header, b: &Header) -> Result<(), DemoError> {
        if a.frame_id == b.frame_id {
            return Ok(());
        }
        Err(self.error(
            format!(
                "clouds are in frame '{}', the clamp in '{}'",
                a.frame_id, b.frame_id
            ),
            "record both in one frame, for example through tf2",
        ))
    }

    fn of_cloud(&self, stamped: &Stamped<PointCloud2>, clock: &Clock) -> Result<CloudFrame, DemoError> {
        let cloud = &stamped.message;
        let bad = |problem: &str| self.error(problem, "publish x, y, z as float32 or float64 in metres");
        if cloud.is_bigendian {
            return Err(bad("a cloud is big-endian"));
        }
        let field = |name: &str| -> Result<&PointField, DemoError> {
            let found = cloud.fields.iter().find(|f| f.name == name);
            let real = found.filter(|f| matches!(f.datatype, FLOAT32 | FLOAT64));
            real.ok_or_else(|| bad("a cloud has no float field x, y or z"))
        };
        let fields = [field("x")?, field("y")?, field("z")?];
        let step = cloud.point_step as usize;
        let count = cloud.width as usize * cloud.height as usize;
        if step == 0 || count.checked_mul(step) != Some(cloud.data.len()) {
            return Err(bad("a cloud holds more or fewer bytes than it says"));
        }
        let number = |record: &[u8], field: &PointField| -> Option<f64> {
            let bytes = record.get(field.offset as usize..)?;
            match field.datatype {
                FLOAT64 => bytes.first_chunk().map(|b| f64::from_le_bytes(*b)),
                _ => bytes.first_chunk().map(|b| f64::from(f32::from_le_bytes(*b))),
            }
        };
        let mut points_m = Vec::with_capacity(count);
        for record in cloud.data.chunks_exact(step) {
            let mut point = [0.0; 3];
            for (x, field) in point.iter_mut().zip(fields) {
                *x = number(record, field).ok_or_else(|| bad("a field lies outside its point"))?;
            }
            // Pixels without depth are not numbers.
            if point.iter().all(|x| x.is_finite()) {
                points_m.push(point);
            }
        }
        Ok(CloudFrame {
            t_s: clock.t_s(stamped),
            points_m,
        })
    }

    /// Joint angles in the arm's order.
    fn joints(&self, state: &JointState) -> Result<[f64; JOINTS], DemoError> {
        in_order(&state.name, &state.position)
            .map_err(|problem| self.error(problem, "record the seven joints of one xArm7, joint1 to joint7"))
    }

    /// The flange for some joints, in the task's frame.
    fn of_joints(
        &self,
        stamped: &Stamped<JointState>,
        clock: &Clock,
        frame: &TaskFrame,
    ) -> Result<ClampSample, DemoError> {
        let pose = flange(&self.joints(&stamped.message)?);
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -frame.yaw_rad);
        let rotation = Rotation3::from_matrix_unchecked(pose.rotation);
        Ok(ClampSample {
            t_s: clock.t_s(stamped),
            position_m: (turn * (pose.position_m - Vector3::from(frame.origin_m))).into(),
            quaternion_xyzw: (turn * UnitQuaternion::from_rotation_matrix(&rotation))
                .coords
                .into(),
            closed: true,
        })
    }
}

fn seconds(ns: i128) -> f64 {
    ns as f64 / 1e9
}

fn of_pose(stamped: &Stamped<PoseStamped>, clock: &Clock) -> ClampSample {
    ClampSample {
        t_s: clock.t_s(stamped),
        position_m: stamped.message.position_m,
        quaternion_xyzw: stamped.message.quaternion_xyzw,
        closed: true,
    }
}

/// Joint angles in the arm's order: by names that end in joint1 to joint7, as the driver gives them with or without an arm's
/// prefix; as they stand where they have no names.
fn in_order(names: &[String], positions: &[f64]) -> Result<[f64; JOINTS], String> {
    let mut q_rad = [0.0; JOINTS];
    for (k, angle) in q_rad.iter_mut().enumerate() {
        let wanted = format!("joint{}", k + 1);
        let mut named = (0..names.len()).filter(|&at| names[at].ends_with(&wanted));
        let at = match (named.next(), named.next()) {
            _ if names.is_empty() => k,
            (Some(at), None) => at,
            (None, _) => {
                return Err(format!(
                    "a JointState names no {wanted}, only {}",
                    names.join(", ")
                ));
            }
            (Some(_), Some(_)) => {
                return Err(format!("a JointState names {wanted} twice: {}", names.join(", ")));
            }
        };
        *angle = *positions
            .get(at)
            .ok_or_else(|| format!("a JointState has {} positions", positions.len()))?;
    }
    Ok(q_rad)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An angle that is taken for another joint's puts the clamp elsewhere, and nothing tells.
    #[test]
    fn joints_are_taken_by_their_names_and_never_by_their_place_among_others() {
        let names = |names: &[&str]| names.iter().map(ToString::to_string).collect::<Vec<_>>();
        let numbers: Vec<f64> = (0..8).map(f64::from).collect();
        let seven: Vec<String> = (1..=7).map(|k| format!("joint{k}")).collect();
        let first = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
        assert_eq!(in_order(&[], &numbers), Ok(first));
        assert_eq!(in_order(&seven, &numbers), Ok(first));
        let mut with_gripper = names(&["drive_joint"]);
        with_gripper.extend(seven.iter().map(|name| format!("L_{name}")));
        assert_eq!(in_order(&with_gripper, &numbers), Ok(first.map(|q| q + 1.0)));
        let two_arms = [with_gripper.clone(), seven.clone()].concat();
        assert!(
            in_order(&two_arms, &[0.0; 15])
                .unwrap_err()
                .contains("joint1 twice")
        );
        let others = names(&["a", "b", "c", "d", "e", "f", "g"]);
        assert!(
            in_order(&others, &numbers)
                .unwrap_err()
                .contains("names no joint1")
        );
        assert!(
            in_order(&seven, &numbers[..6])
                .unwrap_err()
                .contains("6 positions")
        );
    }
}
