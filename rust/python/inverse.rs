//! Binding of inverse kinematics.

use super::arrays::floats;
use super::effects::{PyChain, Value, one_set, vector};
use super::shape::PyShape;
use crate::effects::{Chain, Context};
use crate::inverse::chain::Inverse;
use crate::inverse::published;
use crate::inverse::solve::{Found, Reach};
use crate::{Error, Result};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods};
use pyo3::prelude::*;

type Row<'py> = Bound<'py, PyArray1<f64>>;
type Rows<'py> = Bound<'py, PyArray2<f64>>;
/// Effective commands (T, C), the tip (T, 3), mm to the targets (T,), how often the tip was asked
/// (T,).
type Path<'py> = (Rows<'py>, Rows<'py>, Row<'py>, Bound<'py, PyArray1<i64>>);

/// Where a tip (a shape of three outputs) can go while what acts stays within `low` and `high` (C,)
/// mm.
#[pyclass(name = "Reach", module = "softmap_edge._core", frozen)]
pub struct PyReach {
    reach: Reach,
}

#[pymethods]
impl PyReach {
    /// Only the `axes` (3,) of a target count.
    #[new]
    fn new(
        py: Python<'_>,
        shape: PyRef<'_, PyShape>,
        low: Vec<f64>,
        high: Vec<f64>,
        axes: [bool; 3],
    ) -> PyResult<PyReach> {
        let inner = shape.inner.clone();
        let reach = py.detach(|| Reach::new(inner, low, high, axes))?;
        Ok(PyReach { reach })
    }

    /// Places (S, 3) that were looked at beforehand, and what acts there (S, C).
    #[getter]
    fn samples<'py>(&self, py: Python<'py>) -> PyResult<(Rows<'py>, Rows<'py>)> {
        let (u, places) = self.reach.looked_at();
        let count = places.len() / 3;
        let u = u.to_vec().into_pyarray(py);
        Ok((
            places.to_vec().into_pyarray(py).reshape([count, 3])?,
            u.reshape([count, self.reach.channels()])?,
        ))
    }

    /// Effective commands (T, C) with the tip nearest to each of `targets` (T, 3), one after the
    /// other, the first after `start` (C,): also places (T, 3), distances (T,) mm, and how often
    /// the tip was asked (T,). `published` is the paper's way.
    #[pyo3(signature = (targets, start=None, published=false))]
    fn path<'py>(
        &self,
        py: Python<'py>,
        targets: Value<'_, 'py>,
        start: Option<Vec<f64>>,
        published: bool,
    ) -> PyResult<Path<'py>> {
        let targets = floats("targets", targets, &[("T", None), ("xyz", Some(3))])?.data;
        let channels = self.reach.channels();
        if let Some(start) = start.as_ref().filter(|start| start.len() != channels) {
            let said = format!("a start of {} numbers, expected {channels}", start.len());
            return Err(Error::Invalid(said).into());
        }
        let reach = &self.reach;
        let found: Vec<Found> = py.detach(|| match published {
            true => self::published::path(reach, &targets),
            false => reach.path(&targets, start.as_deref()),
        });
        let count = found.len();
        let column = |of: &dyn Fn(&Found) -> f64| -> Vec<f64> { found.iter().map(of).collect() };
        let asked: Vec<i64> = found.iter().map(|f| f.asked as i64).collect();
        let u: Vec<f64> = found.iter().flat_map(|f| f.u.iter().copied()).collect();
        let places: Vec<f64> = found.iter().flat_map(|f| f.place).collect();
        Ok((
            u.into_pyarray(py).reshape([count, channels])?,
            places.into_pyarray(py).reshape([count, 3])?,
            column(&|f| f.distance).into_pyarray(py),
            asked.into_pyarray(py),
        ))
    }
}

/// What must be commanded so that a certain command acts: a chain without its delays, inverted one
/// sample at a time.
#[pyclass(name = "Inverse", module = "softmap_edge._core")]
pub struct PyInverse {
    inverse: Inverse,
}

/// A chain inverted in a world of gravity (3,), load (g) and temperature (°C), its commands within
/// `low` and `high` (C,).
pub(super) fn inverted(
    chain: &Chain,
    params: Value<'_, '_>,
    low: Vec<f64>,
    high: Vec<f64>,
    gravity: Value<'_, '_>,
    load: f64,
    temperature: f64,
) -> PyResult<Inverse> {
    let params = one_set(chain, params)?;
    let context = Context {
        t: 0.0,
        dt: 0.0,
        gravity: vector("gravity", gravity)?,
        load,
        temperature,
        seen_for: 0.0,
    };
    Ok(Inverse::new(chain, &params, low, high, context)?)
}

#[pymethods]
impl PyInverse {
    #[new]
    #[pyo3(signature = (chain, params, low, high, gravity, load=0.0, temperature=f64::NAN))]
    fn new(
        chain: PyRef<'_, PyChain>,
        params: Value<'_, '_>,
        low: Vec<f64>,
        high: Vec<f64>,
        gravity: Value<'_, '_>,
        load: f64,
        temperature: f64,
    ) -> PyResult<PyInverse> {
        let inverse = inverted(&chain.chain, params, low, high, gravity, load, temperature)?;
        Ok(PyInverse { inverse })
    }

    /// Begin in equilibrium with `u` (C,) held forever; what acts then (C,).
    fn settle<'py>(&mut self, py: Python<'py>, u: Value<'_, 'py>) -> PyResult<Row<'py>> {
        let u = self.commands(u)?;
        Ok(self.inverse.settle(&u).to_vec().into_pyarray(py))
    }

    /// The command (C,) that makes `wanted` (C,) act `dt` seconds after the last one, and by how
    /// much (mm) it misses.
    fn command<'py>(
        &mut self,
        py: Python<'py>,
        wanted: Value<'_, 'py>,
        dt: f64,
    ) -> PyResult<(Row<'py>, f64)> {
        let (wanted, dt) = (self.commands(wanted)?, seconds(dt)?);
        let mut command = vec![0.0; wanted.len()];
        let missed = self.inverse.command(&wanted, dt, &mut command);
        Ok((command.into_pyarray(py), missed))
    }

    /// `u` (C,) has been commanded for `dt` seconds; what it makes act (C,).
    fn passed<'py>(&mut self, py: Python<'py>, u: Value<'_, 'py>, dt: f64) -> PyResult<Row<'py>> {
        let (u, dt) = (self.commands(u)?, seconds(dt)?);
        Ok(self.inverse.passed(&u, dt).to_vec().into_pyarray(py))
    }

    /// One after the other: commands (T, C) that make `wanted` (T, C) act at times `t` (T,) s, and
    /// what they make act (T, C).
    fn path<'py>(
        &mut self,
        py: Python<'py>,
        wanted: Value<'_, 'py>,
        t: Value<'_, 'py>,
    ) -> PyResult<(Rows<'py>, Rows<'py>)> {
        let t = floats("t", t, &[("T", None)])?.data;
        let channels = self.inverse.channels();
        let axes = [("T", Some(t.len())), ("C", Some(channels))];
        let wanted = floats("wanted", wanted, &axes)?.data;
        let (mut commands, mut acts) = (vec![0.0; wanted.len()], Vec::with_capacity(wanted.len()));
        let mut before = t.first().copied().unwrap_or(0.0);
        let rows = wanted
            .chunks_exact(channels.max(1))
            .zip(commands.chunks_exact_mut(channels.max(1)));
        for ((wanted, command), t) in rows.zip(&t) {
            let dt = seconds(t - before)?;
            self.inverse.command(wanted, dt, command);
            acts.extend_from_slice(self.inverse.passed(command, dt));
            before = *t;
        }
        let shape = [t.len(), channels];
        Ok((
            commands.into_pyarray(py).reshape(shape)?,
            acts.into_pyarray(py).reshape(shape)?,
        ))
    }
}

impl PyInverse {
    fn commands(&self, u: Value<'_, '_>) -> PyResult<Vec<f64>> {
        Ok(floats("u", u, &[("C", Some(self.inverse.channels()))])?.data)
    }
}

fn seconds(dt: f64) -> Result<f64> {
    if dt >= 0.0 && dt.is_finite() {
        return Ok(dt);
    }
    Err(Error::Invalid(format!(
        "{dt} s since the last command; times must be finite and not run backwards"
    )))
}
