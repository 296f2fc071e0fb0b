//! Binding of the control loop's process.

use super::inverse::inverted;
use super::servo::trouble;
use crate::control::emergency::{Button, Emergency};
use crate::control::gpio::Gpio;
use crate::control::heartbeat::Heartbeat;
use crate::control::plan::Map;
use crate::control::{Setup, period, recording, serve};
use crate::effects::Chain;
use crate::inverse::chain::Inverse;
use pyo3::import_exception;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use softmap_servo::drive::Member;
use softmap_servo::guard::{self, Axis, Budget, Feedback, Guard, Health, Input, Limits, RANGES};
use softmap_servo::registers::model;
use std::os::fd::{FromRawFd, OwnedFd, RawFd};
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

import_exception!(softmap_edge.errors, LimitError);

fn value<'py>(from: &Bound<'py, PyDict>, name: &str) -> PyResult<Bound<'py, PyAny>> {
    from.get_item(name)?
        .ok_or_else(|| trouble(format!("the limit '{name}' is missing")))
}

fn number(from: &Bound<'_, PyDict>, name: &str) -> PyResult<f64> {
    value(from, name)?
        .extract()
        .map_err(|_| trouble(format!("the limit '{name}' is no number")))
}

fn pair(from: &Bound<'_, PyDict>, name: &str) -> PyResult<(f64, f64)> {
    let [low, high] = value(from, name)?
        .extract()
        .map_err(|_| trouble(format!("the limit '{name}' is no pair of numbers")))?;
    Ok((low, high))
}

fn whole(from: &Bound<'_, PyDict>, name: &str) -> PyResult<i32> {
    value(from, name)?
        .extract()
        .map_err(|_| trouble(format!("the limit '{name}' is no whole number")))
}

/// The limits of a dictionary, checked.
fn limits(from: &Bound<'_, PyDict>) -> PyResult<Limits> {
    let servos: Vec<Bound<'_, PyDict>> = from
        .get_item("servos")?
        .ok_or_else(|| trouble("the limits hold no 'servos'"))?
        .extract()
        .map_err(|_| trouble("the limits' 'servos' are no list of tables"))?;
    let axis = |one: &Bound<'_, PyDict>| {
        let current = match one.get_item("current")? {
            Some(value) if !value.is_none() => Some(number(one, "current")?),
            _ => None,
        };
        Ok(Axis {
            home: whole(one, "home")?,
            low: whole(one, "low")?,
            high: whole(one, "high")?,
            slew: number(one, "slew")?,
            acceleration: number(one, "acceleration")?,
            current,
            fastest: number(one, "fastest")?,
            following: number(one, "following")?,
            warm: number(one, "warm")?,
            hot: number(one, "hot")?,
            voltage: pair(one, "voltage")?,
        })
    };
    let limits = Limits {
        axes: servos.iter().map(axis).collect::<PyResult<_>>()?,
        period: number(from, "period")?,
        stale: number(from, "stale")?,
        hold: number(from, "hold")?,
        slacken: number(from, "slacken")?,
        late: number(from, "late")?,
        silent: number(from, "silent")?,
        grace: number(from, "grace")?,
        ramp: number(from, "ramp")?,
        jump: pair(from, "jump")?,
        jog_travel: number(from, "jog_travel")?,
        jog_slew: number(from, "jog_slew")?,
        jog_current: number(from, "jog_current")?,
        budget: Budget {
            band: number(from, "band")?,
            turns: number(from, "turns")?,
            burst: number(from, "burst")?,
        },
    };
    limits
        .checked()
        .map_err(|fault| LimitError::new_err((fault.text, fault.name, fault.servo)))
}

/// Lowest and highest value and unit of each limit by itself, by its name; `low` and `high` are
/// about home.
#[pyfunction]
pub fn limit_ranges(py: Python<'_>) -> PyResult<Bound<'_, PyDict>> {
    let ranges = PyDict::new(py);
    for (name, low, high, unit) in RANGES {
        ranges.set_item(name, (low, high, unit))?;
    }
    Ok(ranges)
}

/// Refuse limits that make no sense.
#[pyfunction]
pub fn check_limits(table: &Bound<'_, PyDict>) -> PyResult<()> {
    limits(table).map(drop)
}

/// The effects between commands and what acts.
fn through(from: &Bound<'_, PyDict>) -> PyResult<Inverse> {
    let missing = |name: &str| trouble(format!("the chain's '{name}' is missing"));
    let get = |name: &str| from.get_item(name)?.ok_or_else(|| missing(name));
    let low: Vec<f64> = get("low")?.extract()?;
    let chain = Chain::new(&get("names")?.extract::<Vec<String>>()?, low.len())?;
    let (params, gravity) = (get("params")?, get("gravity")?);
    // What is not known is not a number, which JSON has none of.
    let temperature: Option<f64> = get("temperature")?.extract()?;
    inverted(
        &chain,
        &params,
        low,
        get("high")?.extract()?,
        &gravity,
        get("load")?.extract()?,
        temperature.unwrap_or(f64::NAN),
    )
}

/// Run the control loop in this process until its orders end: `orders` and `reports` are
/// descriptors of pipes.
///
/// `servos` are (id, model number); `slope` (C, C) mm a tick, `b` (C,) mm and `home` (C,) ticks are
/// the calibration's; with a `chain` (names, params, low and high (C,) mm, gravity, load,
/// temperature) commands are what should act through it; emergency stops are `gpio` (chip, line,
/// pressed when low) and `heartbeat` (host, port, key, s between beats at most); `record` a file to
/// record to, `setup` the document that begins it.
#[pyfunction]
#[pyo3(signature = (orders, reports, *, port, baud, servos, limits, slope, b, home, chain=None, gpio=None, heartbeat=None, record=None, setup=""))]
pub fn control_loop(
    py: Python<'_>,
    orders: RawFd,
    reports: RawFd,
    port: String,
    baud: u32,
    servos: Vec<[u16; 2]>,
    limits: &Bound<'_, PyDict>,
    slope: Vec<f64>,
    b: Vec<f64>,
    home: Vec<f64>,
    chain: Option<&Bound<'_, PyDict>>,
    gpio: Option<(String, u32, bool)>,
    heartbeat: Option<(String, u16, Vec<u8>, f64)>,
    record: Option<PathBuf>,
    setup: &str,
) -> PyResult<bool> {
    let member = |[id, number]: [u16; 2]| {
        let id = u8::try_from(id).map_err(|_| trouble(format!("servo id {id} is beyond 252")))?;
        let model = model(number)
            .ok_or_else(|| trouble(format!("no servo of model number {number} is known")))?;
        Ok(Member { id, model })
    };
    let button = gpio
        .map(|(chip, line, low)| {
            Gpio::open(&chip, line).map(|line| Button::new(Box::new(line), low))
        })
        .transpose()
        .map_err(trouble)?;
    let heart = heartbeat
        .map(|(host, port, key, timeout)| Heartbeat::open(&host, port, &key, timeout))
        .transpose()
        .map_err(trouble)?;
    let made = Setup {
        stops: Emergency::new(button, heart),
        record: record.map(|path| (path, setup.to_owned())),
        port,
        baud,
        members: servos.into_iter().map(member).collect::<PyResult<_>>()?,
        limits: self::limits(limits)?,
    };
    let chain = chain.map(through).transpose()?;
    let plan = Map::new(slope, b, home, chain, made.limits.period)?;
    // SAFETY: the caller opened both for this loop alone and hands them over.
    let (orders, reports) =
        unsafe { (OwnedFd::from_raw_fd(orders), OwnedFd::from_raw_fd(reports)) };
    py.detach(|| serve(made, plan, orders, reports))
        .map_err(trouble)
}

/// A recording that is read while it grows.
#[pyclass(name = "Reading", module = "softmap_edge._core", frozen)]
pub struct PyReading {
    reading: Mutex<recording::Reading>,
}

#[pymethods]
impl PyReading {
    /// Begin to read `path`.
    #[new]
    fn new(path: PathBuf) -> PyResult<PyReading> {
        let reading = Mutex::new(recording::Reading::open(&path)?);
        Ok(PyReading { reading })
    }

    /// The messages (topic, ns, bytes) that are complete and new, and whether the writer has
    /// closed it.
    fn more<'py>(&self, py: Python<'py>) -> PyResult<(Vec<Message<'py>>, bool)> {
        let mut found = vec![];
        let ended = py.detach(|| {
            let mut reading = self.reading.lock().unwrap_or_else(PoisonError::into_inner);
            reading.more(&mut found).map(|()| reading.ended())
        })?;
        Ok((messages(py, found), ended))
    }
}

/// A message: topic, ns, bytes.
type Message<'py> = (String, u64, Bound<'py, PyBytes>);

fn messages(py: Python<'_>, found: Vec<recording::Message>) -> Vec<Message<'_>> {
    let one = |(topic, now, bytes): recording::Message| (topic, now, PyBytes::new(py, &bytes));
    found.into_iter().map(one).collect()
}

/// The messages (topic, ns, bytes) of a recording, those before the cut of one that was cut short.
#[pyfunction]
pub fn read_recording(py: Python<'_>, path: PathBuf) -> PyResult<Vec<Message<'_>>> {
    let found = py.detach(|| recording::read(&path))?;
    Ok(messages(py, found))
}

/// One servo's feedback of a period: position, clock, current, voltage, temperature, and (hardware,
/// torque, tripped).
type Sensed = (i32, u16, Option<f64>, f64, f64, Option<(u8, bool, bool)>);
/// A period: now, feedback, whether the enable key was pressed if known, targets, whether they
/// are new, request, emergency.
type Told = (
    u64,
    Vec<Option<Sensed>>,
    Option<bool>,
    Option<Vec<f64>>,
    bool,
    Option<String>,
    bool,
);

/// The decision of a period: state, cause, torque, goals.
type Decided = (String, String, bool, Vec<i32>);

/// Let a guard of `table` decide `periods` again; state, cause, torque, and goals of each.
#[pyfunction]
pub fn replay(
    py: Python<'_>,
    table: &Bound<'_, PyDict>,
    periods: Vec<Told>,
) -> PyResult<Vec<Decided>> {
    let limits = limits(table)?;
    let count = limits.axes.len();
    if let Some(period) = periods.iter().find(|period| period.1.len() != count) {
        return Err(trouble(format!(
            "a period with {} servos, the limits are of {count}",
            period.1.len()
        )));
    }
    Ok(py.detach(|| {
        let mut guard = Guard::new(limits);
        let decide = |(now, sensed, deadman, targets, new, request, emergency): &Told| {
            let feedback: Vec<_> = sensed.iter().map(|one| one.map(feedback)).collect();
            let output = guard.tick(&Input {
                now: *now,
                feedback: &feedback,
                message: deadman.map(|deadman| guard::Message {
                    deadman,
                    goal: targets.as_deref().filter(|_| *new),
                }),
                again: targets.as_deref().filter(|_| !*new),
                request: request.as_deref().and_then(recording::request),
                emergency: *emergency,
            });
            (
                period::name(output.state),
                period::name(output.cause),
                output.torque,
                guard.goals().to_vec(),
            )
        };
        periods.iter().map(decide).collect()
    }))
}

fn feedback((position, clock, current, voltage, temperature, health): Sensed) -> Feedback {
    Feedback {
        position,
        clock,
        current,
        voltage,
        temperature,
        health: health.map(|(hardware, torque, tripped)| Health {
            hardware,
            torque,
            tripped,
        }),
    }
}
