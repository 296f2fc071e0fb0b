//! An independent checker of the guard's inputs and outputs, written from docs/reference/safety.md
//! and not from the guard.
//!
//! Times are counted in periods, which the guard never underestimates, so the check holds for any
//! clock.

use super::examined::Known;
use super::{Axis, Cause, Denied, Input, Limits, Output, Request, State};

/// Tolerance for round-off, ticks.
const ROUND: f64 = 1e-6;

/// The outputs of a period; tests may also alter them.
#[derive(Debug, Clone, PartialEq)]
pub struct Said {
    pub output: Output,
    pub goals: Vec<i32>,
    /// Before rounding.
    pub paths: Vec<f64>,
    pub currents: Vec<Option<f64>>,
}

pub struct Checker {
    limits: Limits,
    servos: Vec<Known>,
    before: Option<Said>,
    /// Steps of the last period.
    steps: Vec<f64>,
    began: Vec<f64>,
    /// Periods since the enable key was received pressed, and since a valid target.
    deadman: Option<u64>,
    target: Option<u64>,
    inside: u64,
    /// Start of that, by the clock.
    entered: f64,
    /// Time by the clock, s, and in periods, with the clock reading.
    time: (f64, u64),
    last: Option<u64>,
}

type Judged = Result<(), String>;

impl Checker {
    pub fn new(limits: Limits) -> Checker {
        let count = limits.axes.len();
        Checker {
            limits,
            servos: vec![Known::default(); count],
            before: None,
            steps: vec![0.0; count],
            began: vec![0.0; count],
            deadman: None,
            target: None,
            inside: 0,
            entered: 0.0,
            time: (0.0, 0),
            last: None,
        }
    }

    fn seconds(&self, periods: u64) -> f64 {
        periods as f64 * self.limits.period
    }

    /// Check one period; return its faults.
    pub fn judge(&mut self, input: &Input<'_>, said: &Said) -> Judged {
        let from = self
            .before
            .as_ref()
            .map_or(State::Off, |before| before.output.state);
        self.watch(input, from);
        let verdict = self
            .edges(from, input, said)
            .and_then(|()| self.reactions(input, said))
            .and_then(|()| self.motion(from, said));
        self.inside = if from == said.output.state {
            self.inside + 1
        } else {
            self.entered = self.time.0;
            0
        };
        self.before = Some(said.clone());
        let to = said.output.state;
        if to == State::Off && from != State::Off {
            // In OFF, only data received from then on are known.
            self.servos.fill(Known::default());
        }
        let times = [
            (State::Hold, self.limits.hold),
            (State::SafeStop, self.limits.slacken),
        ];
        for (state, most) in times {
            if to == state && self.seconds(self.inside) > most + 2.0 * self.limits.period {
                return Err(format!("{state:?} for {} s", self.seconds(self.inside)));
            }
        }
        verdict
    }

    fn watch(&mut self, input: &Input<'_>, from: State) {
        let older = |age: &mut Option<u64>| *age = age.map(|age| age + 1);
        older(&mut self.deadman);
        older(&mut self.target);
        if let Some(message) = &input.message {
            self.deadman = message.deadman.then_some(0);
            let sound = |goal: &&[f64]| {
                goal.len() == self.servos.len() && goal.iter().all(|tick| tick.abs() <= 1_048_575.0)
            };
            if message.goal.filter(sound).is_some() {
                self.target = Some(0);
            }
        }
        let (period, limits) = (self.limits.period, &self.limits);
        let passed = match self.last {
            Some(last) if input.now > last => (input.now - last) as f64 * 1e-9,
            _ => period,
        };
        self.last = Some(input.now);
        self.time = (self.time.0 + passed, self.time.1 + 1);
        let time = self.time;
        for (k, known) in self.servos.iter_mut().enumerate() {
            let sent = self.before.as_ref().map(|before| before.paths[k]);
            known.hear(input.feedback[k], time, limits, |position| {
                let away = sent.map_or(0.0, |path| (f64::from(position) - path).abs());
                away <= limits.axes[k].following || !from.active()
            });
        }
    }

    /// Transitions follow the table of docs/reference/safety.md, under its conditions.
    fn edges(&self, from: State, input: &Input<'_>, said: &Said) -> Judged {
        use State::*;
        let (to, asked) = (said.output.state, input.request);
        if from == to {
            return Ok(());
        }
        let by = |request| asked == Some(request) && said.output.denied.is_none();
        let allowed = match (from, to) {
            (Off, Connected) => by(Request::Connect),
            (Connected, Homed) => by(Request::Home),
            (Homed, Ready) => by(Request::Arm),
            (Ready, Engaged | Hold) => by(Request::Engage),
            (Connected | Homed, Commissioning) => by(Request::Commission),
            (Connected | Homed | Ready, Off) => {
                by(Request::Disconnect) || said.output.cause == Cause::Silent
            }
            (Connected | Homed | Ready, Fault) => true,
            (Engaged, Hold | SafeStop | Ready | Fault) => true,
            (Hold, Engaged | SafeStop | Ready | Fault) => true,
            (SafeStop, Ready | Fault) => true,
            (Commissioning, Homed | Connected | Fault) => true,
            (Fault, Homed | Connected) => by(Request::Acknowledge),
            _ => false,
        };
        if !allowed {
            return Err(format!(
                "{from:?} → {to:?} with {asked:?}, denied {:?}",
                said.output.denied
            ));
        }
        let home = |(known, axis): (&Known, &Axis)| {
            known
                .position
                .is_some_and(|at| (at - axis.home).abs() <= 64)
        };
        if (from, to) == (SafeStop, Ready)
            && self.seconds(self.inside).max(self.time.0 - self.entered) + 2.0 * self.limits.period
                < self.limits.slacken
            && !self.servos.iter().zip(&self.limits.axes).all(home)
        {
            return Err("torque went off away from home".into());
        }
        let fit = |known: &Known| {
            known.hardware == 0 && self.seconds(known.unheard) <= self.limits.late + ROUND
        };
        if matches!(to, Connected | Homed | Ready | Engaged | Commissioning)
            && asked.is_some()
            && said.output.denied.is_none()
            && to != from
            && !matches!(from, SafeStop | Commissioning | Engaged | Hold)
            && !self.servos.iter().all(fit)
        {
            return Err(format!("{from:?} → {to:?} with a servo that is ill"));
        }
        let window = |(known, axis): (&Known, &Axis)| {
            known
                .position
                .is_some_and(|at| (axis.low..=axis.high).contains(&at))
        };
        if matches!(
            (from, to),
            (Connected, Homed) | (Homed, Ready) | (Ready, Engaged)
        ) && !self.servos.iter().zip(&self.limits.axes).all(window)
        {
            return Err(format!("{from:?} → {to:?} outside the window"));
        }
        if matches!((from, to), (Off, Connected) | (Fault, _))
            && !self.servos.iter().all(|known| known.torque == Some(false))
        {
            return Err(format!("{from:?} → {to:?} with torque"));
        }
        Ok(())
    }

    /// Faults are handled in time.
    fn reactions(&self, input: &Input<'_>, said: &Said) -> Judged {
        let (state, limits) = (said.output.state, &self.limits);
        if said.output.torque != state.active() {
            return Err(format!("torque {} in {state:?}", said.output.torque));
        }
        if said.output.denied.is_some() && input.request.is_none()
            || matches!(said.output.denied, Some(Denied::From(of)) if of == State::Off && input.request == Some(Request::Connect))
        {
            return Err("denied what may be asked".into());
        }
        if !state.active() {
            return Ok(());
        }
        let slack = limits.period + ROUND;
        let late =
            |age: Option<u64>, most: f64| age.is_none_or(|age| self.seconds(age) > most + slack);
        if input.emergency {
            return Err("torque in an emergency".into());
        }
        if state == State::Engaged
            && (late(self.deadman, limits.stale) || late(self.target, limits.stale))
        {
            return Err(format!(
                "engaged with the deadman {:?}, the target {:?} periods old",
                self.deadman, self.target
            ));
        }
        for (k, (known, axis)) in self.servos.iter().zip(&limits.axes).enumerate() {
            if self.seconds(known.unheard) > limits.silent + slack || known.hardware != 0 {
                return Err(format!(
                    "torque with servo {k} {} periods unheard, errors {}",
                    known.unheard, known.hardware
                ));
            }
            if state == State::Engaged && self.seconds(known.unheard) > limits.late + slack {
                return Err(format!(
                    "engaged with servo {k} {} periods unheard",
                    known.unheard
                ));
            }
            if self.seconds(known.apart) > limits.grace + limits.silent + slack {
                return Err(format!("servo {k} is apart for {} periods", known.apart));
            }
            if matches!(state, State::Engaged | State::Hold)
                && known.temperature >= axis.hot
                && known.unheard == 0
            {
                return Err(format!("servo {k} is hot"));
            }
            let most = axis.current.map(|most| {
                if state == State::Commissioning {
                    most.min(limits.jog_current)
                } else {
                    most
                }
            });
            let most = if known.temperature >= axis.hot {
                most.map(|most| most.min(axis.current.unwrap_or(0.0) / 3.0 + ROUND))
            } else {
                most
            };
            if said.currents[k].is_some() != most.is_some()
                || said.currents[k]
                    .zip(most)
                    .is_some_and(|(a, b)| !(a <= b + ROUND && a > 0.0 || b == 0.0))
            {
                return Err(format!(
                    "servo {k} is given {:?} mA of {most:?}",
                    said.currents[k]
                ));
            }
        }
        Ok(())
    }

    /// No unsafe tick.
    fn motion(&mut self, from: State, said: &Said) -> Judged {
        let state = said.output.state;
        let commissioning = state == State::Commissioning;
        for (k, axis) in self.limits.axes.iter().enumerate() {
            let (path, goal) = (said.paths[k], f64::from(said.goals[k]));
            if !state.active() {
                self.steps[k] = 0.0;
                continue;
            }
            if (path - goal).abs() > 0.5 {
                return Err(format!("goal {goal} of {path}"));
            }
            let before = if from.active() {
                self.before.as_ref().map_or(path, |before| before.paths[k])
            } else {
                self.steps[k] = 0.0;
                let at = self.servos[k].position.map_or(path, f64::from);
                self.began[k] = at;
                at
            };
            let step = path - before;
            let period = self.limits.period;
            let (mut low, mut high) = (f64::from(axis.low), f64::from(axis.high));
            if commissioning {
                let (began, travel) = (self.began[k], self.limits.jog_travel);
                if began < low {
                    low = began;
                }
                if began > high {
                    high = began;
                }
                (low, high) = (low.max(began - travel), high.min(began + travel));
            }
            if !(low - ROUND..=high + ROUND).contains(&path)
                || !commissioning && !(low..=high).contains(&goal)
            {
                return Err(format!(
                    "servo {k} at {path}, the window is {low} to {high}"
                ));
            }
            let slew = if commissioning {
                self.limits.jog_slew.min(axis.slew)
            } else {
                axis.slew
            };
            if step.abs() > slew * period + ROUND {
                return Err(format!(
                    "servo {k} steps {step}, {} is allowed",
                    slew * period
                ));
            }
            let change = (step - self.steps[k]).abs();
            if change > axis.acceleration * period * period + ROUND {
                return Err(format!(
                    "servo {k} changes its step by {change}, {} is allowed",
                    axis.acceleration * period * period
                ));
            }
            if matches!(state, State::Hold)
                && from == State::Hold
                && step.abs() > self.steps[k].abs() + ROUND
            {
                return Err(format!("servo {k} speeds up in HOLD"));
            }
            self.steps[k] = step;
        }
        Ok(())
    }
}
