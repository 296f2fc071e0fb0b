//! Binding of the control loop's process.

use super::servo::trouble;
use crate::control::plan::Linear;
use crate::control::{Setup, serve};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use softmap_servo::drive::Member;
use softmap_servo::guard::reversals::Budget;
use softmap_servo::guard::{Axis, Limits};
use softmap_servo::registers::model;
use std::os::fd::{FromRawFd, OwnedFd, RawFd};

fn number(from: &Bound<'_, PyDict>, name: &str) -> PyResult<f64> {
    let value = from
        .get_item(name)?
        .ok_or_else(|| trouble(format!("the limit '{name}' is missing")))?;
    value
        .extract()
        .map_err(|_| trouble(format!("the limit '{name}' is no number")))
}

fn pair(from: &Bound<'_, PyDict>, name: &str) -> PyResult<(f64, f64)> {
    let value = from
        .get_item(name)?
        .ok_or_else(|| trouble(format!("the limit '{name}' is missing")))?;
    let [low, high] = value
        .extract()
        .map_err(|_| trouble(format!("the limit '{name}' is no pair of numbers")))?;
    Ok((low, high))
}

fn whole(from: &Bound<'_, PyDict>, name: &str) -> PyResult<i32> {
    let value = from
        .get_item(name)?
        .ok_or_else(|| trouble(format!("the limit '{name}' is missing")))?;
    value
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
    };
    limits.checked().map_err(trouble)
}

/// Refuse limits that make no sense.
#[pyfunction]
pub fn check_limits(table: &Bound<'_, PyDict>) -> PyResult<()> {
    limits(table).map(drop)
}

/// Run the control loop in this process until its orders end: `orders` and `reports` are descriptors of pipes.
///
/// `servos` are (id, model number); `inverse` (C, C) ticks a mm, `b` (C,) mm and `home` (C,) ticks are the calibration's;
/// `budget` is that of reversals: band (mm), turns a second, turns at once.
#[pyfunction]
#[pyo3(signature = (orders, reports, *, port, baud, servos, limits, inverse, b, home, budget, fast=true, slack=0.002))]
pub fn control_loop(
    py: Python<'_>,
    orders: RawFd,
    reports: RawFd,
    port: String,
    baud: u32,
    servos: Vec<[u16; 2]>,
    limits: &Bound<'_, PyDict>,
    inverse: Vec<f64>,
    b: Vec<f64>,
    home: Vec<f64>,
    budget: [f64; 3],
    fast: bool,
    slack: f64,
) -> PyResult<()> {
    let member = |[id, number]: [u16; 2]| {
        let id = u8::try_from(id).map_err(|_| trouble(format!("servo id {id} is beyond 252")))?;
        let model = model(number)
            .ok_or_else(|| trouble(format!("no servo of model number {number} is known")))?;
        Ok(Member { id, model })
    };
    let setup = Setup {
        port,
        baud,
        members: servos.into_iter().map(member).collect::<PyResult<_>>()?,
        fast,
        slack,
        limits: self::limits(limits)?,
        budget: Budget {
            band: budget[0],
            rate: budget[1],
            burst: budget[2],
        },
    };
    let plan = Linear::new(inverse, b, home)?;
    // SAFETY: the caller opened both for this loop alone and hands them over.
    let (orders, reports) =
        unsafe { (OwnedFd::from_raw_fd(orders), OwnedFd::from_raw_fd(reports)) };
    py.detach(|| serve(setup, plan, orders, reports))
        .map_err(trouble)
}
