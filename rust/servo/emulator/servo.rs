//! One emulated servo: its registers as a master sees them, and a motor that pulls a tendon behind them.
//!
//! The goal arrives `delay` later, the horn follows it with the time constant `lag` up to its fastest speed, and as far as
//! its current carries the tendon's load (mA over ticks, a table). Without torque the load turns the horn back until it is
//! no more than friction. Heat is one node: dT/dt = heating·I² − (T − room)/cooling.
//! What a reset does: RAM as delivered, torque off, turns lost (the position is that within one turn).
//! A servo that draws its largest current for long protects itself: overload error, torque off.

use std::collections::VecDeque;

use super::table::{Table, refusal};
use crate::packet::instruction;
use crate::registers::{ALERT, Model, TICKS_PER_TURN, VELOCITY_STEP, mode};

/// s between two steps of the motor.
pub const STEP: f64 = 0.001;
/// mA that do not turn the horn.
const FRICTION: f64 = 15.0;
/// °C of the room; °C/s by 1 A; s of cooling down.
const ROOM: f64 = 25.0;
const HEATING: f64 = 0.5;
const COOLING: f64 = 120.0;
/// s that a reset takes.
pub const RESET: f64 = 0.3;
/// mA of those that do not cap their current.
const MOST: f64 = 1500.0;
/// The share of its largest current, and the s for which it draws it, that a servo takes for an overload, and its bit.
const STRAINED: f64 = 0.95;
const PATIENCE: f64 = 1.0;
const OVERLOAD: u8 = 0x20;

/// How a servo moves.
#[derive(Debug, Clone, PartialEq)]
pub struct Motion {
    /// s until a goal arrives, and of the first-order lag behind it.
    pub delay: f64,
    pub lag: f64,
    /// mA that the tendon asks for at horn angles in ticks, ascending; ends go on flat. Positive pulls the angle down.
    pub load: Vec<(f64, f64)>,
}

/// What is broken about a servo.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Broken {
    /// It never answers.
    pub mute: bool,
    /// Its encoder says what it said last.
    pub stuck: bool,
    /// Its tendon pulls no more.
    pub torn: bool,
    /// Its tendon is wound the other way round.
    pub reversed: bool,
    /// Something blocks its horn.
    pub jammed: bool,
    /// It draws what its load asks for, whatever its cap.
    pub uncapped: bool,
}

impl Broken {
    /// How its horn pulls the finger: 1 as it should, −1 the wrong way, 0 not at all.
    pub fn pull(&self) -> f64 {
        match (self.torn, self.reversed) {
            (true, _) => 0.0,
            (false, true) => -1.0,
            (false, false) => 1.0,
        }
    }
}

#[derive(Debug, Clone)]
pub struct Servo {
    pub model: &'static Model,
    pub broken: Broken,
    table: Table,
    motion: Motion,
    /// How many times heavier its load is.
    burden: f64,
    /// s for which it has drawn its largest current.
    strained: f64,
    /// As it was mounted.
    mounted: (u8, f64),
    /// Ticks since it was mounted, never lost.
    angle: f64,
    /// Ticks that the encoder's count leaves out.
    base: f64,
    measured: f64,
    speed: f64,
    temperature: f64,
    volts: f64,
    /// Goals under way, and the one that has arrived.
    goals: VecDeque<(f64, i32)>,
    arrived: i32,
    time: f64,
    fed: f64,
    asleep: f64,
    waiting: Option<(u16, Vec<u8>)>,
}

impl Servo {
    /// A servo as delivered, but for `id` and baud rate code, its horn at `angle` ticks.
    pub fn new(model: &'static Model, id: u8, baud: u8, angle: f64, motion: Motion) -> Servo {
        let mut servo = Servo {
            model,
            broken: Broken::default(),
            table: Table::default(),
            motion,
            burden: 1.0,
            strained: 0.0,
            mounted: (id, angle),
            angle,
            base: 0.0,
            measured: angle,
            speed: 0.0,
            temperature: ROOM,
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
            (layout.pwm_limit, 885),
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

    /// s after which it answers, as it was set.
    pub fn return_delay(&self) -> f64 {
        2e-6 * f64::from(self.table.get(self.model.layout().return_delay))
    }

    /// Whether it answers what it did: its status return level keeps it silent about writes (1), or about all but pings (0).
    pub fn answers(&self, asked: u8) -> bool {
        match self.table.get(self.model.layout().status_return) {
            0 => asked == instruction::PING,
            1 => matches!(
                asked,
                instruction::PING
                    | instruction::READ
                    | instruction::SYNC_READ
                    | instruction::BULK_READ
            ),
            _ => true,
        }
    }

    /// Whether it is up and heard.
    pub fn awake(&self) -> bool {
        self.time >= self.asleep && !self.broken.mute
    }

    pub fn torque(&self) -> bool {
        self.table.get(self.model.layout().torque_enable) == 1
    }

    pub fn tripped(&self) -> bool {
        self.table.get(self.model.layout().bus_watchdog) as u8 == 255
    }

    /// Ticks that the horn has really turned.
    pub fn angle(&self) -> f64 {
        self.angle
    }

    /// °C, and V, as somebody sets them.
    pub fn heat(&mut self, temperature: f64) {
        self.temperature = temperature;
    }

    pub fn supply(&mut self, volts: f64) {
        self.volts = volts;
    }

    /// Make its load so many times as heavy.
    pub fn burden(&mut self, factor: f64) {
        self.burden = factor;
    }

    /// Count a turn too few from now on, as an encoder that missed one; nothing else is forgotten.
    pub fn lose_turn(&mut self) {
        self.base += f64::from(TICKS_PER_TURN);
    }

    /// As it was mounted: nothing is broken, and it has just started.
    pub fn mend(&mut self) {
        self.broken = Broken::default();
        (self.burden, self.temperature, self.volts) = (1.0, ROOM, usual(self.model));
        (self.angle, self.measured, self.speed) = (self.mounted.1, self.mounted.1, 0.0);
        self.set_id(self.mounted.0);
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

    /// Start again after power was lost or a reset was asked for.
    pub fn boot(&mut self) {
        let layout = self.model.layout();
        self.table.forget(layout.torque_enable.address);
        self.base = f64::from(TICKS_PER_TURN) * (self.angle / f64::from(TICKS_PER_TURN)).floor();
        self.asleep = self.time + RESET;
        self.strained = 0.0;
        self.waiting = None;
        self.table.set(layout.status_return, 2);
        self.table
            .set(layout.goal_pwm, self.table.get(layout.pwm_limit));
        self.table
            .set(layout.goal_current, self.table.get(layout.current_limit));
        self.stay();
    }

    /// It has started already.
    pub fn wake(&mut self) {
        self.asleep = self.time;
    }

    /// Its goal is where it stands.
    fn stay(&mut self) {
        self.goals.clear();
        self.arrived = self.position();
        self.table
            .set(self.model.layout().goal_position, self.arrived);
    }

    /// Its watchdog hears that somebody speaks on the bus.
    pub fn feed(&mut self) {
        self.fed = self.time;
    }

    pub fn read(&self, address: u16, size: u16) -> Result<Vec<u8>, u8> {
        self.table.read(address, size)
    }

    pub fn register_write(&mut self, address: u16, data: &[u8]) {
        self.waiting = Some((address, data.to_vec()));
    }

    pub fn action(&mut self) {
        if let Some((address, data)) = self.waiting.take() {
            // An action is not answered, so that nobody hears what it refuses.
            let _ = self.write(address, &data);
        }
    }

    pub fn write(&mut self, address: u16, data: &[u8]) -> Result<(), u8> {
        let layout = self.model.layout();
        let touched = self.table.write(self.model, address, data)?;
        if touched(layout.goal_position) {
            let goal = self.table.get(layout.goal_position);
            self.goals.push_back((self.time + self.motion.delay, goal));
        } else if touched(layout.torque_enable) && self.torque() {
            self.stay();
        }
        self.fed = self.time;
        Ok(())
    }

    /// Clear the turns; only while it stands.
    pub fn clear(&mut self) -> Result<(), u8> {
        if self.speed.abs() > 1.0 {
            return Err(refusal::ACCESS);
        }
        self.base = f64::from(TICKS_PER_TURN) * (self.angle / f64::from(TICKS_PER_TURN)).floor();
        self.stay();
        Ok(())
    }

    /// Let time go on to `until` s.
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
            .set(layout.moving, i32::from(self.speed.abs() > 10.0));
        self.table.set(
            layout.present_velocity,
            (self.speed / VELOCITY_STEP) as i32,
        );
        self.table
            .set(layout.present_voltage, (self.volts * 10.0) as i32);
        self.table.set(
            layout.present_temperature,
            self.temperature.clamp(0.0, 255.0) as i32,
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
        let load = self.load(self.angle);
        let before = self.angle;
        let most = self.model.fastest_turn();
        let (cap, most_drawn) = if self.model.has_current() {
            let unit = self.model.current_unit;
            let cap = f64::from(self.table.get(layout.goal_current)) * unit;
            (cap, f64::from(self.model.current_limit) * unit)
        } else {
            (MOST, MOST)
        };
        let cap = if self.broken.uncapped {
            most_drawn
        } else {
            cap
        };
        let wanted = if self.torque() && self.time >= self.asleep {
            let reference = f64::from(self.arrived) + self.base;
            ((reference - self.measured) / self.motion.lag.max(STEP)).clamp(-most, most)
        } else if load.abs() > FRICTION {
            -load.signum() * most
        } else {
            0.0
        };
        let next = self.angle + wanted * STEP;
        let against = self.load(next) * wanted.signum();
        let jammed = self.broken.jammed && wanted.abs() > 1.0;
        let stalls = self.torque() && (against > cap || jammed);
        self.angle = if stalls || jammed { before } else { next };
        self.speed = (self.angle - before) / STEP;
        if !self.broken.stuck {
            self.measured = self.angle;
        }
        let moving = if self.speed.abs() > 1.0 {
            FRICTION * self.speed.signum()
        } else {
            0.0
        };
        let current = match (self.torque(), stalls) {
            (false, _) => 0.0,
            (true, true) => cap * wanted.signum(),
            (true, false) => (load + moving).clamp(-cap, cap),
        };
        self.strained = if self.torque() && current.abs() >= STRAINED * most_drawn {
            self.strained + STEP
        } else {
            0.0
        };
        if self.strained > PATIENCE {
            self.fail(OVERLOAD);
        }
        let amperes = current * 1e-3;
        self.temperature +=
            STEP * (HEATING * amperes * amperes - (self.temperature - ROOM) / COOLING);
        let unit = if self.model.has_current() {
            self.model.current_unit
        } else {
            1.5
        };
        self.table
            .set(layout.present_current, (current / unit) as i32);
    }

    fn position(&self) -> i32 {
        (self.measured - self.base).round() as i32
    }

    /// mA that the tendon asks for.
    fn load(&self, angle: f64) -> f64 {
        let (pull, home) = (self.broken.pull(), self.mounted.1);
        self.burden * pull * self.tendon(home + pull * (angle - home))
    }

    /// mA that a tendon as it was mounted asks for.
    fn tendon(&self, angle: f64) -> f64 {
        let table = &self.motion.load;
        let at = table.partition_point(|(tick, _)| *tick <= angle);
        match (at.checked_sub(1).and_then(|k| table.get(k)), table.get(at)) {
            (Some((a, low)), Some((b, high))) => low + (high - low) * (angle - a) / (b - a),
            (Some((_, end)), None) | (None, Some((_, end))) => *end,
            (None, None) => 0.0,
        }
    }
}

/// Volts in the middle of those that it runs at.
fn usual(model: &Model) -> f64 {
    0.5 * (model.voltage.0 + model.voltage.1)
}
