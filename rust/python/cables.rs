//! Bindings of the cables of a prior and of its second level of loads.

use super::arrays::floats;
use super::table::PyTable;
use crate::response::cables::Cables;
use crate::response::second_order::Second;
use pyo3::prelude::*;

/// How the tensions of n cables answer loads: `stiffness` (n,) N/mm, `pull` → (n,) N, `stretch` →
/// (n·(F + n),) mm per unit of each of `FIELDS` and of tension, `fields` → displacements per 1 N in
/// each cable.
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

    /// The same cables with their fields seen through a linear map: `weights` (M, M2), `offset`
    /// (M2,).
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

/// What loads do beyond their fields: `numbers` (nodes, P·(m + n) + 6 + n) over the grid of `axes`:
/// mode weights and stretches (mm) of each pair of loads and tensions, row by row, then the growth
/// of each; for n `tendons` that answer, and `modes` (m, M). `moduli` (nodes, Q·(m + n) + 9), if
/// there are any, are the same of the pairs with a modulus: of each with all loads, all tensions
/// and the moduli from itself on.
#[pyclass(name = "Second", module = "softmap_edge._core", frozen)]
pub struct PySecond {
    pub inner: Second,
}

#[pymethods]
impl PySecond {
    #[new]
    #[pyo3(signature = (axes, numbers, tendons, modes, moduli=None))]
    fn new(
        axes: Vec<Bound<'_, PyAny>>,
        numbers: &Bound<'_, PyAny>,
        tendons: usize,
        modes: &Bound<'_, PyAny>,
        moduli: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<PySecond> {
        let axes = axes
            .iter()
            .enumerate()
            .map(|(c, axis)| Ok(floats(&format!("axes[{c}]"), axis, &[("n", None)])?.data))
            .collect::<PyResult<Vec<_>>>()?;
        let numbers = floats("numbers", numbers, &[("nodes", None), ("numbers", None)])?.data;
        let modes = floats("modes", modes, &[("m", None), ("M", None)])?;
        let shape = [("nodes", None), ("numbers", None)];
        let moduli = moduli.map(|moduli| floats("moduli", moduli, &shape));
        let moduli = moduli.transpose()?.map_or(vec![], |found| found.data);
        let inner = Second::new(axes, numbers, moduli, tendons, modes.data, modes.shape[1])?;
        Ok(PySecond { inner })
    }

    /// The same seen through a linear map: `weights` (M, M2).
    fn project(&self, py: Python<'_>, weights: &Bound<'_, PyAny>) -> PyResult<PySecond> {
        let axes = [("M", Some(self.inner.outputs())), ("M2", None)];
        let weights = floats("weights", weights, &axes)?;
        let inner = py.detach(|| self.inner.project(&weights.data, weights.shape[1]))?;
        Ok(PySecond { inner })
    }
}
