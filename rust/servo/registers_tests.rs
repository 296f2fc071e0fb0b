//! Registers and models as the manual has them.

use super::*;

#[test]
fn registers_lie_behind_one_another_and_what_is_kept_lies_before_torque() {
    let mut end = 0;
    for register in X_SERIES.all() {
        let Register {
            name,
            address,
            size,
            eeprom,
            ..
        } = *register;
        assert!(address >= end, "{name} overlaps the one before");
        assert!([1, 2, 4].contains(&size), "{name}");
        end = register.end();
        assert_eq!(end, address + size, "{name}");
        assert_eq!(eeprom, address < 64, "{name}");
        let read_only = ["model number", "firmware version", "moving"].contains(&name)
            || ["hardware error status", "realtime tick"].contains(&name)
            || name.starts_with("present ");
        assert_eq!(register.writable, !read_only, "{name}");
        let made = match (eeprom, read_only) {
            (true, _) => Register {
                writable: !read_only,
                ..kept(name, address, size)
            },
            (false, true) => reported(name, address, size),
            (false, false) => ram(name, address, size),
        };
        assert_eq!(made, *register);
    }
    assert_eq!(X_SERIES.all().count(), 42);
    assert_eq!(end, 147);
}

#[test]
fn the_families_of_the_series_are_known_as_the_manual_has_them() {
    // Of each: steps of current (mA), largest, and the rate and heat it bears.
    for (name, number, unit, most, fastest, hot) in [
        ("XL330-M288", 1200, 1.0, 1750, 4_000_000, 70),
        ("XC330-M288", 1240, 1.0, 2352, 4_000_000, 70),
        ("XL430-W250", 1060, 0.0, 0, 4_500_000, 72),
        ("XM430-W210", 1030, 2.69, 1193, 4_500_000, 80),
        ("XM540-W270", 1120, 2.69, 2047, 4_500_000, 80),
    ] {
        let known = model(number).unwrap();
        assert_eq!((known.name, known.current_limit), (name, most));
        assert_eq!(known.current_unit, unit);
        assert_eq!(BAUD_RATES[usize::from(known.fastest)], fastest);
        assert_eq!(known.temperature_limit, hot);
        assert_eq!(known.code_of(fastest), Some(known.fastest));
        assert_eq!(known.code_of(4_500_000).is_some(), fastest == 4_500_000);
        assert_eq!(
            (known.code_of(57_600), known.code_of(57_601)),
            (Some(1), None)
        );
        assert_eq!(known.has_current(), unit > 0.0);
        let shape = (known.voltage, known.velocity_limit, known.shutdown);
        let made = x(
            number,
            known.name,
            known.fastest,
            (unit, most),
            (hot, shape.0),
            shape.1,
            shape.2,
            known.gains,
            known.stall,
        );
        assert_eq!(made, *known);
    }
}

#[test]
fn each_model_has_gains_of_its_own_as_the_manual_has_them() {
    for (number, gains) in [
        (1190, (400, 400, 0)),
        (1200, (400, 0, 0)),
        (1240, (1100, 0, 500)),
        (1060, (640, 0, 4000)),
        (1120, (800, 0, 0)),
    ] {
        assert_eq!(model(number).unwrap().gains, gains, "{number}");
    }
}

#[test]
fn a_cap_is_whole_steps_of_its_servo_and_never_above_what_was_asked() {
    for (number, most, register, steps) in [
        (1200, 300.5, X_SERIES.goal_current, 300),
        (1030, 300.0, X_SERIES.goal_current, 111),
        (1030, 2.6, X_SERIES.goal_current, 0),
        (1060, 700.0, X_SERIES.goal_pwm, 442),
        (1060, 9000.0, X_SERIES.goal_pwm, 885),
    ] {
        let cap = model(number).unwrap().cap(most);
        assert_eq!(cap, (register, steps), "{most} mA of {number}");
    }
}

#[test]
fn every_model_is_found_by_its_number_alone() {
    for expected in &MODELS {
        assert_eq!(model(expected.number), Some(expected));
        let capped = expected.driven_in() == mode::CURRENT_BASED_POSITION;
        assert_eq!(capped, expected.name != "XL430-W250");
        assert!(usize::from(expected.fastest) < BAUD_RATES.len());
        assert_eq!(expected.layout().goal_position.end(), 120);
    }
    assert_eq!(model(0), None);
    let turn = model(1200).map(Model::fastest_turn).unwrap();
    assert!(
        (turn - 445.0 * 0.229 * 4096.0 / 60.0).abs() < 1e-9,
        "{turn}"
    );
}
