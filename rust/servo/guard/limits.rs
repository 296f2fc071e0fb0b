//! What a bench and a finger allow, checked before anything moves: a limit that makes no sense is refused, not clamped.

use crate::guard::path::Bounds;

/// Limits of one servo.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Axis {
    /// Tick at which the finger is straight, as proved after power-up.
    pub home: i32,
    /// Lowest and highest goal, ticks; home lies between.
    pub low: i32,
    pub high: i32,
    /// Ticks/s and ticks/s².
    pub slew: f64,
    pub acceleration: f64,
    /// mA that it may draw; none where the servo caps no current.
    pub current: Option<f64>,
    /// Ticks/s that the servo reaches at most by itself, above which a position is not believed.
    pub fastest: f64,
    /// Ticks between goal and position that are not believed to be lag.
    pub following: f64,
    /// °C from which its current is cut back, and at which it slackens.
    pub warm: f64,
    pub hot: f64,
    /// Volts between which it runs.
    pub voltage: (f64, f64),
}

/// Limits of the robot.
#[derive(Debug, Clone, PartialEq)]
pub struct Limits {
    /// Seconds of a period of the loop.
    pub period: f64,
    pub axes: Vec<Axis>,
    /// Seconds without a command after which it holds.
    pub stale: f64,
    /// Seconds of holding after which it slackens.
    pub hold: f64,
    /// Seconds after which slackening ends wherever it is, torque off.
    pub slacken: f64,
    /// Seconds without an answer of a servo after which it holds, and after which torque goes off.
    pub late: f64,
    pub silent: f64,
    /// Seconds that a following error, an overload or a wrong voltage lasts before it is believed.
    pub grace: f64,
    /// Seconds over which speed grows after engaging.
    pub ramp: f64,
    /// Ticks by which a target may jump: what is more is slowed down and told, or beyond the second refused.
    pub jump: (f64, f64),
    /// Moves of commissioning: ticks from where they began, ticks/s, mA.
    pub jog_travel: f64,
    pub jog_slew: f64,
    pub jog_current: f64,
}

/// A limit that makes no sense.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{0}")]
pub struct BadLimit(pub String);

/// Servos that one loop drives at most.
pub const MOST_SERVOS: usize = 16;
/// Ticks that a goal may be away from 0, as the servos themselves allow.
pub const FARTHEST: i32 = crate::registers::FARTHEST_GOAL;

impl Limits {
    /// The same limits, or what is wrong with them.
    pub fn checked(self) -> Result<Limits, BadLimit> {
        let within = |name: &str, value: f64, low: f64, high: f64, unit: &str| {
            if value >= low && value <= high {
                return Ok(());
            }
            Err(BadLimit(format!(
                "{name} is {value} {unit}; allowed is {low} to {high} {unit}"
            )))
        };
        within("period", self.period, 0.0005, 0.1, "s")?;
        within("stale", self.stale, 2.0 * self.period, 2.0, "s")?;
        within("hold", self.hold, self.period, 60.0, "s")?;
        within("slacken", self.slacken, 0.1, 60.0, "s")?;
        within("late", self.late, 2.0 * self.period, 0.5, "s")?;
        within("silent", self.silent, self.late, 1.0, "s")?;
        within("grace", self.grace, self.period, 2.0, "s")?;
        within("ramp", self.ramp, 0.0, 10.0, "s")?;
        within("jump.limit", self.jump.0, 0.0, f64::from(FARTHEST), "ticks")?;
        within(
            "jump.reject",
            self.jump.1,
            self.jump.0,
            f64::from(FARTHEST),
            "ticks",
        )?;
        within("jog.travel", self.jog_travel, 1.0, 4096.0, "ticks")?;
        within("jog.slew", self.jog_slew, 1.0, 1000.0, "ticks/s")?;
        within("jog.current", self.jog_current, 0.0, 1000.0, "mA")?;
        within(
            "servos",
            self.axes.len() as f64,
            1.0,
            MOST_SERVOS as f64,
            "",
        )?;
        for (k, axis) in self.axes.iter().enumerate() {
            let named = |name: &str| format!("servo {}: {name}", k + 1);
            let far = f64::from(FARTHEST);
            let home = f64::from(axis.home);
            within(&named("home"), home, -far, far, "ticks")?;
            within(&named("low"), axis.low.into(), -far, home - 1.0, "ticks")?;
            within(&named("high"), axis.high.into(), home + 1.0, far, "ticks")?;
            within(&named("slew"), axis.slew, 1.0, 20_000.0, "ticks/s")?;
            within(
                &named("acceleration"),
                axis.acceleration,
                1.0,
                1e6,
                "ticks/s²",
            )?;
            within(
                &named("fastest"),
                axis.fastest,
                axis.slew,
                50_000.0,
                "ticks/s",
            )?;
            within(&named("following"), axis.following, 1.0, 4096.0, "ticks")?;
            within(&named("hot"), axis.hot, 30.0, 80.0, "°C")?;
            within(&named("warm"), axis.warm, 20.0, axis.hot, "°C")?;
            within(&named("voltage.high"), axis.voltage.1, 3.0, 30.0, "V")?;
            within(
                &named("voltage.low"),
                axis.voltage.0,
                3.0,
                axis.voltage.1,
                "V",
            )?;
            if let Some(current) = axis.current {
                within(&named("current"), current, 1.0, 6000.0, "mA")?;
            }
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

    /// The share of its current that it gets at `temperature` (°C): all while cool, a third where it slackens.
    pub fn share(&self, temperature: f64) -> f64 {
        let above = (temperature - self.warm) / (self.hot - self.warm).max(1e-9);
        1.0 - above.clamp(0.0, 1.0) * (2.0 / 3.0)
    }
}
