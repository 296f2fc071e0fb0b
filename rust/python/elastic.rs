//! Bindings of the elastic-tendon rod and its load fields.

use super::arrays::floats;
use super::shape::PyShape;
use crate::memory::zeros;
use crate::rod::{ElasticField, ElasticRod, Layout, Tendon};
use crate::shape::Shape;
use crate::{Error, Result};
use numpy::{IntoPyArray, PyArray2, PyArray3, PyArrayMethods};
use pyo3::prelude::*;
use rayon::prelude::*;
use std::sync::Arc;

/// The elastic-tendon rod: commands (n, C) to markers (n, 3M) mm.
#[pyclass(name = "ElasticRod", module = "softmap_edge._core", extends = PyShape, frozen)]
pub struct PyElasticRod {
    rod: Arc<ElasticRod>,
}

fn tendons(ends: &[usize], channel: &[usize], pull: &[f64]) -> Result<Vec<Tendon>> {
    if ends.len() != channel.len() || ends.len() != pull.len() {
        return Err(Error::Invalid(format!(
            "tendons end in {} segments, are drawn in by {} commands and {} numbers of mm; give \
            one of each per tendon",
            ends.len(),
            channel.len(),
            pull.len()
        )));
    }
    let each = ends.iter().zip(channel).zip(pull);
    Ok(each
        .map(|((&end, &channel), &pull)| Tendon { end, channel, pull })
        .collect())
}

impl PyElasticRod {
    /// Rows of commands after checking their width.
    fn rows(&self, u: &Bound<'_, PyAny>) -> PyResult<(usize, Vec<f64>)> {
        let u = floats("u", u, &[("n", None), ("C", Some(self.rod.channels()))])?;
        Ok((u.shape[0], u.data))
    }
}

/// The commands of row `i`.
fn row(rows: &[f64], i: usize, channels: usize) -> &[f64] {
    &rows[i * channels..(i + 1) * channels]
}

#[pymethods]
impl PyElasticRod {
    /// `ends`, `channel` (from 0) and `pull` (mm per unit of command) are one a tendon; `at` places
    /// the markers, in segments from the base; `numbers` (P,) are as `labels` names them: rad, mm,
    /// stiffness in mm².
    #[new]
    fn new(
        segments: usize,
        channels: usize,
        ends: Vec<usize>,
        channel: Vec<usize>,
        pull: Vec<f64>,
        at: Vec<f64>,
        numbers: &Bound<'_, PyAny>,
    ) -> PyResult<PyClassInitializer<Self>> {
        let layout = Layout::new(segments, channels, tendons(&ends, &channel, &pull)?, &at)?;
        let rod = Arc::new(ElasticRod::new(
            layout,
            floats("numbers", numbers, &[("P", None)])?.data,
        )?);
        let shape = PyShape { inner: rod.clone() };
        Ok(PyClassInitializer::from(shape).add_subclass(Self { rod }))
    }

    /// The names of its numbers.
    #[getter]
    fn labels(&self) -> Vec<String> {
        self.rod.layout().labels()
    }

    /// Bending (n, 2S) rad of the segments and stretch (n, tendons) mm; a stretch below 0 is how
    /// slack a cable is.
    #[allow(clippy::type_complexity)]
    fn state<'py>(
        &self,
        py: Python<'py>,
        u: &Bound<'py, PyAny>,
    ) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>)> {
        let (n, rows) = self.rows(u)?;
        let (rod, channels) = (self.rod.clone(), self.rod.channels());
        let states: Vec<(Vec<f64>, Vec<f64>)> = py.detach(move || {
            let each = (0..n).into_par_iter();
            each.map(|i| rod.state(row(&rows, i, channels))).collect()
        });
        let (bends, stretch): (Vec<_>, Vec<_>) = states.into_iter().unzip();
        let (width, tendons) = (
            2 * self.rod.layout().segments(),
            self.rod.layout().tendons(),
        );
        Ok((
            bends.concat().into_pyarray(py).reshape([n, width])?,
            stretch.concat().into_pyarray(py).reshape([n, tendons])?,
        ))
    }

    /// Markers (n, 3M) mm and their slopes (n, 3M, P) by every number.
    #[allow(clippy::type_complexity)]
    fn number_slopes<'py>(
        &self,
        py: Python<'py>,
        u: &Bound<'py, PyAny>,
    ) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray3<f64>>)> {
        let (n, rows) = self.rows(u)?;
        let (rod, channels) = (self.rod.clone(), self.rod.channels());
        let (size, width) = (rod.size(), rod.layout().width());
        let mut out = zeros("markers (commands, outputs)", &[n, size])?;
        let mut slopes = zeros("slopes (commands, outputs, numbers)", &[n, size, width])?;
        let (out, slopes) = py.detach(move || {
            out.par_chunks_exact_mut(size)
                .zip(slopes.par_chunks_exact_mut(size * width))
                .enumerate()
                .for_each(|(i, (out, slopes))| {
                    rod.number_slopes(row(&rows, i, channels), out, slopes);
                });
            (out, slopes)
        });
        Ok((
            out.into_pyarray(py).reshape([n, size])?,
            slopes.into_pyarray(py).reshape([n, size, width])?,
        ))
    }
}

/// Marker displacements (n, 3M) mm of an elastic rod under one unit of a load or of a change of its
/// body.
#[pyclass(name = "ElasticField", module = "softmap_edge._core", extends = PyShape, frozen)]
pub struct PyElasticField;

#[pymethods]
impl PyElasticField {
    /// `name`: gravity_x|y|z, tip_force_x|y|z, stiff_0…6 or curve_x|y; `flexibility` mm/N, one over
    /// the stiffness of a tendon.
    #[new]
    fn new(
        rod: PyRef<'_, PyElasticRod>,
        name: &str,
        flexibility: f64,
    ) -> PyResult<PyClassInitializer<Self>> {
        let field = ElasticField::new((*rod.rod).clone(), name, flexibility)?;
        let shape = PyShape {
            inner: Arc::new(field),
        };
        Ok(PyClassInitializer::from(shape).add_subclass(Self))
    }
}
