//! Emergency stops besides the flag in the orders: a GPIO line of the computer, a heartbeat from
//! another computer, or both.
//!
//! They are read once per period, without waiting and without allocation. An unreadable input
//! counts as pressed: a broken wire, a missing chip, a missing heartbeat. The guard then acts
//! (torque off immediately, FAULT until acknowledged).

use super::gpio::Line;
use super::heartbeat::Heartbeat;

/// The emergency stops of a rig.
#[derive(Default)]
pub struct Emergency {
    button: Option<Button>,
    heartbeat: Option<Heartbeat>,
}

/// A line, and its level while the stop is pressed.
pub struct Button {
    line: Box<dyn Line + Send>,
    pressed_low: bool,
}

impl Button {
    /// A contact that opens when pressed reads high, by the pull-up, as does a broken wire;
    /// `pressed_low` is for a contact that closes.
    pub fn new(line: Box<dyn Line + Send>, pressed_low: bool) -> Button {
        Button { line, pressed_low }
    }

    fn pressed(&mut self) -> bool {
        self.line.high() != Some(self.pressed_low)
    }
}

impl Emergency {
    pub fn new(button: Option<Button>, heartbeat: Option<Heartbeat>) -> Emergency {
        Emergency { button, heartbeat }
    }

    /// Whether any of them is pressed or dead at `now` (ns, monotonic).
    pub fn pressed(&mut self, now: u64) -> bool {
        // Read each input, so its data are consumed regardless of the other.
        let button = self.button.as_mut().is_some_and(Button::pressed);
        let heart = self
            .heartbeat
            .as_mut()
            .is_some_and(|heart| heart.pressed(now));
        button || heart
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::allocations::allocations;
    use std::sync::{Arc, Mutex};

    struct Wire(Arc<Mutex<Option<bool>>>);

    impl Line for Wire {
        fn high(&mut self) -> Option<bool> {
            *self.0.lock().unwrap()
        }
    }

    #[test]
    fn a_contact_that_opens_is_pressed_when_open_or_unreadable() {
        let wire = Arc::new(Mutex::new(Some(false)));
        let button = |low| Some(Button::new(Box::new(Wire(wire.clone())), low));
        let (mut opens, mut closes) = (
            Emergency::new(button(false), None),
            Emergency::new(button(true), None),
        );
        assert!(!opens.pressed(0) && closes.pressed(0));
        *wire.lock().unwrap() = Some(true);
        assert!(opens.pressed(0) && !closes.pressed(0));
        *wire.lock().unwrap() = None;
        assert!(opens.pressed(0) && closes.pressed(0));
    }

    #[test]
    fn without_inputs_nothing_is_pressed_and_asking_allocates_nothing() {
        assert!(!Emergency::default().pressed(5));
        let wire = Arc::new(Mutex::new(Some(true)));
        let button = Button::new(Box::new(Wire(wire)), false);
        let heart = Heartbeat::open("127.0.0.1", 0, &[7; 32], 0.1).unwrap();
        let mut both = Emergency::new(Some(button), Some(heart));
        assert_eq!(allocations(|| assert!(both.pressed(1_000))), 0);
    }
}
