//! The emulated bus in simulated time, at a local socket: the other end of `lockstep.rs`.
//!
//! Time passes in steps of the master: it stops while an answer is computed or read, so load does
//! not change results. It has one of two paces. `Paced` follows real time and never catches up:
//! delays of the computer are skipped and counted. `Stepped` advances as far as granted, as fast as
//! possible.

use std::fs::{DirBuilder, remove_dir_all};
use std::io::{Read, Result, Write};
use std::os::unix::fs::DirBuilderExt;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::{JoinHandle, spawn};
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};

use super::Emulator;
use super::pace::{Clock, NAP, Pace};
use crate::lockstep::{ANSWERED, ASKED, BUSY, BYE, HEAR, HELLO, RECEIVE, WAIT, passing};
use crate::packet::LONGEST;

/// Longest folder name for sockets, bytes: their path is limited to 100.
const LONGEST_FOLDER: usize = 60;

struct Shared {
    emulator: Mutex<Emulator>,
    clock: Mutex<Clock>,
    turned: Condvar,
    stop: AtomicBool,
}

impl Shared {
    fn emulator(&self) -> MutexGuard<'_, Emulator> {
        self.emulator.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn clock(&self) -> MutexGuard<'_, Clock> {
        self.clock.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    fn sleep<'a>(&self, clock: MutexGuard<'a, Clock>, most: Duration) -> MutexGuard<'a, Clock> {
        let slept = self.turned.wait_timeout(clock, most.min(NAP));
        slept.unwrap_or_else(PoisonError::into_inner).0
    }
}

/// Simulated servos, served until dropped.
pub struct Simulated {
    shared: Arc<Shared>,
    folder: PathBuf,
    path: String,
    thread: Option<JoinHandle<()>>,
}

impl Simulated {
    /// Serve `emulator` at a socket of this user; its clock shows `base` plus the elapsed time, ns.
    pub fn open(emulator: Emulator, base: u64) -> Result<Simulated> {
        let folder = folder()?;
        let socket = folder.join("servos");
        let listener = UnixListener::bind(&socket)?;
        listener.set_nonblocking(true)?;
        let shared = Arc::new(Shared {
            emulator: Mutex::new(emulator),
            clock: Mutex::new(Clock::new(base)),
            turned: Condvar::new(),
            stop: AtomicBool::new(false),
        });
        let served = shared.clone();
        Ok(Simulated {
            shared,
            folder,
            path: socket.to_string_lossy().into_owned(),
            thread: Some(spawn(move || accept(&served, &listener))),
        })
    }

    /// The socket to open.
    pub fn path(&self) -> &str {
        &self.path
    }

    pub fn emulator(&self) -> MutexGuard<'_, Emulator> {
        self.shared.emulator()
    }

    /// Time as seen by its masters, ns.
    pub fn now(&self) -> u64 {
        let clock = self.shared.clock();
        clock.base + clock.now
    }

    /// Stop time at `at` ns, counted from 0 from now on, until more is granted; servos move up to
    /// it.
    pub fn hold(&self, at: u64) {
        let mut clock = self.shared.clock();
        clock.now = clock.now.max(at);
        (clock.base, clock.pace) = (0, Pace::Stepped(clock.now));
        self.emulator().run(clock.now as f64 * 1e-9);
        self.shared.turned.notify_all();
    }

    /// Grant time up to `until` ns and wait, at most `most`, until the master has used it; return
    /// whether it has.
    pub fn advance(&self, until: u64, most: Duration) -> bool {
        let begun = Instant::now();
        let mut clock = self.shared.clock();
        let Pace::Stepped(granted) = &mut clock.pace else {
            return false;
        };
        *granted = until.max(*granted);
        let granted = *granted;
        self.shared.turned.notify_all();
        while clock.joined && clock.asked.is_none_or(|asked| asked <= granted) {
            let left = most.saturating_sub(begun.elapsed());
            if left.is_zero() || self.shared.stopped() {
                return false;
            }
            clock = self.shared.sleep(clock, left);
        }
        // A master that waits for a later time does not notice this; readers of the horns see them
        // move.
        clock.now = clock.now.max(granted);
        self.emulator().run(clock.now as f64 * 1e-9);
        true
    }

    /// For stepped time: let it run, or stop it; return the time.
    pub fn free(&self, free: bool) -> u64 {
        let mut clock = self.shared.clock();
        let now = clock.now;
        if let Pace::Stepped(granted) = &mut clock.pace {
            *granted = if free { u64::MAX } else { now };
        }
        self.shared.turned.notify_all();
        clock.base + now
    }

    /// For paced time: extend the deadline of the driving program by `window`, or remove it; return
    /// how long the computer was too busy.
    pub fn there(&self, window: Option<Duration>) -> Duration {
        let mut clock = self.shared.clock();
        clock.there = window.map(|window| Instant::now() + window);
        self.shared.turned.notify_all();
        clock.lost
    }

    /// Whether a master waits for time.
    pub fn waiting(&self) -> bool {
        self.shared.clock().asked.is_some()
    }

    /// Unplug: a program with the open port loses it.
    pub fn unplug(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        self.shared.turned.notify_all();
        if let Some(thread) = self.thread.take() {
            // A panic of the thread has been printed; the socket is closed either way.
            let _ = thread.join();
            // A leftover file in a temporary folder is harmless.
            let _ = remove_dir_all(&self.folder);
        }
    }
}

impl Drop for Simulated {
    fn drop(&mut self) {
        self.unplug();
    }
}

/// A new private folder of this user. Socket paths are short: a long folder is not used.
fn folder() -> Result<PathBuf> {
    static NEXT: AtomicU64 = AtomicU64::new(0);
    let mut usual = std::env::temp_dir();
    if usual.as_os_str().len() > LONGEST_FOLDER {
        usual = PathBuf::from("/tmp");
    }
    loop {
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        let name = format!("softmap-{}-{number}", std::process::id());
        let folder = usual.join(name);
        match DirBuilder::new().mode(0o700).create(&folder) {
            Err(fault) if fault.kind() == std::io::ErrorKind::AlreadyExists => {}
            done => return done.map(|()| folder),
        }
    }
}

fn accept(shared: &Arc<Shared>, listener: &UnixListener) {
    let mut serving = vec![];
    while !shared.stopped() {
        if !ready(listener, NAP) {
            continue;
        }
        if let Ok((stream, _)) = listener.accept() {
            let shared = shared.clone();
            serving.retain(|one: &JoinHandle<()>| !one.is_finished());
            serving.push(spawn(move || {
                // A lost master needs no answer.
                let _ = serve(&shared, stream);
            }));
        }
    }
    for one in serving {
        // A panic has been printed.
        let _ = one.join();
    }
}

fn ready(of: impl std::os::fd::AsFd, most: Duration) -> bool {
    let most = Timespec {
        tv_sec: 0,
        tv_nsec: most.as_nanos() as i64,
    };
    let mut asked = [PollFd::new(&of, PollFlags::IN)];
    matches!(poll(&mut asked, Some(&most)), Ok(count) if count > 0)
}

/// Whether `serve` has the port, to be given back.
struct Joined<'a>(&'a Shared, bool);

impl Drop for Joined<'_> {
    fn drop(&mut self) {
        if self.1 {
            let mut clock = self.0.clock();
            (clock.joined, clock.begun, clock.asked) = (false, false, None);
            self.0.turned.notify_all();
        }
    }
}

fn serve(shared: &Shared, mut stream: UnixStream) -> Result<()> {
    stream.set_nonblocking(false)?;
    stream.set_read_timeout(Some(NAP))?;
    let mut joined = Joined(shared, false);
    let mut spoken: Vec<u8> = vec![];
    loop {
        let mut head = [0; ASKED];
        fill(shared, &mut stream, &mut head)?;
        let size = usize::from(u16::from_le_bytes([head[1], head[2]]));
        let mut eight = [0; 8];
        eight.copy_from_slice(&head[3..]);
        let value = u64::from_le_bytes(eight);
        match head[0] {
            HELLO => {
                let mut clock = shared.clock();
                let free = !clock.joined;
                clock.joined |= free;
                joined.1 |= free;
                drop(clock);
                if free {
                    shared.emulator().set_baud(value as u32);
                }
                say(shared, &mut stream, if free { &[] } else { &[BUSY] })?;
            }
            _ if !joined.1 => return Ok(()),
            HEAR => {
                let mut bytes = [0; LONGEST];
                let Some(bytes) = bytes.get_mut(..size) else {
                    return Ok(());
                };
                fill(shared, &mut stream, bytes)?;
                hear(shared, &mut spoken, bytes, value != 0);
            }
            WAIT => {
                if !wait(shared, &stream, value) {
                    return Ok(());
                }
                say(shared, &mut stream, &[])?;
            }
            RECEIVE => {
                if spoken.is_empty() {
                    spoken = receive(shared, value);
                }
                let rest = spoken.split_off(spoken.len().min(size));
                say(shared, &mut stream, &spoken)?;
                spoken = rest;
            }
            BYE => {
                drop(joined);
                return say(shared, &mut stream, &[]);
            }
            _ => return Ok(()),
        }
    }
}

/// Fill `into`, waiting as long as needed.
fn fill(shared: &Shared, stream: &mut UnixStream, mut into: &mut [u8]) -> Result<()> {
    while !into.is_empty() {
        match stream.read(into) {
            Ok(0) => return Err(std::io::ErrorKind::UnexpectedEof.into()),
            Ok(count) => into = &mut into[count..],
            Err(fault) if passing(fault.kind()) && !shared.stopped() => {}
            Err(fault) => return Err(fault),
        }
    }
    Ok(())
}

fn say(shared: &Shared, stream: &mut UnixStream, bytes: &[u8]) -> Result<()> {
    let now = {
        let clock = shared.clock();
        clock.base + clock.now
    };
    let mut answer = Vec::with_capacity(ANSWERED + bytes.len());
    answer.extend(now.to_le_bytes());
    answer.extend((bytes.len() as u16).to_le_bytes());
    answer.extend(bytes);
    stream.write_all(&answer)
}

fn hear(shared: &Shared, spoken: &mut Vec<u8>, bytes: &[u8], forget: bool) {
    let now = shared.clock().now as f64 * 1e-9;
    let mut emulator = shared.emulator();
    if forget {
        spoken.clear();
        while emulator.speak(now).is_some() {}
    }
    emulator.hear(bytes, now);
}

/// The next bytes that are complete by `until`; advances time until they are.
fn receive(shared: &Shared, until: u64) -> Vec<u8> {
    let mut clock = shared.clock();
    let mut emulator = shared.emulator();
    let until = until.saturating_sub(clock.base);
    let due = emulator.due().map(|due| (due * 1e9).ceil() as u64 + 1);
    clock.now = due.map_or(until, |due| due.min(until)).max(clock.now);
    emulator.speak(clock.now as f64 * 1e-9).unwrap_or_default()
}

/// Advance time to `until`; false if the master is lost, or the port was unplugged.
fn wait(shared: &Shared, stream: &UnixStream, until: u64) -> bool {
    let mut clock = shared.clock();
    let until = until.saturating_sub(clock.base);
    clock.asked = Some(until);
    shared.turned.notify_all();
    while let Some(left) = clock.left(until, Instant::now()) {
        clock = shared.sleep(clock, left);
        // A waiting master sends nothing: a successful read means that it closed the socket.
        if shared.stopped() || ready(stream, Duration::ZERO) {
            return false;
        }
    }
    clock.asked = None;
    clock.now = clock.now.max(until);
    shared.emulator().run(clock.now as f64 * 1e-9);
    true
}

#[cfg(test)]
#[path = "simulated_tests.rs"]
mod tests;
