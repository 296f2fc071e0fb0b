//! Binding of the cables of a prior.

use super::arrays::floats;
use super::table::PyTable;
use crate::cables::Cables;
use pyo3::prelude::*;

/// How the tensions of n cables answer loads: `stiffness` (n,) N/mm, `pull` → (n,) N, `stretch` → (n·(F + n),) mm per unit
/// of each of `FIELDS` and of tension, `fields` → displacements per 1 N in each cable.
#[pyclass(name = "Cables", module = "softmap_edge._core", frozen)]
pub struct PyCables {
    pub inner: Cables,
}

#[pymethods]
impl PyCables {
    #[new]
    fn new(
        stiffness: &Bound<'_, PyAny>,
        pull: PyRef<'_, PyTable>,
        stretch: PyRef<'_, PyTable>,
        fields: Vec<PyRef<'_, PyTable>>,
    ) -> PyResult<PyCables> {
        let stiffness = floats("stiffness", stiffness, &[("n", None)])?.data;
        let fields = fields.iter().map(|f| f.table.clone()).collect();
        let inner = Cables::new(stiffness, pull.table.clone(), stretch.table.clone(), fields)?;
        Ok(PyCables { inner })
    }

    /// The same cables with their fields seen through a linear map: `weights` (M, M2), `offset` (M2,).
    fn project(
        &self,
        py: Python<'_>,
        weights: &Bound<'_, PyAny>,
        offset: &Bound<'_, PyAny>,
    ) -> PyResult<PyCables> {
        let offset = floats("offset", offset, &[("M2", None)])?.data;
        let size = self.inner.fields().next().map(|f| f.size());
        let axes = [("M", size), ("M2", Some(offset.len()))];
        let weights = floats("weights", weights, &axes)?.data;
        let inner = py.detach(|| self.inner.project(&weights, &offset))?;
        Ok(PyCables { inner })
    }
}
