//! The writes of a drive to a servo without a current cap.

use super::*;
use crate::emulated_rig;
use crate::emulator::servo::{Motion, Servo};
use crate::emulator::virtual_port::Virtual;
use crate::registers::{X_SERIES, model};

/// One servo of that model number, with id 1, without a finger.
fn alone(number: u16) -> Drive<Virtual> {
    let mut bus = Bus::new(
        Virtual {
            emulator: emulated_rig::emulator(),
            now: 1,
            stall: 0,
        },
        emulated_rig::BAUD,
        1_000_000,
    );
    let kind = model(number).unwrap();
    let servo = Servo::new(
        kind,
        1,
        3,
        2000.0,
        Motion {
            delay: 0.01,
            lag: 0.03,
            load: vec![],
        },
    );
    bus.port().emulator.servos = vec![servo];
    let member = Member { id: 1, model: kind };
    Drive::new(bus, &[member], true, 100.0)
}

#[test]
fn a_servo_that_caps_no_current_gets_its_share_of_pwm_and_loses_no_cap() {
    let mut drive = alone(1060);
    let pwm = |drive: &mut Drive<Virtual>| {
        let bytes = drive.bus().port().emulator.servos[0].read(100, 2).unwrap();
        i16::from_le_bytes([bytes[0], bytes[1]])
    };
    assert_eq!(pwm(&mut drive), 885);
    drive.command(true, &[2000], &[Some(140.0)]).unwrap();
    assert_eq!(pwm(&mut drive), 88, "a tenth of the stall current");
    drive.command(true, &[2000], &[Some(9000.0)]).unwrap();
    assert_eq!(pwm(&mut drive), 885);
    drive
        .bus()
        .port()
        .emulator
        .lose(X_SERIES.goal_pwm.address, 1);
    drive.command(true, &[2000], &[Some(280.0)]).unwrap();
    drive.examine().unwrap();
    assert!(drive.alert());
    drive.command(true, &[2000], &[Some(280.0)]).unwrap();
    assert_eq!(pwm(&mut drive), 177);
}

#[test]
fn a_watchdog_that_tripped_under_a_dead_loop_is_reported_while_it_holds_and_then_cleared() {
    let mut drive = alone(1200);
    let tripped = |drive: &mut Drive<Virtual>| {
        drive.examine().unwrap();
        let told = drive.sense().unwrap()[0].unwrap().health.unwrap().tripped;
        (told, drive.bus().port().emulator.servos[0].tripped())
    };
    drive.command(true, &[2000], &[Some(100.0)]).unwrap();
    drive.bus().port().pass(0.3);
    assert_eq!(tripped(&mut drive), (true, true));
    let off = X_SERIES.torque_enable.address;
    let servo = &mut drive.bus().port().emulator.servos[0];
    servo.write(off, &[0]).unwrap();
    assert_eq!(tripped(&mut drive), (false, true), "it has no torque");
    drive.command(false, &[2000], &[Some(100.0)]).unwrap();
    assert_eq!(tripped(&mut drive), (false, false));
}

#[test]
fn a_silent_servo_takes_the_others_answers_with_it_once_only() {
    let mut drive = alone(1200);
    let mut other = drive.bus().port().emulator.servos[0].clone();
    other.write(X_SERIES.id.address, &[2]).unwrap();
    drive.bus().port().emulator.servos.push(other);
    let members = [1, 2].map(|id| Member {
        id,
        model: model(1200).unwrap(),
    });
    let mut drive = Drive::new(drive.bus, &members, true, 100.0);
    let heard = |drive: &mut Drive<Virtual>| {
        drive.examine().unwrap();
        let said = drive.sense().unwrap();
        [said[0].is_some(), said[1].is_some()]
    };
    let mute = |drive: &mut Drive<Virtual>, is: bool| {
        drive.bus().port().emulator.servos[0].broken.mute = is;
    };
    assert_eq!(heard(&mut drive), [true, true]);
    mute(&mut drive, true);
    assert!(drive.sense().unwrap().iter().all(Option::is_none));
    for _ in 0..3 {
        assert_eq!(heard(&mut drive), [false, true]);
    }
    drive.command(false, &[2000; 2], &[None; 2]).unwrap();
    drive.ask_again();
    drive.examine().unwrap();
    assert_eq!(drive.unreleased(), [1], "the other has said it");
    mute(&mut drive, false);
    assert_eq!(heard(&mut drive), [true, true]);
}
