//! Bindings of the rod and its load fields.

use crate::memory::zeros;
use crate::python::shape::PyShape;
use crate::rod::{Form, Monomials, Rod, RodField, Splines, Terms};
use crate::{Error, Result};
use numpy::{
    IntoPyArray, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use std::sync::Arc;

/// The regressed chord-angle rod: commands (n, C) to markers (n, 3K) mm.
#[pyclass(name = "Rod", module = "softmap_edge._core", extends = PyShape, frozen)]
pub struct PyRod {
    rod: Rod,
}

#[pymethods]
impl PyRod {
    /// `base` (3,) mm, `centre` and `scale` (C,), `degree`, `angles` (1 + F, 2K) rad, `lengths` (1
    /// + 2K + K(2K+1), K) mm. In a `pulled` rod the angles are a polynomial of the pulls of two
    /// cables a command; with `intervals` they are sums of tensor products of cubic B-splines, so
    /// many intervals of each command, whatever the degree.
    #[new]
    #[pyo3(signature = (base, centre, scale, degree, angles, lengths, pulled = false, intervals = 0))]
    #[allow(clippy::too_many_arguments)]
    fn new(
        base: PyReadonlyArray1<'_, f64>,
        centre: PyReadonlyArray1<'_, f64>,
        scale: PyReadonlyArray1<'_, f64>,
        degree: usize,
        angles: PyReadonlyArray2<'_, f64>,
        lengths: PyReadonlyArray2<'_, f64>,
        pulled: bool,
        intervals: usize,
    ) -> PyResult<PyClassInitializer<Self>> {
        let form = match (pulled, intervals) {
            (true, 1..) => {
                return Err(Error::Invalid(format!(
                    "a rod of pulls with {intervals} spline intervals; a rod has pulls or splines, \
                    not both"
                ))
                .into());
            }
            (false, 1..) => Form::Splines { intervals },
            (true, _) => Form::Pulls { degree },
            _ => Form::Powers { degree },
        };
        let row = |array: &PyReadonlyArray1<'_, f64>| {
            array.as_array().iter().copied().collect::<Vec<f64>>()
        };
        let base: [f64; 3] = row(&base).try_into().map_err(|b: Vec<f64>| {
            Error::Invalid(format!(
                "a rod's base point has {} numbers, expected 3",
                b.len()
            ))
        })?;
        check_columns(&angles, &lengths)?;
        let flat = |array: &PyReadonlyArray2<'_, f64>| {
            array.as_array().iter().copied().collect::<Vec<f64>>()
        };
        let rod = Rod::new(
            base,
            row(&centre),
            row(&scale),
            form,
            flat(&angles),
            flat(&lengths),
        )?;
        let shape = PyShape {
            inner: Arc::new(rod.clone()),
        };
        Ok(PyClassInitializer::from(shape).add_subclass(Self { rod }))
    }
}

fn check_columns(
    angles: &PyReadonlyArray2<'_, f64>,
    lengths: &PyReadonlyArray2<'_, f64>,
) -> Result<()> {
    let (angles, lengths) = (angles.shape(), lengths.shape());
    if lengths[1] == 0 || angles[1] != 2 * lengths[1] {
        return Err(Error::Invalid(format!(
            "a rod's angle weights have shape ({}, {}) and its length weights ({}, {}); expected \
            two angle columns for every length column",
            angles[0], angles[1], lengths[0], lengths[1]
        )));
    }
    Ok(())
}

/// Marker displacements (n, 3K) mm of a rod under one unit load along one axis.
#[pyclass(name = "RodField", module = "softmap_edge._core", extends = PyShape, frozen)]
pub struct PyRodField;

#[pymethods]
impl PyRodField {
    /// `name`: gravity_x|y|z or tip_force_x|y|z; `compliance` N⁻¹·mm⁻².
    /// `lock` is the share of each chord's mean bending moment that its tendons carry (0 to 1).
    #[new]
    #[pyo3(signature = (rod, name, compliance, lock = 0.0))]
    fn new(
        rod: PyRef<'_, PyRod>,
        name: &str,
        compliance: f64,
        lock: f64,
    ) -> PyResult<PyClassInitializer<Self>> {
        let field = RodField::new(rod.rod.clone(), name, compliance, lock)?;
        let shape = PyShape {
            inner: Arc::new(field),
        };
        Ok(PyClassInitializer::from(shape).add_subclass(Self))
    }
}

/// All monomials (n, F) of degree 1..`degree` of the columns of `x` (n, C), in the order of a rod's
/// angle weights.
#[pyfunction]
pub fn monomials<'py>(
    py: Python<'py>,
    x: PyReadonlyArray2<'py, f64>,
    degree: usize,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let terms = Terms::Monomials(Monomials::new(x.shape()[1], degree)?);
    values(py, x, terms)
}

/// All tensor products (n, F) of cubic B-splines of the columns of `x` (n, C), `intervals` of each
/// in −1 … 1, in the order of a rod's angle weights.
#[pyfunction]
pub fn tensor_splines<'py>(
    py: Python<'py>,
    x: PyReadonlyArray2<'py, f64>,
    intervals: usize,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let terms = Terms::Splines(Splines::new(x.shape()[1], intervals)?);
    values(py, x, terms)
}

/// The terms (n, F) at the rows of `x` (n, C).
fn values<'py>(
    py: Python<'py>,
    x: PyReadonlyArray2<'py, f64>,
    terms: Terms,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let (n, variables) = (x.shape()[0], x.shape()[1]);
    let rows: Vec<f64> = x.as_array().iter().copied().collect();
    let count = terms.count();
    let mut out = zeros("terms of a map (rows, terms)", &[n, count])?;
    let out = py.detach(move || {
        for (x, out) in rows
            .chunks_exact(variables)
            .zip(out.chunks_exact_mut(count))
        {
            terms.values(x, out);
        }
        out
    });
    out.into_pyarray(py).reshape([n, count])
}

/// The degree of each monomial, in the same order.
#[pyfunction]
pub fn monomial_degrees(variables: usize, degree: usize) -> PyResult<Vec<usize>> {
    Ok(Monomials::new(variables, degree)?.degrees())
}
