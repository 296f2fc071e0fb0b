//! Shared code of the loop's tests, in the crate (`control_tests.rs`) and outside it
//! (`tests/allocations.rs`): two XL330 at 2000 ticks, ready to drive, a plan of 280 ticks per mm,
//! and limits for both.

use softmap_servo::bus::{Bus, Port};
use softmap_servo::control::Plan;
use softmap_servo::drive::{Drive, Member};
use softmap_servo::emulator::Emulator;
use softmap_servo::emulator::servo::{Motion, Servo};
use softmap_servo::guard::{Axis, Budget, Limits};
use softmap_servo::registers::{X_SERIES, mode, model};

pub const IDS: [u8; 2] = [1, 2];
pub const BAUD: u32 = 1_000_000;

/// Commands in mm to ticks, 280 per mm about home.
pub struct Linear;

impl Plan for Linear {
    fn channels(&self) -> usize {
        2
    }

    fn ticks(&mut self, command: &[f64], ticks: &mut [f64]) {
        ticks
            .iter_mut()
            .zip(command)
            .for_each(|(tick, mm)| *tick = 2000.0 + 280.0 * mm);
    }

    fn passed(&mut self, _ticks: &[i32], _period: f64) {}
}

/// A thousand ticks about home on either side, with the period of the loop, s.
pub fn limits(period: f64) -> Limits {
    let axis = Axis {
        home: 2000,
        low: 1000,
        high: 3000,
        slew: 2000.0,
        acceleration: 20_000.0,
        current: Some(600.0),
        fastest: 8000.0,
        following: 300.0,
        warm: 50.0,
        hot: 60.0,
        voltage: (4.0, 6.5),
    };
    let limits = Limits {
        period,
        axes: vec![axis; 2],
        stale: 0.1,
        hold: 0.5,
        slacken: 3.0,
        late: 0.02,
        silent: 0.2,
        grace: 0.2,
        ramp: 0.2,
        jump: (100.0, 800.0),
        jog_travel: 200.0,
        jog_slew: 200.0,
        jog_current: 150.0,
        budget: Budget {
            band: 0.02,
            turns: 5.0,
            burst: 5.0,
        },
    };
    limits.checked().unwrap()
}

/// Two servos with a load of 0.4 mA per tick from home.
pub fn emulator() -> Emulator {
    let motion = Motion {
        delay: 0.01,
        lag: 0.03,
        load: vec![(1000.0, -400.0), (2000.0, 0.0), (3000.0, 400.0)],
    };
    let servos = IDS.map(|id| Servo::new(model(1200).unwrap(), id, 3, 2000.0, motion.clone()));
    Emulator::new(servos.to_vec(), BAUD, 5)
}

/// The drive after set-up.
pub fn drive<P: Port>(mut bus: Bus<P>) -> Drive<P> {
    for id in IDS {
        let driven = (X_SERIES.operating_mode, mode::CURRENT_BASED_POSITION);
        for (register, value) in [driven, (X_SERIES.return_delay, 0)] {
            // At a pseudo-terminal of a busy computer, an answer may be late.
            let heard = (0..20).any(|_| bus.write(id, register.address, &[value]).is_ok());
            assert!(heard, "servo {id} does not answer");
        }
    }
    let model = model(1200).unwrap();
    Drive::new(bus, &IDS.map(|id| Member { id, model }), true, 100.0)
}
