//! Each limit has its edges, and is refused by name beyond them.

use super::*;

/// The widest that is allowed, so that each limit can be moved to its edges alone.
fn widest() -> Limits {
    let axis = Axis {
        home: 0,
        low: -FARTHEST,
        high: FARTHEST,
        slew: 1.0,
        acceleration: 1.0,
        current: Some(600.0),
        fastest: 50_000.0,
        following: 300.0,
        warm: 20.0,
        hot: 80.0,
        voltage: (3.0, 30.0),
    };
    Limits {
        period: 0.001,
        axes: vec![axis; 2],
        stale: 1.0,
        hold: 1.0,
        slacken: 1.0,
        late: 0.01,
        silent: 1.0,
        grace: 1.0,
        ramp: 1.0,
        jump: (0.0, f64::from(FARTHEST)),
        jog_travel: 200.0,
        jog_slew: 200.0,
        jog_current: 150.0,
        budget: Budget {
            band: 0.02,
            turns: 4.0,
            burst: 4.0,
        },
    }
}

#[test]
fn each_limit_has_its_edges_and_is_refused_by_name_beyond_them() {
    type Set = fn(&mut Limits, f64);
    let far = f64::from(FARTHEST);
    let table: [(&str, Set, f64, f64); 25] = [
        ("period", |l, v| l.period = v, 0.0005, 0.005),
        ("stale", |l, v| l.stale = v, 0.002, 2.0),
        ("hold", |l, v| l.hold = v, 0.001, 60.0),
        ("slacken", |l, v| l.slacken = v, 0.1, 60.0),
        ("late", |l, v| l.late = v, 0.002, 0.5),
        ("silent", |l, v| l.silent = v, 0.01, 1.0),
        ("grace", |l, v| l.grace = v, 0.001, 2.0),
        ("ramp", |l, v| l.ramp = v, 0.0, 10.0),
        ("jump (reported)", |l, v| l.jump.0 = v, 0.0, far),
        ("jump (refused)", |l, v| l.jump = (5.0, v), 5.0, far),
        ("jog_travel", |l, v| l.jog_travel = v, 1.0, 4096.0),
        ("jog_slew", |l, v| l.jog_slew = v, 1.0, 1000.0),
        ("jog_current", |l, v| l.jog_current = v, 0.0, 1000.0),
        ("band", |l, v| l.budget.band = v, 0.0, 100.0),
        ("turns", |l, v| l.budget.turns = v, 0.1, 100.0),
        ("burst", |l, v| l.budget.burst = v, 1.0, 100.0),
        ("servo 2: slew", |l, v| l.axes[1].slew = v, 1.0, 20_000.0),
        (
            "servo 2: acceleration",
            |l, v| l.axes[1].acceleration = v,
            1.0,
            1e6,
        ),
        (
            "servo 2: fastest",
            |l, v| l.axes[1].fastest = v,
            1.0,
            50_000.0,
        ),
        (
            "servo 2: following",
            |l, v| l.axes[1].following = v,
            1.0,
            4096.0,
        ),
        ("servo 2: hot", |l, v| l.axes[1].hot = v, 30.0, 80.0),
        ("servo 2: warm", |l, v| l.axes[1].warm = v, 20.0, 80.0),
        (
            "servo 2: voltage (highest)",
            |l, v| l.axes[1].voltage.1 = v,
            3.0,
            30.0,
        ),
        (
            "servo 2: voltage (lowest)",
            |l, v| l.axes[1].voltage.0 = v,
            3.0,
            30.0,
        ),
        (
            "servo 1: current",
            |l, v| l.axes[0].current = Some(v),
            1.0,
            6000.0,
        ),
    ];
    assert!(widest().checked().is_ok());
    for (name, set, low, high) in table {
        let with = |value: f64| {
            let mut limits = widest();
            set(&mut limits, value);
            limits.checked()
        };
        assert!(with(low).is_ok() && with(high).is_ok(), "{name}");
        // The period's own upper edge lies beyond what `late` needs of it.
        let above = if name == "period" { 0.1 } else { high } + 1e-6;
        for value in [low - 1e-6, above, f64::NAN, f64::NEG_INFINITY] {
            let fault = with(value).unwrap_err();
            let said = fault.to_string();
            assert!(said.starts_with(&format!("{name} is {value}")), "{said}");
            let whose = fault
                .servo
                .map_or_else(String::new, |servo| format!("servo {}: ", servo + 1));
            assert!(name.starts_with(&(whose + fault.name)), "{fault:?}");
        }
    }
    let tried = table.map(|(name, ..)| name.rsplit(": ").next().unwrap_or(name));
    for (name, ..) in RANGES {
        let there = tried.iter().any(|one| one.split(" (").next() == Some(name));
        let ticks = ["servos", "home", "low", "high"].contains(&name);
        assert!(there != ticks, "{name} is tried here or with the ticks");
    }
    assert!(named("fly", 0.0).check().is_err(), "what has no range");
    let mut slow = widest();
    (slow.period, slow.late, slow.stale) = (0.1, 0.5, 0.5);
    assert!(slow.checked().is_ok());
}

#[test]
fn ticks_lie_about_home_within_what_the_servos_count() {
    type Set = fn(&mut Axis);
    let table: [(&str, Set); 6] = [
        ("home", |axis| axis.home = FARTHEST + 1),
        ("home", |axis| axis.home = -FARTHEST - 1),
        ("low", |axis| axis.low = axis.home),
        ("low", |axis| axis.low = -FARTHEST - 1),
        ("high", |axis| axis.high = axis.home),
        ("high", |axis| axis.high = FARTHEST + 1),
    ];
    for (name, set) in table {
        let mut limits = widest();
        set(&mut limits.axes[1]);
        let said = limits.checked().unwrap_err().to_string();
        assert!(said.starts_with(&format!("servo 2: {name} is ")), "{said}");
    }
    let mut narrow = widest();
    (narrow.axes[0].low, narrow.axes[0].high) = (-1, 1);
    assert!(narrow.checked().is_ok());
    for (home, low, high) in [
        (FARTHEST, -FARTHEST, FARTHEST),
        (-FARTHEST, -FARTHEST, FARTHEST),
    ] {
        let mut limits = widest();
        (limits.axes[0].home, limits.axes[0].low, limits.axes[0].high) = (home, low, high);
        assert!(
            limits.checked().is_err(),
            "a window on both sides of home, or none"
        );
    }
}

#[test]
fn what_other_limits_leave_of_a_range() {
    type Set = fn(&mut Axis);
    // What is just allowed, what is not, and the message then.
    let table: [(Set, Set, &str); 5] = [
        (
            |axis| (axis.warm, axis.hot) = (60.0, 60.0),
            |axis| (axis.warm, axis.hot) = (60.5, 60.0),
            "servo 2: warm is 60.5 °C; allowed is 20 to 60 °C",
        ),
        (
            |axis| axis.voltage = (7.0, 7.0),
            |axis| axis.voltage = (7.5, 7.0),
            "servo 2: voltage (lowest) is 7.5 V; allowed is 3 to 7 V",
        ),
        (
            |axis| (axis.slew, axis.fastest) = (9.0, 9.0),
            |axis| (axis.slew, axis.fastest) = (9.0, 8.5),
            "servo 2: fastest is 8.5 ticks/s; allowed is 9 to 50000 ticks/s",
        ),
        (
            |axis| (axis.home, axis.low, axis.high) = (1000, 0, FARTHEST),
            |axis| (axis.home, axis.low, axis.high) = (1000, 0, FARTHEST + 1),
            "servo 2: high is 1047576 ticks; allowed is 1 to 1047575 ticks",
        ),
        (
            |axis| (axis.home, axis.low, axis.high) = (-1000, -FARTHEST, 0),
            |axis| (axis.home, axis.low, axis.high) = (-1000, -FARTHEST - 1, 0),
            "servo 2: low is -1047576 ticks; allowed is -1047575 to -1 ticks",
        ),
    ];
    for (fine, beyond, said) in table {
        let with = |set: Set| {
            let mut limits = widest();
            set(&mut limits.axes[1]);
            limits.checked()
        };
        assert!(with(fine).is_ok(), "{said}");
        assert_eq!(with(beyond).unwrap_err().to_string(), said);
    }
}

#[test]
fn a_robot_has_one_to_sixteen_servos() {
    for (count, fine) in [(0, false), (1, true), (16, true), (17, false)] {
        let axis = widest().axes[0];
        let limits = Limits {
            axes: vec![axis; count],
            ..widest()
        };
        let checked = limits.checked();
        assert_eq!(checked.is_ok(), fine, "{count} servos");
        if let Err(fault) = checked {
            assert!(
                fault.text.starts_with(&format!("servos is {count}")),
                "{fault}"
            );
        }
    }
}

#[test]
fn limits_per_period_and_less_current_the_hotter() {
    let axis = Axis {
        low: -50,
        high: 70,
        slew: 200.0,
        acceleration: 3000.0,
        warm: 50.0,
        hot: 60.0,
        current: None,
        ..widest().axes[0]
    };
    let expected = Bounds {
        low: -50.0,
        high: 70.0,
        slew: 2.0,
        acceleration: 0.3,
    };
    assert_eq!(axis.bounds(0.01), expected);
    for (temperature, share) in [
        (20.0, 1.0),
        (50.0, 1.0),
        (55.0, 2.0 / 3.0),
        (60.0, 1.0 / 3.0),
        (99.0, 1.0 / 3.0),
    ] {
        assert!((axis.share(temperature) - share).abs() < 1e-12);
    }
    let edge = Axis { warm: 60.0, ..axis };
    assert_eq!(edge.share(60.0), 1.0, "no division by nothing");
    assert!((edge.share(60.1) - 1.0 / 3.0).abs() < 1e-12);
    assert!(
        Limits {
            axes: vec![axis],
            ..widest()
        }
        .checked()
        .is_ok()
    );
}
