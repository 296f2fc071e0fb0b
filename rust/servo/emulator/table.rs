//! The registers of an emulated servo, and its rules for writes.

use crate::registers::{FARTHEST_GOAL, FULL_PWM, Model, Register, mode};

/// Number of register bytes.
const SIZE: usize = 256;

/// Errors of a status.
pub mod refusal {
    pub const INSTRUCTION: u8 = 2;
    pub const RANGE: u8 = 4;
    pub const LENGTH: u8 = 5;
    pub const LIMIT: u8 = 6;
    pub const ACCESS: u8 = 7;
}

#[derive(Debug, Clone)]
pub struct Table([u8; SIZE]);

impl Default for Table {
    fn default() -> Table {
        Table([0; SIZE])
    }
}

impl Table {
    /// A register's value: signed for two and four bytes, unsigned for one.
    pub fn get(&self, register: Register) -> i32 {
        let at = usize::from(register.address);
        let bytes = &self.0[at..at + usize::from(register.size)];
        match bytes {
            [one] => i32::from(*one),
            [low, high] => i32::from(i16::from_le_bytes([*low, *high])),
            _ => i32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]),
        }
    }

    pub fn set(&mut self, register: Register, value: i32) {
        let (from, size) = (usize::from(register.address), usize::from(register.size));
        self.0[from..from + size].copy_from_slice(&value.to_le_bytes()[..size]);
    }

    /// All zeros from `address` on.
    pub fn forget(&mut self, address: u16) {
        self.0[usize::from(address)..].fill(0);
    }

    pub fn read(&self, address: u16, size: u16) -> Result<Vec<u8>, u8> {
        let from = usize::from(address);
        let bytes = self.0.get(from..from + usize::from(size));
        bytes
            .filter(|bytes| !bytes.is_empty())
            .map(<[u8]>::to_vec)
            .ok_or(refusal::RANGE)
    }

    /// Write allowed values; return the written registers, or the error of its status.
    pub fn write(
        &mut self,
        model: &Model,
        address: u16,
        data: &[u8],
    ) -> Result<impl Fn(Register) -> bool + use<>, u8> {
        let layout = model.layout();
        let (from, end) = (usize::from(address), usize::from(address) + data.len());
        if data.is_empty() || end > SIZE {
            return Err(refusal::RANGE);
        }
        let touched = move |register: Register| {
            from < usize::from(register.end()) && usize::from(register.address) < end
        };
        let torque = self.get(layout.torque_enable) == 1;
        let mut fixed = layout.all().filter(|register| !register.writable);
        if address < layout.torque_enable.address && torque
            || fixed.any(|register| touched(*register))
        {
            return Err(refusal::ACCESS);
        }
        let mut after = self.clone();
        after.0[from..end].copy_from_slice(data);
        let goal = layout.goal_position;
        let whole = from <= usize::from(goal.address) && usize::from(goal.end()) <= end;
        if touched(goal) && !whole {
            return Err(refusal::LENGTH);
        }
        let tripped = self.get(layout.bus_watchdog) == 255;
        if tripped
            && [goal, layout.goal_current, layout.goal_pwm]
                .into_iter()
                .any(touched)
        {
            return Err(refusal::RANGE);
        }
        let driven = after.get(layout.operating_mode) as u8;
        let (low, high) = match driven {
            mode::EXTENDED_POSITION | mode::CURRENT_BASED_POSITION => {
                (-FARTHEST_GOAL, FARTHEST_GOAL)
            }
            _ => (
                after.get(layout.min_position),
                after.get(layout.max_position),
            ),
        };
        let current = after.get(layout.current_limit);
        let pwm = after.get(layout.pwm_limit);
        let checks = [
            (layout.id, 0, 252, refusal::RANGE),
            (
                layout.baud_rate,
                0,
                i32::from(model.fastest),
                refusal::RANGE,
            ),
            (layout.operating_mode, 0, 16, refusal::RANGE),
            (
                layout.current_limit,
                0,
                i32::from(model.current_limit),
                refusal::RANGE,
            ),
            (layout.homing_offset, -1_044_479, 1_044_479, refusal::RANGE),
            (layout.torque_enable, 0, 1, refusal::RANGE),
            (layout.status_return, 0, 2, refusal::RANGE),
            (layout.bus_watchdog, 0, 127, refusal::RANGE),
            (layout.pwm_limit, 0, i32::from(FULL_PWM), refusal::RANGE),
            (layout.goal_pwm, -pwm, pwm, refusal::LIMIT),
            (layout.goal_current, -current, current, refusal::LIMIT),
            (goal, low, high, refusal::LIMIT),
        ];
        for (register, low, high, error) in checks {
            if touched(register) && !(low..=high).contains(&after.get(register)) {
                return Err(error);
            }
        }
        let enables = touched(layout.torque_enable) && after.get(layout.torque_enable) == 1;
        if enables && self.get(layout.hardware_error) != 0 {
            return Err(refusal::ACCESS);
        }
        *self = after;
        Ok(touched)
    }
}
