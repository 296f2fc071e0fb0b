//! Binding of every shape: evaluation and slopes of a batch of commands, outside the interpreter's
//! lock.

use super::arrays::floats;
use crate::Error;
use crate::memory::zeros;
use crate::network::COLUMNS;
use crate::shape::projected::Projected;
use crate::shape::{Shape, Sum, Work};
use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray2,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use rayon::prelude::*;
use std::sync::Arc;

/// Commands that one thread takes at a time.
const TOGETHER: usize = COLUMNS;

/// A map from commands to numbers; `Rod` and `RodField` are of this kind.
#[pyclass(name = "Shape", module = "softmap_edge._core", subclass, frozen)]
pub struct PyShape {
    pub inner: Arc<dyn Shape>,
}

impl PyShape {
    /// Commands as rows, after checking their width.
    fn rows(&self, u: &PyReadonlyArray2<'_, f64>) -> PyResult<Vec<f64>> {
        let (shape, channels) = (u.shape(), self.inner.channels());
        if shape[1] != channels {
            return Err(Error::Invalid(format!(
                "commands of shape ({}, {}), expected (n, {channels})",
                shape[0], shape[1]
            ))
            .into());
        }
        Ok(u.as_array().iter().copied().collect())
    }
}

/// Numbers (M,) and slopes (M, C).
type Slopes<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray2<f64>>);

#[pymethods]
impl PyShape {
    #[getter]
    fn channels(&self) -> usize {
        self.inner.channels()
    }

    #[getter]
    fn size(&self) -> usize {
        self.inner.size()
    }

    /// Names of its own numbers that an effect may change.
    #[getter]
    fn numbers(&self) -> Vec<&'static str> {
        self.inner.numbers()
    }

    /// Numbers (n, M) at commands `u` (n, C).
    fn evaluate<'py>(
        &self,
        py: Python<'py>,
        u: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let (n, rows) = (u.shape()[0], self.rows(&u)?);
        let (shape, channels, size) =
            (self.inner.clone(), self.inner.channels(), self.inner.size());
        let mut out = zeros("an answer (commands, outputs)", &[n, size])?;
        let out = py.detach(move || {
            if n <= TOGETHER {
                shape.eval_rows(&rows, &mut out); // waking a thread costs more
                return out;
            }
            out.par_chunks_mut((TOGETHER * size).max(1))
                .enumerate()
                .for_each(|(i, out)| {
                    let (first, count) = (i * TOGETHER, out.len() / size.max(1));
                    shape.eval_rows(&rows[first * channels..(first + count) * channels], out);
                });
            out
        });
        out.into_pyarray(py).reshape([n, size])
    }

    /// Numbers (M,) and slopes (M, C) at one command `u` (C,), from one pass.
    fn with_slopes<'py>(&self, py: Python<'py>, u: Vec<f64>) -> PyResult<Slopes<'py>> {
        let (channels, size) = (self.inner.channels(), self.inner.size());
        if u.len() != channels {
            return Err(Error::Invalid(format!(
                "a command of {} numbers, expected {channels}",
                u.len()
            ))
            .into());
        }
        let mut values = zeros("an answer (outputs)", &[size])?;
        let mut slopes = zeros("an answer (outputs, channels)", &[size, channels])?;
        let mut work = Work::default();
        self.inner
            .with_slopes(&u, &mut values, &mut slopes, &mut work);
        let slopes = slopes.into_pyarray(py).reshape([size, channels])?;
        Ok((values.into_pyarray(py), slopes))
    }

    /// The same shape seen through `weights` (M, M2) plus `offset` (M2,); tables and networks fold
    /// the map in.
    fn project(
        &self,
        py: Python<'_>,
        weights: &Bound<'_, PyAny>,
        offset: &Bound<'_, PyAny>,
    ) -> PyResult<Py<PyShape>> {
        let offset = floats("offset", offset, &[("M2", None)])?.data;
        let axes = [("M", Some(self.inner.size())), ("M2", Some(offset.len()))];
        let weights = floats("weights", weights, &axes)?.data;
        let inner = Arc::new(Projected::new(self.inner.clone(), weights, offset)?);
        Py::new(py, PyShape { inner })
    }

    /// Slopes (n, M, C) at commands `u` (n, C).
    fn jacobian<'py>(
        &self,
        py: Python<'py>,
        u: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let (n, rows) = (u.shape()[0], self.rows(&u)?);
        let (shape, channels, size) =
            (self.inner.clone(), self.inner.channels(), self.inner.size());
        let mut out = zeros(
            "an answer (commands, outputs, channels)",
            &[n, size, channels],
        )?;
        let out = py.detach(move || {
            rows.par_chunks_exact(channels.max(1))
                .zip(out.par_chunks_exact_mut((size * channels).max(1)))
                .for_each(|(u, out)| shape.jacobian(u, out));
            out
        });
        out.into_pyarray(py).reshape([n, size, channels])
    }
}

/// A prior with a residual on top: numbers and slopes are those of both together.
#[pyclass(name = "Sum", module = "softmap_edge._core", extends = PyShape, frozen)]
pub struct PySum;

#[pymethods]
impl PySum {
    #[new]
    fn new(
        prior: PyRef<'_, PyShape>,
        residual: PyRef<'_, PyShape>,
    ) -> PyResult<PyClassInitializer<PySum>> {
        let inner = Arc::new(Sum::new(prior.inner.clone(), residual.inner.clone())?);
        Ok(PyClassInitializer::from(PyShape { inner }).add_subclass(PySum))
    }
}
