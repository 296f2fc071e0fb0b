//! Binding of the scattered shape family.

use super::arrays::floats;
use super::shape::PyShape;
use crate::shape::scattered::{Kernel, Scattered};
use pyo3::prelude::*;
use std::sync::Arc;

/// Modes over scattered commands: `nodes` (S, C), `scale` (C,), kernel |q|^`power` (1 or 3),
/// `coefficients` (S + 1 + C, m).
#[pyclass(name = "Scattered", module = "softmap_edge._core", extends = PyShape, frozen)]
pub struct PyScattered {
    inner: Arc<Scattered>,
}

fn wrap(shape: Scattered) -> PyClassInitializer<PyScattered> {
    let inner = Arc::new(shape);
    let face = PyShape {
        inner: inner.clone(),
    };
    PyClassInitializer::from(face).add_subclass(PyScattered { inner })
}

#[pymethods]
impl PyScattered {
    #[new]
    fn new(
        nodes: &Bound<'_, PyAny>,
        scale: &Bound<'_, PyAny>,
        power: usize,
        coefficients: &Bound<'_, PyAny>,
        mean: &Bound<'_, PyAny>,
        modes: &Bound<'_, PyAny>,
    ) -> PyResult<PyClassInitializer<PyScattered>> {
        let scale = floats("scale", scale, &[("C", None)])?.data;
        let nodes = floats("nodes", nodes, &[("S", None), ("C", Some(scale.len()))])?.data;
        let mean = floats("mean", mean, &[("M", None)])?.data;
        let modes = floats("modes", modes, &[("m", None), ("M", Some(mean.len()))])?;
        let axes = [("S + 1 + C", None), ("m", Some(modes.shape[0]))];
        let coefficients = floats("coefficients", coefficients, &axes)?.data;
        let kernel = Kernel::of_power(power)?;
        let shape = Scattered::new(nodes, scale, kernel, coefficients, mean, modes.data)?;
        Ok(wrap(shape))
    }

    /// The same family seen through a linear map: `weights` (M, M2), `offset` (M2,).
    fn project(
        &self,
        py: Python<'_>,
        weights: &Bound<'_, PyAny>,
        offset: &Bound<'_, PyAny>,
    ) -> PyResult<Py<PyScattered>> {
        let offset = floats("offset", offset, &[("M2", None)])?.data;
        let axes = [
            ("M", Some(self.inner.outputs())),
            ("M2", Some(offset.len())),
        ];
        let weights = floats("weights", weights, &axes)?.data;
        let shape = py.detach(|| self.inner.project(&weights, &offset))?;
        Py::new(py, wrap(shape))
    }
}
