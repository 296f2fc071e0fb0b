//! The requests of docs/reference/safety.md: where each leads, what it asks for, and what a user
//! who falls silent leads to.

use super::robot::*;
use super::*;

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
fn a_servo_that_was_disconnected_reports_its_torque_again() {
    let off: [Break; 2] = [
        |robot| assert_eq!(robot.ask(Request::Disconnect).state, State::Off),
        |robot| {
            robot.mute = true;
            while robot.tick(None).state != State::Off {}
            robot.mute = false;
        },
    ];
    for ends in off {
        let mut robot = Robot::within(State::Homed);
        ends(&mut robot);
        robot.wrong = |said| said.health = None;
        robot.run(5);
        assert_eq!(robot.ask(Request::Connect).denied, Some(Denied::Torque));
        robot.wrong = |_| {};
        robot.tick(None);
        assert_eq!(robot.ask(Request::Connect).denied, None);
    }
}

#[test]
fn only_homing_ends_that_home_was_forgotten() {
    let again = [Request::Acknowledge, Request::Disconnect, Request::Connect];
    for (requests, forgot) in [
        (&again[..], true),
        (&[Request::Acknowledge, Request::Home], false),
    ] {
        let mut robot = Robot::within(State::Homed);
        robot.wrong = |said| said.position += 300;
        while robot.tick(None).state != State::Fault {}
        assert!(robot.guard.forgot_home());
        for request in requests {
            robot.run(5);
            assert_eq!(robot.ask(*request).denied, None, "{request:?}");
        }
        assert_eq!(robot.guard.forgot_home(), forgot);
    }
}

#[test]
fn silence_of_the_user_holds_then_releases_tension_then_ends() {
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
fn after_a_requested_hold_or_refused_targets_the_key_is_released_first() {
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

#[test]
fn torque_stays_on_until_the_servos_are_home_too_but_no_longer_than_slacken() {
    let slackening = |away: fn(&mut Feedback)| {
        let mut far = limits();
        far.axes.iter_mut().for_each(|axis| axis.following = 200.0);
        let mut robot = Robot::engaged(far);
        robot.wrong = away;
        assert_eq!(robot.ask(Request::Stop).state, State::SafeStop);
        let (periods, output) = robot.until_change();
        assert_eq!(output.state, State::Ready);
        periods as f64 * PERIOD
    };
    let (there, near) = (slackening(|_| {}), slackening(|said| said.position += 60));
    let far = slackening(|said| said.position += 80);
    assert_eq!(there, near);
    assert!(
        there < 1.2 && (far - limits().slacken).abs() < 0.03,
        "{there} {far}"
    );
}
