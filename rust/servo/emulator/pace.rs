//! The pace of simulated time (`simulated.rs`): real time, or as far as granted.

use std::time::{Duration, Instant};

/// The longest sleep of a thread: the interval of the checks for a closed connection.
pub const NAP: Duration = Duration::from_millis(50);
/// Lateness that is caught up; the rest is skipped.
const LATE: Duration = Duration::from_millis(20);

/// The pace of simulated time.
pub enum Pace {
    /// With real time: `at` ns were at `since`.
    Paced { since: Instant, at: u64 },
    /// Up to so many ns.
    Stepped(u64),
}

pub struct Clock {
    /// Elapsed time, and offset of the reported time, ns.
    pub now: u64,
    pub base: u64,
    pub pace: Pace,
    /// Deadline of the driving program, if any; time since it is missed.
    pub there: Option<Instant>,
    pub stands: Option<Instant>,
    /// How long the computer was too busy.
    pub lost: Duration,
    /// Whether a master has the port, has begun its periods, and the time that it waits for.
    pub joined: bool,
    pub begun: bool,
    pub asked: Option<u64>,
}

impl Clock {
    /// Paced time from now on; it shows `base` plus the elapsed time, ns.
    pub fn new(base: u64) -> Clock {
        Clock {
            now: 0,
            base,
            pace: Pace::Paced {
                since: Instant::now(),
                at: 0,
            },
            there: None,
            stands: None,
            lost: Duration::ZERO,
            joined: false,
            begun: false,
            asked: None,
        }
    }

    /// Wait before time may advance to `until`; None if it may now.
    pub fn left(&mut self, until: u64, now: Instant) -> Option<Duration> {
        let (since, at) = match &mut self.pace {
            Pace::Stepped(granted) => return (until > *granted).then_some(NAP),
            Pace::Paced { since, at } => (since, at),
        };
        if !self.begun {
            (self.begun, *since, *at) = (true, now, until);
        }
        if let Some(there) = self.there
            && now > there
        {
            self.stands.get_or_insert(there);
            return Some(NAP);
        }
        if let Some(stood) = self.stands.take() {
            self.lost += now - stood;
            *since += now - stood;
        }
        let due = *since + Duration::from_nanos(until.saturating_sub(*at));
        if now < due {
            return Some(due - now);
        }
        if now - due > LATE {
            self.lost += now - due;
            *since += now - due;
        }
        None
    }
}
