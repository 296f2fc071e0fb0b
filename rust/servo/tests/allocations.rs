//! The control tick allocates nothing: counted by the allocator on the loop's thread, with real
//! packets at a pseudo-terminal, damaged answers and a silent servo.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use emulated_rig::Linear;
use softmap_servo::bus::Bus;
use softmap_servo::control::{Control, Entry, Mailbox, Orders, Record};
use softmap_servo::emulator::Faults;
use softmap_servo::emulator::pty::Terminal;
use softmap_servo::guard::{Guard, Limits, MOST_SERVOS, Request, State};
use softmap_servo::serial::Serial;

#[path = "../emulated_rig.rs"]
mod emulated_rig;

thread_local! {
    static COUNT: Cell<u64> = const { Cell::new(0) };
}

struct Counting;

// SAFETY: every call is forwarded unchanged to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // A thread that is ending has no count any more; its allocations are not counted.
        let _ = COUNT.try_with(|count| count.set(count.get() + 1));
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

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
    let terminal = Terminal::open(emulated_rig::emulator()).unwrap();
    let serial = Serial::open(terminal.path(), emulated_rig::BAUD).unwrap();
    // A busy computer is late, so limits that are not under test are wider.
    let mut limits = Limits {
        stale: 0.2,
        late: 0.2,
        silent: 0.3,
        grace: 0.3,
        ..emulated_rig::limits(0.01)
    };
    limits
        .axes
        .iter_mut()
        .for_each(|axis| axis.following = 400.0);
    let mut control = Control::new(
        emulated_rig::drive(Bus::new(serial, emulated_rig::BAUD, 2_000_000)),
        Guard::new(limits.checked().unwrap()),
        Linear,
        Wave(0.0, None),
        Nowhere,
    );
    let mut reached = [false; 4];
    for tick in 0..250 {
        // Requests are repeated until they are received: a busy computer may be late.
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
