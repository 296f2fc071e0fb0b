//! The guard's state machine. `mod.rs` describes its guarantees; docs/reference/safety.md has the
//! table of faults.

use super::limits::{Axis, FARTHEST, Limits};
use super::path::{Bounds, Path};
use super::servo::Servo;
use super::time::{Stamp, Time};
use super::{Cause, Denied, Input, Output, Reaction, Request, State};

/// Ticks from home within which a servo is home.
const AT_HOME: f64 = 64.0;

/// The state machine and the paths of the goals.
#[derive(Debug, Clone)]
pub struct Guard {
    limits: Limits,
    bounds: Vec<Bounds>,
    /// The same during commissioning.
    jogs: Vec<Bounds>,
    state: State,
    cause: (Cause, Option<u8>),
    /// The robot was homed, and nothing since could have lost home.
    homed: bool,
    /// Home was lost since it was known.
    forgot: bool,
    servos: Vec<Servo>,
    paths: Vec<Path>,
    targets: Vec<f64>,
    goals: Vec<i32>,
    currents: Vec<Option<f64>>,
    time: Time,
    entered: Stamp,
    engaged: Stamp,
    /// Time of the last accepted target.
    fresh: Option<Stamp>,
    refused: bool,
    /// Whether it is pressed, and when it was last pressed.
    deadman: (bool, Stamp),
    /// It must be released before it is valid again.
    rearm: bool,
}

impl Guard {
    /// A guard in state OFF; `limits` are `checked`.
    pub fn new(limits: Limits) -> Guard {
        let count = limits.axes.len();
        let bounds: Vec<Bounds> = limits
            .axes
            .iter()
            .map(|axis| axis.bounds(limits.period))
            .collect();
        Guard {
            jogs: bounds.clone(),
            bounds,
            state: State::Off,
            cause: (Cause::None, None),
            homed: false,
            forgot: false,
            servos: vec![Servo::default(); count],
            paths: limits
                .axes
                .iter()
                .map(|axis| Path::rest(axis.home.into()))
                .collect(),
            targets: limits.axes.iter().map(|axis| axis.home.into()).collect(),
            goals: limits.axes.iter().map(|axis| axis.home).collect(),
            currents: limits.axes.iter().map(|axis| axis.current).collect(),
            time: Time::new(limits.period),
            entered: Stamp::default(),
            engaged: Stamp::default(),
            fresh: None,
            refused: false,
            deadman: (false, Stamp::default()),
            rearm: false,
            limits,
        }
    }

    pub fn state(&self) -> State {
        self.state
    }

    /// Whether home was lost, so the robot must be homed again. Silence without torque does not
    /// lose it: nothing turned.
    pub fn forgot_home(&self) -> bool {
        self.forgot
    }

    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    /// Goals in ticks, one per servo; to be sent while torque is on.
    pub fn goals(&self) -> &[i32] {
        &self.goals
    }

    /// The same before rounding, with their speeds.
    pub fn paths(&self) -> &[Path] {
        &self.paths
    }

    /// Current cap of each servo now, mA, if it has one.
    pub fn currents(&self) -> &[Option<f64>] {
        &self.currents
    }

    /// Process the input of one period; return the actions.
    pub fn tick(&mut self, input: &Input<'_>) -> Output {
        self.time.pass(input.now);
        let active = self.state.active();
        for (k, feedback) in input.feedback.iter().enumerate().take(self.servos.len()) {
            if let Some(said) = feedback {
                let goal = active.then_some(self.paths[k].at);
                self.servos[k].hear(said, &self.limits.axes[k], &self.limits, &self.time, goal);
            }
        }
        let (refused, jumped) = self.listen(input);
        let trouble = self.trouble(input.emergency);
        if let Some((cause, servo)) = trouble {
            self.react(cause, servo);
        }
        let cause = trouble.map(|(cause, _)| cause);
        let denied = input.request.and_then(|request| self.obey(request, cause));
        self.go_on(trouble.is_some());
        self.advance(trouble.is_some());
        let pairs = || self.targets.iter().zip(&self.limits.axes).zip(&self.paths);
        let follows = matches!(self.state, State::Engaged);
        Output {
            state: self.state,
            cause: self.cause.0,
            servo: self.cause.1,
            torque: self.state.active(),
            denied,
            refused,
            jumped,
            outside: follows && pairs().any(|((target, axis), _)| within(*target, axis) != *target),
            slowed: follows
                && pairs().any(|((target, axis), path)| path.at != within(*target, axis)),
        }
    }

    /// Process the target; return whether a goal was rejected, and whether it jumped.
    fn listen(&mut self, input: &Input<'_>) -> (bool, bool) {
        if let Some(message) = &input.message {
            self.rearm &= message.deadman;
            self.deadman.0 = message.deadman;
            if message.deadman {
                self.deadman.1 = self.time.now;
            }
        }
        let new = input.message.and_then(|message| message.goal);
        let Some(goal) = new.or(input.again) else {
            return (false, false);
        };
        let sound = goal.len() == self.targets.len()
            && goal.iter().all(|tick| tick.abs() <= f64::from(FARTHEST));
        let follows = self.state == State::Engaged;
        let jump = goal
            .iter()
            .zip(&self.targets)
            .map(|(tick, before)| if follows { (tick - before).abs() } else { 0.0 })
            .fold(0.0, f64::max);
        let refused = !sound || jump > self.limits.jump.1;
        if new.is_some() {
            self.refused = refused;
        }
        if refused {
            return (true, false);
        }
        self.targets.copy_from_slice(goal);
        if new.is_some() {
            self.fresh = Some(self.time.now);
        }
        (false, jump > self.limits.jump.0)
    }

    /// The most severe present fault, and its servo.
    fn trouble(&self, emergency: bool) -> Option<(Cause, Option<u8>)> {
        let engaged = self.state.active().then_some(self.engaged);
        let servos = self.servos.iter().zip(&self.limits.axes).enumerate();
        let wrong = servos.filter_map(|(k, (servo, axis))| {
            let cause = servo.ill(axis, &self.limits, &self.time, engaged, self.homed)?;
            Some((cause, Some(k as u8)))
        });
        let graver = |a: (Cause, Option<u8>), b: (Cause, Option<u8>)| {
            if b.0.reaction() > a.0.reaction() {
                b
            } else {
                a
            }
        };
        let asked = emergency.then_some((Cause::Emergency, None));
        asked.into_iter().chain(wrong).reduce(graver)
    }

    fn enter(&mut self, state: State, cause: (Cause, Option<u8>)) {
        (self.state, self.cause, self.entered) = (state, cause, self.time.now);
    }

    fn react(&mut self, cause: Cause, servo: Option<u8>) {
        let because = (cause, servo);
        let idle = cause == Cause::Silent && !self.state.active() && self.state != State::Fault;
        self.forgot |= self.homed && !cause.keeps_home() && !idle;
        self.homed &= cause.keeps_home();
        match (self.state, cause.reaction()) {
            (State::Off | State::Fault, _) => {}
            (State::Engaged, Reaction::Hold) => self.enter(State::Hold, because),
            (State::Engaged | State::Hold, Reaction::Slacken) => {
                self.enter(State::SafeStop, because)
            }
            (State::Commissioning, Reaction::Slacken) => self.enter(State::Fault, because),
            (State::Connected | State::Homed | State::Ready, Reaction::Release)
                if cause == Cause::Silent =>
            {
                self.forget();
                self.enter(State::Off, because);
            }
            (_, Reaction::Release) => self.enter(State::Fault, because),
            _ => {}
        }
    }

    /// Apply the request, or return the reason for its denial.
    fn obey(&mut self, request: Request, trouble: Option<Cause>) -> Option<Denied> {
        let to = match (self.state, request) {
            (State::Off, Request::Connect) => State::Connected,
            (State::Connected, Request::Home) => State::Homed,
            (State::Homed, Request::Arm) => State::Ready,
            (State::Ready, Request::Engage) => State::Engaged,
            (State::Connected | State::Homed, Request::Commission) => State::Commissioning,
            (State::Engaged, Request::Hold) => State::Hold,
            (State::Engaged | State::Hold, Request::Stop) => State::SafeStop,
            (State::Commissioning, Request::Stop) => self.rest(),
            (State::Fault, Request::Acknowledge) => self.rest(),
            (State::Connected | State::Homed | State::Ready, Request::Disconnect) => State::Off,
            (state, _) => return Some(Denied::From(state)),
        };
        let checked = !matches!(request, Request::Hold | Request::Stop | Request::Disconnect);
        if let (true, Some(cause)) = (checked, trouble) {
            return Some(Denied::Trouble(cause));
        }
        let torque = matches!(request, Request::Connect | Request::Acknowledge);
        if torque && !self.without_torque() {
            return Some(Denied::Torque);
        }
        let window = matches!(request, Request::Home | Request::Arm | Request::Engage);
        if window && !self.inside() {
            return Some(Denied::Outside);
        }
        match request {
            Request::Engage if !self.driven() => return Some(Denied::Undriven),
            Request::Engage => self.start(),
            Request::Commission => self.start_jog(),
            Request::Disconnect => self.forget(),
            Request::Hold => self.rearm = true,
            Request::Connect | Request::Home => {
                self.homed = request == Request::Home;
                self.forgot &= !self.homed;
                self.servos.iter_mut().for_each(|servo| servo.lost = false);
            }
            _ => {}
        }
        self.enter(to, (Cause::Asked, None));
        None
    }

    fn forget(&mut self) {
        self.homed = false;
        self.servos.fill(Servo::default());
    }

    /// The state without torque, depending on whether home is known.
    fn rest(&self) -> State {
        if self.homed {
            State::Homed
        } else {
            State::Connected
        }
    }

    /// Timed transitions.
    fn go_on(&mut self, trouble: bool) {
        let driven = self.driven();
        match self.state {
            State::Engaged if !self.pressed() => self.enter(State::Hold, (Cause::Deadman, None)),
            State::Engaged if !driven => {
                self.rearm = self.refused;
                let cause = if self.refused {
                    Cause::Refused
                } else {
                    Cause::Stale
                };
                self.enter(State::Hold, (cause, None));
            }
            State::Hold if driven && !trouble && !self.rearm => {
                self.engaged = self.time.now;
                self.enter(State::Engaged, (Cause::None, None));
            }
            State::Hold if self.time.since(self.entered) > self.limits.hold => {
                self.enter(State::SafeStop, self.cause)
            }
            State::SafeStop
                if self.slack() || self.time.since(self.entered) > self.limits.slacken =>
            {
                let fault = self.cause.0.reaction() >= Reaction::Slacken;
                self.enter(if fault { State::Fault } else { State::Ready }, self.cause);
            }
            State::Commissioning
                if self
                    .time
                    .since(self.deadman.1)
                    .min(self.time.since(self.entered))
                    > self.limits.hold =>
            {
                self.enter(self.rest(), (Cause::Deadman, None));
            }
            _ => {}
        }
    }

    /// Advance the goals by one period.
    fn advance(&mut self, trouble: bool) {
        let grown = self.time.since(self.engaged) / self.limits.ramp.max(self.limits.period);
        let (state, moves) = (self.state, self.driven() && !trouble);
        for (k, path) in self.paths.iter_mut().enumerate() {
            let (axis, bounds, target) = (&self.limits.axes[k], &self.bounds[k], self.targets[k]);
            self.currents[k] = axis
                .current
                .map(|most| most * axis.share(self.servos[k].temperature));
            match state {
                State::Engaged => path.step(target, bounds.slew * grown.min(1.0), bounds),
                State::Hold => path.brake(bounds),
                State::SafeStop => path.step(axis.home.into(), 0.5 * bounds.slew, bounds),
                State::Commissioning => {
                    let jog = self.jogs[k];
                    if moves {
                        path.step(target, jog.slew, &jog)
                    } else {
                        path.brake(&jog)
                    }
                    self.currents[k] =
                        self.currents[k].map(|most| most.min(self.limits.jog_current));
                }
                _ => *path = Path::rest(self.servos[k].position.unwrap_or(path.at)),
            }
            self.goals[k] = path.goal();
        }
    }

    /// Switch torque on at the present positions.
    fn start(&mut self) {
        self.engaged = self.time.now;
        for (k, servo) in self.servos.iter_mut().enumerate() {
            self.paths[k] = Path::rest(servo.start(&self.time).unwrap_or(self.paths[k].at));
        }
    }

    /// The same for commissioning moves, which wait for their own targets. From outside the window,
    /// they only lead back.
    fn start_jog(&mut self) {
        self.start();
        self.fresh = None;
        for (k, path) in self.paths.iter().enumerate() {
            let (axis, travel) = (&self.limits.axes[k], self.limits.jog_travel);
            self.targets[k] = path.at;
            self.jogs[k] = Bounds {
                low: (path.at - travel).max(path.at.min(axis.low.into())),
                high: (path.at + travel).min(path.at.max(axis.high.into())),
                slew: (self.limits.jog_slew * self.limits.period).min(self.bounds[k].slew),
                ..self.bounds[k]
            };
        }
    }

    fn pressed(&self) -> bool {
        self.deadman.0 && self.time.since(self.deadman.1) <= self.limits.stale
    }

    /// The enable key is pressed and there is a target, both fresh.
    fn driven(&self) -> bool {
        let stale = |since| self.time.since(since) > self.limits.stale;
        self.pressed() && self.fresh.is_some_and(|since| !stale(since))
    }

    fn inside(&self) -> bool {
        let mut servos = self.servos.iter().zip(&self.limits.axes);
        servos.all(|(servo, axis)| servo.position.is_some_and(|at| within(at, axis) == at))
    }

    fn without_torque(&self) -> bool {
        self.servos
            .iter()
            .all(|servo| servo.health.is_some_and(|health| !health.torque))
    }

    /// Path and servo are home: a servo that lags or lacks current still pulls its tendon.
    fn slack(&self) -> bool {
        let mut servos = self.paths.iter().zip(&self.servos).zip(&self.limits.axes);
        servos.all(|((path, servo), axis)| {
            let home = f64::from(axis.home);
            let there = |at: f64| (at - home).abs() <= AT_HOME;
            *path == Path::rest(home) && servo.position.is_some_and(there)
        })
    }
}

/// The tick of the window nearest to `tick`.
fn within(tick: f64, axis: &Axis) -> f64 {
    tick.clamp(axis.low.into(), axis.high.into())
}
