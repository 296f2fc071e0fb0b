//! Servos and their registers, as data: another model is one line of `MODELS`, another family one
//! more `Layout`.
//!
//! Source: the control tables of the Dynamixel X-series in ROBOTIS' e-Manual (XL330, XC330, XL430,
//! XM430, XM540).

/// A register: its address and size in bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Register {
    pub name: &'static str,
    pub address: u16,
    pub size: u16,
    /// Kept without power; writable while torque is off only.
    pub eeprom: bool,
    pub writable: bool,
}

impl Register {
    /// The first address after it.
    pub const fn end(&self) -> u16 {
        self.address + self.size
    }
}

const fn kept(name: &'static str, address: u16, size: u16) -> Register {
    Register {
        name,
        address,
        size,
        eeprom: true,
        writable: true,
    }
}

const fn ram(name: &'static str, address: u16, size: u16) -> Register {
    Register {
        eeprom: false,
        ..kept(name, address, size)
    }
}

const fn reported(name: &'static str, address: u16, size: u16) -> Register {
    Register {
        writable: false,
        ..ram(name, address, size)
    }
}

/// A layout, and all its registers in a row.
macro_rules! layout {
    ($($name:ident)*) => {
        /// The used registers, by purpose.
        #[derive(Debug)]
        pub struct Layout {
            $(pub $name: Register,)*
        }

        impl Layout {
            pub fn all(&self) -> impl Iterator<Item = &Register> {
                [$(&self.$name),*].into_iter()
            }
        }
    };
}

layout! {
    model_number
    firmware
    id
    baud_rate
    return_delay
    drive_mode
    operating_mode
    shadow_id
    homing_offset
    temperature_limit
    max_voltage
    min_voltage
    pwm_limit
    current_limit
    velocity_limit
    max_position
    min_position
    startup
    shutdown
    torque_enable
    led
    status_return
    hardware_error
    position_d
    position_i
    position_p
    feedforward_2
    feedforward_1
    bus_watchdog
    goal_pwm
    goal_current
    profile_acceleration
    profile_velocity
    goal_position
    realtime_tick
    moving
    present_pwm
    present_current
    present_velocity
    present_position
    present_voltage
    present_temperature
}

pub const X_SERIES: Layout = Layout {
    model_number: Register {
        writable: false,
        ..kept("model number", 0, 2)
    },
    firmware: Register {
        writable: false,
        ..kept("firmware version", 6, 1)
    },
    id: kept("id", 7, 1),
    baud_rate: kept("baud rate", 8, 1),
    return_delay: kept("return delay time", 9, 1),
    drive_mode: kept("drive mode", 10, 1),
    operating_mode: kept("operating mode", 11, 1),
    shadow_id: kept("secondary id", 12, 1),
    homing_offset: kept("homing offset", 20, 4),
    temperature_limit: kept("temperature limit", 31, 1),
    max_voltage: kept("max voltage limit", 32, 2),
    min_voltage: kept("min voltage limit", 34, 2),
    pwm_limit: kept("PWM limit", 36, 2),
    current_limit: kept("current limit", 38, 2),
    velocity_limit: kept("velocity limit", 44, 4),
    max_position: kept("max position limit", 48, 4),
    min_position: kept("min position limit", 52, 4),
    startup: kept("startup configuration", 60, 1),
    shutdown: kept("shutdown", 63, 1),
    torque_enable: ram("torque enable", 64, 1),
    led: ram("LED", 65, 1),
    status_return: ram("status return level", 68, 1),
    hardware_error: reported("hardware error status", 70, 1),
    position_d: ram("position D gain", 80, 2),
    position_i: ram("position I gain", 82, 2),
    position_p: ram("position P gain", 84, 2),
    feedforward_2: ram("feedforward 2nd gain", 88, 2),
    feedforward_1: ram("feedforward 1st gain", 90, 2),
    bus_watchdog: ram("bus watchdog", 98, 1),
    goal_pwm: ram("goal PWM", 100, 2),
    goal_current: ram("goal current", 102, 2),
    profile_acceleration: ram("profile acceleration", 108, 4),
    profile_velocity: ram("profile velocity", 112, 4),
    goal_position: ram("goal position", 116, 4),
    realtime_tick: reported("realtime tick", 120, 2),
    moving: reported("moving", 122, 1),
    present_pwm: reported("present PWM", 124, 2),
    present_current: reported("present current", 126, 2),
    present_velocity: reported("present velocity", 128, 4),
    present_position: reported("present position", 132, 4),
    present_voltage: reported("present input voltage", 144, 2),
    present_temperature: reported("present temperature", 146, 1),
};

/// Operating modes (register 11).
pub mod mode {
    pub const POSITION: u8 = 3;
    pub const EXTENDED_POSITION: u8 = 4;
    pub const CURRENT_BASED_POSITION: u8 = 5;
}

/// Bits of the hardware error status (register 70).
pub const HARDWARE_ERRORS: [(u8, &str); 5] = [
    (0x01, "input voltage"),
    (0x04, "overheating"),
    (0x08, "motor encoder"),
    (0x10, "electrical shock"),
    (0x20, "overload"),
];

/// The status of an instruction (its lower seven bits).
pub const STATUS_ERRORS: [(u8, &str); 7] = [
    (1, "could not process the packet"),
    (2, "does not know the instruction"),
    (3, "received a wrong checksum"),
    (4, "was given a value out of range"),
    (5, "was given too short a value"),
    (6, "was given a value beyond a limit"),
    (7, "refuses access: read only, or torque is on"),
];
/// The alert bit of a status: read the hardware error status.
pub const ALERT: u8 = 0x80;

/// Ticks per turn of the servo's horn.
pub const TICKS_PER_TURN: i32 = 4096;

/// Ticks/s of a step of the velocity registers: 0.229 revolutions a minute.
pub const VELOCITY_STEP: f64 = 0.229 * TICKS_PER_TURN as f64 / 60.0;

/// Largest goal in multi-turn modes, ticks: 256 turns.
pub const FARTHEST_GOAL: i32 = 1_048_575;

/// Baud rates by the code in register 8.
pub const BAUD_RATES: [u32; 8] = [
    9_600, 57_600, 115_200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000,
];

/// Goal PWM of full power.
pub const FULL_PWM: u16 = 885;

/// Firmware from which servos answer all in one packet (fast sync read).
pub const FAST_FIRMWARE: u8 = 45;

/// A kind of servo.
#[derive(Debug, PartialEq)]
pub struct Model {
    pub number: u16,
    pub name: &'static str,
    /// The highest code of `BAUD_RATES` that it knows.
    pub fastest: u8,
    /// mA per step of its current registers; 0 if it neither measures nor caps current (no mode 5):
    /// its PWM is capped instead.
    pub current_unit: f64,
    /// Largest current limit, in steps.
    pub current_limit: u16,
    /// Factory shutdown temperature, °C.
    pub temperature_limit: u8,
    /// Factory supply range, V.
    pub voltage: (f64, f64),
    /// Factory speed limit, steps of `VELOCITY_STEP`.
    pub velocity_limit: u16,
    /// Errors that shut it down by factory setting.
    pub shutdown: u8,
    /// Position gains P, I and D of the manual's control table ("Initial Value"), register units.
    /// The firmware may set others when an operating mode is chosen.
    pub gains: (u16, u16, u16),
    /// Stall torque, N·m, and stall current, mA: "Stall Torque" under "Specifications" of the page
    /// of its name in ROBOTIS' e-Manual, at 5.0 V (XL330, XC330-M), 11.1 V (XC330-T) or 12.0 V
    /// (XL430, XM430, XM540).
    pub stall: (f64, f64),
}

impl Model {
    /// The register that caps its torque, and its value for `most` mA. Without a current cap, it is
    /// goal PWM: torque at standstill is proportional to it, with full PWM at the stall current.
    pub fn cap(&self, most: f64) -> (Register, i16) {
        if self.has_current() {
            (X_SERIES.goal_current, (most / self.current_unit) as i16)
        } else {
            let share = (most / self.stall.1).min(1.0);
            (X_SERIES.goal_pwm, (share * f64::from(FULL_PWM)) as i16)
        }
    }

    /// Whether current is measured and capped.
    pub fn has_current(&self) -> bool {
        self.current_unit > 0.0
    }

    /// Its operating mode: multi-turn, with a current cap if possible.
    pub fn driven_in(&self) -> u8 {
        if self.has_current() {
            mode::CURRENT_BASED_POSITION
        } else {
            mode::EXTENDED_POSITION
        }
    }

    /// Factory speed limit, ticks/s.
    pub fn fastest_turn(&self) -> f64 {
        f64::from(self.velocity_limit) * VELOCITY_STEP
    }

    /// The baud rates that it knows.
    pub fn baud_rates(&self) -> &'static [u32] {
        &BAUD_RATES[..=usize::from(self.fastest)]
    }

    /// The code of a baud rate in register 8, if it knows that.
    pub fn code_of(&self, baud: u32) -> Option<u8> {
        let code = self.baud_rates().iter().position(|rate| *rate == baud);
        code.map(|code| code as u8)
    }

    pub fn layout(&self) -> &'static Layout {
        &X_SERIES
    }
}

const fn x(
    number: u16,
    name: &'static str,
    fastest: u8,
    (current_unit, current_limit): (f64, u16),
    (temperature_limit, voltage): (u8, (f64, f64)),
    velocity_limit: u16,
    shutdown: u8,
    gains: (u16, u16, u16),
    stall: (f64, f64),
) -> Model {
    Model {
        number,
        name,
        fastest,
        current_unit,
        current_limit,
        temperature_limit,
        voltage,
        velocity_limit,
        shutdown,
        gains,
        stall,
    }
}

const SMALL: (u8, (f64, f64)) = (70, (3.5, 7.0));
const SMALL_12: (u8, (f64, f64)) = (70, (5.5, 14.0));
const LARGE: (u8, (f64, f64)) = (80, (9.5, 16.0));

// A table: a row each.
#[rustfmt::skip]
pub const MODELS: [Model; 11] = [
    x(1190, "XL330-M077", 6, (1.0, 1750), SMALL, 1620, 53, (400, 400, 0), (0.215, 1470.0)),
    x(1200, "XL330-M288", 6, (1.0, 1750), SMALL, 445, 53, (400, 0, 0), (0.52, 1470.0)),
    x(1230, "XC330-M181", 6, (1.0, 2352), SMALL, 545, 52, (1200, 0, 500), (0.6, 1800.0)),
    x(1240, "XC330-M288", 6, (1.0, 2352), SMALL, 350, 52, (1100, 0, 500), (0.93, 1800.0)),
    x(1210, "XC330-T181", 6, (1.0, 910), SMALL_12, 510, 52, (900, 0, 0), (0.76, 800.0)),
    x(1220, "XC330-T288", 6, (1.0, 910), SMALL_12, 320, 52, (900, 0, 0), (0.92, 800.0)),
    x(1060, "XL430-W250", 7, (0.0, 0), (72, (6.0, 14.0)), 265, 52, (640, 0, 4000), (1.5, 1400.0)),
    x(1030, "XM430-W210", 7, (2.69, 1193), LARGE, 330, 52, (800, 0, 0), (3.0, 2300.0)),
    x(1020, "XM430-W350", 7, (2.69, 1193), LARGE, 350, 52, (800, 0, 0), (4.1, 2300.0)),
    x(1130, "XM540-W150", 7, (2.69, 2047), LARGE, 230, 52, (800, 0, 0), (7.3, 4400.0)),
    x(1120, "XM540-W270", 7, (2.69, 2047), LARGE, 128, 52, (800, 0, 0), (10.6, 4400.0)),
];

/// The servo of a model number.
pub fn model(number: u16) -> Option<&'static Model> {
    MODELS.iter().find(|model| model.number == number)
}

#[cfg(test)]
#[path = "registers_tests.rs"]
mod tests;
