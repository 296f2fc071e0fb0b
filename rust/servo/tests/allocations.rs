//! The control tick allocates nothing: counted by the allocator itself, on the loop's thread, with real packets at a
//! pseudo-terminal, answers that are damaged and a servo that falls silent.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use softmap_servo::bus::Bus;
use softmap_servo::control::{Control, Entry, Mailbox, Orders, Plan, Record};
use softmap_servo::drive::{Drive, Member};
use softmap_servo::emulator::pty::Terminal;
use softmap_servo::emulator::servo::{Motion, Servo};
use softmap_servo::emulator::{Emulator, Faults};
use softmap_servo::guard::{Axis, Budget, Guard, Limits, MOST_SERVOS, Request, State};
use softmap_servo::registers::{X_SERIES, mode, model};
use softmap_servo::serial::Serial;

thread_local! {
    static COUNT: Cell<u64> = const { Cell::new(0) };
}

struct Counting;

// SAFETY: every call goes to the system's allocator as it came.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // A thread that is ending has no count any more; its allocations are nobody's.
        let _ = COUNT.try_with(|count| count.set(count.get() + 1));
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

struct Linear;

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

struct Wave(f64, Option<Request>);

impl Mailbox for Wave {
    fn collect(&mut self) -> Orders {
        self.0 += 0.02;
        let mut command = [0.0; MOST_SERVOS];
        (command[0], command[1]) = (self.0.sin(), self.0.cos() - 1.0);
        Orders {
            heard: true,
            deadman: true,
            command: Some(command),
            request: self.1.take(),
            ..Orders::default()
        }
    }
}

struct Nowhere;

impl Record for Nowhere {
    fn take(&mut self, _entry: &Entry) {}
}

#[test]
fn the_tick_allocates_nothing() {
    let model = model(1200).unwrap();
    let motion = Motion {
        delay: 0.01,
        lag: 0.02,
        load: vec![],
    };
    let servos = [1, 2].map(|id| Servo::new(model, id, 3, 2000.0, motion.clone()));
    let terminal = Terminal::open(Emulator::new(servos.to_vec(), 1_000_000, 1)).unwrap();
    let mut bus = Bus::new(
        Serial::open(terminal.path(), 1_000_000).unwrap(),
        1_000_000,
        2_000_000,
    );
    for id in [1, 2] {
        bus.write(
            id,
            X_SERIES.operating_mode.address,
            &[mode::CURRENT_BASED_POSITION],
        )
        .unwrap();
        bus.write(id, X_SERIES.return_delay.address, &[0]).unwrap();
    }
    let axis = Axis {
        home: 2000,
        low: 1000,
        high: 3000,
        slew: 2000.0,
        acceleration: 20_000.0,
        current: Some(600.0),
        fastest: 8000.0,
        following: 400.0,
        warm: 50.0,
        hot: 60.0,
        voltage: (4.0, 6.5),
    };
    let limits = Limits {
        period: 0.01,
        axes: vec![axis; 2],
        stale: 0.2,
        hold: 0.5,
        slacken: 3.0,
        late: 0.2,
        silent: 0.3,
        grace: 0.3,
        ramp: 0.1,
        jump: (200.0, 2000.0),
        jog_travel: 200.0,
        jog_slew: 200.0,
        jog_current: 150.0,
        budget: Budget {
            band: 0.02,
            turns: 5.0,
            burst: 5.0,
        },
    };
    let drive = Drive::new(bus, &[1, 2].map(|id| Member { id, model }), true, 100.0);
    let guard = Guard::new(limits.checked().unwrap());
    let mut control = Control::new(drive, guard, Linear, Wave(0.0, None), Nowhere);
    let mut reached = [false; 4];
    for tick in 0..250 {
        // Requests are repeated until they are heard: a busy computer may be late at any of them.
        control.mailbox.1 = match control.guard.state() {
            State::Off => Some(Request::Connect),
            State::Connected => Some(Request::Home),
            State::Homed => Some(Request::Arm),
            State::Ready => Some(Request::Engage),
            _ => None,
        };
        let before = COUNT.get();
        control.step();
        assert_eq!(
            COUNT.get(),
            before,
            "period {tick} in {:?}",
            control.guard.state()
        );
        match tick {
            100 => terminal.emulator().set_faults(Faults {
                damage: 0.3,
                junk: 0.3,
                ..Faults::default()
            }),
            150 => terminal.emulator().servos[1].broken.mute = true,
            _ => {}
        }
        let states = [State::Engaged, State::Hold, State::Fault];
        states
            .iter()
            .zip(&mut reached)
            .for_each(|(state, reached)| *reached |= control.guard.state() == *state);
        reached[3] |= !control.drive.heard().iter().all(Result::is_ok);
    }
    assert!(
        reached[0] && reached[2] && reached[3],
        "engaged, faulted, unheard: {reached:?}"
    );
    let counted = COUNT.get();
    drop(vec![1u8; 100]);
    assert!(COUNT.get() > counted, "the counter counts");
}
