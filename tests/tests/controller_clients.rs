//! Clients in other languages: the Python module and the C header have the controller's layouts, names
//! and codes, the document beside them lists them all, and real Python processes talk to a real
//! controller. What the machine lacks (Python, a C compiler, a Python module) is skipped with a message.
//! And a driver of the arm that is killed and started anew.

mod controller_world;

use controller::session::ICEORYX2;
use controller_world::{PATIENCE, World, await_status, idle, in_phase};
use iceoryx2::prelude::ZeroCopySend;
use serde_json::{Map, Value, json};
use shared::arm::{self, JOINTS, Joints, LEVEL_POSTURE_RAD};
use shared::messages::{
    COMMAND_MAGIC, Command, CommandKind, GOAL_MAGIC, Goal, Gripper, JointTarget, PROTOCOL, Phase,
    ROBOT_MAGIC, Reason, RobotState, STATUS_MAGIC, Status, TARGET_MAGIC, degraded,
};
use std::mem::offset_of;
use std::path::PathBuf;
use std::process::{Child, Command as Process, Output, Stdio};
use std::time::Instant;

/// The layout of a message. Every field is named here: one that is not listed does not compile.
macro_rules! layout {
    ($name:ident, $magic:expr, { $($field:ident),* $(,)? }) => {{
        let message = $name::default();
        let $name { $($field: _),* } = message;
        let mut fields = Map::new();
        $(fields.insert(
            stringify!($field).to_string(),
            json!([offset_of!($name, $field), size_of_val(&message.$field)]),
        );)*
        // SAFETY: the function is unsafe only because implementing the trait is.
        let name = unsafe { $name::type_name() };
        let layout = json!({
            "magic": $magic, "size": size_of::<$name>(), "align": align_of::<$name>(), "fields": fields,
        });
        (name.to_string(), stringify!($name), layout)
    }};
}

/// Every message: type name, name and layout.
fn layouts() -> [(String, &'static str, Value); 5] {
    [
        layout!(Goal, GOAL_MAGIC, { magic, stamp_ns, id, x_m, rope, keep_alive_ms }),
        layout!(Command, COMMAND_MAGIC, { magic, stamp_ns, id, kind, reserved }),
        layout!(RobotState, ROBOT_MAGIC, {
            magic, seq, stamp_ns, target_seq, q_rad, dq_rad_s, error_code, gripper,
        }),
        layout!(JointTarget, TARGET_MAGIC, {
            magic, seq, stamp_ns, goal_id, q_rad, dq_rad_s, stream, phase, gripper, reserved,
        }),
        layout!(Status, STATUS_MAGIC, {
            magic, seq, stamp_ns, judged_goal_id, active_goal_id, finished_goal_id, command_id, cycles,
            missed_deadlines, goals_accepted, goals_refused, messages_ignored, messages_lost, targets_sent,
            state, judged_reason, finished_reason, command_reason, latch_reason, degraded, stream, gripper,
        }),
    ]
}

/// A name of Rust as constants of C and Python are written.
fn upper_snake(name: &str) -> String {
    let mut text = String::new();
    for (at, letter) in name.char_indices() {
        if letter.is_uppercase() && at > 0 {
            text.push('_');
        }
        text.push(letter.to_ascii_uppercase());
    }
    text
}

/// Every code by the name of its kind and its own.
fn codes() -> Vec<(&'static str, Vec<(String, u32)>)> {
    macro_rules! kind {
        ($name:ident) => {{
            let list = $name::ALL.iter();
            let named = list.map(|value| (upper_snake(&format!("{value:?}")), value.code()));
            (stringify!($name), named.collect())
        }};
    }
    let bits = [
        ("NO_FIFO", degraded::NO_FIFO),
        ("NO_AFFINITY", degraded::NO_AFFINITY),
        ("NO_MEMLOCK", degraded::NO_MEMLOCK),
        ("NO_FLUSH_TO_ZERO", degraded::NO_FLUSH_TO_ZERO),
        ("DRY_RUN", degraded::DRY_RUN),
        ("MAY_SLEEP", degraded::MAY_SLEEP),
    ];
    let bits = bits.map(|(name, bit)| (name.to_string(), bit)).to_vec();
    vec![
        kind!(CommandKind),
        kind!(Gripper),
        kind!(Phase),
        kind!(Reason),
        ("Degraded", bits),
    ]
}

fn clients() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../controller/clients")
}

/// Python 3 in the folder of the Python clients, writing nothing there.
fn python() -> Process {
    let mut command = Process::new("python3");
    command
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .env("PYTHONUNBUFFERED", "1")
        .current_dir(clients().join("python"));
    command
}

/// Whether Python 3 is there with these modules; says so where it is not.
fn python_has(modules: &[&str]) -> bool {
    let imports = format!(
        "import sys{}",
        modules.iter().map(|m| format!(", {m}")).collect::<String>()
    );
    let there = python()
        .args(["-c", &imports])
        .output()
        .is_ok_and(|output| output.status.success());
    if !there {
        println!("skipped: this machine has no python3 with {modules:?} (pip install them to run this)");
    }
    there
}

fn words(output: &Output) -> String {
    let text = [&output.stdout[..], &output.stderr[..]].concat();
    String::from_utf8_lossy(&text).into_owned()
}

#[test]
fn the_python_module_has_the_controllers_layouts_and_codes() {
    if !python_has(&[]) {
        return;
    }
    let output = python()
        .args(["genorm_ipc.py", "--layout"])
        .output()
        .expect("python3 runs");
    assert!(output.status.success(), "{}", words(&output));
    let found: Value = serde_json::from_slice(&output.stdout).expect("one JSON object");
    let messages: Map<String, Value> = layouts()
        .into_iter()
        .map(|(type_name, _, layout)| (type_name, layout))
        .collect();
    let codes: Map<String, Value> = codes()
        .into_iter()
        .map(|(kind, list)| {
            (
                kind.to_string(),
                list.into_iter().map(|(n, c)| (n, json!(c))).collect(),
            )
        })
        .collect();
    let expected =
        json!({ "protocol": PROTOCOL, "iceoryx2": ICEORYX2, "messages": messages, "codes": codes });
    assert_eq!(found, expected);
}

#[test]
fn the_python_bridges_pass_their_own_tests() {
    if !python_has(&[]) {
        return;
    }
    let output = python().arg("test_bridges.py").output().expect("python3 runs");
    assert!(output.status.success(), "{}", words(&output));
}

/// A C program that compiles only where the header agrees with this program in everything.
fn c_program() -> String {
    use std::fmt::Write;
    let mut text = String::from("#include <string.h>\n#include \"genorm_ipc.h\"\n");
    let mut expect = |condition: String| {
        let quoted = condition.replace(['"', '\\'], "");
        writeln!(text, "GENORM_STATIC_ASSERT({condition}, \"{quoted}\");").expect("a string takes it");
    };
    expect(format!("GENORM_PROTOCOL == {PROTOCOL}"));
    expect(format!("sizeof GENORM_ICEORYX2 == {}", ICEORYX2.len() + 1));
    let mut names = Vec::new();
    for (type_name, name, layout) in layouts() {
        let upper = upper_snake(name);
        let lower = upper.to_lowercase();
        expect(format!("GENORM_{upper}_MAGIC == UINT64_C({})", layout["magic"]));
        expect(format!("sizeof(struct genorm_{lower}) == {}", layout["size"]));
        for (field, place) in layout["fields"].as_object().expect("fields") {
            expect(format!(
                "offsetof(struct genorm_{lower}, {field}) == {}",
                place[0]
            ));
            expect(format!(
                "sizeof(((struct genorm_{lower} *)0)->{field}) == {}",
                place[1]
            ));
        }
        names.push(format!("strcmp(GENORM_{upper}_TYPE, \"{type_name}\")"));
    }
    for (kind, list) in codes() {
        for (name, code) in list {
            expect(format!("GENORM_{}_{name} == {code}", upper_snake(kind)));
        }
    }
    names.push(format!("strcmp(GENORM_ICEORYX2, \"{ICEORYX2}\")"));
    writeln!(text, "int main(void) {{ return {}; }}", names.join(" || ")).expect("a string takes it");
    text
}

/// Compiles and runs the program; skipped with a message where there is no such compiler.
fn compiles_and_agrees(compiler: &str, source: &str, standard: &str) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (source, program) = (folder.path().join(source), folder.path().join("program"));
    std::fs::write(&source, c_program()).expect("written");
    let compiled = Process::new(compiler)
        .args([standard, "-Wall", "-Wextra", "-Werror", "-pedantic", "-I"])
        .arg(clients().join("c"))
        .arg("-o")
        .args([&program, &source])
        .output();
    let Ok(output) = compiled else {
        println!("skipped: this machine has no '{compiler}'");
        return;
    };
    assert!(output.status.success(), "{}", words(&output));
    let output = Process::new(&program).output().expect("it runs");
    assert!(output.status.success(), "a type name differs");
}

#[test]
fn the_c_header_has_the_controllers_layouts_and_codes() {
    compiles_and_agrees("cc", "layout.c", "-std=c11");
    compiles_and_agrees("c++", "layout.cpp", "-std=c++11");
}

#[test]
fn the_document_lists_every_code_with_the_words_of_the_program() {
    let path = clients().join("README.md");
    let text = std::fs::read_to_string(path).expect("the document");
    let rows = |kind: &str| -> Vec<String> {
        let list = text
            .lines()
            .filter(|line| line.starts_with("| ") && line.contains(kind));
        list.map(String::from).collect()
    };
    macro_rules! listed {
        ($name:ident) => {
            for value in $name::ALL {
                let row = format!("| {} | `{value:?}` | {} |", value.code(), value.text());
                assert!(text.lines().any(|line| line.starts_with(&row)), "{row}");
            }
        };
    }
    listed!(CommandKind);
    listed!(Phase);
    listed!(Reason);
    for reason in Reason::ALL {
        let row = format!("| `{reason:?}` | {} | {} |", reason.text(), reason.remedy());
        assert!(text.lines().any(|line| line.ends_with(&row)), "{row}");
    }
    for (name, bit) in &codes().last().expect("the bits").1 {
        assert!(!rows(&format!("| {bit} | `{name}` |")).is_empty(), "{name}");
    }
    for (type_name, _, _) in layouts() {
        assert!(!rows(&format!("`{type_name}`")).is_empty(), "{type_name}");
    }
    assert!(
        text.contains(&format!("protocol {PROTOCOL} ")) && text.contains(&format!("iceoryx2 {ICEORYX2} "))
    );
}

#[test]
fn a_python_client_has_its_goal_served_and_is_told_of_another_version() {
    if !python_has(&["iceoryx2"]) {
        return;
    }
    let world = World::new();
    let _controller = world.controller(&[]);
    let _robot = world.robot();
    await_status(&mut world.client(), &mut Vec::new(), idle);
    let goal = |x: &str| {
        let output = python().args(["genorm_ipc.py", x, &world.instance]).output();
        let output = output.expect("python3 runs");
        (output.status.code(), words(&output))
    };
    let (code, text) = goal("nan");
    assert!(code == Some(1) && text.contains("NON_FINITE"), "{text}");
    let (code, text) = goal("far");
    assert!(code == Some(2) && text.contains("use: "), "{text}");
    let (code, text) = goal("0.33");
    assert!(code == Some(0) && text.contains("ended: DONE"), "{text}");

    let later = format!(
        "import genorm_ipc as g; g.PROTOCOL = 99; g.Client.connect('{}')",
        world.instance
    );
    let output = python().args(["-c", &later]).output().expect("python3 runs");
    let text = words(&output);
    assert!(
        text.contains("this module speaks protocol 99") && text.contains("take both from one version"),
        "{text}"
    );
}

/// A Python process that does not outlive its test.
struct Script(Child);

impl Drop for Script {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// MuJoCo multiplies the chain by itself, from the same table: positions within 0.1 mm (they agree to
/// rounding), rotations alike.
#[test]
fn the_mujoco_model_agrees_with_the_forward_kinematics() {
    if !python_has(&["mujoco"]) {
        return;
    }
    let script = "import json, random, mujoco; from xarm7_mjcf import mjcf, RANGES_RAD
model = mujoco.MjModel.from_xml_string(mjcf()); data = mujoco.MjData(model); random.seed(7); rows = []
for _ in range(100):
    q = [random.uniform(*limits) for limits in RANGES_RAD]
    data.qpos[:7] = q
    mujoco.mj_forward(model, data)
    rows.append([q, list(data.site('flange').xpos), list(data.site('flange').xmat)])
print(json.dumps(rows))";
    let output = python().args(["-c", script]).output().expect("python3 runs");
    let rows: Vec<(Joints, [f64; 3], [f64; 9])> =
        serde_json::from_slice(&output.stdout).unwrap_or_else(|_| panic!("{}", words(&output)));
    assert_eq!(rows.len(), 100);
    for (q_rad, position_m, rotation) in rows {
        let pose = arm::flange(&q_rad);
        for k in 0..3 {
            assert!((pose.position_m[k] - position_m[k]).abs() < 1e-4, "{q_rad:?}");
            for l in 0..3 {
                assert!(
                    (pose.rotation[(k, l)] - rotation[3 * k + l]).abs() < 1e-4,
                    "{q_rad:?}"
                );
            }
        }
    }
}

#[test]
fn the_mujoco_bridge_swings_a_simulated_arm() {
    if !python_has(&["iceoryx2", "mujoco"]) {
        return;
    }
    let world = World::new();
    let _controller = world.controller(&[]);
    let bridge = python()
        .args(["mujoco_bridge.py", "--instance", &world.instance])
        .stdout(Stdio::null())
        .stderr(world.log())
        .spawn();
    let _bridge = Script(bridge.expect("python3 runs"));
    let mut client = world.client();
    let mut targets = Vec::new();
    await_status(&mut client, &mut targets, idle);
    let id = client.send_goal(0, 0.33).expect("sent");
    let end = await_status(&mut client, &mut targets, |status| status.finished_goal_id == id);
    assert_eq!(end.finished_reason, Reason::Done.code(), "within {PATIENCE:?}");
    assert_eq!(end.latch_reason, Reason::Accepted.code());
}

/// Two drivers would be one arm in two places.
#[test]
fn a_second_driver_is_not_heard_and_is_told_of() {
    let world = World::new();
    let _controller = world.controller(&[]);
    let _robot = world.robot();
    let (mut client, mut targets) = (world.client(), Vec::new());
    await_status(&mut client, &mut targets, idle);
    let _second = world.robot();
    let told = || {
        let log = std::fs::read_to_string(world.path("log")).expect("a log");
        log.contains("a second driver of the arm reports")
    };
    let end = Instant::now() + PATIENCE;
    while !told() {
        assert!(Instant::now() < end, "it is told within {PATIENCE:?}");
        await_status(&mut client, &mut targets, |_| true);
    }
    let id = client.send_goal(0, 0.33).expect("sent");
    let end = await_status(&mut client, &mut targets, |status| status.finished_goal_id == id);
    assert_eq!(end.finished_reason, Reason::Done.code());
}

/// A driver that is killed and started anew finds its arm elsewhere than the last target: the simulated arm
/// always starts in one posture. The next stream begins at that posture, so the driver has sent nothing old.
#[test]
fn a_restarted_driver_leaves_the_arm_where_it_finds_it() {
    let world = World::new();
    let _controller = world.controller(&[]);
    let killed = world.robot();
    let (mut client, mut targets) = (world.client(), Vec::new());
    await_status(&mut client, &mut targets, idle);
    let id = client.send_goal(0, 0.33).expect("sent");
    await_status(&mut client, &mut targets, |status| status.finished_goal_id == id);
    let away_rad = |target: &JointTarget| {
        let away = (0..JOINTS).map(|i| (target.q_rad[i] - LEVEL_POSTURE_RAD[i]).abs());
        away.fold(0.0, f64::max)
    };
    assert!(targets.last().is_some_and(|target| away_rad(target) > 0.1));
    drop(killed);
    await_status(&mut client, &mut targets, in_phase(Phase::Waiting));
    targets.clear();
    let _restarted = world.robot();
    await_status(&mut client, &mut targets, idle);
    while targets.is_empty() {
        await_status(&mut client, &mut targets, |_| true);
    }
    assert!(away_rad(&targets[0]) < 1e-9, "{:?}", targets[0]);
}
