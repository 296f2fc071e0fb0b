//! The checker's data on one servo, and their age by the servo's own clock.

use super::{Feedback, Limits};

#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Known {
    pub position: Option<i32>,
    clock: u16,
    /// The time (s, by clock and by periods) when its clock was last not behind, its advance since
    /// then in ms, and the time when it was last trusted.
    level: (f64, u64),
    ticked: f64,
    believed: (f64, u64),
    /// Periods since an answer, since its clock moved, and since it was near its goal.
    pub unheard: u64,
    frozen: u64,
    pub apart: u64,
    pub hardware: u8,
    pub temperature: f64,
    pub torque: Option<bool>,
}

impl Known {
    /// Process the answer of a servo, if any, in the period that ends at `time` (s by the clock,
    /// and periods); `near` checks whether a position is at its goal.
    pub fn hear(
        &mut self,
        said: Option<Feedback>,
        time: (f64, u64),
        limits: &Limits,
        near: impl Fn(i32) -> bool,
    ) {
        self.unheard += 1;
        self.frozen += 1;
        let Some(Feedback {
            position,
            clock,
            temperature,
            health,
            ..
        }) = said
        else {
            return;
        };
        if self.position.is_some()
            && clock == self.clock
            && self.frozen as f64 * limits.period > 0.1
        {
            return;
        }
        let since =
            |then: (f64, u64)| (time.0 - then.0).max((time.1 - then.1) as f64 * limits.period);
        if self.position.is_none() || since(self.believed) > 1.0 {
            (self.level, self.ticked) = (time, 0.0);
        } else {
            // A clock counts ms up to 32 768; half of that or more counts as going back.
            let ticked = i32::from(clock) - i32::from(self.clock);
            let ticked = self.ticked + f64::from((ticked + 0x4000).rem_euclid(0x8000) - 0x4000);
            let behind = 995.0 * since(self.level) - ticked;
            if behind > 1000.0 * limits.late {
                return;
            }
            (self.level, self.ticked) = if behind > 0.0 {
                (self.level, ticked)
            } else {
                (time, 0.0)
            };
        }
        self.believed = time;
        if self.position.is_none() || clock != self.clock {
            (self.clock, self.frozen) = (clock, 0);
        }
        (self.position, self.unheard) = (Some(position), 0);
        self.temperature = if temperature.is_nan() {
            f64::INFINITY
        } else {
            temperature
        };
        if let Some(health) = health {
            (self.hardware, self.torque) = (health.hardware, Some(health.torque));
        }
        self.apart = if near(position) { 0 } else { self.apart + 1 };
    }
}
