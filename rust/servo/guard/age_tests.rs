//! How old an answer may be by its servo's own clock: one that stands, falls behind, runs slow or
//! begins again.

use super::robot::*;
use super::*;

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
    // It falls behind by a period each; what is more than `late` old counts no more, and `late`
    // later it holds.
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
    // Up to `late` is data's age; beyond it they count as silence, even if they come at the full
    // rate.
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
    for (ticks, denied) in [(99, Some(Denied::Trouble(Cause::Silent))), (100, None)] {
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

#[test]
fn late_periods_that_are_made_up_for_age_nothing() {
    // The loop runs late by up to 0.7 of a period and makes up for it in the next; the servos'
    // clocks are right.
    let mut robot = Robot::within(State::Engaged);
    let (mut due, clock) = (robot.now, robot.said.clock);
    let start = due;
    for tick in 0..30_000_u64 {
        due += 10_000_000;
        robot.now = due + tick * 37 % 8 * 1_000_000 - 10_000_000;
        robot.said.clock = ((u64::from(clock) + (robot.now + 10_000_000 - start) / 1_000_000 - 10)
            % 0x8000) as u16;
        let output = robot.tick(None);
        assert_eq!(output.state, State::Engaged, "{tick} {:?}", output.cause);
    }
}

#[test]
fn an_answer_as_old_as_it_may_be_counts() {
    let mut robot = Robot::engaged(Limits {
        late: (1.0 - 0.005) * 0.05,
        ..limits()
    });
    let holds = (1..20).find(|_| {
        robot.said.clock -= 10;
        robot.tick(None).state == State::Hold
    });
    // Its clock stands: the fifth answer is just as old as `late` and the last one that counts.
    assert_eq!(holds, Some(5 + 5));
}
