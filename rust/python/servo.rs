//! Binding of the servo crate: packets, the bus, and the emulated one.

use pyo3::import_exception;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use softmap_servo::bus::{Bus, Fault, SLACK};
use softmap_servo::decoder::Decoder;
use softmap_servo::opened::Opened;
use softmap_servo::packet::{LONGEST, packet};
use softmap_servo::registers::{FULL_PWM, MODELS};
use softmap_servo::serial::OpenFault;
use std::sync::{Mutex, PoisonError};

import_exception!(softmap_edge.errors, NoAnswer);
import_exception!(softmap_edge.errors, NoSuchRate);
import_exception!(softmap_edge.errors, PortLost);
import_exception!(softmap_edge.errors, ServoError);

pub fn trouble(fault: impl ToString) -> PyErr {
    ServoError::new_err(fault.to_string())
}

/// The packet that asks `id` for `instruction` with `parameters`.
#[pyfunction]
pub fn servo_packet<'py>(
    py: Python<'py>,
    id: u8,
    instruction: u8,
    parameters: &[u8],
) -> PyResult<Bound<'py, PyBytes>> {
    let mut buffer = [0; LONGEST];
    let sent = packet(&mut buffer, id, instruction, parameters).map_err(trouble)?;
    Ok(PyBytes::new(py, sent))
}

/// The packets (id, instruction, parameters) in a stream of bytes.
#[pyfunction]
pub fn servo_packets<'py>(py: Python<'py>, stream: &[u8]) -> Vec<(u8, u8, Bound<'py, PyBytes>)> {
    let mut decoder = Decoder::default();
    let mut found = vec![];
    for bytes in stream.chunks(LONGEST) {
        decoder.push(bytes);
        while let Some(packet) = decoder.next(LONGEST) {
            found.push((
                packet.id,
                packet.instruction,
                PyBytes::new(py, packet.parameters),
            ));
        }
    }
    found
}

/// Names and numbers of each servo that is known.
#[pyfunction]
pub fn servo_models<'py>(py: Python<'py>) -> PyResult<Vec<Bound<'py, PyDict>>> {
    let one = |model: &softmap_servo::registers::Model| {
        let row = PyDict::new(py);
        row.set_item("name", model.name)?;
        row.set_item("number", model.number)?;
        row.set_item("baud_rates", model.baud_rates())?;
        row.set_item(
            "current_unit_mA",
            model.has_current().then_some(model.current_unit),
        )?;
        row.set_item(
            "current_limit_mA",
            model
                .has_current()
                .then_some(model.current_unit * f64::from(model.current_limit)),
        )?;
        row.set_item("temperature_limit_C", model.temperature_limit)?;
        row.set_item("voltage_V", model.voltage)?;
        row.set_item("fastest_ticks_per_s", model.fastest_turn())?;
        row.set_item("stall_torque_Nm", model.stall.0)?;
        row.set_item("stall_current_mA", model.stall.1)?;
        row.set_item(
            "capped_by",
            model.cap(0.0).0.name.replace(' ', "_").to_lowercase(),
        )?;
        row.set_item("operating_mode", model.driven_in())?;
        row.set_item("current_limit", model.current_limit)?;
        row.set_item("velocity_limit", model.velocity_limit)?;
        row.set_item("pwm_limit", FULL_PWM)?;
        row.set_item("shutdown", model.shutdown)?;
        row.set_item("position_gains", model.gains)?;
        Ok(row)
    };
    MODELS.iter().map(one).collect()
}

/// Address, size and whether it is kept without power, of each register that is used, by its name.
#[pyfunction]
pub fn servo_registers<'py>(py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
    let told = PyDict::new(py);
    for register in softmap_servo::registers::X_SERIES.all() {
        let name = register.name.replace(' ', "_").to_lowercase();
        told.set_item(name, (register.address, register.size, register.eeprom))?;
    }
    Ok(told)
}

/// A bus of servos at a serial port, for setting up; no other program can open the port meanwhile.
#[pyclass(name = "ServoBus", module = "softmap_edge._core", frozen)]
pub struct PyServoBus {
    bus: Mutex<Option<Bus<Opened>>>,
    /// The device, and its rate.
    #[pyo3(get)]
    port: String,
    #[pyo3(get)]
    baud: u32,
}

impl PyServoBus {
    fn ask<T: Send>(
        &self,
        py: Python<'_>,
        what: impl FnOnce(&mut Bus<Opened>) -> Result<T, Fault> + Send,
    ) -> PyResult<T> {
        let done = py.detach(|| {
            let mut bus = self.bus.lock().unwrap_or_else(PoisonError::into_inner);
            bus.as_mut().map(what)
        });
        done.ok_or_else(|| PortLost::new_err("the port is closed; open it again"))?
            .map_err(|fault| match fault {
                Fault::Silent => NoAnswer::new_err(fault.to_string()),
                Fault::Port(_) => PortLost::new_err(fault.to_string()),
                other => trouble(other),
            })
    }
}

#[pymethods]
impl PyServoBus {
    /// Open `port` at `baud`; `slack` is how long (s) an answer may take beyond its bytes.
    #[new]
    #[pyo3(signature = (port, baud, slack=0.02))]
    fn new(port: &str, baud: u32, slack: f64) -> PyResult<PyServoBus> {
        if !(0.0005..=1.0).contains(&slack) {
            return Err(trouble(format!(
                "slack is {slack} s; allowed is 0.0005 to 1 s"
            )));
        }
        let opened = Opened::open(port, baud).map_err(|fault| match fault {
            OpenFault::Baud(..) => NoSuchRate::new_err(fault.to_string()),
            other => trouble(other),
        })?;
        let bus = Bus::new(opened, baud, ((slack * 1e9) as u64).max(SLACK / 4));
        Ok(PyServoBus {
            bus: Mutex::new(Some(bus)),
            port: port.to_owned(),
            baud,
        })
    }

    /// Close the port.
    fn close(&self, py: Python<'_>) {
        py.detach(|| {
            drop(
                self.bus
                    .lock()
                    .unwrap_or_else(PoisonError::into_inner)
                    .take(),
            )
        });
    }

    /// Counts of answers so far: asked for, silent, damaged, late, unasked (of another program, or
    /// of a second servo with the same id), and bytes that belonged to no packet (skipped).
    fn counts<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let counts = self.ask(py, |bus| Ok(bus.counts()))?;
        let told = PyDict::new(py);
        for (name, count) in [
            ("asked", counts.asked),
            ("silent", counts.silent),
            ("damaged", counts.damaged),
            ("late", counts.late),
            ("unasked", counts.unasked),
            ("skipped", counts.skipped),
        ] {
            told.set_item(name, count)?;
        }
        Ok(told)
    }

    /// Model number and firmware of a servo; None if it does not answer.
    fn ping(&self, py: Python<'_>, id: u8) -> PyResult<Option<(u16, u8)>> {
        self.ask(py, |bus| match bus.ping(id) {
            Err(Fault::Silent) => Ok(None),
            other => other.map(Some),
        })
    }

    /// Every servo (id, model number, firmware) that answers at this rate; takes some seconds.
    fn scan(&self, py: Python<'_>) -> PyResult<Vec<(u8, u16, u8)>> {
        self.ask(py, |bus| {
            let mut found = vec![];
            bus.ping_all(|id, number, firmware| found.push((id, number, firmware)))?;
            Ok(found)
        })
    }

    /// `size` bytes from `address` on.
    fn read<'py>(
        &self,
        py: Python<'py>,
        id: u8,
        address: u16,
        size: usize,
    ) -> PyResult<Bound<'py, PyBytes>> {
        if !(1..=256).contains(&size) {
            return Err(trouble(format!(
                "{size} bytes of registers; allowed are 1 to 256"
            )));
        }
        let mut data = vec![0; size];
        self.ask(py, |bus| bus.read(id, address, &mut data))?;
        Ok(PyBytes::new(py, &data))
    }

    /// Write bytes from `address` on.
    fn write(&self, py: Python<'_>, id: u8, address: u16, data: &[u8]) -> PyResult<()> {
        self.ask(py, |bus| bus.write(id, address, data).map(drop))
    }

    /// Restart a servo: turns and RAM are lost.
    fn reboot(&self, py: Python<'_>, id: u8) -> PyResult<()> {
        self.ask(py, |bus| bus.reboot(id).map(drop))
    }

    /// Set the present position back to within one turn.
    fn clear_turns(&self, py: Python<'_>, id: u8) -> PyResult<()> {
        self.ask(py, |bus| bus.clear_turns(id).map(drop))
    }

    /// Switch the torque of every servo off, whether or not it answers.
    fn release(&self, py: Python<'_>) -> PyResult<()> {
        self.ask(py, Bus::release)
    }
}
