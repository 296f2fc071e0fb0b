//! Binding of the emulated bus: servos at a pseudo-terminal, and what is broken about them.

use super::servo::trouble;
use pyo3::prelude::*;
use softmap_servo::emulator::pty::Terminal;
use softmap_servo::emulator::servo::{Motion, Servo};
use softmap_servo::emulator::simulated::Simulated;
use softmap_servo::emulator::{Emulator, Faults};
use softmap_servo::packet::HIGHEST_ID;
use softmap_servo::registers::model;
use softmap_servo::serial::monotonic;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Where servos are served: at a pseudo-terminal in real time, or at a socket in simulated time.
enum Place {
    Real(Terminal),
    Simulated(Simulated),
}

impl Place {
    fn path(&self) -> &str {
        match self {
            Place::Real(at) => at.path(),
            Place::Simulated(at) => at.path(),
        }
    }

    fn emulator(&self) -> MutexGuard<'_, Emulator> {
        match self {
            Place::Real(at) => at.emulator(),
            Place::Simulated(at) => at.emulator(),
        }
    }

    fn unplug(&mut self) {
        match self {
            Place::Real(at) => at.unplug(),
            Place::Simulated(at) => at.unplug(),
        }
    }

    fn now(&self) -> u64 {
        match self {
            Place::Real(_) => monotonic(),
            Place::Simulated(at) => at.now(),
        }
    }
}

/// Servos with a tendon behind each, and faults on command: at a pseudo-terminal, or `simulated` at
/// a socket, where time passes as their master takes steps (`hold`, `advance`).
#[pyclass(name = "EmulatedBus", module = "softmap_edge._core", frozen)]
pub struct PyEmulatedBus {
    terminal: Mutex<Place>,
}

impl PyEmulatedBus {
    fn terminal(&self) -> MutexGuard<'_, Place> {
        self.terminal.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Run an operation on simulated time without the interpreter lock.
    fn clock<T: Send>(
        &self,
        py: Python<'_>,
        act: impl FnOnce(&Simulated) -> T + Send,
    ) -> PyResult<T> {
        py.detach(|| match &*self.terminal() {
            Place::Simulated(at) => Ok(act(at)),
            Place::Real(_) => Err(trouble(
                "these servos live in real time; give simulated=True",
            )),
        })
    }

    fn with<T>(&self, servo: usize, act: impl FnOnce(&mut Servo) -> T) -> PyResult<T> {
        let terminal = self.terminal();
        let mut emulator = terminal.emulator();
        let count = emulator.servos.len();
        let found = emulator.servos.get_mut(servo).map(act);
        found.ok_or_else(|| trouble(format!("no servo {servo}; there are 0 to {}", count - 1)))
    }
}

#[pymethods]
impl PyEmulatedBus {
    /// `servos` are (id, model number, baud rate, ticks of the horn); `delay` and `lag` in s;
    /// `load` are (ticks, mA) of each, ascending.
    #[new]
    #[pyo3(signature = (servos, load, *, delay=0.02, lag=0.04, seed=0, simulated=false))]
    fn new(
        servos: Vec<(u8, u16, u32, f64)>,
        load: Vec<Vec<(f64, f64)>>,
        delay: f64,
        lag: f64,
        seed: u64,
        simulated: bool,
    ) -> PyResult<PyEmulatedBus> {
        let times = [delay, lag].iter().all(|time| (0.0..=1.0).contains(time));
        if servos.is_empty() || servos.len() != load.len() || !times {
            return Err(trouble(format!(
                "{} servos with {} loads, delay {delay} s, lag {lag} s; one load a servo and times \
                from 0 to 1 s are allowed",
                servos.len(),
                load.len()
            )));
        }
        let mut made = vec![];
        for ((id, number, baud, angle), load) in servos.into_iter().zip(load) {
            let kind = model(number)
                .ok_or_else(|| trouble(format!("no servo of model number {number} is known")))?;
            let code = kind
                .code_of(baud)
                .ok_or_else(|| trouble(format!("{} has no rate of {baud} baud", kind.name)))?;
            if id > HIGHEST_ID
                || !angle.is_finite()
                || load
                    .iter()
                    .any(|(tick, drawn)| !tick.is_finite() || !drawn.is_finite())
            {
                return Err(trouble(format!(
                    "servo id {id} at {angle} ticks: ids go to {HIGHEST_ID}, numbers are finite"
                )));
            }
            made.push(Servo::new(
                kind,
                id,
                code,
                angle,
                Motion { delay, lag, load },
            ));
        }
        let emulator = Emulator::new(made, 57_600, seed);
        let place = if simulated {
            Place::Simulated(Simulated::open(emulator, monotonic()).map_err(unserved)?)
        } else {
            Place::Real(Terminal::open(emulator).map_err(trouble)?)
        };
        Ok(PyEmulatedBus {
            terminal: Mutex::new(place),
        })
    }

    /// The device to open.
    #[getter]
    fn path(&self) -> String {
        self.terminal().path().to_owned()
    }

    /// What the wire does to answers: chances that one is lost, damaged or follows junk, s that it
    /// is late, and no power.
    #[pyo3(signature = (*, drop=0.0, damage=0.0, junk=0.0, slow=0.0, unpowered=false))]
    fn faults(
        &self,
        drop: f64,
        damage: f64,
        junk: f64,
        slow: f64,
        unpowered: bool,
    ) -> PyResult<()> {
        if ![drop, damage, junk, slow]
            .iter()
            .all(|share| (0.0..=1.0).contains(share))
        {
            return Err(trouble(
                "faults are chances from 0 to 1, and slow from 0 to 1 s",
            ));
        }
        self.terminal().emulator().set_faults(Faults {
            drop,
            damage,
            junk,
            slow,
            unpowered,
        });
        Ok(())
    }

    /// Break a servo, or mend it: it is mute, its encoder stands, its tendon is torn or wound the
    /// other way, its horn is blocked, it does not keep to its current cap. What is not given stays
    /// as it is.
    #[pyo3(signature = (servo, *, mute=None, stuck=None, torn=None, reversed=None, jammed=None, uncapped=None))]
    fn damage(
        &self,
        servo: usize,
        mute: Option<bool>,
        stuck: Option<bool>,
        torn: Option<bool>,
        reversed: Option<bool>,
        jammed: Option<bool>,
        uncapped: Option<bool>,
    ) -> PyResult<()> {
        self.with(servo, |servo| {
            let broken = &mut servo.broken;
            for (flag, given) in [
                (&mut broken.mute, mute),
                (&mut broken.stuck, stuck),
                (&mut broken.torn, torn),
                (&mut broken.reversed, reversed),
                (&mut broken.jammed, jammed),
                (&mut broken.uncapped, uncapped),
            ] {
                *flag = given.unwrap_or(*flag);
            }
        })
    }

    /// Make a servo's load so many times as heavy as it was.
    fn burden(&self, servo: usize, factor: f64) -> PyResult<()> {
        if !(0.0..=100.0).contains(&factor) {
            return Err(trouble(format!(
                "a load {factor} times as heavy; allowed is 0 to 100"
            )));
        }
        self.with(servo, |servo| servo.burden(factor))
    }

    /// Let a servo count a turn too few from now on.
    fn lose_turn(&self, servo: usize) -> PyResult<()> {
        self.with(servo, Servo::lose_turn)
    }

    /// Exchange the ids of two servos.
    fn swap(&self, one: usize, other: usize) -> PyResult<()> {
        self.with(one, |_| ())?;
        self.with(other, |_| ())?;
        self.terminal().emulator().swap(one, other);
        Ok(())
    }

    /// Make everything as it was mounted: nothing is broken, ids and horns are as they were, the
    /// servos have just started.
    fn mend(&self) {
        self.terminal().emulator().mend();
    }

    /// Reset a servo, as a dip of its supply does.
    fn reset(&self, servo: usize) -> PyResult<()> {
        self.with(servo, Servo::boot)
    }

    /// Let a servo report hardware errors (bits of register 70).
    fn fail(&self, servo: usize, bits: u8) -> PyResult<()> {
        self.with(servo, |servo| servo.fail(bits))
    }

    /// Set a servo's temperature, °C.
    fn heat(&self, servo: usize, temperature: f64) -> PyResult<()> {
        self.with(servo, |servo| servo.heat(temperature))
    }

    /// Set a servo's supply, V.
    fn supply(&self, servo: usize, volts: f64) -> PyResult<()> {
        self.with(servo, |servo| servo.supply(volts))
    }

    /// Give a servo another id.
    fn rename(&self, servo: usize, id: u8) -> PyResult<()> {
        self.with(servo, |servo| servo.set_id(id))
    }

    /// Give a servo another firmware: old ones lack instructions.
    fn flash(&self, servo: usize, firmware: u8) -> PyResult<()> {
        self.with(servo, |servo| servo.set_firmware(firmware))
    }

    /// Pull the plug of the port.
    fn unplug(&self, py: Python<'_>) {
        py.detach(|| self.terminal().unplug());
    }

    /// The time (s, monotonic clock), and of each servo how far its horn has turned (ticks),
    /// whether it has torque, whether its watchdog tripped, and how its horn pulls: 1 as it should,
    /// -1 the wrong way, 0 for a torn tendon.
    fn state(&self) -> (f64, Vec<(f64, bool, bool, f64)>) {
        let terminal = self.terminal();
        let now = terminal.now();
        let emulator = terminal.emulator();
        let one = |servo: &Servo| {
            (
                servo.angle(),
                servo.torque(),
                servo.tripped(),
                servo.broken.pull(),
            )
        };
        (now as f64 * 1e-9, emulator.servos.iter().map(one).collect())
    }
    /// The time (ns) of simulated servos.
    fn now(&self, py: Python<'_>) -> PyResult<u64> {
        self.clock(py, Simulated::now)
    }

    /// Let simulated time stand at `at` ns, counted from 0, until `advance` grants more.
    fn hold(&self, py: Python<'_>, at: u64) -> PyResult<()> {
        self.clock(py, |time| time.hold(at))
    }

    /// Grant simulated time up to `until` ns and wait, `most` s at most, until the loop has used it
    /// up; whether it has.
    fn advance(&self, py: Python<'_>, until: u64, most: f64) -> PyResult<bool> {
        self.clock(py, |time| time.advance(until, seconds(most)))
    }

    /// Let stepped time run freely, or stop it; returns the time (ns).
    fn free(&self, py: Python<'_>, free: bool) -> PyResult<u64> {
        self.clock(py, |time| time.free(free))
    }

    /// Paced time goes on for `window` s more, without one whatever happens; s for which the
    /// computer was too busy so far.
    fn there(&self, py: Python<'_>, window: Option<f64>) -> PyResult<f64> {
        self.clock(py, |time| time.there(window.map(seconds)).as_secs_f64())
    }

    /// Whether a loop waits for simulated time to go on.
    fn waiting(&self, py: Python<'_>) -> PyResult<bool> {
        self.clock(py, Simulated::waiting)
    }
}

fn seconds(time: f64) -> Duration {
    Duration::from_secs_f64(time.clamp(0.0, 1e6))
}

fn unserved(fault: std::io::Error) -> PyErr {
    trouble(format!(
        "no socket for simulated servos ({fault}); see that the folder for temporary files can be \
        written (TMPDIR)"
    ))
}
