//! How simulated time goes on (`simulated.rs`): with real time, or as far as it is granted.

use std::time::{Duration, Instant};

/// The longest sleep of a thread: the interval of the checks for a closed connection.
pub const NAP: Duration = Duration::from_millis(50);
/// Lateness that is made up for; what is beyond is left out.
const LATE: Duration = Duration::from_millis(20);

/// How simulated time goes on.
pub enum Pace {
    /// With real time: `at` ns were at `since`.
    Paced { since: Instant, at: u64 },
    /// Up to so many ns.
    Stepped(u64),
}

pub struct Clock {
    /// ns that have passed, and that are added where they are reported.
    pub now: u64,
    pub base: u64,
    pub pace: Pace,
    /// Until when the driving program counts as alive, if it matters; since when it does not.
    pub there: Option<Instant>,
    pub stands: Option<Instant>,
    /// How long the computer was too busy.
    pub lost: Duration,
    /// A master has the port; it has begun its periods; it waits for this time.
    pub joined: bool,
    pub begun: bool,
    pub asked: Option<u64>,
}

impl Clock {
    /// Paced time that begins now; it shows `base` ns and what has passed.
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

    /// How long to wait before time may go on to `until`; none where it may now.
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
