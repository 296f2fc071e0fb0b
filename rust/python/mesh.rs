//! Binding of meshes, and how arrays of places come and go.

use crate::Result;
use crate::error::invalid;
use crate::fem::Vec3;
use crate::fem::mesh::{self, Resolution};
use crate::fem::tetrahedra::tetrahedra;
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2};
use pyo3::prelude::*;

/// (z, radius) mm.
pub(super) type Pairs = Vec<(f64, f64)>;

/// A solid's cells at rest.
#[pyclass(frozen, module = "softmap_edge._core")]
pub struct Mesh {
    pub(super) mesh: mesh::Mesh,
}

#[pymethods]
impl Mesh {
    /// The round finger of a profile of (z, radius) mm; `breaks` are heights that must be layers.
    #[staticmethod]
    fn finger(
        profile: Pairs,
        breaks: Vec<f64>,
        core: usize,
        rings: usize,
        layers: usize,
    ) -> PyResult<Mesh> {
        let resolution = Resolution {
            core,
            rings,
            layers,
        };
        Ok(Mesh {
            mesh: mesh::finger(&paired(profile), &breaks, resolution)?,
        })
    }

    /// The block of `size` mm in `cells` bricks.
    #[staticmethod]
    fn block(size: [f64; 3], cells: [usize; 3]) -> PyResult<Mesh> {
        Ok(Mesh {
            mesh: mesh::block(cells, size.into())?,
        })
    }

    /// Tetrahedra (E, 4) or (E, 10) of nodes (n, 3) mm, each split into eight `refine` times.
    #[staticmethod]
    fn tetrahedra(
        py: Python<'_>,
        nodes: PyReadonlyArray2<f64>,
        cells: PyReadonlyArray2<i64>,
        refine: usize,
    ) -> PyResult<Mesh> {
        let nodes = vectors(&nodes, "nodes")?;
        // A negative number is no node; as an unsigned one it is beyond all.
        let numbers =
            |row: numpy::ndarray::ArrayView1<i64>| row.iter().map(|&n| n as usize).collect();
        let cells: Vec<Vec<usize>> = cells.as_array().rows().into_iter().map(numbers).collect();
        Ok(Mesh {
            mesh: py.detach(|| tetrahedra(nodes, &cells, refine))?,
        })
    }

    /// Nodes at rest (n, 3) mm.
    #[getter]
    fn nodes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        matrix(py, &self.mesh.nodes)
    }

    /// Nodes of the cells (E, 8) of bricks or (E, 10) of tetrahedra.
    #[getter]
    fn cells<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<i64>>> {
        let width = self.mesh.kind.nodes();
        PyArray1::from_vec(py, self.mesh.cells.iter().map(|&n| n as i64).collect())
            .reshape([self.mesh.cells.len() / width, width])
    }

    /// Numbers of the clamped nodes.
    #[getter]
    fn fixed<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<i64>> {
        let clamped = &self.mesh.clamped;
        PyArray1::from_vec(
            py,
            (0..clamped.len())
                .filter(|&n| clamped[n])
                .map(|n| n as i64)
                .collect(),
        )
    }

    /// From the clamped base to the tip, mm.
    #[getter]
    fn height(&self) -> f64 {
        self.mesh.height
    }
}

pub(super) fn matrix<'py>(py: Python<'py>, points: &[Vec3]) -> PyResult<Bound<'py, PyArray2<f64>>> {
    PyArray1::from_vec(py, flat(points).collect()).reshape([points.len(), 3])
}

/// The coordinates of points, one after the other.
pub(super) fn flat(points: &[Vec3]) -> impl Iterator<Item = f64> + '_ {
    points.iter().flat_map(Vec3::to_array)
}

pub(super) fn paired(pairs: Pairs) -> Vec<[f64; 2]> {
    pairs.into_iter().map(|(a, b)| [a, b]).collect()
}

pub(super) fn vectors(array: &PyReadonlyArray2<f64>, name: &str) -> Result<Vec<Vec3>> {
    let view = array.as_array();
    if view.ncols() != 3 {
        return Err(invalid(format!(
            "{name}: expected shape (n, 3), got {:?}",
            view.shape()
        )));
    }
    Ok(view
        .rows()
        .into_iter()
        .map(|r| Vec3::new(r[0], r[1], r[2]))
        .collect())
}
