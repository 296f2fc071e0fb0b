//! The emulated servos through our own bus: motion, caps, watchdog, resets, every model, what is
//! broken on purpose.

use super::servo::{Motion, RESET};
use super::virtual_port::*;
use super::*;
use crate::bus::{Bus, Fault, Port, SLACK};
use crate::registers::{ALERT, MODELS, X_SERIES, mode, model};

#[test]
fn goes_where_it_is_sent_with_delay_and_lag() {
    let mut bus = engaged(&[1, 2]);
    goals(&mut bus, &[1, 2], &[2300, 1700]);
    bus.port().pass(0.006);
    assert_eq!((position(&mut bus, 1), position(&mut bus, 2)), (2000, 2000));
    bus.port().pass(0.03);
    let part = f64::from(position(&mut bus, 1) - 2000) / 300.0;
    assert!((0.5..0.8).contains(&part), "{part} after one time constant");
    bus.port().pass(0.5);
    assert_eq!((position(&mut bus, 1), position(&mut bus, 2)), (2300, 1700));
    let mut current = [0; 2];
    assert_eq!(
        bus.read(1, X_SERIES.present_current.address, &mut current),
        FINE
    );
    let drawn = i16::from_le_bytes(current);
    assert!(
        (119..=120).contains(&drawn),
        "{drawn} mA where the table says 120"
    );
}

#[test]
fn current_caps_the_pull_and_torque_off_lets_go() {
    let mut bus = engaged(&[1]);
    assert_eq!(
        bus.write(1, X_SERIES.goal_current.address, &200i16.to_le_bytes()),
        FINE
    );
    goals(&mut bus, &[1], &[2900]);
    bus.port().pass(2.0);
    let held = position(&mut bus, 1);
    assert!(
        (2480..=2500).contains(&held),
        "stands at {held}, where 200 mA carry no more"
    );
    assert_eq!(bus.write(1, X_SERIES.torque_enable.address, &[0]), FINE);
    bus.port().pass(1.0);
    let free = position(&mut bus, 1);
    assert!((free - 2000).abs() < 60, "slack at {free}");
}

#[test]
fn the_watchdog_stops_and_holds() {
    let mut bus = engaged(&[1]);
    assert_eq!(bus.write(1, X_SERIES.bus_watchdog.address, &[5]), FINE);
    goals(&mut bus, &[1], &[2600]);
    bus.port().pass(0.3);
    assert!(bus.port().emulator.servos[0].tripped());
    let stood = position(&mut bus, 1);
    assert!(bus.port().emulator.servos[0].torque());
    goals(&mut bus, &[1], &[2000]);
    bus.port().pass(0.5);
    assert_eq!(position(&mut bus, 1), stood, "goals are read only now");
    assert_eq!(
        bus.write(1, X_SERIES.goal_position.address, &2000i32.to_le_bytes()),
        Err(Fault::Refused(4))
    );
    assert_eq!(bus.write(1, X_SERIES.bus_watchdog.address, &[0]), FINE);
    goals(&mut bus, &[1], &[2000]);
    bus.port().pass(0.5);
    assert_eq!(position(&mut bus, 1), 2000);
}

#[test]
fn turns_are_lost_by_a_reset_and_by_power() {
    let mut bus = engaged(&[1]);
    bus.port().emulator.servos[0] = Servo::new(
        model(1200).unwrap(),
        1,
        3,
        2000.0,
        Motion {
            load: vec![],
            ..motion()
        },
    );
    assert_eq!(
        bus.write(
            1,
            X_SERIES.operating_mode.address,
            &[mode::EXTENDED_POSITION]
        ),
        FINE
    );
    assert_eq!(bus.write(1, X_SERIES.torque_enable.address, &[1]), FINE);
    goals(&mut bus, &[1], &[9000]);
    bus.port().pass(3.0);
    assert_eq!(position(&mut bus, 1), 9000);
    bus.port().emulator.set_faults(Faults {
        unpowered: true,
        ..Faults::default()
    });
    bus.port().pass(0.1);
    assert_eq!(bus.ping(1), Err(Fault::Silent));
    bus.port().emulator.set_faults(Faults::default());
    bus.port().pass(RESET + 0.1);
    assert_eq!(position(&mut bus, 1), 9000 - 2 * 4096);
    assert!(!bus.port().emulator.servos[0].torque());
}

#[test]
fn every_model_is_heard_at_the_rate_it_has() {
    for (k, model) in MODELS.iter().enumerate() {
        let emulator = Emulator::new(
            vec![Servo::new(model, 7, 1, 0.0, motion())],
            57_600,
            k as u64,
        );
        let mut bus = Bus::new(
            Virtual {
                emulator,
                now: 0,
                stall: 0,
            },
            57_600,
            SLACK,
        );
        assert_eq!(bus.ping(7), Ok((model.number, 46)));
        assert_eq!(bus.ping(8), Err(Fault::Silent));
        bus.port().emulator.set_baud(1_000_000);
        assert_eq!(bus.ping(7), Err(Fault::Silent));
        let (mut data, mut heard) = ([0; 600], [FINE; 300]);
        let ids: Vec<u8> = (0..300).map(|k| k as u8).collect();
        let full = bus.sync_read(
            &[&ids[..], &ids, &ids, &ids].concat(),
            0,
            2,
            &mut data,
            &mut heard,
            false,
        );
        assert!(matches!(full, Err(Fault::Full(_))));
    }
}

#[test]
fn other_instructions_of_the_protocol_do_what_they_say() {
    let mut bus = engaged(&[1, 2]);
    let port = bus.port();
    let mut buffer = [0; LONGEST];
    let mut say = |port: &mut Virtual, id, asked, parameters: &[u8]| {
        let sent = crate::packet::packet(&mut buffer, id, asked, parameters)
            .unwrap()
            .to_vec();
        port.send(&sent, 0).unwrap();
        port.pass(0.5);
        let mut answers = Decoder::default();
        while let Some(bytes) = port.emulator.speak(port.seconds()) {
            answers.push(&bytes);
        }
        let mut found = vec![];
        while let Some(packet) = answers.next(LONGEST) {
            found.push((packet.id, packet.parameters.to_vec()));
        }
        found
    };
    assert_eq!(
        say(port, BROADCAST, instruction::PING, &[]),
        vec![(1, vec![0, 0xB0, 4, 46]), (2, vec![0, 0xB0, 4, 46])]
    );
    let goal = [&116u16.to_le_bytes()[..], &2100i32.to_le_bytes()].concat();
    assert_eq!(
        say(port, 1, instruction::REG_WRITE, &goal),
        vec![(1, vec![0])]
    );
    assert_eq!(port.emulator.servos[0].angle(), 2000.0);
    assert_eq!(say(port, BROADCAST, instruction::ACTION, &[]), vec![]);
    assert_eq!(port.emulator.servos[0].angle().round(), 2100.0);
    let bulk = [&[2, 116, 0, 4, 0][..], &1900i32.to_le_bytes()].concat();
    assert_eq!(say(port, BROADCAST, instruction::BULK_WRITE, &bulk), vec![]);
    let read = say(
        port,
        BROADCAST,
        instruction::BULK_READ,
        &[1, 132, 0, 4, 0, 2, 132, 0, 2, 0],
    );
    assert_eq!(read, vec![(1, vec![0, 52, 8, 0, 0]), (2, vec![0, 108, 7])]);
    assert_eq!(say(port, 1, 0x77, &[]), vec![(1, vec![2])]);
    assert_eq!(say(port, 1, instruction::READ, &[1]), vec![(1, vec![5])]);
    assert_eq!(
        say(port, 1, instruction::READ, &[250, 0, 9, 0]),
        vec![(1, vec![4])]
    );
    assert_eq!(
        say(port, 1, instruction::CLEAR, &[1, 2]),
        vec![(1, vec![2])]
    );
    assert_eq!(
        say(port, 1, instruction::CLEAR, &CLEAR_TURNS),
        vec![(1, vec![0])]
    );
    assert_eq!(
        say(port, 1, instruction::WRITE, &[68, 0, 1]),
        vec![(1, vec![0])]
    );
    assert_eq!(say(port, 1, instruction::WRITE, &[65, 0, 1]), vec![]);
    assert_eq!(
        say(port, 1, instruction::READ, &[65, 0, 1, 0]),
        vec![(1, vec![0, 1])]
    );
    port.emulator.servos[1].set_id(1);
    port.emulator.servos[1].heat(60.0);
    assert_eq!(
        say(port, 1, instruction::READ, &[146, 0, 1, 0]),
        vec![],
        "two of one id talk over each other"
    );
    port.emulator.servos[1].supply(2.0);
    port.emulator.servos[1].fail(1);
    assert_eq!(port.emulator.servos[1].alert(), ALERT);
    assert_eq!(port.emulator.faults(), Faults::default());
}

#[test]
fn an_encoder_that_stands_lets_the_motor_run_away_and_a_torn_tendon_carries_nothing() {
    let mut bus = engaged(&[1, 2]);
    bus.port().emulator.servos[0].broken.stuck = true;
    bus.port().emulator.servos[1].broken.torn = true;
    goals(&mut bus, &[1, 2], &[2100, 2900]);
    bus.port().pass(1.0);
    assert_eq!(position(&mut bus, 1), 2000);
    assert!(bus.port().emulator.servos[0].angle() > 2500.0);
    assert_eq!(position(&mut bus, 2), 2900);
    let mut current = [9; 2];
    assert_eq!(
        bus.read(2, X_SERIES.present_current.address, &mut current),
        FINE
    );
    assert_eq!(current, [0; 2]);
}

#[test]
fn a_load_that_is_too_heavy_shuts_a_servo_down_and_a_cap_prevents_that() {
    for (caps, uncapped, expected) in [(false, false, 0x20), (true, false, 0), (true, true, 0x20)] {
        let mut bus = engaged(&[1]);
        bus.port().emulator.servos[0].broken.uncapped = uncapped;
        bus.port().emulator.servos[0].burden(20.0);
        if caps {
            let cap = 600i16.to_le_bytes();
            assert_eq!(bus.write(1, X_SERIES.goal_current.address, &cap), FINE);
        }
        goals(&mut bus, &[1], &[2600]);
        bus.port().pass(0.8);
        let mut error = [9];
        let told = X_SERIES.hardware_error.address;
        assert!(bus.read(1, told, &mut error).is_ok());
        assert_eq!(error, [0], "not at once");
        bus.port().pass(1.0);
        assert!(bus.read(1, told, &mut error).is_ok());
        assert_eq!(error, [expected], "caps {caps}, uncapped {uncapped}");
        assert_eq!(bus.port().emulator.servos[0].torque(), expected == 0);
        bus.port().emulator.servos[0].mend();
        assert!(bus.read(1, told, &mut error).is_ok());
        assert_eq!((error, position(&mut bus, 1)), ([0], 2000), "as new");
    }
}

#[test]
fn blocked_horns_stand_turns_are_lost_and_tendons_wound_the_other_way() {
    let mut bus = engaged(&[1, 2]);
    bus.port().emulator.servos[0].broken.jammed = true;
    bus.port().emulator.servos[1].lose_turn();
    assert_eq!(position(&mut bus, 2), 2000 - 4096);
    goals(&mut bus, &[1], &[2500]);
    bus.port().pass(0.5);
    assert_eq!(position(&mut bus, 1), 2000);
    let mut current = [0; 2];
    bus.read(1, X_SERIES.present_current.address, &mut current)
        .unwrap();
    assert!(i16::from_le_bytes(current) > 500, "{current:?}");
    bus.port().emulator.servos[0].mend();
    bus.port().emulator.servos[1].mend();
    assert_eq!(position(&mut bus, 2), 2000);

    // A load that asks for 200 mA on one side and for 600 on the other.
    let mut bus = engaged(&[1]);
    let model = model(1200).unwrap();
    let uneven = Motion {
        load: vec![(1000.0, -600.0), (2000.0, 0.0), (3000.0, 200.0)],
        ..motion()
    };
    let mut servo = Servo::new(model, 1, 3, 2000.0, uneven);
    servo
        .write(
            X_SERIES.operating_mode.address,
            &[mode::CURRENT_BASED_POSITION],
        )
        .unwrap();
    servo.write(X_SERIES.torque_enable.address, &[1]).unwrap();
    let mut drawn = |reversed: bool| {
        servo.broken.reversed = reversed;
        bus.port().emulator.servos[0] = servo.clone();
        goals(&mut bus, &[1], &[3000]);
        bus.port().pass(2.0);
        let mut current = [0; 2];
        bus.read(1, X_SERIES.present_current.address, &mut current)
            .unwrap();
        i16::from_le_bytes(current)
    };
    let (plain, other) = (drawn(false), drawn(true));
    assert!(
        (plain - 200).abs() < 20 && (other - 600).abs() < 20,
        "{plain} {other}"
    );
}

#[test]
fn drive_mode_secondary_id_profile_and_limits_do_what_the_manual_says() {
    let mut bus = engaged(&[1, 2]);
    let off = X_SERIES.torque_enable.address;
    for id in [1, 2] {
        assert_eq!(bus.write(id, off, &[0]), FINE);
    }
    // Turned round: the encoder counts the other way, and so do goals.
    assert_eq!(bus.write(1, X_SERIES.drive_mode.address, &[9]), FINE);
    bus.port().pass(0.01);
    assert_eq!(position(&mut bus, 1), -2000);
    assert!(!bus.port().emulator.servos[0].torque());
    goals(&mut bus, &[1], &[-2200]);
    bus.port().pass(1.0);
    assert!(
        bus.port().emulator.servos[0].torque(),
        "a goal switched it on"
    );
    assert!((bus.port().emulator.servos[0].angle() - 2200.0).abs() < 5.0);
    assert_eq!(bus.write(1, off, &[0]), FINE);
    assert_eq!(bus.write(1, X_SERIES.drive_mode.address, &[0]), FINE);
    // A secondary id obeys and never answers.
    assert_eq!(bus.write(2, X_SERIES.shadow_id.address, &[1]), FINE);
    assert_eq!(bus.write(1, X_SERIES.led.address, &[1]), FINE);
    let mut led = [0];
    assert_eq!(bus.read(2, X_SERIES.led.address, &mut led), FINE);
    assert_eq!(led, [1], "what was written to servo 1");
    assert_eq!(bus.write(2, X_SERIES.shadow_id.address, &[255]), FINE);
    // A profile makes it slow, a PWM limit caps its goal PWM.
    let profile = X_SERIES.profile_velocity.address;
    assert_eq!(bus.write(2, profile, &10i32.to_le_bytes()), FINE);
    assert_eq!(bus.write(2, off, &[1]), FINE);
    goals(&mut bus, &[2], &[2400]);
    bus.port().pass(1.0);
    let moved = bus.port().emulator.servos[1].angle() - 2000.0;
    assert!((100.0..=157.0).contains(&moved), "{moved}");
    assert_eq!(bus.write(2, off, &[0]), FINE);
    assert_eq!(bus.write(2, X_SERIES.pwm_limit.address, &[100, 0]), FINE);
    let goal = X_SERIES.goal_pwm.address;
    assert_eq!(bus.write(2, goal, &[200, 0]), Err(Fault::Refused(6)));
    // Another operating mode brings its own gains and no profile.
    assert_eq!(bus.write(2, X_SERIES.position_p.address, &[9, 0]), FINE);
    assert_eq!(bus.write(2, X_SERIES.operating_mode.address, &[3]), FINE);
    let (mut gain, mut velocity) = ([0; 2], [0; 4]);
    assert_eq!(bus.read(2, X_SERIES.position_p.address, &mut gain), FINE);
    assert_eq!(bus.read(2, profile, &mut velocity), FINE);
    assert_eq!((gain, velocity), (400i16.to_le_bytes(), [0; 4]));
}
