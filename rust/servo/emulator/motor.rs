//! The motor of an emulated servo: a horn that follows its goal and pulls a tendon.
//!
//! The horn follows with the time constant `lag` up to its maximum speed, as far as its current
//! carries the tendon's load (mA over ticks, a table). Without torque, the load turns the horn back
//! until it equals friction. Heat is one node: dT/dt = heating·I² − (T − room)/cooling.

use crate::registers::{FULL_PWM, Model, VELOCITY_STEP};

/// s between two steps of the motor.
pub const STEP: f64 = 0.001;
/// Friction of the horn, mA.
const FRICTION: f64 = 15.0;
/// Room temperature, °C; heating by 1 A, °C/s; cooling time constant, s.
const ROOM: f64 = 25.0;
const HEATING: f64 = 0.5;
const COOLING: f64 = 120.0;

/// The motion parameters of a servo.
#[derive(Debug, Clone, PartialEq)]
pub struct Motion {
    /// Delay of a goal, and time constant of the first-order lag, s.
    pub delay: f64,
    pub lag: f64,
    /// Tendon load in mA at horn angles in ticks, ascending, constant beyond the ends. Positive
    /// decreases the angle.
    pub load: Vec<(f64, f64)>,
}

/// The faults of a servo.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Broken {
    /// It never answers.
    pub mute: bool,
    /// Its encoder repeats the last reading.
    pub stuck: bool,
    /// Its tendon is torn.
    pub torn: bool,
    /// Its tendon is wound in the wrong direction.
    pub reversed: bool,
    /// Something blocks its horn.
    pub jammed: bool,
    /// It ignores its current cap.
    pub uncapped: bool,
}

impl Broken {
    /// Effect of its horn on the finger: 1 correct, −1 reversed, 0 none.
    pub fn pull(&self) -> f64 {
        match (self.torn, self.reversed) {
            (true, _) => 0.0,
            (false, true) => -1.0,
            (false, false) => 1.0,
        }
    }
}

/// Allowed current now and largest current, mA, and allowed speed, ticks/s.
pub(super) struct Caps {
    pub now: f64,
    pub largest: f64,
    pub fastest: f64,
}

impl Caps {
    /// Those of `model` while its registers of goal current, goal PWM and profile velocity (0:
    /// none) hold `goal`, `pwm` and `profile`. PWM also limits the speed.
    pub fn of(model: &Model, goal: i32, pwm: i32, profile: i32) -> Caps {
        let share = f64::from(pwm) / f64::from(FULL_PWM);
        let (now, largest) = if model.has_current() {
            let unit = model.current_unit;
            (
                f64::from(goal) * unit,
                f64::from(model.current_limit) * unit,
            )
        } else {
            (share * model.stall.1, model.stall.1)
        };
        let fastest = share * model.fastest_turn();
        Caps {
            now,
            largest,
            fastest: match profile {
                0 => fastest,
                steps => fastest.min(f64::from(steps) * VELOCITY_STEP),
            },
        }
    }
}

#[derive(Debug, Clone)]
pub(super) struct Motor {
    pub motion: Motion,
    /// Factor of its load.
    pub burden: f64,
    /// Angle as mounted, ticks.
    mounted: f64,
    /// Ticks since it was mounted, never lost.
    pub angle: f64,
    /// Encoder reading.
    pub measured: f64,
    /// ticks/s
    pub speed: f64,
    /// °C
    pub temperature: f64,
}

impl Motor {
    pub fn new(angle: f64, motion: Motion) -> Motor {
        Motor {
            motion,
            burden: 1.0,
            mounted: angle,
            angle,
            measured: angle,
            speed: 0.0,
            temperature: ROOM,
        }
    }

    /// Restore the state as mounted.
    pub fn mend(&mut self) {
        (self.burden, self.temperature, self.speed) = (1.0, ROOM, 0.0);
        (self.angle, self.measured) = (self.mounted, self.mounted);
    }

    /// Advance by `STEP` towards `goal` (ticks since mounting; None without torque); return the
    /// current, mA.
    pub fn step(&mut self, goal: Option<f64>, torque: bool, caps: &Caps, broken: &Broken) -> f64 {
        let (load, fastest) = (self.load(self.angle, broken), caps.fastest);
        let before = self.angle;
        let cap = if broken.uncapped {
            caps.largest
        } else {
            caps.now
        };
        let wanted = match goal {
            Some(goal) => {
                ((goal - self.measured) / self.motion.lag.max(STEP)).clamp(-fastest, fastest)
            }
            None if load.abs() > FRICTION => -load.signum() * fastest,
            None => 0.0,
        };
        let next = self.angle + wanted * STEP;
        let against = self.load(next, broken) * wanted.signum();
        let jammed = broken.jammed && wanted.abs() > 1.0;
        let stalls = torque && (against > cap || jammed);
        self.angle = if stalls || jammed { before } else { next };
        self.speed = (self.angle - before) / STEP;
        if !broken.stuck {
            self.measured = self.angle;
        }
        let moving = if self.speed.abs() > 1.0 {
            FRICTION * self.speed.signum()
        } else {
            0.0
        };
        let current = match (torque, stalls) {
            (false, _) => 0.0,
            (true, true) => cap * wanted.signum(),
            (true, false) => (load + moving).clamp(-cap, cap),
        };
        let amperes = current * 1e-3;
        self.temperature +=
            STEP * (HEATING * amperes * amperes - (self.temperature - ROOM) / COOLING);
        current
    }

    /// Tendon load, mA.
    fn load(&self, angle: f64, broken: &Broken) -> f64 {
        let pull = broken.pull();
        self.burden * pull * self.tendon(self.mounted + pull * (angle - self.mounted))
    }

    /// Load of the tendon as mounted, mA.
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
