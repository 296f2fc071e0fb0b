//! The loop on emulated servos in virtual time: a day's work, every fault of a servo, a bad wire, a
//! replay bit for bit.

use super::virtual_rig::*;
use super::*;
use crate::emulator::{Emulator, Faults};
use crate::guard::{Cause, State};
use crate::registers::X_SERIES;

#[test]
fn a_day_s_work_from_off_to_slack() {
    let mut rig = engaged();
    let angles = rig.angles();
    assert!(
        (angles[0] - 2280.0).abs() < 2.0 && (angles[1] - 1720.0).abs() < 2.0,
        "{angles:?}"
    );
    let first = rig
        .record
        .0
        .iter()
        .find(|entry| entry.output.torque)
        .unwrap();
    assert_eq!(
        first.goals[..2],
        [2000, 2000],
        "torque comes on where the servos stand"
    );
    assert_eq!(rig.ask(Request::Stop).state, State::SafeStop);
    until(&mut rig, State::Ready, 2.0);
    rig.run(0.3);
    assert!(rig.emulator().servos.iter().all(|servo| !servo.torque()));
    let angles = rig.angles();
    assert!(
        angles.iter().all(|angle| (angle - 2000.0).abs() < 60.0),
        "{angles:?}"
    );
    assert_eq!(rig.timing().overruns, 0);
}

#[test]
fn a_silent_user_is_held_then_tension_is_released() {
    let mut rig = engaged();
    rig.mailbox.0 = Orders::default();
    let held = until(&mut rig, State::Hold, 1.0);
    assert!((0.09..=0.12).contains(&held), "{held}");
    rig.drive_to([1.0, -1.0]);
    assert_eq!(rig.step().state, State::Engaged);
    rig.mailbox.0 = Orders::default();
    until(&mut rig, State::SafeStop, 1.0);
    until(&mut rig, State::Ready, 2.0);
}

#[test]
fn each_fault_of_a_servo_ends_without_torque_in_its_time() {
    type Break = fn(&mut Emulator);
    let faults: [(&str, Break, Cause, f64); 8] = [
        (
            "mute",
            |e| e.servos[1].broken.mute = true,
            Cause::Silent,
            0.25,
        ),
        (
            "no power",
            |e| {
                e.set_faults(Faults {
                    unpowered: true,
                    ..e.faults()
                })
            },
            Cause::Silent,
            0.25,
        ),
        ("reset", |e| e.servos[1].boot(), Cause::Silent, 0.25),
        (
            "overload",
            |e| e.servos[1].fail(0x20),
            Cause::Hardware,
            0.05,
        ),
        ("voltage", |e| e.servos[1].supply(3.0), Cause::Voltage, 1.5),
        ("heat", |e| e.servos[1].heat(70.0), Cause::Hot, 1.5),
        (
            "lost turns",
            |e| {
                e.servos[1].boot();
                e.servos[1].wake();
            },
            Cause::Dropped,
            0.5,
        ),
        (
            "exchanged",
            |e| {
                e.servos[0].set_id(2);
                e.servos[1].set_id(1);
            },
            Cause::Lost,
            0.1,
        ),
    ];
    for (name, breaks, cause, within) in faults {
        let mut rig = engaged();
        breaks(rig.emulator());
        let took = until(&mut rig, State::Fault, within);
        assert_eq!(rig.guard.state(), State::Fault);
        let last = rig.record.0.last().unwrap().output;
        assert_eq!((last.cause, last.torque), (cause, false), "{name}");
        assert!(took <= within, "{name}: {took}");
        rig.emulator().set_faults(Faults::default());
        rig.run(0.5);
        assert!(
            rig.emulator()
                .servos
                .iter()
                .filter(|servo| servo.awake())
                .all(|servo| !servo.torque()),
            "{name}"
        );
        assert_ne!(rig.ask(Request::Engage).denied, None, "{name} is latched");
    }
}

/// The cap (mA) and the watchdog in the first servo.
fn kept(rig: &mut VirtualRig) -> (i32, u8) {
    let servo = &rig.emulator().servos[0];
    let cap = servo.read(X_SERIES.goal_current.address, 2).unwrap();
    let watchdog = servo.read(X_SERIES.bus_watchdog.address, 1).unwrap();
    (i16::from_le_bytes([cap[0], cap[1]]).into(), watchdog[0])
}

#[test]
fn a_cap_or_a_watchdog_that_is_lost_on_the_wire_is_written_again_or_torque_goes_off() {
    for (register, others) in [
        (X_SERIES.goal_current, (1750, 5)),
        (X_SERIES.bus_watchdog, (600, 0)),
    ] {
        for lost in [2, 1000] {
            let mut rig = rig();
            rig.run(0.3);
            for request in [Request::Connect, Request::Home, Request::Arm] {
                assert_eq!(rig.ask(request).denied, None, "{request:?}");
            }
            rig.drive_to([0.0, 0.0]);
            rig.emulator().lose(register.address, lost);
            assert_eq!(rig.ask(Request::Engage).state, State::Engaged);
            assert_eq!(kept(&mut rig), others, "{} is lost", register.name);
            if lost == 2 {
                rig.run(0.05);
                assert_eq!(kept(&mut rig), (600, 5), "{}", register.name);
                assert_eq!(rig.run(1.0).state, State::Engaged);
            } else {
                until(&mut rig, State::Fault, 0.1);
                assert_eq!(rig.record.0.last().unwrap().output.cause, Cause::Tripped);
            }
        }
    }
}

#[test]
fn an_encoder_that_stands_is_released_before_it_pulls_far() {
    let mut rig = engaged();
    rig.emulator().servos[0].broken.stuck = true;
    rig.drive_to([2.5, -1.0]);
    until(&mut rig, State::Fault, 1.0);
    assert_eq!(rig.record.0.last().unwrap().output.cause, Cause::Following);
    rig.run(0.5);
    assert!((rig.angles()[0] - 2000.0).abs() < 60.0);
}

/// Run periods in which the wire damages a share of the answers.
const DAMAGED: usize = 100_000;

#[test]
fn with_junk_and_damage_no_deadline_is_missed_and_data_stay_young() {
    let mut rig = engaged();
    rig.emulator().set_faults(Faults {
        junk: 0.2,
        damage: 0.05,
        ..Faults::default()
    });
    let (mut age, mut oldest, mut young) = ([0; 2], 0, 0);
    for tick in 0..DAMAGED {
        let mm = (tick as f64 * PERIOD * 2.0).sin();
        rig.drive_to([mm, -mm]);
        let state = rig.step().state;
        assert!(matches!(state, State::Engaged | State::Hold), "{state:?}");
        let entry = rig.record.0.pop().unwrap();
        for (age, said) in age.iter_mut().zip(&entry.feedback) {
            *age = if said.is_some() { 0 } else { *age + 1 };
            oldest = oldest.max(*age);
            young += usize::from(*age <= 3);
            let late = f64::from(*age) * PERIOD > limits().late + 1e-9;
            assert!(!late || state == State::Hold, "older than that it holds");
        }
        // A period ends before the next one begins.
        assert!((entry.late + entry.took) as f64 * 1e-9 < PERIOD);
    }
    assert!(young as f64 >= 0.999 * 2.0 * DAMAGED as f64, "{young}");
    assert_eq!(rig.timing().overruns, 0);
    let counts = rig.drive.bus().counts();
    assert!(counts.damaged > 4 * DAMAGED as u64 / 100, "{counts:?}");
    assert!((2..=10).contains(&oldest), "{oldest} periods");

    // The hard maximum: nothing is received any more.
    rig.emulator().set_faults(Faults {
        drop: 1.0,
        ..Faults::default()
    });
    let held = until(&mut rig, State::Hold, 1.0);
    assert!(held <= limits().late + 2.0 * PERIOD, "{held}");
    let cause = rig.record.0.last().unwrap().output.cause;
    assert_eq!(cause, Cause::Late);
    let ended = held + until(&mut rig, State::Fault, 1.0);
    assert!(ended <= limits().silent + 2.0 * PERIOD, "{ended}");
}

#[test]
fn reversals_are_counted_by_time_whatever_the_rate_of_commands() {
    let mut rig = engaged();
    let begun = rig.channels[0].turned;
    for tick in 0..2000 {
        // A hand that trembles by 0.4 mm at 5 Hz, received 33 times per second.
        if tick % 6 == 0 {
            rig.drive_to([
                1.0 + 0.2 * (f64::from(tick) * PERIOD * 5.0 * std::f64::consts::TAU).sin(),
                -1.0,
            ]);
        } else {
            rig.mailbox.0 = Orders::default();
        }
        rig.step();
    }
    // 10 s at 5 per second and 5 at once; the hand turns 100 times.
    let turned = rig.channels[0].turned - begun;
    assert!((45..=56).contains(&turned), "{turned}");
}

#[test]
fn missed_periods_are_counted_and_skipped() {
    let mut rig = engaged();
    let (ticks, before) = (rig.timing().ticks, rig.drive.bus().port().now());
    rig.drive.bus().port().pass(0.0512);
    rig.run(0.1);
    assert_eq!(rig.timing().overruns, 9);
    assert_eq!(rig.timing().ticks, ticks + 20);
    let passed = rig.drive.bus().port().now() - before;
    assert!((145_000_000..155_000_000).contains(&passed), "{passed}");
    assert!(Timing::quantile(&rig.timing().late, 0.5) <= 1.0);
    assert!(Timing::quantile(&rig.timing().late, 1.0) >= 1000.0);
}

#[test]
fn a_recording_replays_bit_for_bit() {
    let mut rig = engaged();
    rig.emulator().set_faults(Faults {
        damage: 0.1,
        ..Faults::default()
    });
    for tick in 0..2000 {
        let mm = (f64::from(tick) * PERIOD * 3.0).sin();
        rig.drive_to([2.0 * mm, f64::NAN * f64::from(tick % 400 == 0)]);
        rig.step();
    }
    let mut guard = Guard::new(limits());
    for entry in &rig.record.0 {
        let goal = entry.aimed.then_some(&entry.targets[..2]);
        let new = entry.orders.command.is_some();
        let output = guard.tick(&Input {
            now: entry.now,
            feedback: &entry.feedback[..2],
            message: entry.orders.heard.then_some(Message {
                deadman: entry.orders.deadman,
                goal: goal.filter(|_| new),
            }),
            again: goal.filter(|_| !new),
            request: entry.orders.request,
            emergency: entry.orders.emergency,
        });
        assert_eq!(output, entry.output);
        assert_eq!(guard.goals(), &entry.goals[..2]);
    }
}

#[test]
fn a_computer_that_stands_still_before_it_asks_ages_no_answer() {
    for ms in [20, 49, 52, 60, 80, 95] {
        let mut rig = engaged();
        for _ in 0..20 {
            rig.drive.bus().port().stall = ms * 1_000_000;
            rig.run(0.1);
            assert_eq!(rig.guard.state(), State::Engaged, "{ms} ms");
        }
    }
}
