//! State and faults of one servo.

use super::limits::{Axis, Limits};
use super::time::{Stamp, Time};
use super::{Cause, Feedback, Health};

/// Position change without time, ticks: encoder noise and read time.
const LOOSE: f64 = 64.0;
/// Longest stop of a servo's own clock, s: it counts ms, and is read with each answer.
const CLOCK_STANDS: f64 = 0.1;
/// Largest relative slowness of its clock: a cheap oscillator.
const DRIFT: f64 = 0.005;
/// Period of its clock, ms.
const ROUND: u16 = 0x8000;
/// Duration of old answers before its clock is read again, s; not shorter than `silent`.
const ANEW: f64 = 1.0;
/// Time from torque on until a report of no torque counts, s; its health must be read at least this
/// often.
const SWITCHING: f64 = 0.5;
/// Largest share of its cap that a servo draws at the cap.
const AT_CAP: f64 = 1.25;

#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Servo {
    /// Ticks; None until it answers.
    pub position: Option<f64>,
    /// °C.
    pub temperature: f64,
    pub health: Option<Health>,
    /// Its position change was impossible.
    pub lost: bool,
    clock: u16,
    heard: Stamp,
    ticked: Stamp,
    /// When its answers were last in time, and the advance of its clock since, s. Its delay counts
    /// from there and not from answer to answer: a late period and the next one that catches up
    /// would count as two.
    punctual: Stamp,
    gone: f64,
    /// When position, current and voltage were last normal.
    followed: Stamp,
    light: Stamp,
    powered: Stamp,
}

impl Servo {
    /// Process an answer; `goal` is its goal while torque is on.
    pub fn hear(
        &mut self,
        said: &Feedback,
        axis: &Axis,
        limits: &Limits,
        time: &Time,
        goal: Option<f64>,
    ) {
        let position = f64::from(said.position);
        if let Some(before) = self.position {
            if self.old(said.clock, limits, time) {
                return;
            }
            self.lost |= (position - before).abs() > axis.fastest * time.since(self.heard) + LOOSE;
        } else {
            (self.clock, self.ticked, self.punctual) = (said.clock, time.now, time.now);
        }
        self.position = Some(position);
        self.temperature = if said.temperature.is_nan() {
            f64::INFINITY
        } else {
            said.temperature
        };
        self.health = said.health.or(self.health);
        self.heard = time.now;
        if goal.is_none_or(|goal| (position - goal).abs() <= axis.following) {
            self.followed = time.now;
        }
        let most = axis.current.unwrap_or(f64::INFINITY) * AT_CAP;
        if goal.is_none() || said.current.is_none_or(|current| current.abs() <= most) {
            self.light = time.now;
        }
        if said.voltage >= axis.voltage.0 && said.voltage <= axis.voltage.1 {
            self.powered = time.now;
        }
    }

    /// Whether an answer with this `clock` is too old: the clock has stopped, or is behind by more
    /// than `late`.
    fn old(&mut self, clock: u16, limits: &Limits, time: &Time) -> bool {
        let round = clock.wrapping_sub(self.clock) % ROUND;
        let passed = f64::from(round) - f64::from(ROUND) * f64::from(u8::from(round >= ROUND / 2));
        let gone = self.gone + 1e-3 * passed;
        let behind = (1.0 - DRIFT) * time.since(self.punctual) - gone;
        // After this long without useful answers, a servo may have restarted; the guard has already
        // reacted.
        let anew = time.since(self.heard) > ANEW;
        let stands = clock == self.clock && time.since(self.ticked) > CLOCK_STANDS;
        if stands || behind > limits.late && !anew {
            return true;
        }
        if clock != self.clock {
            (self.clock, self.ticked) = (clock, time.now);
        }
        (self.punctual, self.gone) = if anew || behind <= 0.0 {
            (time.now, 0.0)
        } else {
            (self.punctual, gone)
        };
        false
    }

    /// Torque on: reset its history; return its position.
    pub fn start(&mut self, time: &Time) -> Option<f64> {
        (self.followed, self.light) = (time.now, time.now);
        self.health
            .iter_mut()
            .for_each(|health| health.torque = true);
        self.position
    }

    /// The most severe fault. `engaged`: start of torque on, if it is; `homed`: whether home is
    /// known.
    pub fn ill(
        &self,
        axis: &Axis,
        limits: &Limits,
        time: &Time,
        engaged: Option<Stamp>,
        homed: bool,
    ) -> Option<Cause> {
        let active = engaged.is_some();
        let unheard = time.since(self.heard);
        let lasts = |since: Stamp| time.since(since) - unheard > limits.grace;
        let is = |what: fn(&Health) -> bool| self.health.as_ref().is_some_and(what);
        let switched = engaged.is_some_and(|since| time.since(since) > SWITCHING);
        let checks = [
            (self.lost && (homed || active), Cause::Lost),
            (is(|health| health.hardware != 0), Cause::Hardware),
            (
                self.position.is_none() || unheard > limits.silent,
                Cause::Silent,
            ),
            (active && is(|health| health.tripped), Cause::Tripped),
            (switched && is(|health| !health.torque), Cause::Dropped),
            (active && lasts(self.followed), Cause::Following),
            (active && lasts(self.light), Cause::Overload),
            (lasts(self.powered), Cause::Voltage),
            (self.temperature >= axis.hot, Cause::Hot),
            (unheard > limits.late, Cause::Late),
        ];
        checks
            .iter()
            .find(|(wrong, _)| *wrong)
            .map(|(_, cause)| *cause)
    }
}
