//! One period of the loop as a document, for reports and recordings.
//!
//! JSON: missing and non-finite values are null; numbers are written with full precision. Pinned by
//! tests/robot/test_recording.py.

use std::fmt::Debug;

use serde::Serialize;
use softmap_servo::control::Entry;
use softmap_servo::guard::Feedback;

/// The decision, and the goal and the readings of each servo.
#[derive(Serialize)]
pub struct Period {
    state: String,
    cause: String,
    torque: bool,
    refused: bool,
    /// Why a request had no effect.
    denied: Option<String>,
    emergency: bool,
    /// The failure of the bus.
    bus: Option<String>,
    overruns: u64,
    /// Counts of answers so far: requested, lost, damaged, and unrequested.
    asked: u64,
    lost: u64,
    damaged: u64,
    unasked: u64,
    goal: Vec<Option<i32>>,
    position: Vec<Option<i32>>,
    #[serde(rename = "current_mA")]
    current: Vec<Option<f64>>,
    #[serde(rename = "temperature_C")]
    temperature: Vec<Option<f64>>,
    #[serde(rename = "voltage_V")]
    voltage: Vec<Option<f64>>,
}

impl Period {
    /// The period of `entry`, for a robot with a number of servos.
    pub fn of(entry: &Entry, servos: usize) -> Period {
        let output = &entry.output;
        let goals = entry.goals.iter().take(servos);
        Period {
            state: name(output.state),
            cause: name(output.cause),
            torque: output.torque,
            refused: output.refused,
            denied: output.denied.map(name),
            emergency: entry.orders.emergency,
            bus: entry.fault.map(|fault| fault.to_string()),
            overruns: entry.overruns,
            asked: entry.counts.asked,
            lost: entry.counts.silent,
            damaged: entry.counts.damaged,
            unasked: entry.counts.unasked,
            goal: goals.map(|goal| output.torque.then_some(*goal)).collect(),
            position: sensed(entry, servos, |said| Some(said.position)),
            current: sensed(entry, servos, |said| said.current),
            temperature: sensed(entry, servos, |said| Some(said.temperature)),
            voltage: sensed(entry, servos, |said| Some(said.voltage)),
        }
    }
}

/// One reading of each servo.
pub fn sensed<T>(
    entry: &Entry,
    servos: usize,
    of: impl Fn(&Feedback) -> Option<T>,
) -> Vec<Option<T>> {
    let each = entry.feedback.iter().take(servos);
    each.map(|said| said.as_ref().and_then(&of)).collect()
}

/// A name of the guard in snake case.
pub fn name(of: impl Debug) -> String {
    let mut small = String::new();
    for letter in format!("{of:?}").chars() {
        if letter.is_uppercase() && !small.is_empty() && !small.ends_with(['(', '_']) {
            small.push('_');
        }
        small.push(letter.to_ascii_lowercase());
    }
    small
}

#[cfg(test)]
mod tests {
    use super::*;
    use softmap_servo::guard::{Cause, Denied, State};

    #[test]
    fn names_are_small() {
        assert_eq!(name(State::SafeStop), "safe_stop");
        assert_eq!(name(Denied::Trouble(Cause::Hot)), "trouble(hot)");
    }
}
