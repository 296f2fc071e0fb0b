//! The emulator as a port whose time passes only during waits, with servos, for the tests of bus
//! and emulator.

use super::Emulator;
use super::servo::{Motion, Servo};
use crate::bus::{Answer, Bus, Heard, Port, PortFault, SLACK};
use crate::registers::{X_SERIES, mode, model};

/// The emulator as a port whose time passes only during waits.
pub struct Virtual {
    pub emulator: Emulator,
    pub now: u64,
    /// Stall of the computer before the next request, ns.
    pub stall: u64,
}

impl Virtual {
    pub fn seconds(&self) -> f64 {
        self.now as f64 * 1e-9
    }

    pub fn pass(&mut self, seconds: f64) {
        self.now += (seconds * 1e9) as u64;
        let now = self.seconds();
        self.emulator.run(now);
    }
}

impl Port for Virtual {
    fn now(&self) -> u64 {
        self.now
    }

    fn wait(&mut self, until: u64) {
        self.now = self.now.max(until);
        let now = self.seconds();
        self.emulator.run(now);
    }

    fn send(&mut self, bytes: &[u8], _until: u64) -> Result<(), PortFault> {
        let now = self.seconds();
        self.emulator.hear(bytes, now);
        Ok(())
    }

    fn receive(&mut self, into: &mut [u8], until: u64) -> Result<usize, PortFault> {
        let due = self.emulator.due().map(|due| (due * 1e9).ceil() as u64 + 1);
        self.now = due.map_or(until, |due| due.min(until)).max(self.now);
        let Some(bytes) = self.emulator.speak(self.seconds()) else {
            return Ok(0);
        };
        into[..bytes.len()].copy_from_slice(&bytes);
        Ok(bytes.len())
    }

    fn discard(&mut self) -> Result<(), PortFault> {
        self.now += std::mem::take(&mut self.stall);
        while self.emulator.speak(self.seconds()).is_some() {}
        Ok(())
    }
}

pub fn motion() -> Motion {
    Motion {
        delay: 0.01,
        lag: 0.03,
        load: vec![(1000.0, -400.0), (2000.0, 0.0), (3000.0, 400.0)],
    }
}

pub fn servos(ids: &[u8]) -> Vec<Servo> {
    let one = |id: &u8| Servo::new(model(1200).unwrap(), *id, 3, 2000.0, motion());
    ids.iter().map(one).collect()
}

pub fn bus(ids: &[u8]) -> Bus<Virtual> {
    let emulator = Emulator::new(servos(ids), 1_000_000, 1);
    Bus::new(
        Virtual {
            emulator,
            now: 0,
            stall: 0,
        },
        1_000_000,
        SLACK,
    )
}

pub const FINE: Heard = Ok(Answer { alert: false });

pub fn position(bus: &mut Bus<Virtual>, id: u8) -> i32 {
    let mut data = [0; 4];
    assert_eq!(bus.read(id, 132, &mut data), FINE);
    i32::from_le_bytes(data)
}

/// Ready to drive, torque on.
pub fn engaged(ids: &[u8]) -> Bus<Virtual> {
    let mut bus = bus(ids);
    for id in ids {
        assert_eq!(
            bus.write(
                *id,
                X_SERIES.operating_mode.address,
                &[mode::CURRENT_BASED_POSITION]
            ),
            FINE
        );
        assert_eq!(bus.write(*id, X_SERIES.torque_enable.address, &[1]), FINE);
    }
    bus
}

pub fn goals(bus: &mut Bus<impl Port>, ids: &[u8], goals: &[i32]) {
    let data: Vec<u8> = goals.iter().flat_map(|goal| goal.to_le_bytes()).collect();
    bus.sync_write(ids, X_SERIES.goal_position.address, 4, &data)
        .unwrap();
}
