//! Recordings: what is exported as MCAP comes back as the same demonstration, the joints of an arm
//! become the clamp's path, and what cannot be read is refused with one line.

use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use offline::demo::import::{McapTopics, mcap};
use offline::demo::{CLOUD_TOPIC, Demo, DemoError, Observations, clamp_topic, closed_topic, export_mcap};
use shared::arm::DEFAULT_TASK_FRAME;
use std::path::{Path, PathBuf};

fn shipped() -> Demo {
    let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("demos/sample-rope/fit");
    let mut demo = Demo::load(dir).unwrap();
    // A part of it is enough; the grip opens at the end, so that its state is carried as well.
    if let Observations::Clouds(frames) = &mut demo.observations {
        frames.truncate(5);
    }
    demo.commanded[0] = None;
    demo.clamps[0].truncate(40);
    demo.clamps[0][39].closed = false;
    demo
}

fn exported(demo: &Demo) -> (tempfile::TempDir, PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("fit.mcap");
    export_mcap(demo, &file).unwrap();
    (dir, file)
}

fn topics() -> McapTopics {
    McapTopics {
        cloud: CLOUD_TOPIC.into(),
        clamps: vec![clamp_topic(0)],
        joints: None,
        closed: vec![closed_topic(0)],
    }
}

/// Clouds are single precision in both formats, so nothing is lost at all.
#[test]
fn an_exported_demonstration_comes_back() {
    let demo = shipped();
    let (_dir, file) = exported(&demo);
    let back = mcap(&file, &topics(), None, &DEFAULT_TASK_FRAME, &demo.name).unwrap();
    assert_eq!((back.demo, back.empty_clouds), (demo, 0));
}

/// A frame in which the rope was out of sight.
#[test]
fn a_cloud_without_a_point_is_left_out_and_counted() {
    let mut demo = shipped();
    let Observations::Clouds(frames) = &mut demo.observations else {
        panic!("the sample rope is seen as clouds")
    };
    frames[2].points_m = vec![[f64::NAN; 3]; 3];
    let (_dir, file) = exported(&demo);
    let back = mcap(&file, &topics(), None, &DEFAULT_TASK_FRAME, &demo.name).unwrap();
    assert_eq!((back.demo.times_s().len(), back.empty_clouds), (4, 1));
}

/// The gripper's state must not land on the clamp that happens to be named first.
#[test]
fn each_clamp_has_its_own_topic_or_none_has() {
    let two = McapTopics {
        clamps: vec![clamp_topic(0), clamp_topic(0)],
        ..topics()
    };
    refused(&two, "1 topics say whether a clamp holds, but there are 2 clamps");
}

/// As `ros2 bag record` leaves it: a message is recorded later than it was measured, and nothing says when the
/// demonstration began.
#[test]
fn the_first_measurement_is_at_zero_however_late_it_was_recorded() {
    let demo = shipped();
    let (dir, file) = exported(&demo);
    let late = dir.path().join("late.mcap");
    let later = altered(&std::fs::read(&file).unwrap(), |message| {
        message.log_time += 80_000_000;
        true
    });
    std::fs::write(&late, later).unwrap();
    let topics = McapTopics {
        closed: Vec::new(),
        ..topics()
    };
    let back = mcap(&late, &topics, None, &DEFAULT_TASK_FRAME, "late")
        .unwrap()
        .demo;
    let first_s = back.times_s()[0].min(back.clamps[0][0].t_s);
    assert_eq!(first_s, 0.0);
    let spans = |demo: &Demo| demo.times_s().last().unwrap() - demo.times_s()[0];
    assert!((spans(&back) - spans(&demo)).abs() < 1e-6);
}

/// The openings have no stamp, so they are on the recorder's clock: that of another machine, or not the simulated
/// time of the stamps.
#[test]
fn a_clamp_opens_at_the_same_pose_whatever_the_recorders_clock_says() {
    let demo = shipped();
    for later_ns in [HOUR_NS, -HOUR_NS, 80_000_000] {
        let back = imported_altered(&demo, |message| {
            message.log_time = message.log_time.saturating_add_signed(later_ns);
            true
        });
        assert_eq!(closed(&back.unwrap()), closed(&demo), "{later_ns}");
    }
}

/// As where simulated time runs slower than the recorder's clock.
#[test]
fn openings_on_a_clock_that_runs_at_another_rate_are_refused() {
    let mut later_ns = 0;
    let back = imported_altered(&shipped(), |message| {
        later_ns += 20_000_000;
        message.log_time += later_ns;
        true
    });
    let error = back.unwrap_err().to_string();
    assert!(
        error.contains(&closed_topic(0)) && error.contains("scatters") && !error.contains('\n'),
        "{error}"
    );
}

/// On one clock the first state holds before it as well.
#[test]
fn a_first_state_that_comes_late_is_refused_on_another_clock_only() {
    let demo = shipped();
    let late = |later_ns: i64| {
        let mut first_ns = None;
        imported_altered(&demo, |message| {
            let first_ns = *first_ns.get_or_insert(message.log_time);
            let stays =
                message.channel.topic != closed_topic(0) || message.log_time >= first_ns + 300_000_000;
            message.log_time = message.log_time.saturating_add_signed(later_ns);
            stays
        })
    };
    assert_eq!(closed(&late(0).unwrap()), closed(&demo));
    let error = late(HOUR_NS).unwrap_err().to_string();
    assert!(
        error.contains("0.30 s after the clamp's first pose") && !error.contains('\n'),
        "{error}"
    );
}

const HOUR_NS: i64 = 3_600_000_000_000;

fn closed(demo: &Demo) -> Vec<bool> {
    demo.clamps[0].iter().map(|sample| sample.closed).collect()
}

/// What comes back of a demonstration from the recording that [`altered`] makes.
fn imported_altered(
    demo: &Demo,
    alter: impl FnMut(&mut mcap::Message<'_>) -> bool,
) -> Result<Demo, DemoError> {
    let (_dir, file) = exported(demo);
    let recording = altered(&std::fs::read(&file).unwrap(), alter);
    std::fs::write(&file, recording).unwrap();
    mcap(&file, &topics(), None, &DEFAULT_TASK_FRAME, "altered").map(|back| back.demo)
}

/// The recording with the messages that `alter` keeps, as it leaves them, on channels without metadata.
fn altered(recording: &[u8], mut alter: impl FnMut(&mut mcap::Message<'_>) -> bool) -> Vec<u8> {
    let mut writer = mcap::Writer::new(std::io::Cursor::new(Vec::new())).unwrap();
    copy_attachments(recording, &mut writer);
    for message in mcap::MessageStream::new(recording).unwrap() {
        let mut message = message.unwrap();
        if !alter(&mut message) {
            continue;
        }
        let channel = mcap::Channel {
            metadata: std::collections::BTreeMap::new(),
            ..(*message.channel).clone()
        };
        message.channel = std::sync::Arc::new(channel);
        writer.write(&message).unwrap();
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

fn refused(topics: &McapTopics, why: &str) {
    let (_dir, file) = exported(&shipped());
    let error = mcap(&file, topics, None, &DEFAULT_TASK_FRAME, "demo")
        .unwrap_err()
        .to_string();
    assert!(error.contains(why) && !error.contains('\n'), "{error}");
}

#[test]
fn a_topic_that_is_not_there_or_of_another_type_is_refused() {
    let absent = McapTopics {
        cloud: "/camera".into(),
        ..topics()
    };
    refused(&absent, CLOUD_TOPIC);
    let other = McapTopics {
        clamps: vec![CLOUD_TOPIC.into()],
        ..topics()
    };
    refused(&other, "not geometry_msgs/msg/PoseStamped");
}

#[test]
fn a_truncated_recording_and_one_of_markers_are_refused() {
    let (dir, file) = exported(&shipped());
    let bytes = std::fs::read(&file).unwrap();
    let short = dir.path().join("short.mcap");
    std::fs::write(&short, &bytes[..bytes.len() / 2]).unwrap();
    let error = mcap(&short, &topics(), None, &DEFAULT_TASK_FRAME, "demo").unwrap_err();
    assert!(error.to_string().contains("MCAP"), "{error}");
    let mut demo = shipped();
    demo.observations = Observations::Markers(Vec::new());
    assert!(export_mcap(&demo, &dir.path().join("markers.mcap")).is_err());
}

/// A bag as a driver records it: joints by name and out of order.
#[test]
fn joints_become_the_flange_in_the_tasks_frame() {
    let demo = shipped();
    let (_dir, file) = exported(&demo);
    let q = [0.3, -0.5, 0.2, 0.9, -0.4, 0.7, 0.1];
    let with_joints = add_joints(&std::fs::read(&file).unwrap(), q);
    std::fs::write(&file, with_joints).unwrap();
    let topics = McapTopics {
        clamps: Vec::new(),
        joints: Some("/joint_states".into()),
        closed: Vec::new(),
        ..topics()
    };
    let frame = shared::blob::TaskFrame {
        origin_m: [0.1, 0.2, 0.3],
        yaw_rad: 0.4,
    };
    let back = mcap(&file, &topics, None, &frame, "joints").unwrap().demo;
    let pose = shared::arm::flange(&q);
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -0.4);
    let at = turn * (pose.position_m - Vector3::new(0.1, 0.2, 0.3));
    let sample = &back.clamps[0][0];
    assert!((Vector3::from(sample.position_m) - at).norm() < 1e-12);
    let wanted =
        turn * UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(pose.rotation));
    let [x, y, z, w] = sample.quaternion_xyzw;
    let got = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z));
    assert!(wanted.angle_to(&got) < 1e-6);
}

fn copy_attachments(recording: &[u8], writer: &mut mcap::Writer<std::io::Cursor<Vec<u8>>>) {
    for record in mcap::read::LinearReader::new(recording).unwrap() {
        if let mcap::records::Record::Attachment { header, data, .. } = record.unwrap() {
            let attachment = mcap::Attachment {
                log_time: header.log_time,
                create_time: header.create_time,
                name: header.name,
                media_type: header.media_type,
                data,
            };
            writer.attach(&attachment).unwrap();
        }
    }
}

/// The recording with one JointState on /joint_states, whose bytes are put together here by hand.
fn add_joints(recording: &[u8], q: [f64; 7]) -> Vec<u8> {
    let mut writer = mcap::Writer::new(std::io::Cursor::new(Vec::new())).unwrap();
    copy_attachments(recording, &mut writer);
    let mut first = 0;
    for message in mcap::MessageStream::new(recording).unwrap() {
        let message = message.unwrap();
        first = if first == 0 { message.log_time } else { first };
        writer.write(&message).unwrap();
    }
    let mut bytes = vec![0, 1, 0, 0];
    let pad = |bytes: &mut Vec<u8>, to: usize| {
        while !(bytes.len() - 4).is_multiple_of(to) {
            bytes.push(0);
        }
    };
    bytes.extend(((first / 1_000_000_000) as i32).to_le_bytes());
    bytes.extend(((first % 1_000_000_000) as u32).to_le_bytes());
    bytes.extend(1u32.to_le_bytes());
    bytes.push(0);
    pad(&mut bytes, 4);
    let order = [6, 5, 4, 3, 2, 1, 0];
    bytes.extend(7u32.to_le_bytes());
    for joint in order {
        pad(&mut bytes, 4);
        bytes.extend(7u32.to_le_bytes());
        bytes.extend(format!("joint{}\0", joint + 1).bytes());
    }
    pad(&mut bytes, 4);
    bytes.extend(7u32.to_le_bytes());
    pad(&mut bytes, 8);
    for joint in order {
        bytes.extend(q[joint].to_le_bytes());
    }
    bytes.extend(0u32.to_le_bytes());
    bytes.extend(0u32.to_le_bytes());
    let schema = writer
        .add_schema("sensor_msgs/msg/JointState", "ros2msg", b"")
        .unwrap();
    let channel = writer
        .add_channel(schema, "/joint_states", "cdr", &std::collections::BTreeMap::new())
        .unwrap();
    let header = mcap::records::MessageHeader {
        channel_id: channel,
        sequence: 0,
        log_time: first,
        publish_time: first,
    };
    writer.write_to_known_channel(&header, &bytes).unwrap();
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}
