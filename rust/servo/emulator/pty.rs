//! The emulated bus at a pseudo-terminal, in real time, in its own thread: any master opens it like
//! a serial port.
//!
//! The master's baud rate is that of the terminal's settings, so a wrong one gets no answer, as on
//! a real bus.

use std::os::fd::OwnedFd;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Instant;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{Mode, OFlags, open};
use rustix::io::{Errno, read, write};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, ioctl_tiocnxcl, tcgetattr, tcsetattr};

use super::Emulator;
use crate::urgent::urgent;

/// Below that of a control loop.
const PRIORITY: i32 = 40;
/// Longest sleep of the thread, ns: servos move while the bus is silent.
const NAP: i64 = 2_000_000;
/// Lateness of the thread, s, from which the computer was too busy or the emulator was locked.
const LATE: f64 = 0.01;

/// An emulator that runs at a pseudo-terminal until it is dropped.
pub struct Terminal {
    emulator: Arc<Mutex<Emulator>>,
    path: String,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Terminal {
    /// Open a pseudo-terminal and serve it.
    pub fn open(emulator: Emulator) -> Result<Terminal, Errno> {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
        grantpt(&master)?;
        unlockpt(&master)?;
        let path = ptsname(&master, vec![])?.to_string_lossy().into_owned();
        // Kept open, so the terminal persists between two masters.
        let slave = open(
            path.as_str(),
            OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC,
            Mode::empty(),
        )?;
        let mut settings = tcgetattr(&slave)?;
        settings.make_raw();
        settings.set_speed(57_600)?;
        tcsetattr(&slave, OptionalActions::Now, &settings)?;
        let emulator = Arc::new(Mutex::new(emulator));
        let stop = Arc::new(AtomicBool::new(false));
        let (shared, stopped) = (emulator.clone(), stop.clone());
        let thread = std::thread::spawn(move || serve(&shared, &stopped, &master, &slave));
        Ok(Terminal {
            emulator,
            path,
            stop,
            thread: Some(thread),
        })
    }

    /// The device to open.
    pub fn path(&self) -> &str {
        &self.path
    }

    /// The emulator, stopped during access.
    pub fn emulator(&self) -> MutexGuard<'_, Emulator> {
        self.emulator.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Unplug: a program with the open port loses it.
    pub fn unplug(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A panic of the thread has been printed; the terminal is closed either way.
            let _ = thread.join();
        }
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        self.unplug();
    }
}

fn serve(emulator: &Mutex<Emulator>, stop: &AtomicBool, master: &OwnedFd, slave: &OwnedFd) {
    // Servos do not depend on the load of the computer; without this priority, they answer late
    // while it is busy.
    urgent(PRIORITY);
    let begin = Instant::now();
    let mut last = 0.0;
    let mut turn = |emulator: &mut Emulator| {
        let now = begin.elapsed().as_secs_f64();
        emulator.excuse((now - last - LATE).max(0.0));
        last = now;
        now
    };
    let mut bytes = [0; 1024];
    while !stop.load(Ordering::Relaxed) {
        let mut ready = [PollFd::new(master, PollFlags::IN)];
        let due = {
            let mut emulator = emulator.lock().unwrap_or_else(PoisonError::into_inner);
            let now = turn(&mut emulator);
            while let Some(answer) = emulator.speak(now) {
                // A master that does not read loses answers, as on a wire.
                let _ = write(master, &answer);
            }
            emulator.run(now);
            emulator
                .due()
                .map(|due| ((due - now) * 1e9).max(0.0) as i64)
        };
        let nap = Timespec {
            tv_sec: 0,
            tv_nsec: due.unwrap_or(NAP).min(NAP),
        };
        if !matches!(poll(&mut ready, Some(&nap)), Ok(count) if count > 0) {
            // A port drops its exclusive lock at the last close. This one is kept open, and would
            // block the next program after a killed master. If this fails, only root could open it
            // again.
            let _ = ioctl_tiocnxcl(slave);
            continue;
        }
        if let Ok(count) = read(master, &mut bytes) {
            let mut emulator = emulator.lock().unwrap_or_else(PoisonError::into_inner);
            if let Ok(settings) = tcgetattr(slave) {
                emulator.set_baud(settings.output_speed());
            }
            let now = turn(&mut emulator);
            emulator.hear(&bytes[..count], now);
        }
    }
}
