//! One turn of the loop, and the queues through which it meets the rest of the program. Nothing here
//! allocates, locks, logs or waits.

use crate::allocations;
use crate::clock::{self, Grid};
use crate::constants::{
    COLD_US, EARLY_US, RECORD_QUEUE, REQUEST_QUEUE, ROBOT_QUEUE, STATUS_QUEUE, TARGET_QUEUE,
};
use crate::recorder;
use crate::ring::Ring;
use crate::rt;
use crate::step::{Controller, Inputs, Output};
use crate::timing::{Cost, Stations, Timing};
use shared::arm::LEVEL_POSTURE_RAD;
use shared::messages::{Command, CommandKind, Goal, JointTarget, Phase, ROBOT_MAGIC, RobotState, Status};
use shared::recording::Record;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// Plans timed before the loop starts; the shortest is taken.
const PLANS_TIMED: u32 = 16;

/// What the loop and the bridge share; made once, before the loop starts.
pub struct Queues {
    /// Bridge to loop.
    pub goals: Ring<Goal>,
    /// Bridge to loop: cancels, resets and what is no command.
    pub commands: Ring<Command>,
    /// Bridge to loop: keep-alives, of which clients may send more than there are cycles.
    pub keep_alives: Ring<Command>,
    /// Bridge to loop: emergency stops, which no flood of other commands may delay or push out.
    pub stops: Ring<Command>,
    /// Bridge to loop.
    pub robots: Ring<RobotState>,
    /// Loop to bridge.
    pub targets: Ring<JointTarget>,
    /// Loop to bridge.
    pub statuses: Ring<Status>,
    /// Loop to recorder, only when a recording is asked for.
    pub records: Option<Ring<Record>>,
    /// Tells the loop to stop and end.
    pub shutdown: AtomicBool,
    /// Set by the loop when it has ended.
    pub ended: AtomicBool,
    /// When the next cycle is due, ns; set by the loop once everything of the present one is in the queues.
    pub next_cycle_ns: AtomicU64,
    lost: AtomicU64,
}

impl Queues {
    /// Empty queues of the capacities in `constants`.
    pub fn new(record: bool) -> Self {
        Self {
            goals: Ring::new(REQUEST_QUEUE),
            commands: Ring::new(REQUEST_QUEUE),
            keep_alives: Ring::new(REQUEST_QUEUE),
            stops: Ring::new(REQUEST_QUEUE),
            robots: Ring::new(ROBOT_QUEUE),
            targets: Ring::new(TARGET_QUEUE),
            statuses: Ring::new(STATUS_QUEUE),
            records: record.then(|| Ring::new(RECORD_QUEUE)),
            shutdown: AtomicBool::new(false),
            ended: AtomicBool::new(false),
            next_cycle_ns: AtomicU64::new(0),
            lost: AtomicU64::new(0),
        }
    }

    /// Puts an item in; where there is no room it is lost and counted.
    pub fn put<T>(&self, queue: &Ring<T>, item: T) {
        if queue.push(item).is_err() {
            self.count_lost();
        }
    }

    /// Puts a command where it belongs.
    pub fn put_command(&self, command: Command) {
        match CommandKind::from_code(command.kind) {
            Some(CommandKind::EmergencyStop) => self.put(&self.stops, command),
            // One says no more than the next: where there is no room, none is lost.
            Some(CommandKind::KeepAlive) => drop(self.keep_alives.push(command)),
            _ => self.put(&self.commands, command),
        }
    }

    /// Empties the queue of keep-alives; returns one of the goal `goal_id`, if there is any.
    fn keep_alive_of(&self, goal_id: u64) -> Option<Command> {
        let of_goal = self.keep_alives.drain().filter(|command| command.id == goal_id);
        of_goal.last()
    }

    /// Counts a message that did not get through.
    pub fn count_lost(&self) {
        self.lost.fetch_add(1, Ordering::Relaxed);
    }

    /// Items lost so far.
    pub fn lost(&self) -> u64 {
        self.lost.load(Ordering::Relaxed)
    }
}

/// The arm that a dry run imagines: where the last target put it, still.
fn imagined_arm(last: Option<&JointTarget>, now_ns: u64) -> RobotState {
    RobotState {
        magic: ROBOT_MAGIC,
        stamp_ns: now_ns,
        q_rad: last.map_or(LEVEL_POSTURE_RAD, |target| target.q_rad),
        target_seq: last.map_or(0, |target| target.seq),
        ..RobotState::default()
    }
}

/// Whether targets are sent in a phase.
fn sends_targets(phase: Phase) -> bool {
    !matches!(phase, Phase::Waiting | Phase::Fault | Phase::Ended)
}

/// The controller together with its ends of the queues.
pub struct Cycle<'a> {
    controller: Controller,
    queues: &'a Queues,
    dry_run: bool,
    /// Whether the command of the turn before was a keep-alive.
    was_kept: bool,
    last: Option<JointTarget>,
    /// A goal taken ahead of its turn.
    waiting: Option<Goal>,
    /// The goal judged last, until its first target is out.
    goal: Option<Goal>,
    /// Whether this turn judged a goal.
    judged: bool,
    /// The newest status, while there is no room for it: the last of a swing must not be the one that is lost.
    unsent: Option<Status>,
}

impl<'a> Cycle<'a> {
    /// With `dry_run` no target leaves and the arm is imagined to follow at once.
    pub fn new(controller: Controller, queues: &'a Queues, dry_run: bool) -> Self {
        Self {
            controller,
            queues,
            dry_run,
            was_kept: false,
            last: None,
            waiting: None,
            goal: None,
            judged: false,
            unsent: None,
        }
    }

    /// Stops first; keep-alives and other commands in turn, so that no flood of the ones holds up the others.
    fn next_command(&mut self) -> Option<Command> {
        let queues = self.queues;
        let served = self.controller.active_goal_id();
        let other = || queues.commands.pop();
        let kept = || queues.keep_alive_of(served);
        let command = (queues.stops.pop()).or_else(|| {
            if self.was_kept {
                other().or_else(kept)
            } else {
                kept().or_else(other)
            }
        });
        self.was_kept = command.is_some_and(|command| command.kind == CommandKind::KeepAlive.code());
        command
    }

    fn gather(&mut self, now_ns: u64, missed_deadlines: u64) -> Inputs {
        let mut robot = self.queues.robots.drain().last();
        if self.dry_run {
            robot = Some(imagined_arm(self.last.as_ref(), now_ns));
        }
        Inputs {
            goal: self.waiting.take().or_else(|| self.queues.goals.pop()),
            command: self.next_command(),
            robot,
            shutdown: self.queues.shutdown.load(Ordering::Relaxed),
            missed_deadlines,
            messages_lost: self.queues.lost(),
        }
    }

    /// One turn for the instant `now_ns`; `write` gets the target for the arm, if there is one, and an empty one when targets
    /// end.
    pub fn turn(&mut self, now_ns: u64, missed: u64, write: &mut dyn FnMut(&JointTarget)) -> Output {
        let inputs = self.gather(now_ns, missed);
        self.goal = inputs.goal.or(self.goal);
        self.judged = inputs.goal.is_some();
        let output = self.controller.step(&inputs, now_ns);
        if let Some(target) = &output.target {
            if !self.dry_run {
                write(target);
                self.queues.put(&self.queues.targets, *target);
            }
            self.last = Some(*target);
        }
        let withdraws = !self.dry_run && !sends_targets(self.controller.phase());
        if withdraws && self.last.take().is_some() {
            // A driver that starts later must not send what was for an arm that has been moved since.
            write(&JointTarget::default());
        }
        self.send_status(output.status);
        if let Some(records) = &self.queues.records {
            let cycle = self.controller.cycles();
            self.queues
                .put(records, recorder::record(cycle, now_ns, &inputs, &output));
        }
        output
    }

    /// Sends a status, or what waits of an earlier turn.
    fn send_status(&mut self, status: Option<Status>) {
        if status.is_some() && self.unsent.is_some() {
            self.queues.count_lost();
        }
        if let Some(newest) = status.or(self.unsent.take()) {
            self.unsent = self.queues.statuses.push(newest).err();
        }
    }

    /// The stamp of the goal whose first target is the one of this turn, ns.
    fn first_served_ns(&mut self, output: &Output) -> Option<u64> {
        let target = output.target.as_ref()?;
        let goal = self
            .goal
            .take_if(|goal| goal.id == target.goal_id && goal.id != 0)?;
        Some(goal.stamp_ns)
    }

    /// Turns on the grid until the controller has ended; counts what this thread asks for meanwhile.
    pub fn run(&mut self, period_ns: u64, timing: &mut Timing, write: &mut dyn FnMut(&JointTarget)) {
        let faults_before = rt::page_faults();
        let ((), allocator_calls) = allocations::watched(|| self.turn_on_grid(period_ns, timing, write));
        timing.note_cost(Cost {
            allocator_calls,
            page_faults: rt::page_faults() - faults_before,
        });
        self.queues.ended.store(true, Ordering::Release);
    }

    fn turn_on_grid(&mut self, period_ns: u64, timing: &mut Timing, write: &mut dyn FnMut(&JointTarget)) {
        let plan_ns = self.plan_ns();
        let mut grid = Grid::new(clock::now_ns(), period_ns);
        loop {
            let due_ns = grid.next_ns();
            let asked_ns = due_ns - EARLY_US * 1000;
            clock::sleep_until(asked_ns);
            let woke_ns = clock::now_ns();
            let began_ns = self.prepare_until(due_ns, plan_ns, timing);
            let served_ns = grid.serve(began_ns);
            let output = self.turn(served_ns, grid.missed(), write);
            self.queues.next_cycle_ns.store(grid.next_ns(), Ordering::Release);
            let done_ns = clock::now_ns();
            timing.note(Stations {
                asked_ns,
                woke_ns,
                due_ns,
                began_ns,
                done_ns,
            });
            if let Some(sent_ns) = self.first_served_ns(&output) {
                timing.note_goal(sent_ns, done_ns, self.controller.period_ns());
            }
            if self.judged {
                timing.note_answer(began_ns, done_ns);
            }
            if output.ended {
                break;
            }
        }
    }

    /// What planning for a likely goal takes once it is warm, ns.
    fn plan_ns(&mut self) -> u64 {
        let timed = (0..PLANS_TIMED).map(|_| {
            let goal = self.controller.likely_goal();
            let start_ns = clock::now_ns();
            self.controller.prepare(&goal);
            clock::now_ns() - start_ns
        });
        timed.min().unwrap_or(0)
    }

    /// Waits for `due_ns` awake and returns the time then. Meanwhile plans for the goal that waits, or for a
    /// likely one, while that surely fits: what the turn needs is then in the caches, and neither a plan nor a
    /// wake-up delays it.
    fn prepare_until(&mut self, due_ns: u64, plan_ns: u64, timing: &mut Timing) -> u64 {
        let room_ns = plan_ns + COLD_US * 1000;
        let mut cold = true;
        loop {
            let now_ns = clock::now_ns();
            if now_ns >= due_ns {
                return now_ns;
            }
            if due_ns - now_ns > room_ns && self.waiting.is_none() {
                self.waiting = self.queues.goals.pop();
                let goal = self.waiting.unwrap_or_else(|| self.controller.likely_goal());
                self.controller.prepare(&goal);
                if std::mem::take(&mut cold) {
                    timing.note_plan(now_ns, clock::now_ns());
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample;
    use crate::step::Setup;
    use shared::messages::{COMMAND_MAGIC, GOAL_MAGIC, TARGET_MAGIC};

    fn command(kind: CommandKind, id: u64) -> Command {
        Command {
            magic: COMMAND_MAGIC,
            stamp_ns: 0,
            id,
            kind: kind.code(),
            reserved: 0,
        }
    }

    fn controller() -> Controller {
        Controller::new(Setup {
            blob: sample::blob(),
            cycle_ns: 4_000_000,
            cycles_per_target: 1,
            silent_cycles_max: 50,
            gripper_lead_ns: 0,
            degraded: 0,
        })
    }

    /// A cycle to which a command came, and after it a flood of others; and what it put out.
    fn flooded(queues: &Queues, first: Command, flood: CommandKind) -> (Cycle<'_>, Output) {
        let mut cycle = Cycle::new(controller(), queues, true);
        cycle.turn(4_000_000, 0, &mut |_| {});
        queues.put_command(first);
        for id in first.id + 1..1000 {
            queues.put_command(command(flood, id));
        }
        let output = cycle.turn(8_000_000, 0, &mut |_| {});
        (cycle, output)
    }

    #[test]
    fn a_flood_of_commands_does_not_hold_up_a_stop() {
        let queues = Queues::new(false);
        let stop = command(CommandKind::EmergencyStop, 1);
        let (cycle, _) = flooded(&queues, stop, CommandKind::Cancel);
        assert_eq!(cycle.controller.phase(), Phase::Stopping);
        assert!(queues.lost() > 900, "the flood is counted");
    }

    /// Clients that send more keep-alives than there are cycles neither push out nor delay anything else.
    #[test]
    fn a_flood_of_keep_alives_holds_up_no_other_command() {
        let queues = Queues::new(false);
        let reset = command(CommandKind::Reset, 7);
        let (_, output) = flooded(&queues, reset, CommandKind::KeepAlive);
        assert_eq!(output.status.map(|status| status.command_id), Some(7));
        assert_eq!(queues.lost(), 0);
    }

    /// A client that keeps its promise is not stopped because another one sends a command in every cycle.
    #[test]
    fn a_flood_of_commands_holds_up_no_keep_alive() {
        let queues = Queues::new(false);
        let mut cycle = Cycle::new(controller(), &queues, true);
        let mut turn = |k: u64, commands: &[Command]| {
            commands.iter().for_each(|&command| queues.put_command(command));
            cycle.turn(k * 4_000_000, 0, &mut |_| {});
            cycle.controller.phase()
        };
        for k in 1..4 {
            turn(k, &[]);
        }
        queues.put(
            &queues.goals,
            Goal {
                magic: GOAL_MAGIC,
                id: 5,
                stamp_ns: 16_000_000,
                x_m: 0.33,
                keep_alive_ms: 100,
                ..Goal::default()
            },
        );
        for k in 4..100 {
            let (kept, reset) = (command(CommandKind::KeepAlive, 5), command(CommandKind::Reset, k));
            assert_eq!(turn(k, &[reset, reset, kept]), Phase::Homing, "turn {k}");
        }
    }

    /// The keep-alive of the goal that is served gets through among those of others.
    #[test]
    fn of_many_keep_alives_the_one_that_counts_is_taken() {
        let queues = Queues::new(false);
        for id in [3, 9, 4] {
            queues.put_command(command(CommandKind::KeepAlive, id));
        }
        let taken = queues.keep_alive_of(9).map(|command| command.id);
        assert_eq!((taken, queues.keep_alive_of(9)), (Some(9), None));
    }

    #[test]
    fn a_goal_taken_ahead_is_judged_once_and_in_order() {
        let queues = Queues::new(false);
        let mut cycle = Cycle::new(controller(), &queues, true);
        cycle.turn(4_000_000, 0, &mut |_| {});
        for id in [7, 8] {
            let goal = Goal {
                magic: GOAL_MAGIC,
                id,
                x_m: f64::NAN,
                ..Goal::default()
            };
            queues.put(&queues.goals, goal);
        }
        let due_ns = clock::now_ns() + 5_000_000;
        assert!(cycle.prepare_until(due_ns, 0, &mut Timing::default()) >= due_ns);
        let judged: Vec<_> = (2..6)
            .map(|k| cycle.turn(k * 4_000_000, 0, &mut |_| {}).status)
            .map(|status| status.map(|status| (status.judged_goal_id, status.goals_refused)))
            .collect();
        assert_eq!(judged, [Some((7, 1)), Some((8, 2)), None, None]);
    }

    /// A driver that died, whose arm was then moved by hand, sent the old target when it started again.
    #[test]
    fn no_target_stays_on_the_blackboard_once_none_are_sent() {
        let queues = Queues::new(false);
        let mut cycle = Cycle::new(controller(), &queues, false);
        let mut board = JointTarget::default();
        for k in 1..200 {
            let now_ns = k * 4_000_000;
            // The arm follows, and falls silent.
            if k < 100 {
                queues.put(
                    &queues.robots,
                    imagined_arm(Some(&board).filter(|t| t.seq > 0), now_ns),
                );
            }
            cycle.turn(now_ns, 0, &mut |target| board = *target);
            if k == 99 {
                assert_eq!(
                    (board.magic, cycle.controller.phase()),
                    (TARGET_MAGIC, Phase::Idle)
                );
            }
        }
        assert_eq!(
            (board, cycle.controller.phase()),
            (JointTarget::default(), Phase::Waiting)
        );
    }

    /// A client that was told nothing for a while is told how things stand now.
    #[test]
    fn the_newest_status_is_sent_once_there_is_room() {
        let queues = Queues::new(false);
        let mut cycle = Cycle::new(controller(), &queues, true);
        let status = |judged_goal_id: u64| Status {
            judged_goal_id,
            ..Status::default()
        };
        for goal_id in 1..=STATUS_QUEUE as u64 + 2 {
            cycle.send_status(Some(status(goal_id)));
        }
        assert_eq!(queues.lost(), 1, "the one before the newest");
        assert_eq!(queues.statuses.drain().count(), STATUS_QUEUE);
        cycle.send_status(None);
        let newest = queues.statuses.pop().map(|status| status.judged_goal_id);
        assert_eq!(newest, Some(STATUS_QUEUE as u64 + 2));
        cycle.send_status(None);
        assert!(queues.statuses.is_empty());
    }

    #[test]
    fn a_dry_run_sends_nothing() {
        let queues = Queues::new(false);
        let mut cycle = Cycle::new(controller(), &queues, true);
        for k in 1..10 {
            let output = cycle.turn(k * 4_000_000, 0, &mut |_| panic!("a target left"));
            assert!(output.target.is_some());
        }
        assert!(queues.targets.is_empty());
    }
}
