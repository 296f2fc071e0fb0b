//! The tables of docs/safety.md, period by period: every cause in every state, when it counts, and what is known then.

use super::*;

const PERIOD: f64 = 0.01;
/// Health is told with every answer here, so that what it says counts at once.
const FINE: Health = Health {
    hardware: 0,
    torque: false,
    tripped: false,
};

fn limits() -> Limits {
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

/// Two servos that do at once what they are told, and what somebody asks of them.
#[derive(Clone)]
struct Robot {
    guard: Guard,
    now: u64,
    at: [i32; 2],
    said: Feedback,
    /// What servo 2 says otherwise; it says nothing, or what it said last.
    wrong: fn(&mut Feedback),
    mute: bool,
    stuck: bool,
    torque: bool,
    deadman: Option<bool>,
    target: Option<[f64; 2]>,
    emergency: bool,
}

impl Robot {
    fn new() -> Robot {
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
    fn hasty(slacken: f64) -> Robot {
        let mut robot = Robot::new();
        robot.guard = Guard::new(Limits {
            slacken,
            ..limits()
        });
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

    fn tick(&mut self, request: Option<Request>) -> Output {
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

    fn run(&mut self, ticks: usize) -> Output {
        (0..ticks).map(|_| self.tick(None)).last().unwrap()
    }

    fn ask(&mut self, request: Request) -> Output {
        self.tick(Some(request))
    }

    /// Periods until the state is another one, and what was said then; at most 500.
    fn until_change(&mut self) -> (usize, Output) {
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
    fn within(state: State) -> Robot {
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
    fn knows_home(&self) -> bool {
        let mut robot = self.clone();
        robot.wrong = |_| {};
        (robot.mute, robot.stuck, robot.emergency) = (false, false, false);
        robot.run(40);
        let output = robot.ask(Request::Acknowledge);
        assert_eq!(output.denied, None);
        output.state == State::Homed
    }
}

type Break = fn(&mut Robot);

/// Cause, how it comes about, periods until it counts, reaction.
const WRONG: [(Cause, Break, usize, Reaction); 12] = [
    (
        Cause::Emergency,
        |r| r.emergency = true,
        1,
        Reaction::Release,
    ),
    (
        Cause::Lost,
        |r| r.wrong = |said| said.position += 1000,
        1,
        Reaction::Release,
    ),
    (
        Cause::Hardware,
        |r| {
            r.wrong = |said| {
                said.health = Some(Health {
                    hardware: 4,
                    torque: true,
                    ..FINE
                })
            }
        },
        1,
        Reaction::Release,
    ),
    (Cause::Silent, |r| r.mute = true, 11, Reaction::Release),
    (
        Cause::Tripped,
        |r| {
            r.wrong = |said| {
                said.health = Some(Health {
                    tripped: true,
                    torque: true,
                    ..FINE
                })
            }
        },
        1,
        Reaction::Release,
    ),
    (
        Cause::Dropped,
        |r| r.wrong = |said| said.health = Some(FINE),
        1,
        Reaction::Release,
    ),
    (
        Cause::Overload,
        |r| {
            // The first servo is the one that has a cap: 1.25 times 600 mA.
            r.said.current = Some(-751.0)
        },
        21,
        Reaction::Slacken,
    ),
    (
        Cause::Voltage,
        |r| r.wrong = |said| said.voltage = 3.9,
        21,
        Reaction::Slacken,
    ),
    (
        Cause::Voltage,
        |r| r.wrong = |said| said.voltage = 6.1,
        21,
        Reaction::Slacken,
    ),
    (
        Cause::Voltage,
        |r| r.wrong = |said| said.voltage = f64::NAN,
        21,
        Reaction::Slacken,
    ),
    (
        Cause::Hot,
        |r| r.wrong = |said| said.temperature = 60.0,
        1,
        Reaction::Slacken,
    ),
    (
        Cause::Hot,
        |r| r.wrong = |said| said.temperature = f64::NAN,
        1,
        Reaction::Slacken,
    ),
];

#[test]
fn every_cause_in_every_state_at_its_period() {
    for (cause, breaks, periods, reaction) in WRONG {
        assert_eq!(cause.reaction(), reaction, "{cause:?}");
        let servo = match cause {
            Cause::Emergency => None,
            Cause::Overload => Some(0),
            _ => Some(1),
        };
        for state in State::ALL {
            let mut robot = Robot::within(state);
            breaks(&mut robot);
            let active = matches!(
                state,
                State::Engaged | State::Hold | State::SafeStop | State::Commissioning
            );
            let known = !matches!(state, State::Off | State::Connected);
            let under_torque = matches!(cause, Cause::Tripped | Cause::Dropped | Cause::Overload);
            let expected = match (reaction, state) {
                (_, State::Off | State::Fault) => state,
                _ if under_torque && !active => state,
                (Reaction::Release, _) if cause == Cause::Lost && !known => state,
                (Reaction::Release, _) if cause == Cause::Silent && !active => State::Off,
                (Reaction::Release, _) => State::Fault,
                (_, State::Engaged | State::Hold) => State::SafeStop,
                (_, State::Commissioning) => State::Fault,
                _ => state,
            };
            let said = format!("{cause:?} in {state:?}");
            if state == expected {
                let output = robot.run(if state == State::Hold { 10 } else { 25 });
                assert_eq!(output.state, state, "{said}");
                continue;
            }
            // Silence of 0.05 s comes first, and holds.
            if cause == Cause::Silent && state == State::Engaged {
                let (count, output) = robot.until_change();
                assert_eq!(
                    (count, output.state, output.cause),
                    (6, State::Hold, Cause::Late)
                );
                assert_eq!(robot.run(5).state, State::Fault);
                continue;
            }
            let (count, output) = robot.until_change();
            assert_eq!(output.state, expected, "{said}");
            assert_eq!((output.cause, output.servo), (cause, servo), "{said}");
            assert_eq!(count, periods, "{said}");
            assert_eq!(output.torque, expected == State::SafeStop, "{said}");
            if expected == State::Fault {
                let keeps = reaction != Reaction::Release || cause == Cause::Emergency;
                assert_eq!(robot.knows_home(), keeps && known, "{said}");
            }
        }
    }
}

#[test]
fn home_is_forgotten_in_fault_where_the_cause_says_so() {
    let robot = Robot::within(State::Fault);
    assert!(robot.knows_home(), "an emergency stop turns no servo");
    for (cause, breaks, periods, reaction) in WRONG {
        if matches!(cause, Cause::Tripped | Cause::Dropped | Cause::Overload) {
            continue;
        }
        let mut robot = Robot::within(State::Fault);
        breaks(&mut robot);
        robot.run(periods);
        let keeps = reaction != Reaction::Release || cause == Cause::Emergency;
        assert_eq!(robot.knows_home(), keeps, "{cause:?}");
        let denied = robot.ask(Request::Acknowledge).denied;
        assert!(denied.is_some() || cause == Cause::Lost, "{cause:?}");
    }
}

#[test]
fn what_is_just_within_its_limit_is_no_trouble() {
    let well: [Break; 6] = [
        |r| r.said.current = Some(750.0),
        |r| r.said.current = None,
        |r| r.wrong = |said| said.voltage = 4.0,
        |r| r.wrong = |said| said.voltage = 6.0,
        |r| r.wrong = |said| said.temperature = 59.9,
        // The second servo caps no current, so that nothing is too much for it.
        |r| r.wrong = |said| said.current = Some(9e9),
    ];
    for breaks in well {
        let mut robot = Robot::within(State::Engaged);
        breaks(&mut robot);
        assert_eq!(robot.run(60).state, State::Engaged);
    }
    for (leap, state) in [(94, State::Engaged), (95, State::Fault)] {
        let mut robot = Robot::within(State::Engaged);
        robot.wrong = if leap == 94 {
            |said| said.position += 94
        } else {
            |said| said.position += 95
        };
        assert_eq!(robot.tick(None).state, state, "30 ticks a period, and 64");
    }
    // Of a position 60 ticks from its goal nothing is said, of one 61 away after `grace`.
    for (away, state) in [(60, State::Engaged), (61, State::Fault)] {
        let mut robot = Robot::within(State::Engaged);
        robot.wrong = if away == 60 {
            |said| said.position -= 60
        } else {
            |said| said.position -= 61
        };
        assert_eq!(robot.run(20).state, State::Engaged);
        let output = robot.tick(None);
        assert_eq!(output.state, state);
        if state == State::Fault {
            assert_eq!((output.cause, output.servo), (Cause::Following, Some(1)));
        }
    }
}

#[test]
fn what_lasts_is_what_was_heard() {
    // Ninety ms of a low supply, then silence, then a supply that is well: it never lasted.
    let mut robot = Robot::within(State::Engaged);
    robot.wrong = |said| said.voltage = 1.0;
    robot.run(18);
    robot.mute = true;
    assert_eq!(robot.run(5).state, State::Engaged);
    robot.mute = false;
    robot.wrong = |_| {};
    assert_eq!(robot.run(30).state, State::Engaged);
}

#[test]
fn an_old_answer_is_none_once_its_clock_has_stood() {
    let mut robot = Robot::within(State::Engaged);
    let mut seen = vec![];
    for count in 1..20 {
        let before = robot.guard.state();
        robot.said.clock -= 10;
        let output = robot.tick(None);
        if output.state != before {
            seen.push((count, output.cause));
        }
    }
    // It falls behind by a period each; what is more than `late` old counts no more, and `late` later it holds.
    assert_eq!(seen, [(5 + 6, Cause::Late), (5 + 11, Cause::Silent)]);
    let mut robot = Robot::within(State::Homed);
    robot.guard = Guard::new(Limits {
        late: 0.5,
        silent: 0.5,
        ..limits()
    });
    robot.ask(Request::Connect);
    for count in 1..80 {
        robot.said.clock -= 10;
        let off = robot.tick(None).state == State::Off;
        // A clock that has stood for 0.1 s is none, however late answers may be.
        assert_eq!(off, count > 10 + 50, "{count}");
    }
}

#[test]
fn a_servo_without_torque_is_believed_half_a_second_after_it_was_switched_on() {
    let mut robot = Robot::within(State::Ready);
    robot.ask(Request::Engage);
    robot.wrong = |said| said.health = Some(FINE);
    let (count, output) = robot.until_change();
    assert_eq!((count, output.cause), (51, Cause::Dropped));
}

#[test]
fn the_gravest_wins_and_of_equals_the_first() {
    let mut robot = Robot::within(State::Engaged);
    robot.said.temperature = 70.0;
    robot.wrong = |said| {
        said.health = Some(Health {
            hardware: 1,
            torque: true,
            ..FINE
        })
    };
    let output = robot.tick(None);
    assert_eq!((output.cause, output.servo), (Cause::Hardware, Some(1)));
    let mut robot = Robot::within(State::Engaged);
    robot.said.temperature = 70.0;
    let output = robot.tick(None);
    assert_eq!((output.cause, output.servo), (Cause::Hot, Some(0)));
    let mut robot = Robot::within(State::Engaged);
    robot.emergency = true;
    robot.wrong = |said| {
        said.health = Some(Health {
            hardware: 1,
            torque: true,
            ..FINE
        })
    };
    assert_eq!(robot.tick(None).cause, Cause::Emergency);
}

#[test]
fn requests_lead_along_their_edges_alone() {
    for state in State::ALL {
        for request in Request::ALL {
            let to = match (state, request) {
                (State::Off, Request::Connect) => Some(State::Connected),
                (State::Connected, Request::Home) => Some(State::Homed),
                (State::Homed, Request::Arm) => Some(State::Ready),
                (State::Ready, Request::Engage) => Some(State::Engaged),
                (State::Connected | State::Homed, Request::Commission) => {
                    Some(State::Commissioning)
                }
                (State::Engaged, Request::Hold) => Some(State::Hold),
                (State::Engaged | State::Hold, Request::Stop) => Some(State::SafeStop),
                (State::Commissioning, Request::Stop) => Some(State::Homed),
                (State::Fault, Request::Acknowledge) => Some(State::Homed),
                (State::Connected | State::Homed | State::Ready, Request::Disconnect) => {
                    Some(State::Off)
                }
                _ => None,
            };
            let mut robot = Robot::within(state);
            let output = robot.ask(request);
            let denied = to.is_none().then_some(Denied::From(state));
            assert_eq!(output.denied, denied, "{request:?} in {state:?}");
            assert_eq!(
                output.state,
                to.unwrap_or(state),
                "{request:?} in {state:?}"
            );
        }
    }
    let mut robot = Robot::within(State::Connected);
    robot.ask(Request::Commission);
    assert_eq!(
        robot.ask(Request::Stop).state,
        State::Connected,
        "home is not known"
    );
}

#[test]
fn conditions_of_requests() {
    for (state, request, breaks, denied) in [
        (
            State::Off,
            Request::Connect,
            (|r| r.torque = true) as Break,
            Denied::Torque,
        ),
        (
            State::Off,
            Request::Connect,
            |r| r.wrong = |said| said.temperature = 70.0,
            Denied::Trouble(Cause::Hot),
        ),
        (
            State::Connected,
            Request::Home,
            |r| r.at = [601, 100],
            Denied::Outside,
        ),
        (
            State::Connected,
            Request::Home,
            |r| r.at = [100, -401],
            Denied::Outside,
        ),
        (
            State::Ready,
            Request::Engage,
            |r| r.deadman = Some(false),
            Denied::Undriven,
        ),
        (
            State::Fault,
            Request::Acknowledge,
            |r| r.torque = true,
            Denied::Torque,
        ),
    ] {
        let mut robot = Robot::within(state);
        let leap = robot.at;
        breaks(&mut robot);
        if robot.at != leap {
            // As slowly as a servo moves by itself.
            let to = robot.at;
            robot.at = leap;
            for _ in 0..100 {
                for (at, to) in robot.at.iter_mut().zip(to) {
                    *at += (to - *at).clamp(-20, 20);
                }
                robot.tick(None);
            }
        }
        let output = robot.ask(request);
        assert_eq!(
            (output.denied, output.state),
            (Some(denied), state),
            "{request:?}"
        );
    }
    // Without a target, and with none that is fresh.
    let mut robot = Robot::new();
    robot.target = None;
    robot.tick(None);
    for request in [Request::Connect, Request::Home, Request::Arm] {
        assert_eq!(robot.ask(request).denied, None);
    }
    assert_eq!(robot.ask(Request::Engage).denied, Some(Denied::Undriven));
    robot.target = Some([100.0, 100.0]);
    robot.tick(None);
    robot.target = None;
    robot.run(10);
    assert_eq!(
        robot.clone().ask(Request::Engage).denied,
        Some(Denied::Undriven)
    );
    robot.target = Some([100.0, 100.0]);
    assert_eq!(robot.ask(Request::Engage).denied, None);
}

#[test]
fn silence_of_the_user_holds_then_slackens_then_ends() {
    for (deadman, cause, count) in [
        (Some(false), Cause::Deadman, 1),
        (None, Cause::Deadman, 11),
        (Some(true), Cause::Stale, 11),
    ] {
        let mut robot = Robot::within(State::Engaged);
        (robot.deadman, robot.target) = (deadman, None);
        let (took, output) = robot.until_change();
        assert_eq!((output.state, output.cause), (State::Hold, cause));
        assert_eq!(took, count, "{cause:?}");
        let mut again = robot.clone();
        (again.deadman, again.target) = (Some(true), Some([400.0, 300.0]));
        let output = again.tick(None);
        assert_eq!((output.state, output.cause), (State::Engaged, Cause::None));
        let (took, output) = robot.until_change();
        assert_eq!(
            (took, output.state, output.cause),
            (26, State::SafeStop, cause)
        );
        let (took, output) = robot.until_change();
        assert_eq!(output.state, State::Ready);
        assert!(
            (60..80).contains(&took),
            "300 ticks at half the slew: {took}"
        );
        assert_eq!(robot.at, [100, 100]);
    }
}

#[test]
fn slackening_ends_in_its_time_wherever_it_is() {
    let mut robot = Robot::within(State::Engaged);
    robot.target = Some([600.0, -400.0]);
    robot.run(150);
    robot.ask(Request::Stop);
    let (took, output) = robot.until_change();
    assert!(
        (100..150).contains(&took),
        "500 ticks at half the slew: {took}"
    );
    assert_eq!(output.state, State::Ready);
    let mut robot = Robot::hasty(0.5);
    robot.ask(Request::Stop);
    let (took, output) = robot.until_change();
    assert_eq!((took, output.state), (51, State::Ready));
    assert!(robot.guard.goals()[0] > 120);
}

#[test]
fn after_a_hold_that_was_asked_for_or_refused_targets_the_deadman_is_let_go_first() {
    let mut robot = Robot::within(State::Hold);
    assert_eq!(robot.run(20).state, State::Hold, "still pressed");
    robot.deadman = Some(false);
    robot.tick(None);
    robot.deadman = Some(true);
    assert_eq!(robot.tick(None).state, State::Engaged);

    for bad in [[f64::NAN, 0.0], [0.0, 2e6], [400.0, -400.1]] {
        let mut robot = Robot::within(State::Engaged);
        robot.target = Some(bad);
        let (took, output) = robot.until_change();
        assert_eq!(
            (took, output.state, output.cause),
            (11, State::Hold, Cause::Refused)
        );
        assert!(output.refused);
        robot.target = Some([400.0, 300.0]);
        assert_eq!(robot.run(15).state, State::Hold);
        robot.deadman = Some(false);
        robot.tick(None);
        robot.deadman = Some(true);
        assert_eq!(robot.tick(None).state, State::Engaged);
    }
}

#[test]
fn targets_pass_are_told_or_are_refused() {
    for (target, refused, jumped, outside) in [
        ([450.0, 300.0], false, false, false),
        ([450.1, 300.0], false, true, false),
        ([400.0, 600.1], false, true, true),
        ([400.0, 600.0], false, true, false),
        ([400.0, -400.0], false, true, false),
        ([400.0, -400.1], true, false, false),
        ([f64::INFINITY, 300.0], true, false, false),
    ] {
        let mut robot = Robot::within(State::Engaged);
        robot.target = Some(target);
        let output = robot.tick(None);
        assert_eq!(
            (output.refused, output.jumped, output.outside),
            (refused, jumped, outside),
            "{target:?}"
        );
        let moves = !refused && target != [400.0, 300.0];
        assert_eq!(output.slowed, moves, "{target:?}");
        if !refused {
            let output = robot.run(120);
            assert!(!output.slowed && !output.jumped && output.state == State::Engaged);
            let there = target.map(|tick: f64| tick.clamp(-400.0, 600.0).round() as i32);
            assert_eq!(robot.guard.goals(), there, "{target:?}");
        }
    }
    // Before it is engaged nothing is a jump.
    let mut robot = Robot::within(State::Ready);
    robot.target = Some([-1_048_575.0, 1_048_575.0]);
    let output = robot.tick(None);
    assert!(!output.refused && !output.jumped && !output.outside && !output.slowed);
    robot.target = Some([-1_048_575.5, 0.0]);
    assert!(robot.tick(None).refused);
}

#[test]
fn aiming_anew_is_no_news() {
    let mut robot = Robot::within(State::Engaged);
    let aim = |robot: &mut Robot, again: &[f64]| {
        robot.now += 10_000_000;
        robot.said.clock += 10;
        robot.at = [robot.guard.goals()[0], robot.guard.goals()[1]];
        let feedback = robot.at.map(|position| {
            let health = Some(Health {
                torque: true,
                ..FINE
            });
            Some(Feedback {
                position,
                health,
                ..robot.said
            })
        });
        robot.guard.tick(&Input {
            now: robot.now,
            feedback: &feedback,
            message: Some(Message {
                deadman: true,
                goal: None,
            }),
            again: Some(again),
            request: None,
            emergency: false,
        })
    };
    for _ in 0..10 {
        assert_eq!(aim(&mut robot, &[410.0, 300.0]).state, State::Engaged);
    }
    assert!(robot.guard.goals()[0] > 400, "it is followed");
    assert!(aim(&mut robot, &[410.0]).refused, "one number a servo");
    let mut bad = Robot::within(State::Engaged);
    for _ in 0..10 {
        assert!(aim(&mut bad, &[f64::NAN, 0.0]).refused);
    }
    let output = aim(&mut bad, &[f64::NAN, 0.0]);
    assert_eq!(
        (output.state, output.cause),
        (State::Hold, Cause::Stale),
        "keeps nothing going"
    );
}

#[test]
fn commissioning_moves_little_slowly_and_only_while_the_deadman_is_pressed() {
    let mut robot = Robot::within(State::Homed);
    robot.target = Some([400.0, 300.0]);
    robot.tick(None);
    robot.target = None;
    robot.ask(Request::Commission);
    robot.run(5);
    assert_eq!(
        robot.guard.goals(),
        [100, 100],
        "an older target does not count"
    );
    assert_eq!(robot.guard.currents(), [Some(150.0), None]);
    robot.target = Some([400.0, 90.0]);
    let mut fastest = 0.0f64;
    for _ in 0..60 {
        robot.tick(None);
        fastest = fastest.max(robot.guard.paths()[0].speed);
    }
    assert_eq!(fastest, 1.0, "ticks a period");
    assert_eq!(robot.guard.goals(), [140, 90]);
    robot.target = Some([0.0, 90.0]);
    robot.run(5);
    robot.deadman = Some(false);
    robot.run(5);
    let stood = robot.guard.goals()[0];
    let (took, output) = robot.until_change();
    assert_eq!(
        (took, output.state, output.cause),
        (21, State::Homed, Cause::Deadman)
    );
    assert!((60..140).contains(&stood));
}

#[test]
fn a_deadman_let_go_ends_commissioning_after_hold() {
    let mut robot = Robot::within(State::Commissioning);
    robot.deadman = None;
    let (took, output) = robot.until_change();
    assert_eq!((took, output.state), (26, State::Homed));
    let mut robot = Robot::within(State::Commissioning);
    robot.target = Some([160.0, 100.0]);
    robot.run(3);
    robot.mute = true;
    robot.run(7);
    let braked = robot.guard.paths()[0];
    robot.run(2);
    assert_eq!(
        (robot.guard.paths()[0], braked.speed),
        (braked, 0.0),
        "late: it stands"
    );
    assert_eq!(robot.guard.state(), State::Commissioning);
}

#[test]
fn speed_grows_after_engaging_and_current_falls_with_heat() {
    let mut robot = Robot::within(State::Ready);
    robot.target = Some([600.0, 100.0]);
    robot.ask(Request::Engage);
    let mut speeds = vec![robot.guard.paths()[0].speed];
    for _ in 0..12 {
        robot.tick(None);
        speeds.push(robot.guard.paths()[0].speed);
    }
    for (k, speed) in speeds.iter().enumerate() {
        let most = (k as f64).min(10.0);
        assert!((speed - most).abs() < 1e-9, "period {k}: {speed} of {most}");
    }
    assert_eq!(robot.guard.currents(), [Some(600.0), None]);
    robot.said.temperature = 55.0;
    robot.tick(None);
    let [Some(current), None] = robot.guard.currents() else {
        panic!("{:?}", robot.guard.currents())
    };
    assert!((current - 400.0).abs() < 1e-9, "{current}");
    // Braking: one tick a period² and period.
    robot.ask(Request::Hold);
    assert_eq!(robot.guard.paths()[0].speed, 9.0);
    let mut robot = Robot::within(State::Engaged);
    robot.ask(Request::Stop);
    let fastest = (0..50)
        .map(|_| {
            robot.tick(None);
            robot.guard.paths()[0].speed.abs()
        })
        .fold(0.0, f64::max);
    assert_eq!(fastest, 5.0, "half the slew");
}

#[test]
fn without_torque_the_goal_is_where_the_servo_stands() {
    let mut robot = Robot::within(State::Ready);
    robot.at = [110, 95];
    robot.tick(None);
    assert_eq!(robot.guard.goals(), [110, 95]);
    robot.target = Some([110.0, 95.0]);
    robot.ask(Request::Engage);
    assert_eq!(robot.guard.goals(), [110, 95], "nothing jumps");
    assert_eq!(robot.guard.limits(), &limits());
}

#[test]
fn each_state_says_whether_it_has_torque() {
    for state in State::ALL {
        let mut robot = Robot::within(state);
        let torque = robot.tick(None).torque;
        let expected = !matches!(
            state,
            State::Off | State::Connected | State::Homed | State::Ready | State::Fault
        );
        assert_eq!((torque, state.active()), (expected, expected), "{state:?}");
    }
}

/// Answers that come `late` periods late from now on: the clock of then.
fn delayed(robot: &mut Robot, late: u16, ticks: usize) -> Vec<(usize, State, Cause)> {
    let mut seen = vec![];
    robot.said.clock -= 10 * late;
    for count in 1..=ticks {
        let before = robot.guard.state();
        let output = robot.tick(None);
        if output.state != before {
            seen.push((count, output.state, output.cause));
        }
    }
    seen
}

#[test]
fn answers_that_fall_behind_are_no_answers() {
    // Up to `late` is data's age; beyond it they count as silence, whoever brings them at the full rate.
    for (late, holds) in [(1, false), (5, false), (6, true), (20, true)] {
        let mut robot = Robot::within(State::Engaged);
        robot.said.clock = 12_000;
        robot.run(2);
        let seen = delayed(&mut robot, late, 40);
        let expected = [
            (6, State::Hold, Cause::Late),
            (11, State::Fault, Cause::Silent),
        ];
        let expected = if holds { &expected[..] } else { &[] };
        assert_eq!(seen, expected, "{late} periods");
    }
    let mut robot = Robot::within(State::Engaged);
    for _ in 0..10_000 {
        assert_eq!(
            robot.tick(None).state,
            State::Engaged,
            "its clock begins anew"
        );
        robot.said.clock %= 0x8000;
    }
    let mut robot = Robot::within(State::Connected);
    robot.mute = true;
    robot.run(5);
    robot.mute = false;
    robot.said.clock += 500;
    assert_eq!(robot.run(20).state, State::Connected, "ahead is not behind");
    // After a second without an answer of use nothing is known of its clock.
    for (ticks, denied) in [(99, Some(Denied::Trouble(Cause::Silent))), (102, None)] {
        let mut robot = Robot::within(State::Fault);
        robot.said.clock = 12_000;
        robot.run(2);
        delayed(&mut robot, 30, ticks);
        assert_eq!(robot.ask(Request::Acknowledge).denied, denied, "{ticks}");
    }
}

#[test]
fn a_clock_may_be_slow_by_its_drift_and_no_more() {
    for (every, holds) in [(25, false), (16, true)] {
        let mut robot = Robot::within(State::Engaged);
        let mut held = false;
        for tick in 1..6000 {
            // Ten ms a period, and one less every so many: 0.4 % slow, and 0.6 %.
            robot.said.clock -= u16::from(tick % every == 0);
            held |= robot.tick(None).state != State::Engaged;
            robot.said.clock %= 0x8000;
        }
        assert_eq!(held, holds, "{every}");
    }
}
