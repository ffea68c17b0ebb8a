//! `offline demo import …` and `offline demo export …`.

use super::demos::write;
use super::numbers::above_zero;
use super::output::{note, print};
use super::place::Place;
use anyhow::Context;
use clap::{Args, Subcommand};
use offline::demo::{Demo, DemoSpec, export_mcap, import, recording};
use std::path::{Path, PathBuf};

/// Where a recording comes from.
#[derive(Subcommand)]
pub enum ImportCommand {
    /// Swings that the controller recorded with `--record`.
    #[command(after_help = "Example: offline demo import recording run.rec --seen cameras/ --out demos/")]
    Recording(Recorded),
    /// Cables held at one end: static poses, free and driven swings (PAC_model_matlab).
    #[command(after_help = "Example: offline demo import pac-cables data/pac_cables --out demos/pac")]
    PacCables(Folders),
    /// Ropes held at both ends, by motion capture (DEFORM).
    #[command(after_help = "Example: offline demo import deform data/deform --out demos/deform --rate-hz 25")]
    Deform(Thinned),
    /// A foam cylinder moved by an arm (PRB_Net).
    #[command(after_help = "Example: offline demo import noodle data/noodle --out demos/noodle --rate-hz 25")]
    Noodle(Thinned),
    /// Hanging loops of wire (adapteddlo_muj).
    #[command(after_help = "Example: offline demo import wires data/wires --out demos/wires")]
    Wires(Folders),
    /// A ROS 2 recording: clouds, and the clamps as poses or as the joints of the arm.
    #[command(
        after_help = "Example: offline demo import mcap bag.mcap --cloud-topic /rope/points --joint-topic \
                      /joint_states --spec demo.toml --out my-rope/fit"
    )]
    Mcap(McapArguments),
}

impl ImportCommand {
    /// What is read.
    fn source(&self) -> &Path {
        match self {
            Self::Recording(recorded) => &recorded.file,
            Self::PacCables(folders) | Self::Wires(folders) => &folders.dir,
            Self::Deform(thinned) | Self::Noodle(thinned) => &thinned.folders.dir,
            Self::Mcap(arguments) => &arguments.file,
        }
    }
}

/// A recording of the controller.
#[derive(Args)]
pub struct Recorded {
    /// The recording.
    file: PathBuf,
    /// What cameras saw meanwhile: a folder with `clouds.csv` or `markers.csv`, in the frame of the task,
    /// times in s of this machine's CLOCK_MONOTONIC. Without it only the gripped end is seen.
    #[arg(long, value_name = "DIR")]
    seen: Option<PathBuf>,
    /// Folder under which one demonstration folder per swing is written.
    #[arg(long, value_name = "DIR", default_value = ".")]
    out: PathBuf,
}

/// A recording and its topics.
#[derive(Args)]
pub struct McapArguments {
    /// The recording, an uncompressed .mcap file.
    file: PathBuf,
    /// Topic of the rope's clouds (sensor_msgs/msg/PointCloud2).
    #[arg(long)]
    cloud_topic: String,
    /// Topic of the rope's end in each clamp (geometry_msgs/msg/PoseStamped), in the order of [[clamps]].
    #[arg(long, num_args = 1.., required_unless_present = "joint_topic")]
    clamp_topic: Vec<String>,
    /// Topic of the arm that holds the rope (sensor_msgs/msg/JointState of an xArm7).
    #[arg(long, conflicts_with = "clamp_topic")]
    joint_topic: Option<String>,
    /// Topic per clamp that says whether it holds (std_msgs/msg/Bool); it always does by default.
    #[arg(long, num_args = 1..)]
    closed_topic: Vec<String>,
    /// A demo.toml that declares rope, clamps and cameras; the recording's attachment by default.
    #[arg(long, value_name = "FILE")]
    spec: Option<PathBuf>,
    #[command(flatten)]
    place: Place,
    /// Demonstration folder to write.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// Where a demonstration goes to.
#[derive(Subcommand)]
pub enum ExportCommand {
    /// A recording that Foxglove and ROS 2 tools open.
    #[command(after_help = "Example: offline demo export mcap offline/demos/sample-rope/fit fit.mcap")]
    Mcap {
        /// Demonstration folder.
        folder: PathBuf,
        /// File to write.
        file: PathBuf,
    },
}

/// Writes a demonstration in another format.
pub fn export(target: ExportCommand, json: bool) -> anyhow::Result<()> {
    let ExportCommand::Mcap { folder, file } = target;
    export_mcap(&Demo::load(&folder)?, &file)?;
    if json {
        print(serde_json::json!({ "written": file.display().to_string() }))
    } else {
        print(format_args!("wrote {}", file.display()))
    }
}

/// What to read and where to write.
#[derive(Args)]
pub struct Folders {
    /// Folder of the data set.
    dir: PathBuf,
    /// Folder under which one demonstration folder per recording is written.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// A data set with more frames than a fit needs.
#[derive(Args)]
pub struct Thinned {
    #[command(flatten)]
    folders: Folders,
    /// Observed frames per second to keep; clamp paths are kept whole.
    #[arg(long, default_value_t = 25.0, value_parser = above_zero)]
    rate_hz: f64,
}

/// Imports, writes the folders and says what is in them.
pub fn import(source: ImportCommand, json: bool) -> anyhow::Result<()> {
    let from = source.source().display().to_string();
    let imported = || format!("imported from {from}");
    let (demos, out) = match source {
        ImportCommand::Recording(a) => (recording(&a.file, a.seen.as_deref())?, a.out),
        ImportCommand::PacCables(a) => (import::pac_cables(&a.dir)?, a.out),
        ImportCommand::Wires(a) => (import::wires(&a.dir)?, a.out),
        ImportCommand::Mcap(a) => {
            let folder = a.out.clone();
            let read = mcap(a)?;
            if read.empty_clouds > 0 {
                note(format_args!(
                    "left out {} clouds without a point",
                    read.empty_clouds
                ));
            }
            return write(&read.demo, &folder, json).with_context(imported);
        }
        ImportCommand::Deform(a) => (import::deform(&a.folders.dir, a.rate_hz)?, a.folders.out),
        ImportCommand::Noodle(a) => (import::noodle(&a.folders.dir, a.rate_hz)?, a.folders.out),
    };
    for demo in &demos {
        write(demo, &out.join(&demo.name), json).with_context(imported)?;
    }
    Ok(())
}

fn mcap(a: McapArguments) -> anyhow::Result<import::FromMcap> {
    let topics = import::McapTopics {
        cloud: a.cloud_topic,
        clamps: a.clamp_topic,
        joints: a.joint_topic,
        closed: a.closed_topic,
    };
    let spec = a.spec.as_deref().map(DemoSpec::load).transpose()?;
    let name = a.out.file_name().map_or("demo".into(), |n| n.to_string_lossy());
    Ok(import::mcap(&a.file, &topics, spec, &a.place.frame(), &name)?)
}
