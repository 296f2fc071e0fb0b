//! The servos of one robot on a bus: the reads and writes of the loop each period, for each model.
//!
//! Goals and currents are written before torque, so nothing jumps at torque on. Torque off is
//! written until each servo has reported it. The bus watchdog runs under torque: a servo without
//! messages stops by itself. Servos do not acknowledge these writes, so a cap or a watchdog may be
//! lost on the wire: both are read back and written again.

use crate::bus::{Answer, Bus, Fault, Heard, Port};
use crate::guard::{Feedback, Health};
use crate::registers::{Model, Register, X_SERIES};

/// Registers read each period: from its own clock to its temperature.
const SENSED: (u16, usize) = (X_SERIES.realtime_tick.address, 27);
/// Registers read less often: from torque to the current cap.
const HEALTH: (u16, usize) = (X_SERIES.torque_enable.address, 40);
/// Resolution of the bus watchdog, ms.
const WATCHDOG_STEP: f64 = 20.0;
/// The value of a tripped bus watchdog.
const TRIPPED: u8 = 0xFF;
/// Successive checks at which a servo may lack its watchdog or cap, written again after each.
const LACKS: u8 = 8;

/// A servo on the bus.
#[derive(Debug, Clone, Copy)]
pub struct Member {
    pub id: u8,
    pub model: &'static Model,
}

/// All servos of a robot.
pub struct Drive<P> {
    bus: Bus<P>,
    ids: Vec<u8>,
    models: Vec<&'static Model>,
    fast: bool,
    watchdog: u8,
    data: Vec<u8>,
    heard: Vec<Heard>,
    feedback: Vec<Option<Feedback>>,
    health: Vec<Option<Health>>,
    /// The last writes: whether torque is on, and the current in steps.
    torque: bool,
    currents: Vec<i16>,
    /// Successive checks at which a servo had another watchdog or cap than written.
    lacks: Vec<u8>,
    alert: bool,
}

impl<P: Port> Drive<P> {
    /// Drive `members`; `fast` reads all in one answer, `watchdog` in ms is the time-out of a servo
    /// without messages.
    pub fn new(bus: Bus<P>, members: &[Member], fast: bool, watchdog: f64) -> Drive<P> {
        let count = members.len();
        Drive {
            bus,
            ids: members.iter().map(|member| member.id).collect(),
            models: members.iter().map(|member| member.model).collect(),
            fast,
            watchdog: (watchdog / WATCHDOG_STEP).ceil().clamp(1.0, 127.0) as u8,
            data: vec![0; count * HEALTH.1],
            heard: vec![Ok(Answer { alert: false }); count],
            feedback: vec![None; count],
            health: vec![None; count],
            torque: false,
            currents: vec![i16::MIN; count],
            lacks: vec![0; count],
            alert: false,
        }
    }

    pub fn bus(&mut self) -> &mut Bus<P> {
        &mut self.bus
    }

    /// The last answer of each servo.
    pub fn heard(&self) -> &[Heard] {
        &self.heard
    }

    /// Whether to check the servos' health now: an answer had its alert bit set, torque has just
    /// come on, or a written value was missing.
    pub fn alert(&self) -> bool {
        self.alert
    }

    /// Whether each servo reported torque off at its last check.
    pub fn released(&self) -> bool {
        self.health.iter().all(without_torque)
    }

    /// The ids of servos that have not.
    pub fn unreleased(&self) -> Vec<u8> {
        let servos = self.ids.iter().zip(&self.health);
        servos
            .filter(|(_, health)| !without_torque(health))
            .map(|(id, _)| *id)
            .collect()
    }

    /// Clear the reports of the servos.
    pub fn ask_again(&mut self) {
        self.health.fill(None);
    }

    /// Read the feedback of each servo; None for a servo without an answer.
    pub fn sense(&mut self) -> Result<&[Option<Feedback>], Fault> {
        self.feedback.fill(None);
        self.read(SENSED)?;
        for (k, heard) in self.heard.iter().enumerate() {
            let Ok(answer) = heard else { continue };
            self.alert |= answer.alert;
            let bytes = &self.data[k * SENSED.1..(k + 1) * SENSED.1];
            let word = |register: Register| {
                let at = usize::from(register.address - SENSED.0);
                [bytes[at], bytes[at + 1]]
            };
            let at = usize::from(X_SERIES.present_position.address - SENSED.0);
            let position = [bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]];
            let unit = self.models[k].current_unit;
            let steps = i16::from_le_bytes(word(X_SERIES.present_current));
            self.feedback[k] = Some(Feedback {
                position: i32::from_le_bytes(position),
                clock: u16::from_le_bytes(word(X_SERIES.realtime_tick)),
                current: self.models[k]
                    .has_current()
                    .then_some(f64::from(steps) * unit),
                voltage: f64::from(u16::from_le_bytes(word(X_SERIES.present_voltage))) / 10.0,
                temperature: f64::from(bytes[SENSED.1 - 1]),
                health: self.health[k].take(),
            });
        }
        Ok(&self.feedback)
    }

    /// Read the health of each servo; it is included in the next feedback.
    pub fn examine(&mut self) -> Result<(), Fault> {
        self.read(HEALTH)?;
        self.alert = false;
        for (k, heard) in self.heard.iter().enumerate() {
            if heard.is_err() {
                continue;
            }
            let bytes = &self.data[k * HEALTH.1..(k + 1) * HEALTH.1];
            let at = |register: Register| usize::from(register.address - HEALTH.0);
            let watchdog = bytes[at(X_SERIES.bus_watchdog)];
            let cap = at(self.models[k].cap(0.0).0);
            let cap = i16::from_le_bytes([bytes[cap], bytes[cap + 1]]);
            let bare = ![self.watchdog, TRIPPED].contains(&watchdog);
            let most = Some(self.currents[k]).filter(|most| *most != i16::MIN);
            self.lacks[k] = if self.torque && (bare || most.is_some_and(|most| cap != most)) {
                self.lacks[k].saturating_add(1)
            } else {
                0
            };
            self.alert |= again(self.lacks[k]);
            // A cap below the written one is the servo's own limit, and is accepted.
            let beyond = bare || most.is_some_and(|most| cap > most);
            let torque = bytes[at(X_SERIES.torque_enable)] == 1;
            // Without torque, it remains from a terminated loop; torque off clears it.
            let stopped = torque && watchdog == TRIPPED;
            self.health[k] = Some(Health {
                hardware: bytes[at(X_SERIES.hardware_error)],
                torque,
                tripped: stopped || beyond && self.lacks[k] >= LACKS,
            });
        }
        Ok(())
    }

    /// Write goals (ticks) and currents (mA; the share of the PWM for a servo without a current
    /// cap) under torque, or torque off.
    pub fn command(
        &mut self,
        torque: bool,
        goals: &[i32],
        currents: &[Option<f64>],
    ) -> Result<(), Fault> {
        if !torque {
            self.torque = false;
            self.lacks.fill(0);
            self.each(X_SERIES.torque_enable, |_| 0)?;
            return self.each(X_SERIES.bus_watchdog, |_| 0);
        }
        let models = &self.models;
        let steps = |k: usize| currents[k].map(|most: f64| models[k].cap(most).1);
        let changed =
            (0..goals.len()).any(|k| steps(k).is_some_and(|steps| steps != self.currents[k]));
        let lacking = self.lacks.iter().any(|looks| again(*looks));
        if changed || lacking || !self.torque {
            (0..goals.len()).for_each(|k| self.currents[k] = steps(k).unwrap_or(i16::MIN));
            self.caps()?;
        }
        self.each(X_SERIES.goal_position, |k| goals[k])?;
        let watchdog = i32::from(self.watchdog);
        if lacking && self.torque {
            self.each(X_SERIES.bus_watchdog, |_| watchdog)?;
        }
        if !self.torque {
            self.each(X_SERIES.bus_watchdog, |_| watchdog)?;
            self.each(X_SERIES.torque_enable, |_| 1)?;
            // Switching torque on may set the goal to the present position.
            self.each(X_SERIES.goal_position, |k| goals[k])?;
            (self.torque, self.alert) = (true, true);
        }
        Ok(())
    }

    /// Write the caps of servos with a cap.
    fn caps(&mut self) -> Result<(), Fault> {
        for k in 0..self.ids.len() {
            if self.currents[k] != i16::MIN {
                let bytes = self.currents[k].to_le_bytes();
                let address = self.models[k].cap(0.0).0.address;
                self.bus
                    .sync_write(&self.ids[k..k + 1], address, 2, &bytes)?;
            }
        }
        Ok(())
    }

    fn each(&mut self, register: Register, value: impl Fn(usize) -> i32) -> Result<(), Fault> {
        let size = usize::from(register.size);
        for k in 0..self.ids.len() {
            self.data[k * size..(k + 1) * size].copy_from_slice(&value(k).to_le_bytes()[..size]);
        }
        let all = self.ids.len() * size;
        self.bus
            .sync_write(&self.ids, register.address, size, &self.data[..all])
    }

    /// Read each servo. A common answer ends at a silent servo: after a silence, each answers
    /// separately.
    fn read(&mut self, (address, size): (u16, usize)) -> Result<(), Fault> {
        let fast = self.fast && self.heard.iter().all(Result::is_ok);
        let data = &mut self.data[..self.ids.len() * size];
        self.bus
            .sync_read(&self.ids, address, size, data, &mut self.heard, fast)
    }
}

/// Whether a servo has reported torque off.
fn without_torque(health: &Option<Health>) -> bool {
    health.is_some_and(|health| !health.torque)
}

/// Whether to write again after a number of failed checks.
fn again(looks: u8) -> bool {
    (1..LACKS).contains(&looks)
}

#[cfg(test)]
#[path = "drive_tests.rs"]
mod tests;
