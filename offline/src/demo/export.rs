//! A demonstration as an MCAP file that Foxglove and ROS 2 tools open: profile `ros2`, messages in
//! CDR. What messages cannot say, `demo.toml`, goes along as an attachment.

use super::ros::{self, Bool, FLOAT32, Header, Message, PointCloud2, PointField, PoseStamped, Time};
use super::{ClampSample, Demo, DemoError, Observations, refuse_to_replace_file};
use mcap::{Attachment, WriteOptions, Writer, records::MessageHeader};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::Path;

/// Time of the demonstration's t = 0, ns since 1970: viewers do not like recordings from 1970.
const EPOCH_NS: u64 = 1_700_000_000_000_000_000;
/// Key of [`EPOCH_NS`] in the channels' metadata.
pub(super) const EPOCH_KEY: &str = "genorm_epoch_ns";
/// Name of the attachment that holds `demo.toml`.
pub(super) const SPEC_NAME: &str = "demo.toml";
const FRAME: &str = "world";

/// Topic of the clouds.
pub const CLOUD_TOPIC: &str = "/rope/points";

/// Topic of the pose of clamp `index`.
pub fn clamp_topic(index: usize) -> String {
    format!("/clamp_{index}/pose")
}

/// Topic that says whether clamp `index` holds.
pub fn closed_topic(index: usize) -> String {
    format!("/clamp_{index}/closed")
}

/// One message before it is written.
struct Entry {
    stamp_ns: u64,
    channel: u16,
    data: Vec<u8>,
}

/// Writes a demonstration with clouds as an MCAP file, whole or not at all; one that is there may be a measurement, and stays.
///
/// # Errors
/// The demonstration holds markers, which have no ROS message, the file is there, or it cannot be written.
pub fn export_mcap(demo: &Demo, file: &Path) -> Result<(), DemoError> {
    refuse_to_replace_file(file, None)?;
    let bytes = recording(demo).map_err(|problem| {
        DemoError::new(
            file,
            problem,
            "export a demonstration with clouds, and check the disk",
        )
    })?;
    crate::run_files::write_whole(file, &bytes).map_err(|e| DemoError::unwritten(file, "writing", &e.cause))
}

fn recording(demo: &Demo) -> Result<Vec<u8>, String> {
    let Observations::Clouds(frames) = &demo.observations else {
        return Err("it holds markers, for which ROS 2 has no message".into());
    };
    let options = WriteOptions::new().profile("ros2").compression(None);
    let mut writer = options
        .library("genorm-offline")
        .create(Cursor::new(Vec::new()))
        .map_err(text)?;
    let mut entries = Vec::new();
    let channel = channel::<PointCloud2>(&mut writer, CLOUD_TOPIC)?;
    for frame in frames {
        let message = cloud(frame.t_s, &frame.points_m);
        entries.push(entry(channel, frame.t_s, &message)?);
    }
    for (index, path) in demo.clamps.iter().enumerate() {
        clamp(&mut writer, index, path, &mut entries)?;
    }
    entries.sort_by_key(|entry| entry.stamp_ns);
    for (sequence, entry) in entries.iter().enumerate() {
        let header = MessageHeader {
            channel_id: entry.channel,
            sequence: sequence as u32,
            log_time: entry.stamp_ns,
            publish_time: entry.stamp_ns,
        };
        writer
            .write_to_known_channel(&header, &entry.data)
            .map_err(text)?;
    }
    let spec = toml::to_string(&demo.spec).map_err(text)?;
    let attachment = Attachment {
        log_time: EPOCH_NS,
        create_time: EPOCH_NS,
        name: SPEC_NAME.into(),
        media_type: "application/toml".into(),
        data: Cow::Owned(spec.into_bytes()),
    };
    writer.attach(&attachment).map_err(text)?;
    writer.finish().map_err(text)?;
    Ok(writer.into_inner().into_inner())
}

type Output = Writer<Cursor<Vec<u8>>>;

fn text(error: impl std::fmt::Display) -> String {
    error.to_string()
}

fn channel<M: Message>(writer: &mut Output, topic: &str) -> Result<u16, String> {
    let schema = writer
        .add_schema(M::NAME, "ros2msg", M::DEFINITION.as_bytes())
        .map_err(text)?;
    let metadata = BTreeMap::from([(EPOCH_KEY.to_owned(), EPOCH_NS.to_string())]);
    writer.add_channel(schema, topic, "cdr", &metadata).map_err(text)
}

fn clamp(
    writer: &mut Output,
    index: usize,
    path: &[ClampSample],
    entries: &mut Vec<Entry>,
) -> Result<(), String> {
    let poses = channel::<PoseStamped>(writer, &clamp_topic(index))?;
    let closed = channel::<Bool>(writer, &closed_topic(index))?;
    for sample in path {
        let pose = PoseStamped {
            header: header(sample.t_s),
            position_m: sample.position_m,
            quaternion_xyzw: sample.quaternion_xyzw,
        };
        entries.push(entry(poses, sample.t_s, &pose)?);
        entries.push(entry(closed, sample.t_s, &Bool { data: sample.closed })?);
    }
    Ok(())
}

fn entry<M: Message>(channel: u16, t_s: f64, message: &M) -> Result<Entry, String> {
    Ok(Entry {
        stamp_ns: stamp_ns(t_s),
        channel,
        data: ros::encode(message)?,
    })
}

fn stamp_ns(t_s: f64) -> u64 {
    EPOCH_NS.saturating_add_signed((t_s * 1e9).round() as i64)
}

fn header(t_s: f64) -> Header {
    let stamp = stamp_ns(t_s);
    Header {
        stamp: Time {
            sec: (stamp / 1_000_000_000) as i32,
            nanosec: (stamp % 1_000_000_000) as u32,
        },
        frame_id: FRAME.into(),
    }
}

fn cloud(t_s: f64, points_m: &[[f64; 3]]) -> PointCloud2 {
    const STEP: u32 = 12;
    let field = |(axis, name): (u32, &str)| PointField {
        name: name.into(),
        offset: 4 * axis,
        datatype: FLOAT32,
        count: 1,
    };
    let numbers = points_m.iter().flatten();
    PointCloud2 {
        header: header(t_s),
        height: 1,
        width: points_m.len() as u32,
        fields: [(0, "x"), (1, "y"), (2, "z")].map(field).to_vec(),
        is_bigendian: false,
        point_step: STEP,
        row_step: STEP * points_m.len() as u32,
        data: numbers.flat_map(|x| (*x as f32).to_le_bytes()).collect(),
        is_dense: true,
    }
}
