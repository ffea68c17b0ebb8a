//! kill -9 of the controller and of its clients at any time, the first 30 ms of a start included: the
//! next start and the next connection work at once, and nothing is left for a person to delete.

mod controller_world;

use controller::client::Client;
use controller::session::Instance;
use controller_world::{PATIENCE, Process, World, await_status, idle, program};
use std::fs::File;
use std::path::PathBuf;
use std::process::Command;
use std::sync::mpsc;
use std::time::{Duration, Instant};

/// What the promise allows a restart to take, from spawning the program to the first status.
const RESTART_MAX: Duration = Duration::from_secs(2);

/// A delay in the first 30 ms for two of three rounds, within the next 600 ms for the third.
fn delay(round: u64, salt: u64) -> Duration {
    let spread_us = (round * 7919 + salt * 104_729 + 137) % 30_000;
    Duration::from_micros(if round % 3 == 2 {
        30_000 + 20 * spread_us
    } else {
        spread_us
    })
}

fn kill(process: &mut Process) {
    process.0.kill().expect("killed");
    process.0.wait().expect("reaped");
}

/// A client program of this world.
fn client_program(world: &World, round: u64) -> Process {
    let mut command = match round % 3 {
        0 => Command::new(program("examples/watch_targets")),
        1 => {
            let mut command = Command::new(program("examples/send_goal"));
            command.args(["--x", "0.33"]);
            command
        }
        _ => Command::new(program("examples/sim_robot")),
    };
    command.args(["--instance", &world.instance]);
    command.stdout(world.log()).stderr(world.log());
    Process(command.spawn().expect("the client starts"))
}

/// Shared memory of this world's instance that exists now.
fn shared_memory_files(world: &World) -> Vec<PathBuf> {
    let instance = Instance::new(&world.instance).expect("a name");
    instance.shared_memory().collect()
}

/// Kills controllers and clients in turns and starts the next controller over what they leave.
fn survives(rounds: u64) {
    let world = World::new();
    let _robot = world.robot();
    let (mut slowest, mut late, mut most_files) = (Duration::ZERO, 0, 0);
    for round in 0..rounds {
        let mut victim = world.controller(&[]);
        let mut client = client_program(&world, round);
        std::thread::sleep(delay(round, 0));
        // In every other round the client dies first, while the controller lives on.
        if round % 2 == 0 {
            kill(&mut client);
            std::thread::sleep(delay(round, 1));
            kill(&mut victim);
        } else {
            kill(&mut victim);
            kill(&mut client);
        }
        let start = Instant::now();
        let mut next = world.controller(&[]);
        let mut client = Client::connect(&world.instance, PATIENCE)
            .unwrap_or_else(|error| panic!("round {round}: {error}"));
        let status = client.wait_status(PATIENCE).expect("a status");
        assert!(status.is_some(), "round {round}");
        let took = start.elapsed();
        late += u64::from(took > RESTART_MAX);
        slowest = slowest.max(took);
        most_files = most_files.max(shared_memory_files(&world).len());
        kill(&mut next);
    }
    println!(
        "{rounds} rounds: slowest restart {slowest:?}, {late} beyond {RESTART_MAX:?}, at most {most_files} files of shared memory"
    );
    // Every start clears away what came before: what exists does not grow with the rounds.
    assert!(most_files < 200, "{most_files} files");
    let _controller = world.controller(&[]);
    let mut client = world.client();
    // The arm's driver has outlived all those controllers and still finds the next one.
    await_status(&mut client, &mut Vec::new(), idle);
}

#[test]
fn killed_controllers_and_clients_leave_nothing_that_stops_the_next_start() {
    survives(18);
}

#[test]
#[ignore = "five minutes: run it by hand with --nocapture after changing sessions or services"]
fn two_hundred_rounds() {
    survives(200);
}

/// Clients killed while the controller lives on: it serves the next ones as if nothing had happened.
#[test]
fn a_controller_outlives_its_clients() {
    let world = World::new();
    let _controller = world.controller(&[]);
    let _robot = world.robot();
    let mut client = world.client();
    await_status(&mut client, &mut Vec::new(), idle);
    for round in 0..40 {
        let mut victim = client_program(&world, if round % 2 == 0 { 0 } else { 3 });
        std::thread::sleep(delay(round, 2) / 4);
        kill(&mut victim);
    }
    let mut other = world.client();
    await_status(&mut other, &mut Vec::new(), idle);
}

/// A client killed between naming its shared memory and giving it a size leaves an empty file under a name
/// that the next one to connect opens when it clears away what the dead left. iceoryx2 0.10 alone would wait
/// for that file's size without end.
#[test]
fn memory_that_a_killed_client_left_half_made_holds_up_nobody() {
    let world = World::new();
    let _controller = world.controller(&[]);
    let mut victim = client_program(&world, 0);
    let connections = await_connections(&world);
    kill(&mut victim);
    for connection in connections {
        let name = connection.to_string_lossy().to_string();
        let (ports, suffix) = name.rsplit_once('.').expect("a suffix");
        let (rest, receiver) = ports.rsplit_once('_').expect("two ports");
        let (prefix, sender) = rest.rsplit_once('_').expect("a sender");
        let next = |port: &str| port.parse::<u128>().expect("a port's number") + 1;
        // One of its ports with one that never was.
        for ports in [
            format!("{}_{receiver}", next(sender)),
            format!("{sender}_{}", next(receiver)),
        ] {
            let half_made = format!("{prefix}_{ports}.{suffix}");
            File::create_new(half_made).expect("an empty file");
        }
    }

    let (connected, outcome) = mpsc::channel();
    let instance = world.instance.clone();
    std::thread::spawn(move || connected.send(Client::connect(&instance, PATIENCE).is_ok()));
    assert_eq!(outcome.recv_timeout(PATIENCE), Ok(true), "the next client");
    let start = Instant::now();
    let is_empty = |path: &PathBuf| path.metadata().is_ok_and(|metadata| metadata.len() == 0);
    while shared_memory_files(&world).iter().any(is_empty) {
        assert!(start.elapsed() < PATIENCE, "half-made files stay");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// The connections of the only client, once all are there: two that it sends on and two that it receives on.
fn await_connections(world: &World) -> Vec<PathBuf> {
    let start = Instant::now();
    while start.elapsed() < PATIENCE {
        let mut files = shared_memory_files(world);
        files.retain(|path| path.extension().is_some_and(|kind| kind == "connection"));
        if files.len() == 4 {
            return files;
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    panic!("the client did not connect");
}
