//! Binding of the predictor.

use super::arrays::floats;
use super::at_work;
use super::cables::{PyCables, PySecond};
use super::effects::{Maybe, PyChain, Value, one_set, record, vector};
use super::shape::PyShape;
use crate::effects::{Conditions, Context};
use crate::predict::{Predictor, still};
use crate::response::contact::Contact;
use crate::shape::Shape;
use crate::{Error, Result};
use numpy::{IntoPyArray, PyArray3, PyArray4, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::Arc;

/// Places, fields, cables and second level of the stations that an obstacle can stop, and their
/// radii.
type Stations<'py> = (
    PyRef<'py, PyShape>,
    Bound<'py, PyDict>,
    Option<PyRef<'py, PyCables>>,
    Option<PyRef<'py, PySecond>>,
    Vec<f64>,
);

/// Commands → chain → prior and fields → sensing, batched: what every fit calls.
#[pyclass(name = "Predictor", module = "softmap_edge._core", frozen)]
pub struct PyPredictor {
    predictor: Arc<Predictor>,
}

#[pymethods]
impl PyPredictor {
    /// `positions` (V,) is true for places and false for directions; `gravity_reference` (3,) is
    /// what the prior was solved with. `second` is what loads do beyond their fields. `contact`
    /// makes it possible to stop the body: a shape of the places of its stations, fields, cables
    /// and second level seen at them, and their radii. Without `declared_loads` the gravity and
    /// load of a run are not applied: the scale of the fields is not known.
    #[new]
    #[pyo3(signature = (prior, fields, positions, gravity_reference, cables=None, declared_loads=true, contact=None, second=None))]
    fn new(
        prior: PyRef<'_, PyShape>,
        fields: &Bound<'_, PyDict>,
        positions: Vec<bool>,
        gravity_reference: Value<'_, '_>,
        cables: Option<PyRef<'_, PyCables>>,
        declared_loads: bool,
        contact: Option<Stations<'_>>,
        second: Option<PyRef<'_, PySecond>>,
    ) -> PyResult<PyPredictor> {
        let shapes = named(fields)?;
        let reference = vector("gravity_reference", gravity_reference)?;
        let cables = cables.map(|c| c.inner.clone());
        let contact = contact.map(
            |(places, moved, cables, second, radii)| -> PyResult<Contact> {
                let cables = cables.as_ref().map(|c| &c.inner);
                Ok(Contact::new(
                    places.inner.clone(),
                    named(&moved)?,
                    cables,
                    second.as_ref().map(|s| &s.inner),
                    radii,
                )?)
            },
        );
        let contact = contact.transpose()?;
        let second = second.map(|s| s.inner.clone());
        let predictor: Result<_> = Predictor::new(
            prior.inner.clone(),
            shapes,
            cables,
            second,
            positions,
            reference,
        );
        let mut predictor = predictor?;
        if let Some(contact) = contact {
            predictor = predictor.with_contact(contact);
        }
        let predictor = if declared_loads {
            predictor
        } else {
            predictor.without_declared_loads()
        };
        Ok(PyPredictor {
            predictor: Arc::new(predictor),
        })
    }

    /// The predictor of linear forms of the outputs, `weights` (3V, M) with M a multiple of 3; None
    /// where a shape is no table.
    fn through(&self, py: Python<'_>, weights: Value<'_, '_>) -> PyResult<Option<PyPredictor>> {
        let size = Some(3 * self.predictor.vectors());
        let weights = floats("weights", weights, &[("3V", size), ("M", None)])?;
        let forms = weights.shape[1];
        if forms == 0 || forms % 3 != 0 {
            return Err(Error::Invalid(format!(
                "{forms} linear forms; give a multiple of 3, forms of zeros fill up"
            ))
            .into());
        }
        let predictor = py.detach(|| self.predictor.through(&weights.data, forms))?;
        Ok(predictor.map(|predictor| PyPredictor {
            predictor: Arc::new(predictor),
        }))
    }

    /// The outputs (3V) as a shape of what acts, in a world that stays as it is: a chain's shape
    /// and prior effects with `params` (P,), gravity (3,), load (g), temperature (°C). Channel and
    /// sensing effects are left out.
    #[pyo3(signature = (chain, params, gravity, load=0.0, temperature=f64::NAN))]
    fn still(
        &self,
        chain: PyRef<'_, PyChain>,
        params: Value<'_, '_>,
        gravity: Value<'_, '_>,
        load: f64,
        temperature: f64,
    ) -> PyResult<PyShape> {
        let params = one_set(&chain.chain, params)?;
        let gravity = vector("gravity", gravity)?;
        let context = Context {
            t: 0.0,
            dt: 0.0,
            gravity,
            load,
            temperature,
            seen_for: 0.0,
        };
        let inner = still(&self.predictor, &chain.chain, &params, context)?;
        Ok(PyShape { inner })
    }

    /// Frames (B, K, V, 3) for params (B, P) on inputs.
    fn predict<'py>(
        &self,
        py: Python<'py>,
        chain: PyRef<'py, PyChain>,
        params: Value<'_, 'py>,
        inputs: PyRef<'py, PyInputs>,
    ) -> PyResult<Bound<'py, PyArray4<f64>>> {
        let (params, sets) = asked(&chain, params, &inputs)?;
        let (body, inner, on) = (&*self.predictor, &chain.chain, &*inputs);
        let out = at_work(py, inner, || {
            body.predict(inner, &params, &on.u, &on.world, &on.t_seen)
        })?;
        let shape = [sets, on.t_seen.len(), body.vectors(), 3];
        out.into_pyarray(py).reshape(shape)
    }

    /// Effective commands (B, K, C) at the seen times for params (B, P) on inputs.
    fn acting<'py>(
        &self,
        py: Python<'py>,
        chain: PyRef<'py, PyChain>,
        params: Value<'_, 'py>,
        inputs: PyRef<'py, PyInputs>,
    ) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let (params, sets) = asked(&chain, params, &inputs)?;
        let (body, inner, on) = (&*self.predictor, &chain.chain, &*inputs);
        let out = at_work(py, inner, || {
            body.acting(inner, &params, &on.u, &on.world, &on.t_seen)
        })?;
        out.into_pyarray(py)
            .reshape([sets, on.t_seen.len(), inner.channels()])
    }

    /// Slopes (C, K, V, 3) of the frames over what acts, `step` (C,) to both sides, about params
    /// (1, P) on inputs.
    fn slopes<'py>(
        &self,
        py: Python<'py>,
        chain: PyRef<'py, PyChain>,
        params: Value<'_, 'py>,
        inputs: PyRef<'py, PyInputs>,
        step: Value<'_, 'py>,
    ) -> PyResult<Bound<'py, PyArray4<f64>>> {
        let (params, _) = asked(&chain, params, &inputs)?;
        let (body, inner, on) = (&*self.predictor, &chain.chain, &*inputs);
        let step = floats("step", step, &[("C", None)])?.data;
        let out = at_work(py, inner, || {
            body.slopes(inner, &params, &step, &on.u, &on.world, &on.t_seen)
        })?;
        out.into_pyarray(py)
            .reshape([inner.channels(), on.t_seen.len(), body.vectors(), 3])
    }
}

/// Parameters (B, P) of a chain that takes the commands of a record, and B.
fn asked(chain: &PyChain, params: Value<'_, '_>, inputs: &PyInputs) -> PyResult<(Vec<f64>, usize)> {
    let (wanted, given) = (chain.chain.channels(), inputs.channels);
    if wanted != given {
        let message = format!(
            "the inputs have {given} commands a sample, the chain takes {wanted}; make the chain \
            for these"
        );
        return Err(Error::Invalid(message).into());
    }
    let params = chain.sets(params)?;
    Ok((params.data, params.shape[0]))
}

/// Commands and the world around them, and when they were looked at: checked and copied once,
/// predicted many times.
#[pyclass(name = "Inputs", module = "softmap_edge._core", frozen)]
pub struct PyInputs {
    channels: usize,
    u: Vec<f64>,
    world: Conditions,
    t_seen: Vec<f64>,
}

#[pymethods]
impl PyInputs {
    /// u (T, C) mm at t (T,) s, seen at t_seen (K,) s by `cameras` (A, 3, 4); gravity (T, 3),
    /// hanging if there is none, load (T,) g, temperature (T,) °C.
    #[new]
    #[pyo3(signature = (u, t, t_seen, gravity=None, load=None, temperature=None, cameras=None))]
    fn new(
        u: Value<'_, '_>,
        t: Value<'_, '_>,
        t_seen: Value<'_, '_>,
        gravity: Maybe<'_>,
        load: Maybe<'_>,
        temperature: Maybe<'_>,
        cameras: Maybe<'_>,
    ) -> PyResult<PyInputs> {
        let (u, world) = record(u, None, t, gravity, load, temperature)?;
        let world = match cameras {
            None => world,
            Some(poses) => {
                let axes = [("A", None), ("rows", Some(3)), ("columns", Some(4))];
                let poses = floats("cameras", &poses, &axes)?.data;
                let row = |pose: &[f64], i: usize| [0, 1, 2, 3].map(|k| pose[4 * i + k]);
                let pose = |pose: &[f64]| [0, 1, 2].map(|i| row(pose, i));
                world.seen_by(poses.chunks_exact(12).map(pose).collect())
            }
        };
        Ok(PyInputs {
            channels: u.shape[1],
            u: u.data,
            world,
            t_seen: floats("t_seen", t_seen, &[("K", None)])?.data,
        })
    }
}

/// Shapes by name.
fn named(fields: &Bound<'_, PyDict>) -> PyResult<Vec<(String, Arc<dyn Shape>)>> {
    let shape = |(name, field): (Bound<'_, PyAny>, Bound<'_, PyAny>)| {
        let field: PyRef<'_, PyShape> = field.extract()?;
        Ok((name.extract::<String>()?, field.inner.clone()))
    };
    fields.iter().map(shape).collect()
}
