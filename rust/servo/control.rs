//! The control loop: receive, plan, guard, send, record, once per period at absolute times, without
//! allocation or lock.
//!
//! The newest target is used. A missed period is counted and skipped, never repeated. The user
//! sends commands of the finger (mm); the planner converts them to ticks, and receives the ticks
//! actually sent (its effects have memory).

use crate::bus::{Counts, Fault, Port};
use crate::drive::Drive;
use crate::guard::reversals::Reversals;
use crate::guard::{Feedback, Guard, Input, MOST_SERVOS, Message, Output, Request};
use crate::timing::Timing;

/// s between two checks of the servos' health.
const EXAMINE: f64 = 0.2;

/// Commands to ticks.
pub trait Plan {
    /// Number of its commands.
    fn channels(&self) -> usize;
    /// The ticks (one per servo) for `command` (mm) now; not finite if there are none.
    fn ticks(&mut self, command: &[f64], ticks: &mut [f64]);
    /// One period has passed with `ticks` (goals, or positions without torque).
    fn passed(&mut self, ticks: &[i32], period: f64);
}

/// Messages of the user since the last period.
#[derive(Debug, Clone, Copy, Default)]
pub struct Orders {
    /// Whether a message was received.
    pub heard: bool,
    /// Pressed in all received messages.
    pub deadman: bool,
    /// The newest command, mm.
    pub command: Option<[f64; MOST_SERVOS]>,
    /// ns at which it was sent.
    pub sent: u64,
    pub request: Option<Request>,
    pub emergency: bool,
}

/// The source of orders.
pub trait Mailbox {
    /// The pending messages, without waiting.
    fn collect(&mut self) -> Orders;
}

/// One period: all inputs and outputs of the guard. A recording of it replays bit for bit.
#[derive(Debug, Clone, Copy)]
pub struct Entry {
    /// Time after the servos' answers, ns: the guard's time.
    pub now: u64,
    pub orders: Orders,
    /// Whether a command was ever received, and its ticks now.
    pub aimed: bool,
    pub targets: [f64; MOST_SERVOS],
    pub feedback: [Option<Feedback>; MOST_SERVOS],
    pub output: Output,
    pub goals: [i32; MOST_SERVOS],
    /// Lateness and duration of the period, ns.
    pub late: u64,
    pub took: u64,
    /// The bus failed.
    pub fault: Option<Fault>,
    /// Missed periods so far.
    pub overruns: u64,
    /// Counts of answers so far.
    pub counts: Counts,
}

/// The receiver of entries.
pub trait Record {
    /// Take one, without waiting.
    fn take(&mut self, entry: &Entry);
}

/// The loop and its parts.
pub struct Control<P, L, M, R> {
    pub drive: Drive<P>,
    pub guard: Guard,
    pub plan: L,
    pub mailbox: M,
    pub record: R,
    timing: Timing,
    channels: Vec<Reversals>,
    /// The newest command as sent, and as target, mm.
    wanted: Option<[f64; MOST_SERVOS]>,
    command: Vec<f64>,
    targets: Vec<f64>,
    positions: Vec<i32>,
    period: u64,
    due: u64,
    since_examined: f64,
    fault: Option<Fault>,
}

impl<P: Port, L: Plan, M: Mailbox, R: Record> Control<P, L, M, R> {
    /// Assemble a loop; its first period begins with the first step.
    pub fn new(
        drive: Drive<P>,
        guard: Guard,
        plan: L,
        mailbox: M,
        record: R,
    ) -> Control<P, L, M, R> {
        let (servos, channels) = (guard.limits().axes.len(), plan.channels());
        let resting = Reversals::new(0.0, &guard.limits().budget);
        Control {
            period: (guard.limits().period * 1e9) as u64,
            timing: Timing::default(),
            channels: vec![resting; channels],
            wanted: None,
            command: vec![0.0; channels],
            targets: vec![0.0; servos],
            positions: guard.limits().axes.iter().map(|axis| axis.home).collect(),
            due: 0,
            since_examined: f64::INFINITY,
            fault: None,
            drive,
            guard,
            plan,
            mailbox,
            record,
        }
    }

    pub fn timing(&self) -> &Timing {
        &self.timing
    }

    /// The failure of the bus in the last period.
    pub fn fault(&self) -> Option<Fault> {
        self.fault
    }

    /// Wait for the next period and run it.
    pub fn step(&mut self) -> Output {
        let begun = self.begin();
        let late = begun - self.due;
        let orders = self.mailbox.collect();
        let period = self.guard.limits().period;
        let mut fault = None;
        let mut feedback = [None; MOST_SERVOS];
        match self.drive.sense() {
            Ok(heard) => feedback[..heard.len()].copy_from_slice(heard),
            Err(failed) => fault = Some(failed),
        }
        // No answer is younger than that: a stamp before the request would make all later answers
        // look old.
        let now = self.drive.bus().port().now();
        self.since_examined += period;
        let due = self.since_examined >= EXAMINE || self.drive.alert();
        // Two time-outs would not fit into a period.
        if due && self.drive.heard().iter().all(Result::is_ok) {
            self.since_examined = 0.0;
            fault = fault.or(self.drive.examine().err());
        }
        if let Some(command) = &orders.command {
            self.wanted = Some(*command);
            Timing::note(&mut self.timing.age, begun.saturating_sub(orders.sent));
        }
        self.aim(period);
        let goal = self.wanted.is_some().then_some(&self.targets[..]);
        let output = self.guard.tick(&Input {
            now,
            feedback: &feedback[..self.targets.len()],
            message: orders.heard.then_some(Message {
                deadman: orders.deadman,
                goal: goal.filter(|_| orders.command.is_some()),
            }),
            again: goal.filter(|_| orders.command.is_none()),
            request: orders.request,
            emergency: orders.emergency,
        });
        let sent = self
            .drive
            .command(output.torque, self.guard.goals(), self.guard.currents());
        fault = fault.or(sent.err());
        self.fault = fault;
        for (position, said) in self.positions.iter_mut().zip(&feedback) {
            *position = said.map_or(*position, |said| said.position);
        }
        let passed = if output.torque {
            self.guard.goals()
        } else {
            &self.positions
        };
        self.plan.passed(passed, period);
        let mut entry = Entry {
            now,
            orders,
            aimed: self.wanted.is_some(),
            targets: [f64::NAN; MOST_SERVOS],
            feedback,
            output,
            goals: [0; MOST_SERVOS],
            late,
            took: self.drive.bus().port().now() - begun,
            fault,
            overruns: self.timing.overruns,
            counts: self.drive.bus().counts(),
        };
        entry.targets[..self.targets.len()].copy_from_slice(&self.targets);
        entry.goals[..self.targets.len()].copy_from_slice(self.guard.goals());
        self.record.take(&entry);
        output
    }

    /// Wait until a period is due, skip missed ones, and return the time.
    fn begin(&mut self) -> u64 {
        let port = self.drive.bus().port();
        let now = port.now();
        if self.due == 0 {
            self.due = now;
        } else {
            self.due += self.period;
            let missed = now.saturating_sub(self.due) / self.period;
            self.due += missed * self.period;
            self.timing.overruns += missed;
        }
        port.wait(self.due);
        let begun = port.now();
        self.timing.ticks += 1;
        Timing::note(&mut self.timing.late, begun - self.due);
        begun
    }

    /// The ticks of the newest command, with limited reversals; the planner's effects advance
    /// meanwhile.
    fn aim(&mut self, period: f64) {
        let Some(wanted) = &self.wanted else { return };
        let budget = &self.guard.limits().budget;
        for ((channel, command), mm) in self.channels.iter_mut().zip(&mut self.command).zip(wanted)
        {
            *command = if mm.is_finite() {
                channel.step(*mm, period, budget)
            } else {
                f64::NAN
            };
        }
        self.plan.ticks(&self.command, &mut self.targets);
    }
}

#[cfg(test)]
#[path = "control_tests.rs"]
mod tests;
#[cfg(test)]
#[path = "virtual_rig.rs"]
mod virtual_rig;
