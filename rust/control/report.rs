//! What the loop did, out of a ring to whoever reads the reports: a JSON document a line, some thirty a second.
//!
//! `softmap.loop/1`: the state and why, of each servo goal, position, current, temperature and voltage; what was refused
//! or denied at once; at the end how late periods began and how old commands were.

use std::fmt::{Debug, Write as _};
use std::os::fd::OwnedFd;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};
use rustix::io::{Errno, write};
use softmap_servo::control::{Entry, Record};
use softmap_servo::guard::State;
use softmap_servo::timing::Timing;

use super::Ended;
use super::recording::Recording;

/// How often the thread looks at the ring.
const LOOK: Duration = Duration::from_millis(5);
/// ns between two reports while nothing changes.
const OFTEN: u64 = 33_000_000;

/// The loop's end of the ring; what does not fit is counted.
pub struct Ring {
    sender: rtrb::Producer<Entry>,
    lost: u64,
}

impl Ring {
    pub fn new(sender: rtrb::Producer<Entry>) -> Ring {
        Ring { sender, lost: 0 }
    }

    /// Entries that the reporting thread was too slow for.
    pub fn lost(&self) -> u64 {
        self.lost
    }
}

impl Record for Ring {
    fn take(&mut self, entry: &Entry) {
        self.lost += u64::from(self.sender.push(*entry).is_err());
    }
}

/// The thread that reports.
pub struct Reporter {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<OwnedFd>>,
}

impl Reporter {
    /// Report what comes out of `ring` to `pipe`, and record it; `warnings` first.
    pub fn start(
        mut ring: rtrb::Consumer<Entry>,
        pipe: OwnedFd,
        mut recording: Option<Recording>,
        (servos, commands): (usize, usize),
        warnings: &[String],
    ) -> Reporter {
        if let Ok(flags) = fcntl_getfl(&pipe) {
            // Were it refused, a reader that sleeps would keep this thread waiting, not the loop.
            let _ = fcntl_setfl(&pipe, flags | OFlags::NONBLOCK);
        }
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = stop.clone();
        let begin = format!("{{\"schema\": \"softmap.loop/1\", \"warnings\": {warnings:?}}}\n");
        let thread = std::thread::spawn(move || {
            say(&pipe, &begin);
            let (mut told, mut state, mut line) = (0, None, String::new());
            loop {
                let last = stopped.load(Ordering::Relaxed);
                while let Ok(entry) = ring.pop() {
                    if let Some(Err(fault)) =
                        recording.as_mut().map(|open| open.add(&entry, commands))
                    {
                        // A disk that is full ends the recording, not the loop.
                        recording = None;
                        say(&pipe, &unrecorded(&fault.to_string()));
                    }
                    let output = &entry.output;
                    let news =
                        state != Some(output.state) || output.denied.is_some() || output.refused;
                    if news || entry.now.saturating_sub(told) >= OFTEN {
                        (told, state) = (entry.now, Some(output.state));
                        line.clear();
                        document(&mut line, &entry, servos);
                        say(&pipe, &line);
                    }
                }
                if last {
                    if let Some(Err(fault)) = recording.map(Recording::end) {
                        say(&pipe, &unrecorded(&fault.to_string()));
                    }
                    return pipe;
                }
                std::thread::sleep(LOOK);
            }
        });
        Reporter {
            stop,
            thread: Some(thread),
        }
    }

    /// Say how it ended, and how the loop kept its time.
    pub fn finish(mut self, ended: Ended, timing: &Timing, lost: u64) {
        self.stop.store(true, Ordering::Relaxed);
        let Some(Ok(pipe)) = self.thread.take().map(JoinHandle::join) else {
            return;
        };
        let quantiles = |bins| {
            let [a, b, c] = [0.5, 0.99, 0.999].map(|q| Timing::quantile(bins, q));
            format!("{{\"p50\": {a}, \"p99\": {b}, \"p99_9\": {c}}}")
        };
        let line = format!(
            "{{\"schema\": \"softmap.loop/1\", \"ended\": \"{}\", \"ticks\": {}, \"overruns\": {}, \"lost\": {lost}, \
             \"late_us\": {}, \"command_age_us\": {}, \"late_bins\": {:?}}}\n",
            name(ended),
            timing.ticks,
            timing.overruns,
            quantiles(&timing.late),
            if timing.age.iter().any(|count| *count > 0) {
                quantiles(&timing.age)
            } else {
                "null".to_owned()
            },
            timing.late
        );
        let begin = Instant::now();
        while !say(&pipe, &line) && begin.elapsed() < Duration::from_secs(1) {
            std::thread::sleep(LOOK);
        }
    }
}

fn unrecorded(fault: &str) -> String {
    format!("{{\"schema\": \"softmap.loop/1\", \"unrecorded\": {fault:?}}}\n")
}

/// Write a line that fits into the pipe whole; false if there is no room for it now.
fn say(pipe: &OwnedFd, line: &str) -> bool {
    write(pipe, line.as_bytes()) != Err(Errno::AGAIN)
}

/// A name of the guard's in small letters with underscores.
pub(crate) fn name(of: impl Debug) -> String {
    let mut small = String::new();
    for letter in format!("{of:?}").chars() {
        if letter.is_uppercase() && !small.is_empty() && !small.ends_with(['(', '_']) {
            small.push('_');
        }
        small.push(letter.to_ascii_lowercase());
    }
    small
}

/// A text of JSON, or null.
pub(super) fn quoted(text: Option<String>) -> String {
    text.map_or("null".to_owned(), |text| format!("{text:?}"))
}

/// Add `"key": [...]`, null where there is no finite number.
pub(super) fn list(
    line: &mut String,
    key: &str,
    count: usize,
    number: &dyn Fn(usize) -> Option<f64>,
) {
    // Writing to a String cannot fail.
    let _ = write!(line, ", \"{key}\": [");
    for k in 0..count {
        let between = if k == 0 { "" } else { ", " };
        let _ = match number(k).filter(|number| number.is_finite()) {
            Some(number) => write!(line, "{between}{number}"),
            None => write!(line, "{between}null"),
        };
    }
    line.push(']');
}

fn document(line: &mut String, entry: &Entry, servos: usize) {
    let output = &entry.output;
    let active = output.state != State::Off && output.torque;
    let _ = write!(
        line,
        "{{\"schema\": \"softmap.loop/1\", \"t\": {}, \"state\": \"{}\", \"cause\": \"{}\", \"servo\": {}, \"torque\": {}, \
         \"denied\": {}, \"emergency\": {}, \"refused\": {}, \"jumped\": {}, \"outside\": {}, \"slowed\": {}, \"bus\": {}, \"overruns\": {}",
        entry.now as f64 * 1e-9,
        name(output.state),
        name(output.cause),
        output
            .servo
            .map_or("null".to_owned(), |servo| servo.to_string()),
        output.torque,
        quoted(output.denied.map(name)),
        entry.orders.emergency,
        output.refused,
        output.jumped,
        output.outside,
        output.slowed,
        quoted(entry.fault.map(|fault| fault.to_string())),
        entry.overruns,
    );
    let sensed = |k: usize| entry.feedback[k];
    list(line, "goal", servos, &|k| {
        active.then(|| f64::from(entry.goals[k]))
    });
    list(line, "position", servos, &|k| {
        Some(f64::from(sensed(k)?.position))
    });
    list(line, "current_mA", servos, &|k| sensed(k)?.current);
    list(line, "temperature_C", servos, &|k| {
        Some(sensed(k)?.temperature)
    });
    list(line, "voltage_V", servos, &|k| Some(sensed(k)?.voltage));
    line.push_str("}\n");
}

#[cfg(test)]
mod tests {
    use super::*;
    use softmap_servo::guard::{Cause, Denied};

    #[test]
    fn names_are_small() {
        assert_eq!(name(State::SafeStop), "safe_stop");
        assert_eq!(name(Denied::Trouble(Cause::Hot)), "trouble(hot)");
    }
}
