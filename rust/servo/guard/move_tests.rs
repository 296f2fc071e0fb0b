//! Outcomes of targets: passed, reported or refused, and how goals move engaged, slackening and
//! commissioning.

use super::robot::*;
use super::*;

#[test]
fn targets_pass_are_reported_or_are_refused() {
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
fn aiming_again_is_no_news() {
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
fn commissioning_moves_little_slowly_and_only_while_the_key_is_pressed() {
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
    robot.run(15);
    assert_eq!(robot.guard.goals()[0], stood, "nobody presses it");
    let (took, output) = robot.until_change();
    assert_eq!(
        (took, output.state, output.cause),
        (6, State::Homed, Cause::Deadman)
    );
    assert!((60..140).contains(&stood));
}

#[test]
fn a_jog_stands_while_something_is_wrong() {
    let mut robot = Robot::within(State::Homed);
    robot.ask(Request::Commission);
    robot.target = Some([400.0, 90.0]);
    robot.run(5);
    // Servo 2 is not heard: it is late before it is silent.
    robot.mute = true;
    robot.run(7);
    let stood = robot.guard.goals()[0];
    assert_eq!(
        (robot.run(3).state, robot.guard.goals()[0]),
        (State::Commissioning, stood)
    );
    robot.mute = false;
    robot.run(5);
    assert!(robot.guard.goals()[0] > stood);
}

#[test]
fn commissioning_keeps_to_the_window_and_from_outside_leads_back_only() {
    // The window is −400 to 600, a jog travels 40.
    for (at, reached) in [
        (100, [60, 140]),
        (-390, [-400, -350]),
        (590, [550, 600]),
        (-420, [-420, -380]),
        (630, [590, 630]),
    ] {
        for (target, end) in [-1e4, 1e4].into_iter().zip(reached) {
            let mut robot = Robot::new();
            robot.at = [at, 100];
            robot.tick(None);
            for request in [Request::Connect, Request::Commission] {
                assert_eq!(robot.ask(request).denied, None);
            }
            robot.target = Some([target, 100.0]);
            robot.run(60);
            assert_eq!(robot.guard.goals(), [end, 100], "from {at} to {target}");
        }
    }
}

#[test]
fn a_released_key_ends_commissioning_after_hold() {
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
