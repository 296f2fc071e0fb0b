//! One emulated servo: its registers for the master; `motor.rs` has the motor.
//!
//! The goal arrives `delay` later. A reset restores the factory RAM, switches torque off, and loses
//! turns (the position is within one turn). A servo that draws its largest current for too long
//! protects itself: overload error, torque off.

use std::collections::VecDeque;

pub use super::motor::{Broken, Motion};
use super::motor::{Caps, Motor, STEP};
use super::table::{Table, refusal};
use crate::packet::{HIGHEST_ID, instruction};
use crate::registers::{ALERT, FULL_PWM, Model, TICKS_PER_TURN, VELOCITY_STEP, mode};

/// Duration of a reset, s.
pub const RESET: f64 = 0.3;
/// Overload: share of the largest current, duration in s, and error bit.
const STRAINED: f64 = 0.95;
const PATIENCE: f64 = 1.0;
const OVERLOAD: u8 = 0x20;
/// Bits of its drive mode: reversed direction, and torque on by a goal.
const REVERSED: i32 = 1;
const ON_BY_GOAL: i32 = 8;

#[derive(Debug, Clone)]
pub struct Servo {
    pub model: &'static Model,
    pub broken: Broken,
    table: Table,
    motor: Motor,
    /// Time at its largest current, s.
    strained: f64,
    /// Its id as mounted.
    mounted: u8,
    /// Ticks missing from the encoder's count.
    base: f64,
    volts: f64,
    /// Goals in transit, and the current one.
    goals: VecDeque<(f64, i32)>,
    arrived: i32,
    time: f64,
    fed: f64,
    asleep: f64,
    waiting: Option<(u16, Vec<u8>)>,
}

impl Servo {
    /// A factory-default servo with `id` and baud rate code, its horn at `angle` ticks.
    pub fn new(model: &'static Model, id: u8, baud: u8, angle: f64, motion: Motion) -> Servo {
        let mut servo = Servo {
            model,
            broken: Broken::default(),
            table: Table::default(),
            motor: Motor::new(angle, motion),
            strained: 0.0,
            mounted: id,
            base: 0.0,
            volts: usual(model),
            goals: VecDeque::new(),
            arrived: 0,
            time: 0.0,
            fed: 0.0,
            asleep: 0.0,
            waiting: None,
        };
        let layout = model.layout();
        for (register, value) in [
            (layout.model_number, i32::from(model.number)),
            (layout.firmware, 46),
            (layout.id, i32::from(id)),
            (layout.baud_rate, i32::from(baud)),
            (layout.return_delay, 250),
            (layout.operating_mode, i32::from(mode::POSITION)),
            (layout.shadow_id, 255),
            (layout.temperature_limit, i32::from(model.temperature_limit)),
            (layout.max_voltage, (model.voltage.1 * 10.0) as i32),
            (layout.min_voltage, (model.voltage.0 * 10.0) as i32),
            (layout.pwm_limit, i32::from(FULL_PWM)),
            (layout.current_limit, i32::from(model.current_limit)),
            (layout.velocity_limit, i32::from(model.velocity_limit)),
            (layout.max_position, TICKS_PER_TURN - 1),
            (layout.shutdown, i32::from(model.shutdown)),
        ] {
            servo.table.set(register, value);
        }
        servo.boot();
        servo.wake();
        servo
    }

    pub fn id(&self) -> u8 {
        self.table.get(self.model.layout().id) as u8
    }

    /// Whether it obeys requests to `id`: its own id, or its secondary one (register 12), to which
    /// it never answers.
    pub fn obeys(&self, id: u8) -> bool {
        let shadow = self.table.get(self.model.layout().shadow_id) as u8;
        self.id() == id || shadow == id && shadow <= HIGHEST_ID
    }

    /// 1, or −1 if its drive mode reverses every direction.
    fn way(&self) -> f64 {
        if self.table.get(self.model.layout().drive_mode) & REVERSED == 0 {
            1.0
        } else {
            -1.0
        }
    }

    pub fn set_id(&mut self, id: u8) {
        self.table.set(self.model.layout().id, i32::from(id));
    }

    pub fn firmware(&self) -> u8 {
        self.table.get(self.model.layout().firmware) as u8
    }

    pub fn set_firmware(&mut self, version: u8) {
        self.table
            .set(self.model.layout().firmware, i32::from(version));
    }

    pub fn baud(&self) -> usize {
        self.table.get(self.model.layout().baud_rate) as usize
    }

    /// Its return delay, s.
    pub fn return_delay(&self) -> f64 {
        2e-6 * f64::from(self.table.get(self.model.layout().return_delay))
    }

    /// Whether it answers: its status return level suppresses answers to writes (1), or to all but
    /// pings (0).
    pub fn answers(&self, asked: u8) -> bool {
        match self.table.get(self.model.layout().status_return) {
            0 => asked == instruction::PING,
            1 => matches!(
                asked,
                instruction::PING
                    | instruction::READ
                    | instruction::SYNC_READ
                    | instruction::FAST_SYNC_READ
                    | instruction::BULK_READ
            ),
            _ => true,
        }
    }

    /// Whether it is running and reachable.
    pub fn awake(&self) -> bool {
        self.time >= self.asleep && !self.broken.mute
    }

    pub fn torque(&self) -> bool {
        self.table.get(self.model.layout().torque_enable) == 1
    }

    pub fn tripped(&self) -> bool {
        self.table.get(self.model.layout().bus_watchdog) as u8 == 255
    }

    /// True rotation of the horn, ticks.
    pub fn angle(&self) -> f64 {
        self.motor.angle
    }

    /// Set temperature, °C, and supply, V.
    pub fn heat(&mut self, temperature: f64) {
        self.motor.temperature = temperature;
    }

    pub fn supply(&mut self, volts: f64) {
        self.volts = volts;
    }

    /// Multiply its load.
    pub fn burden(&mut self, factor: f64) {
        self.motor.burden = factor;
    }

    /// Count one turn too few from now on, like an encoder that missed one.
    pub fn lose_turn(&mut self) {
        self.base += f64::from(TICKS_PER_TURN);
    }

    /// Restore the mounted state without faults, just started.
    pub fn mend(&mut self) {
        self.broken = Broken::default();
        self.volts = usual(self.model);
        self.motor.mend();
        self.set_id(self.mounted);
        self.boot();
        self.base = 0.0;
        self.stay();
        self.wake();
    }

    /// Report a hardware error; those in its shutdown register switch torque off.
    pub fn fail(&mut self, bits: u8) {
        let layout = self.model.layout();
        self.table.set(
            layout.hardware_error,
            self.table.get(layout.hardware_error) | i32::from(bits),
        );
        if self.table.get(layout.shutdown) as u8 & bits != 0 {
            self.table.set(layout.torque_enable, 0);
        }
    }

    /// The alert bit of its answers.
    pub fn alert(&self) -> u8 {
        if self.table.get(self.model.layout().hardware_error) == 0 {
            0
        } else {
            ALERT
        }
    }

    /// Restart after a loss of power or a reset.
    pub fn boot(&mut self) {
        let layout = self.model.layout();
        self.table.forget(layout.torque_enable.address);
        self.base =
            f64::from(TICKS_PER_TURN) * (self.motor.angle / f64::from(TICKS_PER_TURN)).floor();
        self.asleep = self.time + RESET;
        self.strained = 0.0;
        self.waiting = None;
        self.table.set(layout.status_return, 2);
        self.begin_mode();
        self.stay();
    }

    /// Set gains, profile and goal PWM of a newly chosen operating mode.
    fn begin_mode(&mut self) {
        let layout = self.model.layout();
        let (p, i, d) = self.model.gains; // the emulator does not use them
        for (register, value) in [
            (layout.position_p, i32::from(p)),
            (layout.position_i, i32::from(i)),
            (layout.position_d, i32::from(d)),
            (layout.feedforward_1, 0),
            (layout.feedforward_2, 0),
            (layout.profile_velocity, 0),
            (layout.profile_acceleration, 0),
            (layout.goal_pwm, self.table.get(layout.pwm_limit)),
            (layout.goal_current, self.table.get(layout.current_limit)),
        ] {
            self.table.set(register, value);
        }
    }

    /// It has started already.
    pub fn wake(&mut self) {
        self.asleep = self.time;
    }

    /// Set its goal to its position.
    fn stay(&mut self) {
        self.goals.clear();
        self.arrived = self.position();
        self.table
            .set(self.model.layout().goal_position, self.arrived);
    }

    /// Reset its watchdog: there is traffic on the bus.
    pub fn feed(&mut self) {
        self.fed = self.time;
    }

    /// Exclude the next `time` s from its watchdog.
    pub fn excuse(&mut self, time: f64) {
        self.fed += time;
    }

    pub fn read(&self, address: u16, size: u16) -> Result<Vec<u8>, u8> {
        self.table.read(address, size)
    }

    pub fn register_write(&mut self, address: u16, data: &[u8]) {
        self.waiting = Some((address, data.to_vec()));
    }

    pub fn action(&mut self) {
        if let Some((address, data)) = self.waiting.take() {
            // An action is not answered, so that its refusals are not reported.
            let _ = self.write(address, &data);
        }
    }

    pub fn write(&mut self, address: u16, data: &[u8]) -> Result<(), u8> {
        let layout = self.model.layout();
        let touched = self.table.write(self.model, address, data)?;
        if touched(layout.goal_position) {
            let goal = self.table.get(layout.goal_position);
            let enables = self.table.get(layout.drive_mode) & ON_BY_GOAL != 0;
            if enables && self.table.get(layout.hardware_error) == 0 {
                self.table.set(layout.torque_enable, 1);
            }
            self.goals
                .push_back((self.time + self.motor.motion.delay, goal));
        } else if touched(layout.torque_enable) && self.torque() {
            self.stay();
        }
        if touched(layout.operating_mode) {
            self.begin_mode();
        }
        self.fed = self.time;
        Ok(())
    }

    /// Clear the turns; only at standstill.
    pub fn clear(&mut self) -> Result<(), u8> {
        if self.motor.speed.abs() > 1.0 {
            return Err(refusal::ACCESS);
        }
        self.base =
            f64::from(TICKS_PER_TURN) * (self.motor.angle / f64::from(TICKS_PER_TURN)).floor();
        self.stay();
        Ok(())
    }

    /// Advance time to `until` s.
    pub fn run(&mut self, until: f64) {
        while self.time + STEP <= until {
            self.time += STEP;
            self.step();
        }
        let layout = self.model.layout();
        self.table.set(layout.present_position, self.position());
        self.table
            .set(layout.realtime_tick, (self.time * 1000.0) as i32 & 0x7FFF);
        self.table
            .set(layout.moving, i32::from(self.motor.speed.abs() > 10.0));
        self.table.set(
            layout.present_velocity,
            (self.way() * self.motor.speed / VELOCITY_STEP) as i32,
        );
        self.table
            .set(layout.present_voltage, (self.volts * 10.0) as i32);
        self.table.set(
            layout.present_temperature,
            self.motor.temperature.clamp(0.0, 255.0) as i32,
        );
    }

    fn step(&mut self) {
        let layout = self.model.layout();
        let watchdog = self.table.get(layout.bus_watchdog) as u8;
        if self.torque()
            && (1..=127).contains(&watchdog)
            && self.time - self.fed > 0.02 * f64::from(watchdog)
        {
            self.table.set(layout.bus_watchdog, -1);
            self.stay();
        }
        while self.goals.front().is_some_and(|(due, _)| *due <= self.time) {
            self.arrived = self
                .goals
                .pop_front()
                .map_or(self.arrived, |(_, goal)| goal);
        }
        let torque = self.torque();
        let goal = self.way() * f64::from(self.arrived) + self.base;
        let least = |goal, limit| self.table.get(goal).min(self.table.get(limit));
        let caps = Caps::of(
            self.model,
            least(layout.goal_current, layout.current_limit),
            least(layout.goal_pwm, layout.pwm_limit),
            self.table.get(layout.profile_velocity),
        );
        let current = self.motor.step(
            (torque && self.time >= self.asleep).then_some(goal),
            torque,
            &caps,
            &self.broken,
        );
        self.strained = if torque && current.abs() >= STRAINED * caps.largest {
            self.strained + STEP
        } else {
            0.0
        };
        if self.strained > PATIENCE {
            self.fail(OVERLOAD);
        }
        // A servo without current measurement reports its load instead, in thousandths of the stall
        // load.
        let unit = if self.model.has_current() {
            self.model.current_unit
        } else {
            1e-3 * self.model.stall.1
        };
        self.table
            .set(layout.present_current, (self.way() * current / unit) as i32);
    }

    fn position(&self) -> i32 {
        (self.way() * (self.motor.measured - self.base)).round() as i32
    }
}

/// The middle of its supply range, V.
fn usual(model: &Model) -> f64 {
    0.5 * (model.voltage.0 + model.voltage.1)
}
