//! Binding of the predictor.

use super::arrays::floats;
use super::cables::PyCables;
use super::effects::{Maybe, PyChain, Value, vector};
use super::shape::PyShape;
use crate::Result;
use crate::predict::Predictor;
use numpy::{IntoPyArray, PyArray4, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Commands → chain → prior and fields → sensing, batched: what every fit calls.
#[pyclass(name = "Predictor", module = "softmap_edge._core", frozen)]
pub struct PyPredictor {
    predictor: Predictor,
}

#[pymethods]
impl PyPredictor {
    /// `positions` (V,) is true for places and false for directions; `gravity_reference` (3,) is what the prior was solved with.
    /// Without `declared_loads` the gravity and load of a run are not applied: the scale of the fields is not known.
    #[new]
    #[pyo3(signature = (prior, fields, positions, gravity_reference, cables=None, declared_loads=true))]
    fn new(
        prior: PyRef<'_, PyShape>,
        fields: &Bound<'_, PyDict>,
        positions: Vec<bool>,
        gravity_reference: Value<'_, '_>,
        cables: Option<PyRef<'_, PyCables>>,
        declared_loads: bool,
    ) -> PyResult<PyPredictor> {
        let mut shapes = vec![];
        for (name, field) in fields.iter() {
            let field: PyRef<'_, PyShape> = field.extract()?;
            shapes.push((name.extract::<String>()?, field.inner.clone()));
        }
        let reference = vector("gravity_reference", gravity_reference)?;
        let cables = cables.map(|c| c.inner.clone());
        let predictor: Result<_> =
            Predictor::new(prior.inner.clone(), shapes, cables, positions, reference);
        let predictor = predictor?;
        Ok(PyPredictor {
            predictor: if declared_loads {
                predictor
            } else {
                predictor.without_declared_loads()
            },
        })
    }

    /// Frames (B, K, V, 3) for params (B, P) on u (T, C) mm at t (T,) s, seen at t_seen (K,) s.
    #[pyo3(signature = (chain, params, u, t, t_seen, gravity=None, load=None, temperature=None))]
    fn predict<'py>(
        &self,
        py: Python<'py>,
        chain: PyRef<'py, PyChain>,
        params: Value<'_, 'py>,
        u: Value<'_, 'py>,
        t: Value<'_, 'py>,
        t_seen: Value<'_, 'py>,
        gravity: Maybe<'py>,
        load: Maybe<'py>,
        temperature: Maybe<'py>,
    ) -> PyResult<Bound<'py, PyArray4<f64>>> {
        let params = chain.sets(params)?;
        let still = self.predictor.reference();
        let (u, mut world) = chain.record(u, t, still, gravity, load, temperature)?;
        let t_seen = floats("t_seen", t_seen, &[("K", None)])?.data;
        let (body, inner) = (&self.predictor, &chain.chain);
        let out = py.detach(|| body.predict(inner, &params.data, &u, &mut world, &t_seen))?;
        let shape = [params.shape[0], t_seen.len(), body.vectors(), 3];
        out.into_pyarray(py).reshape(shape)
    }
}
