//! The loop as it runs in earnest: a session of its own, the bridge, an arm that follows at once and a
//! client whose goals come at any time.

use crate::bridge::Bridge;
use crate::client::Client;
use crate::clock;
use crate::cycle::{Cycle, Queues};
use crate::rt;
use crate::serve::Rate;
use crate::services;
use crate::session::Instance;
use crate::step::{Controller, Setup};
use crate::timing::Timing;
use crate::voice;
use anyhow::{Context, Result};
use iceoryx2::prelude::Config;
use shared::arm::LEVEL_POSTURE_RAD;
use shared::blob::Blob;
use shared::messages::{CommandKind, Phase, RobotState, Status};
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::sync::mpsc::{self, Receiver, Sender};
use std::time::{Duration, Instant};

static REFUSED: AtomicU32 = AtomicU32::new(0);

/// What the operating system refused the loop that ran last; bits of [`shared::messages::degraded`].
pub fn refused() -> u32 {
    REFUSED.load(Ordering::Relaxed)
}

/// How long a goal is served before it is cancelled for the next one.
const SERVED: Duration = Duration::from_millis(20);

const PATIENCE: Duration = Duration::from_secs(5);

/// Runs the loop for `duration` and returns what it noted and the cycles it missed.
pub fn run(blob: &Blob, rate: Rate, duration: Duration) -> Result<(Timing, u64)> {
    let instance = &Instance::new(&format!("bench-{}", std::process::id()))?;
    let session = instance.start()?;
    let queues = Queues::new(false);
    let node = services::node(session.config())?;
    let (_speaker, voice) = voice::start(false)?;
    let mut newest = Status::default();
    let timing = std::thread::scope(|scope| {
        let (config, queues) = (session.config(), &queues);
        // Each side has a channel of its own, whose end goes with its thread: waiting for one that gave up ends.
        let (built, loop_ready) = mpsc::channel();
        let (arm_built, arm_ready) = mpsc::channel();
        let (client_built, client_ready) = mpsc::channel();
        let (go, started) = mpsc::channel();
        let thread = scope.spawn(move || run_loop(blob, rate, config, queues, &built, &started));
        // The blackboard has to be there before clients come, and they before the loop starts: what
        // connecting costs the machine is not what is measured here.
        if loop_ready.recv().is_err() {
            return thread.join().expect("the loop's thread does not panic");
        }
        let mut bridge = Bridge::new(&node, voice)?;
        session.announce()?;
        let target_ns = rate.cycle_ns() * u64::from(rate.cycles_per_target());
        let arm = scope.spawn(move || play_arm(instance.name(), queues, &arm_built));
        let client = scope.spawn(move || send_goals(blob, target_ns, instance.name(), queues, &client_built));
        if arm_ready.recv().is_ok() && client_ready.recv().is_ok() {
            go.send(())?;
        } else {
            queues.ended.store(true, Ordering::Release);
        }
        drop(go);
        rt::prefer_bridge();
        let start = Instant::now();
        while !queues.ended.load(Ordering::Acquire) && !thread.is_finished() {
            bridge.round(queues, &mut |status| newest = *status);
            bridge.rest(queues);
            if start.elapsed() > duration {
                queues.shutdown.store(true, Ordering::Relaxed);
            }
        }
        bridge.round(queues, &mut |status| newest = *status);
        arm.join().expect("the arm's thread does not panic")?;
        client.join().expect("the client's thread does not panic")?;
        thread.join().expect("the loop's thread does not panic")
    })?;
    drop((node, session));
    instance.purge()?;
    Ok((timing, newest.missed_deadlines))
}

fn run_loop(
    blob: &Blob,
    rate: Rate,
    config: &Config,
    queues: &Queues,
    ready: &Sender<()>,
    go: &Receiver<()>,
) -> Result<Timing> {
    let mut timing = Timing::default();
    let node = services::node(config)?;
    let writer = services::newest_writer(&node)?;
    let refused = rt::prepare_thread();
    REFUSED.store(refused, Ordering::Relaxed);
    let setup = Setup {
        blob: Box::new(blob.clone()),
        cycle_ns: rate.cycle_ns(),
        cycles_per_target: rate.cycles_per_target(),
        silent_cycles_max: 1_000_000_000 / rate.cycle_ns(),
        gripper_lead_ns: 0,
        degraded: refused,
    };
    let mut cycle = Cycle::new(Controller::new(setup), queues, false);
    ready.send(())?;
    go.recv().context("an arm or a client could not connect")?;
    cycle.run(rate.cycle_ns(), &mut timing, &mut |target| {
        writer.update_with_copy(*target)
    });
    Ok(timing)
}

fn ends(queues: &Queues) -> bool {
    queues.shutdown.load(Ordering::Relaxed) || queues.ended.load(Ordering::Acquire)
}

fn play_arm(instance: &str, queues: &Queues, ready: &Sender<()>) -> Result<()> {
    let mut port = Client::connect(instance, PATIENCE)?.arm()?;
    ready.send(())?;
    let mut state = RobotState {
        q_rad: LEVEL_POSTURE_RAD,
        ..RobotState::default()
    };
    let mut next_ns = clock::now_ns();
    while !queues.ended.load(Ordering::Acquire) {
        if let Some(target) = port.newest_target() {
            state.q_rad = target.q_rad;
        }
        port.send_state(state)?;
        next_ns += 4_000_000;
        clock::sleep_until(next_ns);
    }
    Ok(())
}

/// Goals sent by this process; slices of one measurement go on from one another.
static ARRIVALS: AtomicU64 = AtomicU64::new(0);

/// When to send the next goal: at the next instant with the next phase of the period. Phases step by the
/// golden ratio, so any number of them is spread evenly over the period, wherever the loop's grid lies.
fn next_arrival_ns(now_ns: u64, period_ns: u64) -> u64 {
    const GOLDEN: f64 = 0.618_033_988_749_894_8;
    let k = ARRIVALS.fetch_add(1, Ordering::Relaxed);
    let phase_ns = ((k as f64 * GOLDEN).fract() * period_ns as f64) as u64;
    let first_ns = now_ns - now_ns % period_ns + phase_ns;
    if first_ns < now_ns {
        first_ns + period_ns
    } else {
        first_ns
    }
}

/// One goal after the other, each cancelled soon, so that many can be timed.
fn send_goals(
    blob: &Blob,
    period_ns: u64,
    instance: &str,
    queues: &Queues,
    ready: &Sender<()>,
) -> Result<()> {
    let mut client = Client::connect(instance, PATIENCE)?;
    ready.send(())?;
    let reach_m = blob.ropes[0].reach_m;
    for k in 0u64.. {
        wait_until_idle(&mut client, queues)?;
        if ends(queues) {
            break;
        }
        clock::sleep_until(next_arrival_ns(clock::now_ns(), period_ns));
        client.send_goal(0, reach_m.at((k % 100) as f64 * 0.01))?;
        std::thread::sleep(SERVED);
        client.send_command(CommandKind::Cancel)?;
    }
    Ok(())
}

fn wait_until_idle(client: &mut Client, queues: &Queues) -> Result<()> {
    let start = Instant::now();
    let idle = |status: &Status| status.state == Phase::Idle.code() && status.active_goal_id == 0;
    // What was sent before the last goal is old news.
    while client.next_status()?.is_some() {}
    while !ends(queues) && start.elapsed() < PATIENCE {
        if client.wait_status(SERVED)?.is_some_and(|status| idle(&status)) {
            break;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn goals_arrive_evenly_over_the_period() {
        const BINS: u64 = 10;
        let mut counts = [0; BINS as usize];
        for k in 0..500 {
            let now_ns = 1_000_000_000 + 20_050_000 * k;
            let at_ns = next_arrival_ns(now_ns, 4_000_000);
            assert!((now_ns..now_ns + 4_000_000).contains(&at_ns));
            counts[(at_ns % 4_000_000 * BINS / 4_000_000) as usize] += 1;
        }
        assert!(counts.iter().all(|count| (48..=52).contains(count)), "{counts:?}");
    }
}
