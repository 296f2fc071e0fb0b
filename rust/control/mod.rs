//! The control loop as a separate process: orders through one pipe, reports through another, servos
//! at a port.
//!
//! The loop itself is `softmap_servo::control`. This module adds real-time priority, signals, and a
//! thread for slow work: it writes reports (and the recording) from a ring that the loop never
//! waits for. If the orders' pipe closes, the sender is gone: hold, release tension, torque off.
//! SIGINT and SIGTERM do so immediately. However the loop ends, also by a panic, torque off is sent
//! last. Pinned by tests/robot/test_controller.py, tests/robot/test_faults.py and
//! tests/robot/test_nobody_watches.py.

pub mod emergency;
pub mod gpio;
pub mod heartbeat;
pub mod period;
pub mod pipe;
pub mod plan;
mod realtime;
pub mod recording;
mod report;

use std::os::fd::OwnedFd;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use softmap_servo::bus::{Bus, Fault, Port, PortFault, SLACK};
use softmap_servo::control::{Control, Plan, Record};
use softmap_servo::drive::{Drive, Member};
use softmap_servo::guard::{Guard, Limits, Request};
use softmap_servo::opened::Opened;
use softmap_servo::registers::FAST_FIRMWARE;
use softmap_servo::serial::monotonic;

use crate::error::{Result, invalid};
use emergency::Emergency;
use pipe::PipeMailbox;
use recording::Recording;
use report::{Last, Reporter, Ring};

/// Watchdog time of the servos, ms: several periods, and short for a person.
const WATCHDOG: f64 = 100.0;
/// Entries that the reporting thread may lag behind: several seconds at any rate.
const RING: usize = 4096;
/// Retries before a servo is reported as silent.
const TRIES: usize = 9;
/// s for which torque off is repeated at the end.
const FAREWELL: f64 = 0.5;

/// The configuration of a loop.
pub struct Setup {
    pub port: String,
    pub baud: u32,
    pub members: Vec<Member>,
    pub limits: Limits,
    /// The emergency stops of the rig, besides the one in the orders.
    pub stops: Emergency,
    /// The recording file, and the JSON document of its configuration.
    pub record: Option<(PathBuf, String)>,
}

/// Run until the orders end or a signal arrives; reports go to `reports`. Returns whether home must
/// be confirmed again.
pub fn serve(setup: Setup, plan: impl Plan, orders: OwnedFd, reports: OwnedFd) -> Result<bool> {
    let servos = setup.members.len();
    if servos != setup.limits.axes.len() {
        return Err(invalid(format!(
            "{servos} servos with limits for {}",
            setup.limits.axes.len()
        )));
    }
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
        signal_hook::flag::register(signal, stop.clone())
            .map_err(|fault| invalid(format!("signal {signal} cannot be handled: {fault}")))?;
    }
    let port = Opened::open(&setup.port, setup.baud).map_err(|fault| invalid(fault.to_string()))?;
    let simulated = port.simulated();
    let mut bus = Bus::new(port, setup.baud, SLACK);
    let fast = found_as_declared(&mut bus, &setup.members)?;
    let begun = bus.port().now();
    let drive = Drive::new(bus, &setup.members, fast, WATCHDOG);
    let mailbox = PipeMailbox::new(orders, plan.channels(), setup.stops);
    let (sender, receiver) = rtrb::RingBuffer::new(RING);
    let warnings = if simulated {
        vec![]
    } else {
        realtime::warnings()
    };
    let sizes = (servos, plan.channels());
    let begin =
        |(path, setup): (PathBuf, String)| Recording::begin(&path, &setup, begun, sizes.0, sizes.1);
    let recording = setup.record.map(begin).transpose()?;
    let ids = setup.members.iter().map(|member| member.id).collect();
    let reporter = Reporter::start(receiver, reports, recording, ids, sizes.1, &warnings);
    let guard = Guard::new(setup.limits);
    // Simulated time stops while a period is reported, so reports do not depend on load.
    let record = Ring::new(sender, simulated.then(|| reporter.progress()).flatten());
    let control = Control::new(drive, guard, plan, mailbox, record);
    let mut control = Farewell(control, false);
    if !simulated {
        realtime::enter();
    }
    let ended = run(&mut control.0, &stop);
    control.say();
    let last = Last {
        ended,
        timing: control.0.timing().clone(),
        lost: control.0.record.lost(),
        kept: control.0.drive.unreleased(),
    };
    let forgot = control.0.guard.forgot_home();
    drop(control);
    reporter.finish(&last);
    Ok(forgot)
}

/// Why a loop ended, for the last report.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ended {
    /// The sender of the orders is gone.
    Alone,
    /// A signal arrived.
    Signal,
    /// The port is lost.
    Port,
}

fn run<L: Plan, R: Record>(
    control: &mut Control<Opened, L, PipeMailbox, R>,
    stop: &AtomicBool,
) -> Ended {
    loop {
        let signalled = stop.load(Ordering::Relaxed);
        if signalled {
            control.mailbox.ask(Request::Stop);
        }
        let output = control.step();
        if output.torque {
            continue;
        }
        if signalled {
            return Ended::Signal;
        }
        if control.mailbox.closed() {
            return Ended::Alone;
        }
        if control.fault() == Some(Fault::Port(PortFault::Gone)) {
            return Ended::Port;
        }
    }
}

/// Retry without an answer: one glitch does not mean a missing servo.
fn patiently<T>(
    mut ask: impl FnMut() -> std::result::Result<T, Fault>,
) -> std::result::Result<T, Fault> {
    let mut answer = ask();
    for _ in 0..TRIES {
        if !matches!(answer, Err(Fault::Silent)) {
            break;
        }
        answer = ask();
    }
    answer
}

/// Reject servos that differ from the rig, or have torque on; return whether all can answer in one
/// packet.
fn found_as_declared(bus: &mut Bus<Opened>, members: &[Member]) -> Result<bool> {
    let mut fast = true;
    for Member { id, model } in members {
        // They answered a moment ago, when their set-up was checked.
        let silent = |fault: Fault| {
            invalid(format!(
                "servo {id}: {fault}; check its power and the cables of the bus, and close what \
                else loads this computer (`softmap servo doctor --rig FILE` looks at both), then \
                run the same command again"
            ))
        };
        let (number, firmware) = patiently(|| bus.ping(*id)).map_err(silent)?;
        if number != model.number {
            let found =
                softmap_servo::registers::model(number).map_or("another model", |found| found.name);
            return Err(invalid(format!(
                "servo {id} is {found} ({number}), expected {} ({})",
                model.name, model.number
            )));
        }
        fast &= firmware >= FAST_FIRMWARE;
        let (mut head, mut torque) = ([0; 64], [0]);
        patiently(|| bus.read(*id, 0, &mut head)).map_err(silent)?;
        let enabled = model.layout().torque_enable.address;
        patiently(|| bus.read(*id, enabled, &mut torque)).map_err(silent)?;
        let offset = model.layout().homing_offset.address as usize;
        if torque[0] != 0 {
            return Err(invalid(format!(
                "servo {id} has torque already: another program drives it, or one died; `softmap \
                servo off` releases it"
            )));
        }
        let mode = head[model.layout().operating_mode.address as usize];
        if mode != model.driven_in() || head[offset..offset + 4] != [0; 4] {
            return Err(invalid(format!(
                "servo {id} is in mode {mode} with homing offset {:?}, expected mode {} and none; \
                run `softmap servo setup`",
                i32::from_le_bytes([
                    head[offset],
                    head[offset + 1],
                    head[offset + 2],
                    head[offset + 3]
                ]),
                model.driven_in()
            )));
        }
    }
    Ok(fast)
}

/// Send torque off as the last message to the servos; return whether it was sent.
struct Farewell<L: Plan, R: Record>(Control<Opened, L, PipeMailbox, R>, bool);

impl<L: Plan, R: Record> Farewell<L, R> {
    fn say(&mut self) {
        if std::mem::replace(&mut self.1, true) {
            return;
        }
        let drive = &mut self.0.drive;
        drive.ask_again();
        let until = monotonic() + (FAREWELL * 1e9) as u64;
        while monotonic() < until {
            // A lost port accepts nothing; the servos' own watchdogs then stop them.
            let sent = drive.command(false, &[], &[]);
            let known = drive.examine().is_ok() && drive.released();
            if known || sent.is_err() {
                break;
            }
        }
    }
}

impl<L: Plan, R: Record> Drop for Farewell<L, R> {
    fn drop(&mut self) {
        self.say();
    }
}
