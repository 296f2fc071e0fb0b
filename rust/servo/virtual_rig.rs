//! The loop on emulated servos in virtual time, as its tests drive it.

use super::*;
use crate::bus::Bus;
use crate::emulated_rig::{self, Linear};
use crate::emulator::Emulator;
use crate::emulator::servo::Servo;
use crate::emulator::virtual_port::Virtual;
use crate::guard::{Limits, State};

#[derive(Default)]
pub struct Script(pub Orders);

impl Mailbox for Script {
    fn collect(&mut self) -> Orders {
        let orders = self.0;
        self.0.request = None;
        orders
    }
}

#[derive(Default)]
pub struct Log(pub Vec<Entry>);

impl Record for Log {
    fn take(&mut self, entry: &Entry) {
        self.0.push(*entry);
    }
}

pub type VirtualRig = Control<Virtual, Linear, Script, Log>;

pub const PERIOD: f64 = 0.005;

pub fn limits() -> Limits {
    emulated_rig::limits(PERIOD)
}

pub fn rig() -> VirtualRig {
    let port = Virtual {
        emulator: emulated_rig::emulator(),
        now: 1,
        stall: 0,
    };
    Control::new(
        emulated_rig::drive(Bus::new(port, emulated_rig::BAUD, 1_000_000)),
        Guard::new(limits()),
        Linear,
        Script::default(),
        Log::default(),
    )
}

impl VirtualRig {
    pub fn run(&mut self, seconds: f64) -> Output {
        let ticks = (seconds / PERIOD).round() as usize;
        (0..ticks.max(1)).map(|_| self.step()).last().unwrap()
    }

    pub fn ask(&mut self, request: Request) -> Output {
        self.mailbox.0.request = Some(request);
        self.step()
    }

    pub fn drive_to(&mut self, mm: [f64; 2]) {
        let mut command = [0.0; MOST_SERVOS];
        command[..2].copy_from_slice(&mm);
        self.mailbox.0 = Orders {
            heard: true,
            deadman: true,
            command: Some(command),
            sent: self.drive.bus().port().now(),
            ..Orders::default()
        };
    }

    pub fn emulator(&mut self) -> &mut Emulator {
        &mut self.drive.bus().port().emulator
    }

    pub fn angles(&mut self) -> Vec<f64> {
        self.emulator().servos.iter().map(Servo::angle).collect()
    }
}

/// Engaged, standing at (1, −1) mm.
pub fn engaged() -> VirtualRig {
    let mut rig = rig();
    rig.run(0.3);
    for request in [Request::Connect, Request::Home, Request::Arm] {
        let output = rig.ask(request);
        assert_eq!(output.denied, None, "{request:?}");
    }
    rig.drive_to([0.0, 0.0]);
    assert_eq!(rig.ask(Request::Engage).state, State::Engaged);
    rig.drive_to([1.0, -1.0]);
    rig.run(1.5);
    rig
}

/// Steps until `state`, in s.
pub fn until(rig: &mut VirtualRig, state: State, most: f64) -> f64 {
    for tick in 0..(most / PERIOD) as usize {
        if rig.step().state == state {
            return (tick + 1) as f64 * PERIOD;
        }
    }
    panic!(
        "{state:?} is not reached in {most} s but {:?}",
        rig.guard.state()
    );
}
