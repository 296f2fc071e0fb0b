//! Bindings of the chain.

use super::arrays::{Floats, floats};
use super::at_work;
use crate::Error;
use crate::effects::{Chain, Conditions, Context, Parameter, Reach, WithMap};
use crate::response::loads::{self, Coefficients};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArray3, PyArrayMethods};
use pyo3::prelude::*;

pub(super) type Value<'a, 'py> = &'a Bound<'py, PyAny>;
pub(super) type Maybe<'py> = Option<Bound<'py, PyAny>>;
type Row<'py> = Bound<'py, PyArray1<f64>>;
type Rows<'py> = Bound<'py, PyArray2<f64>>;
type Records<'py> = Bound<'py, PyArray3<f64>>;

/// Numbers of one row of coefficients.
const WIDTH: usize = size_of::<Coefficients>() / size_of::<f64>();

/// Gravity of a hanging finger, for calls in which nothing depends on it.
const HANGING: [f64; 3] = [0.0, 0.0, 1.0];

/// Effects composed in stage order for C channels; parameters and state are arrays that the caller
/// keeps.
#[pyclass(name = "Chain", module = "softmap_edge._core", frozen)]
pub struct PyChain {
    pub(super) chain: Chain,
}

#[pymethods]
impl PyChain {
    #[new]
    fn new(names: Vec<String>, channels: usize) -> PyResult<PyChain> {
        let chain = Chain::new(&names, channels)?;
        Ok(PyChain { chain })
    }

    /// Names of the effects, in stage order.
    #[getter]
    fn names(&self) -> Vec<&'static str> {
        self.chain.names()
    }

    #[getter]
    fn channels(&self) -> usize {
        self.chain.channels()
    }

    /// Numbers in a state.
    #[getter]
    fn state_size(&self) -> usize {
        self.chain.state_size()
    }

    #[getter]
    fn labels(&self) -> Vec<String> {
        self.chain
            .parameters()
            .into_iter()
            .map(|(label, _)| label)
            .collect()
    }

    #[getter]
    fn units(&self) -> Vec<&'static str> {
        self.chain
            .parameters()
            .iter()
            .map(|(_, p)| p.unit)
            .collect()
    }

    #[getter]
    fn null<'py>(&self, py: Python<'py>) -> Row<'py> {
        self.column(py, |p| p.null)
    }

    #[getter]
    fn start<'py>(&self, py: Python<'py>) -> Row<'py> {
        self.column(py, |p| p.start)
    }

    #[getter]
    fn low<'py>(&self, py: Python<'py>) -> Row<'py> {
        self.column(py, |p| p.low)
    }

    #[getter]
    fn high<'py>(&self, py: Python<'py>) -> Row<'py> {
        self.column(py, |p| p.highest(self.chain.channels()))
    }

    /// How far a fit may go beyond `high`, in halves of the range of the commands; 0 if it is not
    /// limited so.
    #[getter]
    fn half_ranges<'py>(&self, py: Python<'py>) -> Row<'py> {
        self.column(py, |p| match p.reach {
            Reach::HalfRanges(times) => times,
            _ => 0.0,
        })
    }

    /// The same in weights that would move the tip sideways by the length of the body.
    #[getter]
    fn lengths<'py>(&self, py: Python<'py>) -> Row<'py> {
        self.column(py, |p| match p.reach {
            Reach::Lengths(times) => times,
            _ => 0.0,
        })
    }

    /// The upper end of the search while a static map is fitted as well, in halves of the range of
    /// the commands; 0 if it is not limited so.
    #[getter]
    fn map_half_ranges<'py>(&self, py: Python<'py>) -> Row<'py> {
        self.column(py, |p| match p.with_map {
            WithMap::HalfRanges(times) => times,
            _ => 0.0,
        })
    }

    /// The same in the unit of the parameter; 0 if it is not limited so.
    #[getter]
    fn map_high<'py>(&self, py: Python<'py>) -> Row<'py> {
        self.column(py, |p| match p.with_map {
            WithMap::UpTo(most) => most,
            _ => 0.0,
        })
    }

    #[getter]
    fn log<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<bool>> {
        self.column(py, Parameter::log)
    }

    #[getter]
    fn integer<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<bool>> {
        self.column(py, |p| p.integer)
    }

    /// The group (P,) of each parameter: numbers of one group are equal unless they are set
    /// separately.
    #[getter]
    fn tie<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<i64>> {
        let groups: Vec<i64> = self.chain.tie().into_iter().map(|g| g as i64).collect();
        groups.into_pyarray(py)
    }

    /// The label (P,) of a parameter's group.
    #[getter]
    fn group_labels(&self) -> Vec<String> {
        self.chain.group_labels()
    }

    /// What each number of a parameter set (P,) stands for; None where it is a number like any
    /// other.
    fn meanings(&self, params: Value<'_, '_>) -> PyResult<Vec<Option<String>>> {
        let params = one_set(&self.chain, params)?;
        self.chain.check(&params)?;
        let numbers = self.chain.parameters().into_iter().zip(params);
        let said = numbers.map(|((_, p), value)| {
            p.meaning
                .map(|meaning| meaning(value, self.chain.channels()))
        });
        Ok(said.collect())
    }

    #[getter]
    fn instant<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<bool>> {
        self.column(py, |p| p.instant)
    }

    /// Effective (B, T, C) mm for params (B, P) on u (T, C) mm at t (T,) s; channel effects only.
    #[pyo3(signature = (params, u, t, gravity=None, load=None, temperature=None, state=None))]
    fn rollout<'py>(
        &self,
        py: Python<'py>,
        params: Value<'_, 'py>,
        u: Value<'_, 'py>,
        t: Value<'_, 'py>,
        gravity: Maybe<'py>,
        load: Maybe<'py>,
        temperature: Maybe<'py>,
        state: Maybe<'py>,
    ) -> PyResult<Records<'py>> {
        let both = self.records(py, params, u, t, gravity, load, temperature, state)?;
        Ok(both.0)
    }

    /// Like `rollout`, and the states (B, S) at the end of the record, with which the next one goes
    /// on.
    #[pyo3(signature = (params, u, t, gravity=None, load=None, temperature=None, state=None))]
    fn advance<'py>(
        &self,
        py: Python<'py>,
        params: Value<'_, 'py>,
        u: Value<'_, 'py>,
        t: Value<'_, 'py>,
        gravity: Maybe<'py>,
        load: Maybe<'py>,
        temperature: Maybe<'py>,
        state: Maybe<'py>,
    ) -> PyResult<(Records<'py>, Rows<'py>)> {
        self.chain.stepwise()?;
        self.records(py, params, u, t, gravity, load, temperature, state)
    }

    /// The state (S,) in equilibrium with u0 (C,) mm held forever.
    fn init<'py>(
        &self,
        py: Python<'py>,
        params: Value<'_, 'py>,
        u0: Value<'_, 'py>,
    ) -> PyResult<Row<'py>> {
        let (params, u) = self.one(params, u0)?;
        Ok(self.chain.init(&params, &u)?.into_pyarray(py))
    }

    /// Advance one sample: (what acts (C,) mm, new state (S,)); the state given is left as it is.
    #[pyo3(signature = (params, state, u, dt, t, gravity=None, load=None, temperature=None))]
    fn step<'py>(
        &self,
        py: Python<'py>,
        params: Value<'_, 'py>,
        state: Value<'_, 'py>,
        u: Value<'_, 'py>,
        dt: f64,
        t: f64,
        gravity: Maybe<'py>,
        load: Option<f64>,
        temperature: Option<f64>,
    ) -> PyResult<(Row<'py>, Row<'py>)> {
        self.chain.stepwise()?;
        let (params, mut x) = self.one(params, u)?;
        let mut state = floats("state", state, &[("S", Some(self.chain.state_size()))])?.data;
        let gravity = match gravity {
            Some(value) => vector("gravity", &value)?,
            None => HANGING,
        };
        if !(dt >= 0.0 && dt.is_finite() && t.is_finite()) {
            let message =
                format!("dt is {dt} s and t is {t} s; dt must be finite and not negative");
            return Err(Error::Invalid(message).into());
        }
        let context = Context {
            t,
            dt,
            gravity,
            load: load.unwrap_or(0.0),
            temperature: temperature.unwrap_or(f64::NAN),
            seen_for: 0.0,
        };
        self.chain.step(&params, &mut x, &mut state, &context);
        Ok((x.into_pyarray(py), state.into_pyarray(py)))
    }

    /// The effective command (C,) mm if u were commanded now; remembers nothing.
    #[pyo3(signature = (params, state, u, dt, t, gravity=None, load=None, temperature=None))]
    fn peek<'py>(
        &self,
        py: Python<'py>,
        params: Value<'_, 'py>,
        state: Value<'_, 'py>,
        u: Value<'_, 'py>,
        dt: f64,
        t: f64,
        gravity: Maybe<'py>,
        load: Option<f64>,
        temperature: Option<f64>,
    ) -> PyResult<Row<'py>> {
        let both = self.step(py, params, state, u, dt, t, gravity, load, temperature)?;
        Ok(both.0)
    }

    /// Names of the coefficients that the shape effects of this chain use.
    #[getter]
    fn fields(&self) -> Vec<&'static str> {
        let mut used: Vec<usize> = self.chain.fields().iter().map(|(f, _)| *f).collect();
        used.sort_unstable();
        used.dedup();
        let mut names: Vec<_> = used.into_iter().map(loads::name).collect();
        names.dedup();
        names
    }

    /// Names of the numbers of the prior that this chain changes.
    #[getter]
    fn numbers(&self) -> Vec<&'static str> {
        self.chain.numbers()
    }

    /// Coefficients (B, K, F + 14) of `FIELDS`, of the compliance of the cables that +u and −u of
    /// each command pull, and of an obstacle (`loads.rs`) that the shape effects add, for gravity
    /// (K, 3), load (K,) g and the effective command (K, C). Effects with a memory take its rows as
    /// a record.
    #[pyo3(signature = (params, gravity, load=None, temperature=None, u=None))]
    fn coefficients<'py>(
        &self,
        py: Python<'py>,
        params: Value<'_, 'py>,
        gravity: Value<'_, 'py>,
        load: Maybe<'py>,
        temperature: Maybe<'py>,
        u: Maybe<'py>,
    ) -> PyResult<Records<'py>> {
        let params = self.sets(params)?;
        let gravity = floats("gravity", gravity, &[("K", None), ("xyz", Some(3))])?;
        let frames = gravity.shape[0];
        let load = column("load", load, frames, 0.0)?;
        let temperature = column("temperature", temperature, frames, f64::NAN)?;
        let world = Conditions::new(vec![0.0; frames], triples(&gravity), load, temperature)?;
        let channels = self.chain.channels();
        let u = match u {
            None => vec![0.0; frames * channels],
            Some(u) => floats("u", &u, &[("K", Some(frames)), ("C", Some(channels))])?.data,
        };
        self.chain.sets(&params.data)?;
        let width = self.chain.width();
        let mut out = Vec::with_capacity(params.shape[0] * frames * WIDTH);
        let kept = self.chain.remembered();
        for b in 0..params.shape[0] {
            let set = &params.data[b * width..(b + 1) * width];
            let remembered = self.chain.remember(set, &u, frames);
            for k in 0..frames {
                let u = &u[k * channels..(k + 1) * channels];
                let own = &remembered[k * kept..(k + 1) * kept];
                out.extend(self.chain.coefficients(set, u, own, &world.at(k)));
            }
        }
        out.into_pyarray(py)
            .reshape([params.shape[0], frames, WIDTH])
    }

    fn __repr__(&self) -> String {
        format!(
            "Chain({:?}, channels={})",
            self.names(),
            self.chain.channels()
        )
    }
}

impl PyChain {
    /// Effective commands (B, T, C) and the states (B, S) at the end.
    fn records<'py>(
        &self,
        py: Python<'py>,
        params: Value<'_, 'py>,
        u: Value<'_, 'py>,
        t: Value<'_, 'py>,
        gravity: Maybe<'py>,
        load: Maybe<'py>,
        temperature: Maybe<'py>,
        state: Maybe<'py>,
    ) -> PyResult<(Records<'py>, Rows<'py>)> {
        let chain = &self.chain;
        let params = self.sets(params)?;
        let channels = Some(chain.channels());
        let (u, mut world) = record(u, channels, t, gravity, load, temperature)?;
        let (sets, memory) = (params.shape[0], chain.state_size());
        let axes = [("B", Some(sets)), ("S", Some(memory))];
        let mut states = match state {
            Some(state) => floats("state", &state, &axes)?.data,
            None => vec![],
        };
        let out = at_work(py, chain, || {
            chain.rollout(&params.data, &u.data, &mut world, &mut states)
        })?;
        let shape = [sets, world.len(), chain.channels()];
        Ok((
            out.into_pyarray(py).reshape(shape)?,
            states.into_pyarray(py).reshape([sets, memory])?,
        ))
    }

    fn column<'py, T: numpy::Element>(
        &self,
        py: Python<'py>,
        pick: impl Fn(&Parameter) -> T,
    ) -> Bound<'py, PyArray1<T>> {
        let values: Vec<T> = self
            .chain
            .parameters()
            .iter()
            .map(|(_, p)| pick(p))
            .collect();
        values.into_pyarray(py)
    }

    /// Parameters (B, P).
    pub(super) fn sets(&self, params: Value<'_, '_>) -> PyResult<Floats> {
        let width = self.chain.width();
        // Without parameters all sets are the same.
        let sets = (width == 0).then_some(1);
        if let Some(groups) = tied(&self.chain) {
            let given = floats("params", params, &[("B", sets), ("P", None)])?;
            if given.shape[1] == groups {
                return Ok(Floats {
                    shape: vec![given.shape[0], width],
                    data: self.chain.spread(&given.data, groups),
                });
            }
        }
        floats("params", params, &[("B", sets), ("P", Some(width))])
    }

    /// Checked parameters (P,) and command (C,).
    fn one(&self, params: Value<'_, '_>, u: Value<'_, '_>) -> PyResult<(Vec<f64>, Vec<f64>)> {
        let params = one_set(&self.chain, params)?;
        self.chain.check(&params)?;
        let u = floats("u", u, &[("C", Some(self.chain.channels()))])?.data;
        Ok((params, u))
    }
}

/// How many numbers a parameter set has with one number for each shared parameter; None if no
/// parameter is shared.
fn tied(chain: &Chain) -> Option<usize> {
    let groups = chain.tie().last().map_or(0, |last| last + 1);
    (groups < chain.width()).then_some(groups)
}

/// One parameter set (P,) of a chain. A set with one number for each group of `tie` is spread to
/// all channels.
pub(super) fn one_set(chain: &Chain, params: Value<'_, '_>) -> PyResult<Vec<f64>> {
    if let Some(groups) = tied(chain) {
        let given = floats("params", params, &[("P", None)])?.data;
        if given.len() == groups {
            return Ok(chain.spread(&given, groups));
        }
    }
    Ok(floats("params", params, &[("P", Some(chain.width()))])?.data)
}

/// Commands (T, C) and the world around them; what is absent is constant, gravity that of a hanging
/// finger.
pub(super) fn record(
    u: Value<'_, '_>,
    channels: Option<usize>,
    t: Value<'_, '_>,
    gravity: Maybe<'_>,
    load: Maybe<'_>,
    temperature: Maybe<'_>,
) -> PyResult<(Floats, Conditions)> {
    let t = floats("t", t, &[("T", None)])?.data;
    let samples = t.len();
    let u = floats("u", u, &[("T", Some(samples)), ("C", channels)])?;
    let gravity = match gravity {
        None => vec![HANGING],
        Some(value) => triples(&floats(
            "gravity",
            &value,
            &[("T", Some(samples)), ("xyz", Some(3))],
        )?),
    };
    let load = column("load", load, samples, 0.0)?;
    let temperature = column("temperature", temperature, samples, f64::NAN)?;
    Ok((u, Conditions::new(t, gravity, load, temperature)?))
}

/// One number a sample, or a constant where there is none.
fn column(name: &str, value: Maybe<'_>, samples: usize, absent: f64) -> PyResult<Vec<f64>> {
    match value {
        None => Ok(vec![absent]),
        Some(value) => Ok(floats(name, &value, &[("T", Some(samples))])?.data),
    }
}

pub(super) fn vector(name: &str, value: Value<'_, '_>) -> PyResult<[f64; 3]> {
    let data = floats(name, value, &[("xyz", Some(3))])?.data;
    Ok([data[0], data[1], data[2]])
}

fn triples(values: &Floats) -> Vec<[f64; 3]> {
    values
        .data
        .chunks_exact(3)
        .map(|v| [v[0], v[1], v[2]])
        .collect()
}
