//! The causes of docs/reference/safety.md, period by period: each in every state, when it counts,
//! and what is known then.

use super::robot::*;
use super::*;

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
                assert!(robot.guard.forgot_home(), "{said}");
                continue;
            }
            let (count, output) = robot.until_change();
            assert_eq!(output.state, expected, "{said}");
            assert_eq!((output.cause, output.servo), (cause, servo), "{said}");
            assert_eq!(count, periods, "{said}");
            assert_eq!(output.torque, expected == State::SafeStop, "{said}");
            let keeps = reaction != Reaction::Release || cause == Cause::Emergency;
            // Who falls silent without torque is unplugged or without power: nothing turned, and
            // the mark detects loss of power.
            let took = !keeps && known && (active || cause != Cause::Silent);
            assert_eq!(robot.guard.forgot_home(), took, "{said}");
            if expected == State::Fault {
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
        assert_eq!(robot.guard.forgot_home(), !keeps, "{cause:?}");
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
    // A position 60 ticks from its goal is not reported; one 61 ticks away is, after `grace`.
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
