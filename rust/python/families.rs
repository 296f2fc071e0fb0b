//! Bindings of the effect families, their column banks, and level 1 of the diagnosis.

use super::arrays::{floats, integers};
use super::effects::{Maybe, Value};
use crate::Error;
use crate::families::{Bank, FrameSet, Level, REGISTRY, Series};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};

type Row<'py> = Bound<'py, PyArray1<f64>>;
type Rows<'py> = Bound<'py, PyArray2<f64>>;
type Which<'py> = Bound<'py, PyArray1<i64>>;
/// Basis (K, r) and strength (r,) of a kernel over frames.
type Kernel<'py> = (Bound<'py, PyAny>, Bound<'py, PyAny>);
/// Training and test frames of a fold; basis and strength of the kernel over the training frames,
/// then over the test frames.
type Fold<'py> = (
    Bound<'py, PyAny>,
    Bound<'py, PyAny>,
    Bound<'py, PyAny>,
    Bound<'py, PyAny>,
    Bound<'py, PyAny>,
    Bound<'py, PyAny>,
);

/// Return the registry of families, one dictionary each.
#[pyfunction]
pub fn families<'py>(py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
    let list = PyList::empty(py);
    for family in REGISTRY {
        let entry = PyDict::new(py);
        entry.set_item("name", family.name)?;
        entry.set_item("kind", family.kind.name())?;
        entry.set_item("doc", family.doc)?;
        entry.set_item("needs", family.needs.to_vec())?;
        entry.set_item("mimics", family.mimics.to_vec())?;
        entry.set_item("experiment", family.experiment)?;
        entry.set_item("members", family.members.to_vec())?;
        entry.set_item("columns", family.columns.is_some())?;
        entry.set_item("signals", family.signals.is_some())?;
        entry.set_item("fields", family.fields.to_vec())?;
        entry.set_item("modes", family.modes)?;
        list.append(entry)?;
    }
    Ok(list)
}

/// Effective commands of a run at full rate, with its conditions.
#[pyclass(name = "Series", module = "softmap_edge._core", frozen)]
pub struct PySeries {
    series: Series,
}

#[pymethods]
impl PySeries {
    /// `v` (T, C) mm, `t` (T,) s, `middle` and `half` range (C,) mm, `temperature` (T,) °C, integer
    /// codes of `orientation` (T,); `orientations` are the codes of all runs that are fitted
    /// together, if this is one of several; `free_map` says that the static map was learned freely,
    /// which leaves out columns that imitate its error.
    #[new]
    #[pyo3(signature = (v, t, middle, half, temperature=None, orientation=None, orientations=None, free_map=false))]
    fn new(
        v: Value<'_, '_>,
        t: Value<'_, '_>,
        middle: Value<'_, '_>,
        half: Value<'_, '_>,
        temperature: Maybe<'_>,
        orientation: Maybe<'_>,
        orientations: Maybe<'_>,
        free_map: bool,
    ) -> PyResult<PySeries> {
        let t = floats("t", t, &[("T", None)])?.data;
        let samples = Some(t.len());
        let v = floats("v", v, &[("T", samples), ("C", None)])?;
        let channels = Some(v.shape[1]);
        let row = |name, value| Ok::<_, PyErr>(floats(name, value, &[("C", channels)])?.data);
        let temperature = match temperature {
            None => None,
            Some(value) => Some(floats("temperature", &value, &[("T", samples)])?.data),
        };
        let orientation = match orientation {
            None => None,
            Some(value) => Some(integers("orientation", &value)?),
        };
        let orientations = match orientations {
            None => None,
            Some(value) => Some(integers("orientations", &value)?),
        };
        let (middle, half) = (row("middle", middle)?, row("half", half)?);
        let series = Series::new(
            &v.data,
            t,
            &middle,
            half,
            temperature,
            orientation,
            orientations,
        )?;
        Ok(PySeries {
            series: series.with_free_map(free_map),
        })
    }

    /// Number of samples T.
    #[getter]
    fn samples(&self) -> usize {
        self.series.samples()
    }

    /// Number of channels C.
    #[getter]
    fn channels(&self) -> usize {
        self.series.channels()
    }
}

/// Column bank of one family for C channels.
#[pyclass(name = "Bank", module = "softmap_edge._core", frozen)]
pub struct PyBank {
    bank: Bank,
}

#[pymethods]
impl PyBank {
    #[new]
    fn new(name: &str, channels: usize) -> PyResult<PyBank> {
        let bank = Bank::new(name, channels)?;
        Ok(PyBank { bank })
    }

    #[getter]
    fn name(&self) -> &'static str {
        self.bank.family().name
    }

    #[getter]
    fn channels(&self) -> usize {
        self.bank.channels()
    }

    /// Return the channel (n,) and the samples (n, K) mm of the columns at the times `at` (K,) s.
    fn columns<'py>(
        &self,
        py: Python<'py>,
        series: &PySeries,
        at: Value<'_, 'py>,
    ) -> PyResult<(Which<'py>, Rows<'py>)> {
        let at = times(at)?;
        let sampled = py.detach(|| self.bank.columns(&series.series, &at))?;
        pair(py, sampled, at.len())
    }

    /// Return the effective command (T, C) mm with column weights `theta` (n,).
    fn applied<'py>(
        &self,
        py: Python<'py>,
        series: &PySeries,
        theta: Value<'_, 'py>,
    ) -> PyResult<Rows<'py>> {
        let theta = floats("theta", theta, &[("n", None)])?.data;
        let acting = py.detach(|| self.bank.applied(&series.series, &theta))?;
        let shape = [series.series.samples(), series.series.channels()];
        acting.into_pyarray(py).reshape(shape)
    }

    /// Return the rows (m, K) that multiply each field at the times `at` (K,) s.
    fn modulation<'py>(
        &self,
        py: Python<'py>,
        series: &PySeries,
        at: Value<'_, 'py>,
    ) -> PyResult<Rows<'py>> {
        let at = times(at)?;
        rows(py, self.bank.modulation(&series.series, &at)?, at.len())
    }

    /// Return the channel (n,) and the samples (n, K) of the signals at the times `at` (K,) s.
    fn signals<'py>(
        &self,
        py: Python<'py>,
        series: &PySeries,
        at: Value<'_, 'py>,
        wide: bool,
    ) -> PyResult<(Which<'py>, Rows<'py>)> {
        let at = times(at)?;
        let sampled = py.detach(|| self.bank.signals(&series.series, &at, wide))?;
        pair(py, sampled, at.len())
    }

    fn __repr__(&self) -> String {
        format!("Bank({:?}, channels={})", self.name(), self.channels())
    }
}

/// Ridge regression of a residual on columns by name, with blocked cross-validation.
#[pyclass(name = "Level", module = "softmap_edge._core")]
pub struct PyLevel {
    level: Level,
}

#[pymethods]
impl PyLevel {
    /// `form` (M,): model-error variance of each mode. `kernel`: (basis (K, r), strength (r,)) over
    /// all frames. `folds`: one (train, test, train basis, train strength, test basis, test
    /// strength) per fold.
    #[new]
    fn new(form: Value<'_, '_>, kernel: Kernel<'_>, folds: Vec<Fold<'_>>) -> PyResult<PyLevel> {
        let form = floats("form", form, &[("M", None)])?.data;
        let strength = floats("strength", &kernel.1, &[("r", None)])?.data;
        let axes = [("K", None), ("r", Some(strength.len()))];
        let basis = floats("basis", &kernel.0, &axes)?;
        let all = FrameSet {
            index: (0..basis.shape[0]).collect(),
            basis: basis.data,
            strength,
        };
        let pairs = folds.iter().map(|(train, test, tb, ts, sb, ss)| {
            Ok((
                frame_set("train", train, tb, ts)?,
                frame_set("test", test, sb, ss)?,
            ))
        });
        let level = Level::new(form, all, pairs.collect::<PyResult<_>>()?)?;
        Ok(PyLevel { level })
    }

    /// Names in the order in which they were added.
    #[getter]
    fn names(&self) -> Vec<&str> {
        self.level.names()
    }

    /// Add columns base[which_j] ∘ weight_j under a name: `base` (s, K, M), `which` (n,), `weight`
    /// (n, K).
    fn add(
        &mut self,
        name: &str,
        base: Value<'_, '_>,
        which: Value<'_, '_>,
        weight: Value<'_, '_>,
    ) -> PyResult<()> {
        let frames = Some(self.level.frames());
        let modes = Some(self.level.modes());
        let base = floats("base", base, &[("s", None), ("K", frames), ("M", modes)])?;
        let which = indices("which", which)?;
        let weight = floats("weight", weight, &[("n", Some(which.len())), ("K", frames)])?;
        Ok(self.level.add(name, &base.data, &which, &weight.data)?)
    }

    /// Return the same folds without columns.
    fn fresh(&self) -> PyLevel {
        PyLevel {
            level: self.level.fresh(),
        }
    }

    /// Take the residual (K, M), whose modes are in units of noise.
    fn close(&mut self, residual: Value<'_, '_>) -> PyResult<()> {
        let residual = self.modes("residual", residual)?;
        Ok(self.level.close(&residual)?)
    }

    /// Return the held-out loss (F,) of each fold, fitting the columns of `names` with one ridge
    /// each.
    fn losses<'py>(
        &mut self,
        py: Python<'py>,
        names: Vec<String>,
        ridges: Vec<f64>,
    ) -> PyResult<Row<'py>> {
        let losses = py.detach(|| rayon::scope(|_| self.level.losses(&names, &ridges)))?;
        Ok(losses.into_pyarray(py))
    }

    /// Return the loss of a fit of all frames on these same frames.
    fn training_loss(
        &mut self,
        py: Python<'_>,
        names: Vec<String>,
        ridges: Vec<f64>,
    ) -> PyResult<f64> {
        Ok(py.detach(|| self.level.training_loss(&names, &ridges))?)
    }

    /// Fit all frames; return the column weights (n,) of each of `names`.
    fn theta<'py>(
        &mut self,
        py: Python<'py>,
        names: Vec<String>,
        ridges: Vec<f64>,
    ) -> PyResult<Vec<Row<'py>>> {
        let theta = py.detach(|| self.level.theta(&names, &ridges))?;
        Ok(theta
            .into_iter()
            .map(|part| part.into_pyarray(py))
            .collect())
    }

    /// Return the effective degrees of freedom of `name` in a fit of all `names`.
    fn freedom(
        &mut self,
        py: Python<'_>,
        names: Vec<String>,
        ridges: Vec<f64>,
        name: &str,
    ) -> PyResult<f64> {
        Ok(py.detach(|| self.level.freedom(&names, &ridges, name))?)
    }

    /// Return the modes (K, M) of the columns of a name with weights `theta` (n,), not whitened.
    fn fitted<'py>(
        &self,
        py: Python<'py>,
        name: &str,
        theta: Value<'_, 'py>,
    ) -> PyResult<Rows<'py>> {
        let theta = floats("theta", theta, &[("n", None)])?.data;
        rows(py, self.level.fitted(name, &theta)?, self.level.modes())
    }

    /// Return the loss (F,) of fixed modes (K, M) on the test frames of each fold, without any fit.
    fn losses_of<'py>(&self, py: Python<'py>, modes: Value<'_, 'py>) -> PyResult<Row<'py>> {
        let modes = self.modes("modes", modes)?;
        let losses = py.detach(|| self.level.losses_of(&modes))?;
        Ok(losses.into_pyarray(py))
    }

    fn __repr__(&self) -> String {
        format!(
            "Level({} frames, {} modes, {:?})",
            self.level.frames(),
            self.level.modes(),
            self.level.names()
        )
    }
}

impl PyLevel {
    fn modes(&self, name: &str, value: Value<'_, '_>) -> PyResult<Vec<f64>> {
        let axes = [
            ("K", Some(self.level.frames())),
            ("M", Some(self.level.modes())),
        ];
        Ok(floats(name, value, &axes)?.data)
    }
}

/// Read a set of frames and the kernel over them.
fn frame_set(
    name: &str,
    index: Value<'_, '_>,
    basis: Value<'_, '_>,
    strength: Value<'_, '_>,
) -> PyResult<FrameSet> {
    let index = indices(name, index)?;
    let strength = floats("strength", strength, &[("r", None)])?.data;
    let axes = [("frames", Some(index.len())), ("r", Some(strength.len()))];
    let basis = floats("basis", basis, &axes)?.data;
    Ok(FrameSet {
        index,
        basis,
        strength,
    })
}

/// Read non-negative integers.
fn indices(name: &str, value: Value<'_, '_>) -> PyResult<Vec<usize>> {
    let place = |n: i64| usize::try_from(n);
    let found: std::result::Result<_, _> = integers(name, value)?.into_iter().map(place).collect();
    Ok(found.map_err(|_| Error::Invalid(format!("{name} contains a negative number")))?)
}

fn times(at: Value<'_, '_>) -> PyResult<Vec<f64>> {
    Ok(floats("at", at, &[("K", None)])?.data)
}

/// Return numbers as rows of `width`.
fn rows(py: Python<'_>, data: Vec<f64>, width: usize) -> PyResult<Rows<'_>> {
    let count = data.len() / width.max(1);
    data.into_pyarray(py).reshape([count, width])
}

fn pair(
    py: Python<'_>,
    (which, weight): (Vec<usize>, Vec<f64>),
    width: usize,
) -> PyResult<(Which<'_>, Rows<'_>)> {
    let shape = [which.len(), width];
    let which: Vec<i64> = which.into_iter().map(|channel| channel as i64).collect();
    Ok((
        which.into_pyarray(py),
        weight.into_pyarray(py).reshape(shape)?,
    ))
}
