//! The guard between every target and the servos: a state machine that denies by default, and paths
//! within limits.
//!
//!   OFF → CONNECTED → HOMED → READY → ENGAGED ⇄ HOLD → SAFE_STOP → READY, or FAULT
//!
//! Pure: one call a period with the time, what was heard of each servo and what is asked; out come
//! state, torque and the goals to send. The same inputs give the same goals, bit for bit, so that a
//! recording can be replayed. An *unsafe tick* is a goal outside the window, or beyond slew or
//! acceleration limits, in this order of priority. Reactions to every fault:
//! docs/reference/safety.md. Time-outs run by the clock and by counted periods, whichever is
//! sooner: a clock that stands still or jumps back stretches none.

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

/// Where the guard stands. Torque is on from ENGAGED to SAFE_STOP and while commissioning, nowhere
/// else.
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
    /// Brakes, then stands under torque.
    Hold,
    /// Goes home at half the slew, then torque off.
    SafeStop,
    /// Torque off, until acknowledged.
    Fault,
    /// Small slow moves under little current, before home is known.
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

/// The requests of a user. A request that the state does not allow is denied: nothing happens.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Request {
    /// OFF → CONNECTED, once all servos are heard, healthy and without torque.
    Connect,
    /// CONNECTED → HOMED: a user confirmed home, and all positions lie in the window.
    Home,
    /// HOMED → READY, without any trouble.
    Arm,
    /// READY → ENGAGED, with the enable key pressed and a fresh target.
    Engage,
    /// ENGAGED → HOLD.
    Hold,
    /// Release tension, then torque off; while commissioning torque off at once.
    Stop,
    /// FAULT → HOMED or CONNECTED, once its cause is gone.
    Acknowledge,
    /// Back to OFF from a state without torque; not from FAULT, which is acknowledged first.
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

/// Why the guard stands where it stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Cause {
    None,
    /// Somebody asked for it.
    Asked,
    /// The enable key was released, or not heard of for `stale`.
    Deadman,
    /// No valid target for `stale`.
    Stale,
    /// Targets were refused until none was left: not finite, far outside, or jumping.
    Refused,
    /// A servo did not answer for `late`.
    Late,
    /// A servo draws more than it may.
    Overload,
    Voltage,
    Hot,
    Emergency,
    /// A servo did not answer for `silent`.
    Silent,
    /// A servo reports a hardware error.
    Hardware,
    /// A position is too far from its goal: blocked, or its encoder stands.
    Following,
    /// A position moved as no servo can: turns were lost, or ids exchanged.
    Lost,
    /// A servo has no torque though it should: it was reset or shut down.
    Dropped,
    /// A servo's bus watchdog tripped: it heard nothing for too long and holds.
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

    /// Whether the turns of the servos are known afterwards.
    pub fn keeps_home(self) -> bool {
        self.reaction() != Reaction::Release || self == Cause::Emergency
    }
}

/// Why a request changed nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Denied {
    /// It is not allowed in this state.
    From(State),
    /// Something is wrong.
    Trouble(Cause),
    /// A servo has torque, or has not reported whether it has.
    Torque,
    /// A servo stands outside the window.
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
    /// Its own clock, ms; it stands still if an old answer comes again.
    pub clock: u16,
    /// mA, where it is measured.
    pub current: Option<f64>,
    /// V.
    pub voltage: f64,
    /// °C.
    pub temperature: f64,
    /// Readings that are asked for less often.
    pub health: Option<Health>,
}

/// The health that a servo reports.
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
    /// Goals in ticks, one a servo, if there are new ones.
    pub goal: Option<&'a [f64]>,
}

/// All that a tick is decided by.
#[derive(Debug, Clone, Copy)]
pub struct Input<'a> {
    /// ns of a clock that does not go backwards.
    pub now: u64,
    /// Of each servo, what was heard since the last tick.
    pub feedback: &'a [Option<Feedback>],
    pub message: Option<Message<'a>>,
    /// Without a new goal: the last one as the planner has it now. No news, so that it keeps
    /// nothing going.
    pub again: Option<&'a [f64]>,
    pub request: Option<Request>,
    /// The emergency stop is pressed, or its line is dead.
    pub emergency: bool,
}

/// The actions for now; goals and currents are asked of the guard.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Output {
    pub state: State,
    pub cause: Cause,
    /// The servo that caused it.
    pub servo: Option<u8>,
    pub torque: bool,
    /// Why the request of this tick changed nothing.
    pub denied: Option<Denied>,
    /// The target of this tick was refused.
    pub refused: bool,
    /// A target jumped by more than passes unnoticed.
    pub jumped: bool,
    /// A target lies outside the window.
    pub outside: bool,
    /// A goal is not at its target yet.
    pub slowed: bool,
}
