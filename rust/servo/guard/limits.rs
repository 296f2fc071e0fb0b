//! The limits of rig and finger, checked before any motion: an invalid limit is rejected, not
//! clamped.

use crate::guard::Budget;
use crate::guard::path::Bounds;

/// Limits of one servo.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Axis {
    /// Tick at which the finger is straight, as homed after power-up.
    pub home: i32,
    /// Lowest and highest goal, ticks; home is between them.
    pub low: i32,
    pub high: i32,
    /// Ticks/s and ticks/s².
    pub slew: f64,
    pub acceleration: f64,
    /// Current limit, mA; None if the servo has no current cap.
    pub current: Option<f64>,
    /// Maximum speed of the servo, ticks/s; a faster position change is rejected.
    pub fastest: f64,
    /// Distance of goal and position beyond lag, ticks.
    pub following: f64,
    /// Temperatures, °C: from the first, its current is reduced; at the second, it releases
    /// tension.
    pub warm: f64,
    pub hot: f64,
    /// Supply range, V.
    pub voltage: (f64, f64),
}

/// Limits of the robot.
#[derive(Debug, Clone, PartialEq)]
pub struct Limits {
    /// Period of the loop, s.
    pub period: f64,
    pub axes: Vec<Axis>,
    /// Time without a command before it holds, s.
    pub stale: f64,
    /// Time of holding before it releases tension, s.
    pub hold: f64,
    /// Time after which tension release ends at any position, with torque off, s.
    pub slacken: f64,
    /// Times without an answer of a servo before it holds, and before torque off, s.
    pub late: f64,
    pub silent: f64,
    /// Duration of a following error, an overload or a wrong voltage before it counts, s.
    pub grace: f64,
    /// Ramp of the speed after engaging, s.
    pub ramp: f64,
    /// Jump of a target, ticks: above the first it is slowed down and reported, above the second
    /// rejected.
    pub jump: (f64, f64),
    /// Commissioning moves: ticks from their start, ticks/s, mA.
    pub jog_travel: f64,
    pub jog_slew: f64,
    pub jog_current: f64,
    /// Of each command.
    pub budget: Budget,
}

/// An invalid limit: its name, its servo (from 0) if it belongs to one, and the message.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{text}")]
pub struct BadLimit {
    pub servo: Option<usize>,
    pub name: &'static str,
    pub text: String,
}

/// Most servos of one loop.
pub const MOST_SERVOS: usize = 16;
/// Largest goal of the servos, ticks from 0.
pub const FARTHEST: i32 = crate::registers::FARTHEST_GOAL;

/// For each limit alone: name, lowest and highest value, unit (that of the commands if empty).
/// `low` and `high` are about home, `jump` and `voltage` are pairs; `Limits::checked` tests the
/// dependent limits.
#[rustfmt::skip]
pub const RANGES: [(&str, f64, f64, &str); 27] = [
    ("servos", 1.0, MOST_SERVOS as f64, ""),
    ("period", 0.0005, 0.1, "s"),
    ("stale", 0.001, 2.0, "s"),
    ("hold", 0.001, 60.0, "s"),
    ("slacken", 0.1, 60.0, "s"),
    ("late", 0.001, 0.5, "s"),
    ("silent", 0.001, 1.0, "s"),
    ("grace", 0.001, 2.0, "s"),
    ("ramp", 0.0, 10.0, "s"),
    ("jump", 0.0, FARTHEST as f64, "ticks"),
    ("jog_travel", 1.0, 4096.0, "ticks"),
    ("jog_slew", 1.0, 1000.0, "ticks/s"),
    ("jog_current", 0.0, 1000.0, "mA"),
    ("band", 0.0, 100.0, ""),
    ("turns", 0.1, 100.0, "1/s"),
    ("burst", 1.0, 100.0, "turns"),
    ("home", -FARTHEST as f64, FARTHEST as f64, "ticks"),
    ("low", -FARTHEST as f64, -1.0, "ticks"),
    ("high", 1.0, FARTHEST as f64, "ticks"),
    ("slew", 1.0, 20_000.0, "ticks/s"),
    ("acceleration", 1.0, 1e6, "ticks/s²"),
    ("current", 1.0, 6000.0, "mA"),
    ("fastest", 1.0, 50_000.0, "ticks/s"),
    ("following", 1.0, 4096.0, "ticks"),
    ("warm", 20.0, 80.0, "°C"),
    ("hot", 30.0, 80.0, "°C"),
    ("voltage", 3.0, 30.0, "V"),
];

/// A value, its owner, and its range given the other limits.
struct Named {
    servo: Option<usize>,
    name: &'static str,
    /// Which of a pair.
    side: &'static str,
    value: f64,
    least: f64,
    most: f64,
}

fn named(name: &'static str, value: f64) -> Named {
    Named {
        servo: None,
        name,
        side: "",
        value,
        least: f64::NEG_INFINITY,
        most: f64::INFINITY,
    }
}

impl Named {
    fn of(self, servo: usize) -> Named {
        let servo = Some(servo);
        Named { servo, ..self }
    }

    fn side(self, side: &'static str) -> Named {
        Named { side, ..self }
    }

    fn least(self, least: f64) -> Named {
        Named { least, ..self }
    }

    fn most(self, most: f64) -> Named {
        Named { most, ..self }
    }

    fn check(&self) -> Result<(), BadLimit> {
        // A name without a range allows no value.
        let (low, high, unit) = RANGES
            .iter()
            .find(|range| range.0 == self.name)
            .map_or((f64::INFINITY, 0.0, ""), |range| {
                (range.1, range.2, range.3)
            });
        let (low, high) = (low.max(self.least), high.min(self.most));
        if self.value >= low && self.value <= high {
            return Ok(());
        }
        let whose = self
            .servo
            .map_or_else(String::new, |servo| format!("servo {}: ", servo + 1));
        let unit = if unit.is_empty() {
            String::new()
        } else {
            format!(" {unit}")
        };
        let (servo, name, side, value) = (self.servo, self.name, self.side, self.value);
        let text =
            format!("{whose}{name}{side} is {value}{unit}; allowed is {low} to {high}{unit}");
        Err(BadLimit { servo, name, text })
    }
}

impl Limits {
    /// The same limits, or their faults.
    pub fn checked(self) -> Result<Limits, BadLimit> {
        let (period, jump, budget) = (self.period, self.jump, self.budget);
        let robot = [
            named("servos", self.axes.len() as f64),
            named("period", period),
            named("stale", self.stale).least(2.0 * period),
            named("hold", self.hold).least(period),
            named("slacken", self.slacken),
            named("late", self.late).least(2.0 * period),
            named("silent", self.silent).least(self.late),
            named("grace", self.grace).least(period),
            named("ramp", self.ramp),
            named("jump", jump.0).side(" (reported)"),
            named("jump", jump.1).side(" (refused)").least(jump.0),
            named("jog_travel", self.jog_travel),
            named("jog_slew", self.jog_slew),
            named("jog_current", self.jog_current),
            named("band", budget.band),
            named("turns", budget.turns),
            named("burst", budget.burst),
        ];
        robot.iter().try_for_each(Named::check)?;
        for (k, axis) in self.axes.iter().enumerate() {
            let (home, far, volts) = (f64::from(axis.home), f64::from(FARTHEST), axis.voltage);
            let servo = [
                named("home", home),
                named("low", f64::from(axis.low) - home).least(-far - home),
                named("high", f64::from(axis.high) - home).most(far - home),
                named("slew", axis.slew),
                named("acceleration", axis.acceleration),
                named("fastest", axis.fastest).least(axis.slew),
                named("following", axis.following),
                named("hot", axis.hot),
                named("warm", axis.warm).most(axis.hot),
                named("voltage", volts.1).side(" (highest)"),
                named("voltage", volts.0).side(" (lowest)").most(volts.1),
            ];
            let current = axis.current.map(|current| named("current", current));
            let mut all = servo.into_iter().chain(current);
            all.try_for_each(|one| one.of(k).check())?;
        }
        Ok(self)
    }
}

impl Axis {
    /// Its limits per period.
    pub fn bounds(&self, period: f64) -> Bounds {
        Bounds {
            low: self.low.into(),
            high: self.high.into(),
            slew: self.slew * period,
            acceleration: self.acceleration * period * period,
        }
    }

    /// The share of its current at `temperature` (°C): all while cool, a third where it releases
    /// tension.
    pub fn share(&self, temperature: f64) -> f64 {
        let above = (temperature - self.warm) / (self.hot - self.warm).max(1e-9);
        1.0 - above.clamp(0.0, 1.0) * (2.0 / 3.0)
    }
}

#[cfg(test)]
#[path = "limit_tests.rs"]
mod tests;
