//! Binding of a user's own effects: what a Python file declares, and its law, which takes the
//! interpreter for each record.

use super::arrays::floats;
use crate::Error;
use crate::effects::{self, Conditions, Declaration, Kind, Parameter, RecordEffect, Stage};
use numpy::{PyArray1, PyArrayMethods};
use pyo3::prelude::*;

/// What `register` takes, by key.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct Declared {
    name: String,
    family: String,
    stage: String,
    formula: String,
    doc: String,
    signature: String,
    reference: String,
    experiment: (String, f64),
    needs: Vec<String>,
    parameters: Vec<Number>,
}

#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct Number {
    name: String,
    unit: String,
    null: f64,
    start: f64,
    low: f64,
    high: f64,
    doc: String,
    per_channel: bool,
    shared: bool,
    integer: bool,
}

/// Add an effect to the registry: its declaration, and `rollout(params (P,), u (T, C), t, gravity
/// (T, 3), load, temperature)` that returns (T, C). It must take any T and C above 0 and say in one
/// line what went wrong.
#[pyfunction]
pub fn register(declaration: Bound<'_, PyAny>, rollout: Py<PyAny>) -> PyResult<()> {
    let d: Declared = declaration.extract()?;
    let stages = [Stage::Command, Stage::Transmission, Stage::Material];
    let Some(stage) = stages.into_iter().find(|stage| stage.name() == d.stage) else {
        return Err(Error::Invalid(format!(
            "the effect '{}' has the stage '{}'; command, transmission and material are allowed",
            d.name, d.stage
        ))
        .into());
    };
    let parameters: Vec<Parameter> = d.parameters.into_iter().map(Number::leak).collect();
    let needs: Vec<&'static str> = d.needs.into_iter().map(leak).collect();
    let declaration = Declaration {
        name: leak(d.name),
        family: leak(d.family),
        stage,
        kind: Kind::Effect,
        formula: leak(d.formula),
        doc: leak(d.doc),
        signature: leak(d.signature),
        reference: leak(d.reference),
        experiment: (leak(d.experiment.0), d.experiment.1),
        alike: &[],
        needs: needs.leak(),
        parameters: parameters.leak(),
    };
    Ok(effects::register(declaration, Box::new(Own { rollout }))?)
}

/// Take an effect that was registered out of the registry; chains that hold it keep it.
#[pyfunction]
pub fn forget(name: &str) -> PyResult<()> {
    Ok(effects::forget(name)?)
}

/// Text for as long as the process lives, as every declaration has it.
fn leak(text: String) -> &'static str {
    text.leak()
}

impl Number {
    fn leak(self) -> Parameter {
        let (name, unit, doc) = (leak(self.name), leak(self.unit), leak(self.doc));
        let mut p = Parameter::new(name, unit, self.null, self.start, self.low, self.high, doc);
        if self.per_channel {
            p = p.per_channel();
        }
        if self.shared {
            p = p.shared();
        }
        if self.integer { p.integer() } else { p }
    }
}

struct Own {
    rollout: Py<PyAny>,
}

impl RecordEffect for Own {
    fn rollout(
        &self,
        params: &[f64],
        samples: &mut [f64],
        channels: usize,
        conditions: &Conditions,
    ) -> crate::Result<()> {
        let asked = Python::attach(|py| {
            self.ask(py, params, samples, channels, conditions)
                .map_err(|error| error.value(py).to_string())
        });
        samples.copy_from_slice(&asked.map_err(Error::Invalid)?);
        Ok(())
    }
}

impl Own {
    fn ask(
        &self,
        py: Python<'_>,
        params: &[f64],
        samples: &[f64],
        channels: usize,
        conditions: &Conditions,
    ) -> PyResult<Vec<f64>> {
        let worlds: Vec<_> = (0..conditions.len()).map(|k| conditions.at(k)).collect();
        let column = |pick: fn(&effects::Context) -> f64| {
            PyArray1::from_vec(py, worlds.iter().map(pick).collect())
        };
        let gravity: Vec<f64> = worlds.iter().flat_map(|world| world.gravity).collect();
        let rows = conditions.len();
        let arguments = (
            PyArray1::from_slice(py, params),
            PyArray1::from_slice(py, samples).reshape([rows, channels])?,
            PyArray1::from_slice(py, conditions.t()),
            PyArray1::from_vec(py, gravity).reshape([rows, 3])?,
            column(|world| world.load),
            column(|world| world.temperature),
        );
        let answer = self.rollout.bind(py).call1(arguments)?;
        let axes = [("T", Some(rows)), ("C", Some(channels))];
        Ok(floats("what a Python effect returns", &answer, &axes)?.data)
    }
}
