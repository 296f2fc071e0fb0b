//! Two servos that do at once what the guard commands, for the tests of docs/reference/safety.md
//! (`*_tests.rs` in its folder).

use super::*;

pub const PERIOD: f64 = 0.01;
/// Health comes with every answer here, so that it counts at once.
pub const FINE: Health = Health {
    hardware: 0,
    torque: false,
    tripped: false,
};

pub fn limits() -> Limits {
    let axis = Axis {
        home: 100,
        low: -400,
        high: 600,
        slew: 1000.0,
        acceleration: 10_000.0,
        current: Some(600.0),
        fastest: 3000.0,
        following: 60.0,
        warm: 50.0,
        hot: 60.0,
        voltage: (4.0, 6.0),
    };
    let other = Axis {
        current: None,
        ..axis
    };
    let limits = Limits {
        period: PERIOD,
        axes: vec![axis, other],
        stale: 0.1,
        hold: 0.25,
        slacken: 1.5,
        late: 0.05,
        silent: 0.1,
        grace: 0.2,
        ramp: 0.1,
        jump: (50.0, 700.0),
        jog_travel: 40.0,
        jog_slew: 100.0,
        jog_current: 150.0,
        budget: Budget {
            band: 0.02,
            turns: 4.0,
            burst: 4.0,
        },
    };
    limits.checked().unwrap()
}

/// Two servos that follow commands at once, and the requests of a user.
#[derive(Clone)]
pub struct Robot {
    pub guard: Guard,
    pub now: u64,
    pub at: [i32; 2],
    pub said: Feedback,
    /// The answer of servo 2 instead: none, or its last one.
    pub wrong: fn(&mut Feedback),
    pub mute: bool,
    pub stuck: bool,
    pub torque: bool,
    pub deadman: Option<bool>,
    pub target: Option<[f64; 2]>,
    pub emergency: bool,
}

impl Robot {
    pub fn new() -> Robot {
        Robot {
            guard: Guard::new(limits()),
            now: 1,
            at: [100, 100],
            said: Feedback {
                position: 0,
                clock: 0,
                current: Some(200.0),
                voltage: 5.0,
                temperature: 30.0,
                health: Some(FINE),
            },
            wrong: |_| {},
            mute: false,
            stuck: false,
            torque: false,
            deadman: Some(true),
            target: Some([400.0, 300.0]),
            emergency: false,
        }
    }

    /// Engaged and at its targets, with `slacken` s to go home.
    pub fn hasty(slacken: f64) -> Robot {
        Robot::engaged(Limits {
            slacken,
            ..limits()
        })
    }

    /// Engaged and at its targets.
    pub fn engaged(limits: Limits) -> Robot {
        let mut robot = Robot::new();
        robot.guard = Guard::new(limits);
        robot.tick(None);
        for request in [
            Request::Connect,
            Request::Home,
            Request::Arm,
            Request::Engage,
        ] {
            assert_eq!(robot.ask(request).denied, None);
        }
        robot.run(100);
        robot
    }

    pub fn tick(&mut self, request: Option<Request>) -> Output {
        self.now += 10_000_000;
        self.said.clock += 10;
        let mut feedback = [None; 2];
        for (k, place) in feedback.iter_mut().enumerate() {
            if self.torque && !(self.stuck && k == 1) {
                self.at[k] = self.guard.goals()[k];
            }
            let mut said = Feedback {
                position: self.at[k],
                ..self.said
            };
            said.health = Some(Health {
                torque: self.torque,
                ..FINE
            });
            if k == 1 {
                (self.wrong)(&mut said);
            }
            *place = (k == 0 || !self.mute).then_some(said);
        }
        let output = self.guard.tick(&Input {
            now: self.now,
            feedback: &feedback,
            message: self.deadman.map(|deadman| Message {
                deadman,
                goal: self.target.as_ref().map(|target| &target[..]),
            }),
            again: None,
            request,
            emergency: self.emergency,
        });
        self.torque = output.torque;
        output
    }

    pub fn run(&mut self, ticks: usize) -> Output {
        (0..ticks).map(|_| self.tick(None)).last().unwrap()
    }

    pub fn ask(&mut self, request: Request) -> Output {
        self.tick(Some(request))
    }

    /// Periods until the state is another one, and the output then; at most 500.
    pub fn until_change(&mut self) -> (usize, Output) {
        let before = self.guard.state();
        for count in 1..=500 {
            let output = self.tick(None);
            if output.state != before {
                return (count, output);
            }
        }
        panic!("{before:?} for ever");
    }

    /// In `state`; engaged, it stands at its targets.
    pub fn within(state: State) -> Robot {
        let mut robot = Robot::new();
        robot.tick(None);
        let way: &[Request] = match state {
            State::Off => &[],
            State::Connected => &[Request::Connect],
            State::Homed | State::Fault => &[Request::Connect, Request::Home],
            State::Commissioning => &[Request::Connect, Request::Home, Request::Commission],
            State::Ready => &[Request::Connect, Request::Home, Request::Arm],
            _ => &[
                Request::Connect,
                Request::Home,
                Request::Arm,
                Request::Engage,
            ],
        };
        for request in way {
            assert_eq!(robot.ask(*request).denied, None, "{request:?}");
        }
        if robot.torque {
            robot.run(100);
        }
        match state {
            State::Hold => drop(robot.ask(Request::Hold)),
            State::SafeStop => drop(robot.ask(Request::Stop)),
            State::Fault => {
                robot.emergency = true;
                robot.tick(None);
                robot.emergency = false;
            }
            _ => {}
        }
        assert_eq!(robot.guard.state(), state);
        robot
    }

    /// Whether home is known: what an acknowledgement leads to.
    pub fn knows_home(&self) -> bool {
        let mut robot = self.clone();
        robot.wrong = |_| {};
        (robot.mute, robot.stuck, robot.emergency) = (false, false, false);
        robot.run(40);
        let output = robot.ask(Request::Acknowledge);
        assert_eq!(output.denied, None);
        output.state == State::Homed
    }
}

pub type Break = fn(&mut Robot);
