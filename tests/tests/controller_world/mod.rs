//! Real processes of the controller and its clients, each test with an instance of its own: helper of the
//! tests beside it.

// Each test program uses another part of this.
#![allow(dead_code)]

#[path = "../../../controller/tests/virtual_arm/limit_check.rs"]
pub mod limit_check;

use controller::client::Client;
use controller::session::Instance;
use controller::{policy_file, sample};
use shared::messages::{JointTarget, Phase, Status};
use std::fs::File;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Far beyond what anything here takes; only a hang reaches it.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// A process that does not outlive its test.
pub struct Process(pub Child);

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The folder of built programs that this test itself lies in, and the flag that builds into it.
pub fn build_folder() -> (PathBuf, &'static [&'static str]) {
    let mut folder = std::env::current_exe().expect("a test has a path");
    folder.pop();
    if folder.ends_with("deps") {
        folder.pop();
    }
    let flags: &[&str] = if folder.ends_with("release") {
        &["--release"]
    } else {
        &[]
    };
    (folder, flags)
}

/// Path of a program of the controller crate, built first if it is missing.
pub fn program(relative: &str) -> PathBuf {
    let (folder, flags) = build_folder();
    let path = folder.join(relative);
    if !path.exists() {
        let status = Command::new(env!("CARGO"))
            .args(["build", "-p", "controller", "--bins", "--examples"])
            .args(flags)
            .current_dir(env!("CARGO_MANIFEST_DIR"))
            .status()
            .expect("cargo runs");
        assert!(status.success(), "cannot build {relative}");
    }
    path
}

/// An instance of the controller with a sample policy file of its own.
pub struct World {
    pub instance: String,
    folder: TempDir,
}

impl World {
    pub fn new() -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let count = COUNT.fetch_add(1, Ordering::Relaxed);
        let folder = tempfile::tempdir().expect("a temporary folder");
        policy_file::write(&folder.path().join("policy.blob"), &sample::blob()).expect("a policy file");
        Self {
            instance: format!("test-{}-{count}", std::process::id()),
            folder,
        }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Where the programs of this world write their messages.
    pub fn log(&self) -> Stdio {
        let file = File::options().create(true).append(true).open(self.path("log"));
        file.expect("a log file").into()
    }

    pub fn controller(&self, more: &[&str]) -> Process {
        self.controller_that_tells(self.log(), more)
    }

    /// A controller whose standard error is `words`.
    pub fn controller_that_tells(&self, words: impl Into<Stdio>, more: &[&str]) -> Process {
        let child = Command::new(program("controller"))
            .arg("--policy")
            .arg(self.path("policy.blob"))
            .args(["--instance", &self.instance, "--robot-timeout-ms", "2000"])
            .args(more)
            .stderr(words)
            .spawn()
            .expect("the controller starts");
        Process(child)
    }

    /// An arm that a busy machine may hold up: it takes steps of any length.
    pub fn robot(&self) -> Process {
        self.robot_that_steps("10")
    }

    /// An arm that takes steps of its targets up to so many rad.
    pub fn robot_that_steps(&self, step_max_rad: &str) -> Process {
        let child = Command::new(program("examples/sim_robot"))
            .args(["--instance", &self.instance, "--step-max-rad", step_max_rad])
            .stderr(self.log())
            .spawn()
            .expect("the simulated arm starts");
        Process(child)
    }

    pub fn client(&self) -> Client {
        Client::connect(&self.instance, PATIENCE).expect("a connection")
    }
}

impl Drop for World {
    fn drop(&mut self) {
        if std::thread::panicking() {
            let log = std::fs::read_to_string(self.path("log")).unwrap_or_default();
            eprintln!("what the programs said:\n{log}");
        }
        // The programs of a test are declared after its world, so they have ended by now.
        let purged = Instance::new(&self.instance).and_then(|instance| instance.purge());
        if let Err(error) = purged {
            eprintln!("left behind: {error}");
        }
    }
}

/// Waits for a status that `wanted` accepts, collecting the targets that come meanwhile.
pub fn await_status(
    client: &mut Client,
    targets: &mut Vec<JointTarget>,
    wanted: impl Fn(&Status) -> bool,
) -> Status {
    let start = Instant::now();
    while start.elapsed() < PATIENCE {
        let status = client.wait_status(Duration::from_millis(20)).expect("a status");
        while let Some(target) = client.next_target().expect("a target") {
            targets.push(target);
        }
        if let Some(status) = status.filter(|status| wanted(status)) {
            return status;
        }
    }
    panic!("the status waited for did not come");
}

pub fn idle(status: &Status) -> bool {
    in_phase(Phase::Idle)(status)
}

/// Whether a status says that the controller does this.
pub fn in_phase(phase: Phase) -> impl Fn(&Status) -> bool {
    move |status| status.state == phase.code()
}

/// Sends a signal, by its name without SIG.
pub fn signal(process: &Process, name: &str) {
    let done = Command::new("kill")
        .args([&format!("-{name}"), &process.0.id().to_string()])
        .status()
        .is_ok_and(|status| status.success());
    assert!(done, "the signal was not sent");
}

/// Asks a process to end as an operator does, and returns whether it ended well.
pub fn terminate(process: &mut Process) -> bool {
    signal(process, "TERM");
    process.0.wait().is_ok_and(|status| status.success())
}
