//! Reports of the loop, from a ring to their reader: one JSON document per line, about thirty per
//! second.
//!
//! `softmap.loop/1`: the state and its cause; goal, position, current, temperature and voltage of
//! each servo; rejected or denied requests immediately; at the end, lateness of periods and age of
//! commands.

use std::os::fd::OwnedFd;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::{JoinHandle, Thread};
use std::time::{Duration, Instant};

use mcap::McapError;
use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};
use rustix::io::{Errno, write};
use serde::Serialize;
use serde_json::json;
use softmap_servo::control::{Entry, Record};
use softmap_servo::timing::{BINS, Timing};

use super::Ended;
use super::period::{Period, name};
use super::recording::{Recording, cause};

/// The schema of the documents.
const SCHEMA: &str = "softmap.loop/1";
/// Polling interval of the ring.
const LOOK: Duration = Duration::from_millis(5);
/// ns between two reports while nothing changes.
const OFTEN: u64 = 33_000_000;

/// Timeout of a loop in simulated time for a report: a disk may be slow, and the thread may have
/// failed.
const PATIENCE: Duration = Duration::from_secs(10);

/// The progress of the reporting thread.
pub struct Progress {
    thread: Thread,
    handled: Arc<AtomicU64>,
}

/// The loop's end of the ring; entries that do not fit are counted. With `progress`, each entry is
/// reported before the next begins.
pub struct Ring {
    sender: rtrb::Producer<Entry>,
    lost: u64,
    taken: u64,
    progress: Option<Progress>,
}

impl Ring {
    pub fn new(sender: rtrb::Producer<Entry>, progress: Option<Progress>) -> Ring {
        Ring {
            sender,
            lost: 0,
            taken: 0,
            progress,
        }
    }

    /// Wait until all taken entries are reported.
    fn follow(&self) {
        let Some(Progress { thread, handled }) = &self.progress else {
            return;
        };
        let begun = Instant::now();
        while handled.load(Ordering::Acquire) < self.taken && begun.elapsed() < PATIENCE {
            thread.unpark();
            std::thread::sleep(Duration::from_micros(50));
        }
    }

    /// Entries that the reporting thread was too slow for.
    pub fn lost(&self) -> u64 {
        self.lost
    }
}

impl Record for Ring {
    fn take(&mut self, entry: &Entry) {
        match self.sender.push(*entry) {
            Ok(()) => self.taken += 1,
            Err(_) => self.lost += 1,
        }
        self.follow();
    }
}

/// The last report.
pub struct Last {
    pub ended: Ended,
    pub timing: Timing,
    /// Entries that were not reported.
    pub lost: u64,
    /// Ids of servos that have not reported that they have no torque.
    pub kept: Vec<u8>,
}

/// The reporting thread.
pub struct Reporter {
    stop: Arc<AtomicBool>,
    handled: Arc<AtomicU64>,
    thread: Option<JoinHandle<OwnedFd>>,
}

impl Reporter {
    /// Report the entries of `ring` to `pipe`, and record them; `warnings` first.
    pub fn start(
        mut ring: rtrb::Consumer<Entry>,
        pipe: OwnedFd,
        mut recording: Option<Recording>,
        ids: Vec<u8>,
        commands: usize,
        warnings: &[String],
    ) -> Reporter {
        if let Ok(flags) = fcntl_getfl(&pipe) {
            // If this fails, a slow reader blocks this thread, not the loop.
            let _ = fcntl_setfl(&pipe, flags | OFlags::NONBLOCK);
        }
        let stop = Arc::new(AtomicBool::new(false));
        let handled = Arc::new(AtomicU64::new(0));
        let (stopped, count) = (stop.clone(), handled.clone());
        let begin = json!({"schema": SCHEMA, "warnings": warnings});
        let thread = std::thread::spawn(move || {
            say(&pipe, &begin);
            let (mut told, mut state) = (0, None);
            let mut hardware = vec![None; ids.len()];
            loop {
                let last = stopped.load(Ordering::Relaxed);
                while let Ok(entry) = ring.pop() {
                    for (known, said) in hardware.iter_mut().zip(&entry.feedback) {
                        let health = said.and_then(|said| said.health);
                        *known = health.map_or(*known, |health| Some(health.hardware));
                    }
                    if let Some(Err(fault)) =
                        recording.as_mut().map(|open| open.add(&entry, commands))
                    {
                        // A full disk ends the recording, not the loop.
                        recording = None;
                        say(&pipe, &unrecorded(&fault));
                    }
                    let output = &entry.output;
                    let news =
                        state != Some(output.state) || output.denied.is_some() || output.refused;
                    if news || entry.now.saturating_sub(told) >= OFTEN {
                        (told, state) = (entry.now, Some(output.state));
                        say(&pipe, &Told::of(&entry, &ids, &hardware));
                    }
                    count.fetch_add(1, Ordering::Release);
                }
                if last {
                    if let Some(Err(fault)) = recording.map(Recording::end) {
                        say(&pipe, &unrecorded(&fault));
                    }
                    return pipe;
                }
                std::thread::park_timeout(LOOK);
            }
        });
        Reporter {
            stop,
            handled,
            thread: Some(thread),
        }
    }

    /// The progress of the reporting thread, for a loop that waits for it.
    pub fn progress(&self) -> Option<Progress> {
        let thread = self.thread.as_ref()?.thread().clone();
        let handled = self.handled.clone();
        Some(Progress { thread, handled })
    }

    /// Report the end, and the timing of the loop.
    pub fn finish(mut self, last: &Last) {
        self.stop.store(true, Ordering::Relaxed);
        let Some(Ok(pipe)) = self.thread.take().map(JoinHandle::join) else {
            return;
        };
        let timing = &last.timing;
        let quantiles = |bins: &[u64; BINS]| {
            let [a, b, c] = [0.5, 0.99, 0.999].map(|q| Timing::quantile(bins, q));
            json!({"p50": a, "p99": b, "p99_9": c})
        };
        let aged = timing.age.iter().any(|count| *count > 0);
        let line = json!({
            "schema": SCHEMA,
            "ended": name(last.ended),
            "ticks": timing.ticks,
            "overruns": timing.overruns,
            "lost": last.lost,
            "kept_torque": &last.kept,
            "late_us": quantiles(&timing.late),
            "command_age_us": aged.then(|| quantiles(&timing.age)),
            "late_bins": &timing.late[..],
        });
        let begin = Instant::now();
        while !say(&pipe, &line) && begin.elapsed() < Duration::from_secs(1) {
            std::thread::sleep(LOOK);
        }
    }
}

fn unrecorded(fault: &McapError) -> serde_json::Value {
    json!({"schema": SCHEMA, "unrecorded": cause(fault)})
}

/// Write a complete line to the pipe; false if it does not fit now.
fn say(pipe: &OwnedFd, document: &impl Serialize) -> bool {
    // A document whose keys are texts can always be written.
    let mut line = serde_json::to_vec(document).unwrap_or_default();
    line.push(b'\n');
    write(pipe, &line) != Err(Errno::AGAIN)
}

/// The part of a report that is not in a recording.
#[derive(Serialize)]
struct Told<'a> {
    schema: &'static str,
    /// s.
    t: f64,
    servo: Option<u8>,
    /// Its id.
    id: Option<u8>,
    ids: &'a [u8],
    /// The last reported bits of the hardware errors of each servo.
    hardware: &'a [Option<u8>],
    jumped: bool,
    outside: bool,
    slowed: bool,
    #[serde(flatten)]
    period: Period,
}

impl Told<'_> {
    fn of<'a>(entry: &Entry, ids: &'a [u8], hardware: &'a [Option<u8>]) -> Told<'a> {
        let output = &entry.output;
        Told {
            schema: SCHEMA,
            t: entry.now as f64 * 1e-9,
            servo: output.servo,
            id: output.servo.and_then(|k| ids.get(usize::from(k)).copied()),
            ids,
            hardware,
            jumped: output.jumped,
            outside: output.outside,
            slowed: output.slowed,
            period: Period::of(entry, ids.len()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustix::io::read;
    use rustix::pipe::pipe;

    #[test]
    fn a_full_disk_is_named() {
        let full = McapError::from(std::io::Error::from(Errno::NOSPC));
        let said = unrecorded(&full);
        assert!(
            said["unrecorded"]
                .as_str()
                .unwrap()
                .starts_with("No space left on device")
        );
    }

    #[test]
    fn every_report_is_one_line_of_json() {
        let (ours, theirs) = pipe().unwrap();
        let text = "no\u{1b} \u{7f} \u{200b} \"€\" \n";
        assert!(say(&theirs, &json!({"unrecorded": text, "t": f64::NAN})));
        let mut line = [0; 256];
        let count = read(&ours, &mut line).unwrap();
        assert_eq!(
            line[..count].iter().filter(|byte| **byte == b'\n').count(),
            1
        );
        let back: serde_json::Value = serde_json::from_slice(&line[..count]).unwrap();
        assert_eq!(back, json!({"unrecorded": text, "t": null}));
    }
}
