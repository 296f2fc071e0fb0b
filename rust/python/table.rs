//! Binding of the tabulated shape family.

use super::arrays::floats;
use super::shape::PyShape;
use crate::shape::table::Table;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods};
use pyo3::prelude::*;
use std::sync::Arc;

/// Modes on a tensor grid of commands: `axes` [(n_c,)] mm, `coefficients` (n_1·…·n_C, m), `mean`
/// (M,), `modes` (m, M).
#[pyclass(name = "Table", module = "softmap_edge._core", extends = PyShape, frozen)]
pub struct PyTable {
    pub table: Arc<Table>,
}

fn wrap(table: Table) -> PyClassInitializer<PyTable> {
    let table = Arc::new(table);
    let face = PyShape {
        inner: table.clone(),
    };
    PyClassInitializer::from(face).add_subclass(PyTable { table })
}

#[pymethods]
impl PyTable {
    #[new]
    fn new(
        axes: Vec<Bound<'_, PyAny>>,
        coefficients: &Bound<'_, PyAny>,
        mean: &Bound<'_, PyAny>,
        modes: &Bound<'_, PyAny>,
    ) -> PyResult<PyClassInitializer<PyTable>> {
        let axes = axes
            .iter()
            .enumerate()
            .map(|(c, axis)| Ok(floats(&format!("axes[{c}]"), axis, &[("n", None)])?.data))
            .collect::<PyResult<Vec<_>>>()?;
        let mean = floats("mean", mean, &[("M", None)])?.data;
        let modes = floats("modes", modes, &[("m", None), ("M", Some(mean.len()))])?;
        let count = Some(modes.shape[0]);
        let coefficients = floats(
            "coefficients",
            coefficients,
            &[("nodes", None), ("m", count)],
        )?;
        Ok(wrap(Table::new(axes, coefficients.data, mean, modes.data)?))
    }

    /// The grid nodes of each channel, mm.
    #[getter]
    fn axes<'py>(&self, py: Python<'py>) -> Vec<Bound<'py, PyArray1<f64>>> {
        self.table
            .axes()
            .map(|axis| axis.to_vec().into_pyarray(py))
            .collect()
    }

    /// Mode weights (n_1·…·n_C, m), the last axis fastest.
    #[getter]
    fn coefficients<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let nodes = self.table.axes().map(<[f64]>::len).product::<usize>();
        self.table
            .coefficients()
            .to_vec()
            .into_pyarray(py)
            .reshape([nodes, self.table.count()])
    }

    #[getter]
    fn mean<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.table.mean().to_vec().into_pyarray(py)
    }

    /// Modes (m, M).
    #[getter]
    fn modes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let shape = [self.table.count(), self.table.mean().len()];
        self.table.modes().to_vec().into_pyarray(py).reshape(shape)
    }

    /// The same family seen through a linear map: `weights` (M, M2), `offset` (M2,).
    fn project(
        &self,
        py: Python<'_>,
        weights: &Bound<'_, PyAny>,
        offset: &Bound<'_, PyAny>,
    ) -> PyResult<Py<PyTable>> {
        let size = Some(self.table.mean().len());
        let offset = floats("offset", offset, &[("M2", None)])?.data;
        let axes = [("M", size), ("M2", Some(offset.len()))];
        let weights = floats("weights", weights, &axes)?.data;
        let table = py.detach(|| self.table.project(&weights, &offset))?;
        Py::new(py, wrap(table))
    }
}
