//! The guard between every target and the servos: a state machine that denies by default, and
//! limited paths.
//!
//!   OFF → CONNECTED → HOMED → READY → ENGAGED ⇄ HOLD → SAFE_STOP → READY, or FAULT
//!
//! It is pure: one call per period with the time, the answers of the servos and the user's inputs
//! returns state, torque and goals. Equal inputs give equal goals, bit for bit, so a recording can
//! be replayed. An *unsafe tick* is a goal outside the window, or beyond slew or acceleration
//! limits, in this order of priority. Reactions to every fault: docs/reference/safety.md. Time-outs
//! run by the clock and by counted periods, whichever is sooner: a clock that stops or jumps back
//! extends none.

#[cfg(test)]
mod age_tests;
#[cfg(test)]
mod cause_tests;
#[cfg(test)]
mod checker;
#[cfg(test)]
mod examined;
#[cfg(test)]
mod fuzz;
pub mod limits;
mod machine;
#[cfg(test)]
mod move_tests;
pub mod path;
#[cfg(test)]
mod request_tests;
pub mod reversals;
#[cfg(test)]
mod robot;
mod servo;
mod time;

pub use limits::{Axis, BadLimit, FARTHEST, Limits, MOST_SERVOS, RANGES};
pub use machine::Guard;
pub use reversals::Budget;

/// The state of the guard. Torque is on only from ENGAGED to SAFE_STOP and during commissioning.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum State {
    /// Nothing is known of the servos.
    Off,
    /// All servos answer; the robot has not been homed since power-up.
    Connected,
    /// The robot is homed.
    Homed,
    /// Checked and waiting to engage.
    Ready,
    /// Follows targets.
    Engaged,
    /// Brakes, then holds under torque.
    Hold,
    /// Goes home at half the slew, then torque off.
    SafeStop,
    /// Torque off, until acknowledged.
    Fault,
    /// Small slow moves with low current, before home is known.
    Commissioning,
}

impl State {
    pub const ALL: [State; 9] = [
        State::Off,
        State::Connected,
        State::Homed,
        State::Ready,
        State::Engaged,
        State::Hold,
        State::SafeStop,
        State::Fault,
        State::Commissioning,
    ];

    /// Whether torque is on and goals are sent.
    pub fn active(self) -> bool {
        matches!(
            self,
            State::Engaged | State::Hold | State::SafeStop | State::Commissioning
        )
    }
}

/// The requests of a user. A request that the state does not allow is denied without effect.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Request {
    /// OFF → CONNECTED, once all servos answer, healthy and without torque.
    Connect,
    /// CONNECTED → HOMED: a user confirmed home, and all positions are in the window.
    Home,
    /// HOMED → READY, without any fault.
    Arm,
    /// READY → ENGAGED, with the enable key pressed and a fresh target.
    Engage,
    /// ENGAGED → HOLD.
    Hold,
    /// Release tension, then torque off; during commissioning, torque off immediately.
    Stop,
    /// FAULT → HOMED or CONNECTED, once its cause is gone.
    Acknowledge,
    /// Back to OFF from a state without torque; not from FAULT, which must be acknowledged first.
    Disconnect,
    /// CONNECTED or HOMED → COMMISSIONING.
    Commission,
}

impl Request {
    pub const ALL: [Request; 9] = [
        Request::Connect,
        Request::Home,
        Request::Arm,
        Request::Engage,
        Request::Hold,
        Request::Stop,
        Request::Acknowledge,
        Request::Disconnect,
        Request::Commission,
    ];
}

/// The cause of the guard's state.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Cause {
    None,
    /// A user request.
    Asked,
    /// The enable key was released, or not received for `stale`.
    Deadman,
    /// No valid target for `stale`.
    Stale,
    /// All targets were rejected: not finite, far outside, or jumping.
    Refused,
    /// A servo did not answer for `late`.
    Late,
    /// A servo exceeds its current limit.
    Overload,
    Voltage,
    Hot,
    Emergency,
    /// A servo did not answer for `silent`.
    Silent,
    /// A servo reports a hardware error.
    Hardware,
    /// A position is too far from its goal: blocked, or a frozen encoder.
    Following,
    /// An impossible position change: turns were lost, or ids exchanged.
    Lost,
    /// A servo lacks torque although it is on: it was reset or shut down.
    Dropped,
    /// A servo's bus watchdog tripped: it received nothing for too long and holds.
    Tripped,
}

impl Cause {
    pub const ALL: [Cause; 16] = [
        Cause::None,
        Cause::Asked,
        Cause::Deadman,
        Cause::Stale,
        Cause::Refused,
        Cause::Late,
        Cause::Overload,
        Cause::Voltage,
        Cause::Hot,
        Cause::Emergency,
        Cause::Silent,
        Cause::Hardware,
        Cause::Following,
        Cause::Lost,
        Cause::Dropped,
        Cause::Tripped,
    ];

    /// The reaction to it.
    pub fn reaction(self) -> Reaction {
        match self {
            Cause::None | Cause::Asked => Reaction::None,
            Cause::Deadman | Cause::Stale | Cause::Refused | Cause::Late => Reaction::Hold,
            Cause::Overload | Cause::Voltage | Cause::Hot => Reaction::Slacken,
            _ => Reaction::Release,
        }
    }

    /// Whether the servos' turns are known afterwards.
    pub fn keeps_home(self) -> bool {
        self.reaction() != Reaction::Release || self == Cause::Emergency
    }
}

/// Why a request had no effect.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Denied {
    /// It is not allowed in this state.
    From(State),
    /// There is a fault.
    Trouble(Cause),
    /// A servo has torque, or has not reported whether it has.
    Torque,
    /// A servo is outside the window.
    Outside,
    /// The enable key is not pressed, or there is no fresh target.
    Undriven,
}

/// The reaction to a cause; the later the graver.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Reaction {
    None,
    /// Brake and hold; goes on by itself once the cause is gone, releases tension when it lasts.
    Hold,
    /// Go home at half the slew, then torque off and FAULT.
    Slacken,
    /// Torque off at once, and FAULT.
    Release,
}

/// One answer of a servo.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Feedback {
    /// Ticks.
    pub position: i32,
    /// Its own clock, ms; it does not advance if an old answer is repeated.
    pub clock: u16,
    /// mA, where it is measured.
    pub current: Option<f64>,
    /// V.
    pub voltage: f64,
    /// °C.
    pub temperature: f64,
    /// Readings at a lower rate.
    pub health: Option<Health>,
}

/// The reported health of a servo.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Health {
    /// Bits of its hardware error status.
    pub hardware: u8,
    pub torque: bool,
    /// Its bus watchdog tripped and it holds under torque.
    pub tripped: bool,
}

/// The user's inputs in this period.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Message<'a> {
    pub deadman: bool,
    /// Goals in ticks, one per servo, if there are new ones.
    pub goal: Option<&'a [f64]>,
}

/// All inputs of a tick.
#[derive(Debug, Clone, Copy)]
pub struct Input<'a> {
    /// Time of a monotonic clock, ns.
    pub now: u64,
    /// The answer of each servo since the last tick.
    pub feedback: &'a [Option<Feedback>],
    pub message: Option<Message<'a>>,
    /// Without a new goal: the planner's current version of the last one. It does not reset
    /// time-outs.
    pub again: Option<&'a [f64]>,
    pub request: Option<Request>,
    /// The emergency stop is pressed, or its line has failed.
    pub emergency: bool,
}

/// The actions of this tick; goals and currents are read from the guard.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Output {
    pub state: State,
    pub cause: Cause,
    /// The servo that caused it.
    pub servo: Option<u8>,
    pub torque: bool,
    /// Why the request of this tick had no effect.
    pub denied: Option<Denied>,
    /// The target of this tick was rejected.
    pub refused: bool,
    /// A target jumped by more than the reported limit.
    pub jumped: bool,
    /// A target is outside the window.
    pub outside: bool,
    /// A goal is not at its target yet.
    pub slowed: bool,
}
