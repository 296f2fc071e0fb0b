//! Binding of trained networks.

use super::arrays::floats;
use super::shape::PyShape;
use crate::network::{Network, check};
use pyo3::prelude::*;
use std::sync::Arc;

/// A network of an ONNX `file` (its bytes) that `softmap-training` wrote: commands (n, C) to
/// numbers (n, M).
#[pyclass(name = "Network", module = "softmap_edge._core", extends = PyShape, frozen)]
pub struct PyNetwork {
    network: Arc<Network>,
}

fn wrap(network: Network) -> PyClassInitializer<PyNetwork> {
    let network = Arc::new(network);
    let inner = network.clone();
    PyClassInitializer::from(PyShape { inner }).add_subclass(PyNetwork { network })
}

#[pymethods]
impl PyNetwork {
    #[new]
    fn new(file: &[u8]) -> PyResult<PyClassInitializer<PyNetwork>> {
        Ok(wrap(Network::read(file)?))
    }

    /// Numbers that were trained.
    #[getter]
    fn parameters(&self) -> usize {
        self.network.parameters()
    }

    /// The same network seen through a linear map: `weights` (M, M2), `offset` (M2,).
    fn project(
        &self,
        py: Python<'_>,
        weights: &Bound<'_, PyAny>,
        offset: &Bound<'_, PyAny>,
    ) -> PyResult<Py<PyNetwork>> {
        let offset = floats("offset", offset, &[("M2", None)])?.data;
        let axes = [("M", None), ("M2", Some(offset.len()))];
        let weights = floats("weights", weights, &axes)?.data;
        let seen = py.detach(|| self.network.project(&weights, &offset))?;
        Py::new(py, wrap(seen))
    }
}

/// Refuses an ONNX `file` (its bytes) that refers to other files, or whose graph may never end.
#[pyfunction]
pub fn check_onnx(file: &[u8]) -> PyResult<()> {
    Ok(check(file)?)
}
