//! Bindings of point sets and surfaces: Chamfer distance, nearest places, registration.

use super::arrays::floats;
use super::shape::PyShape;
use crate::Error;
use crate::algebra::Vec3;
use crate::geometry::chamfer::Chamfer;
use crate::geometry::paper::register_as_published;
use crate::geometry::register::{Recipe, Registered, Registrar, Template};
use crate::geometry::start::{self, Start};
use crate::geometry::surface::Surface;
use numpy::{IntoPyArray, PyArray1, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rayon::prelude::*;

type Edges<'py> = (
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray1<f64>>,
);

/// Read points (N, 3).
fn points(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Vec<Vec3>> {
    let found = floats(name, value, &[("N", None), ("xyz", Some(3))])?.data;
    Ok(found.chunks_exact(3).map(Vec3::from_slice).collect())
}

fn weights(name: &str, value: Option<&Bound<'_, PyAny>>, count: usize) -> PyResult<Vec<f64>> {
    value.map_or(Ok(vec![]), |value| {
        Ok(floats(name, value, &[("N", Some(count))])?.data)
    })
}

fn rows<'py>(py: Python<'py>, points: Vec<Vec3>) -> PyResult<Bound<'py, PyAny>> {
    let count = points.len();
    let points: Vec<[f64; 3]> = points.into_iter().map(Into::into).collect();
    Ok(points
        .into_flattened()
        .into_pyarray(py)
        .reshape([count, 3])?
        .into_any())
}

/// Chamfer distance of a template (N, 3) and a cloud (M, 3): `there`, `back` (mm), `distance` and
/// `index` of each point's nearest, both ways, and the `gradient` (N, 3) of their sum. `seen` (N,)
/// and `trusted` (M,) weigh the points.
#[pyfunction]
#[pyo3(signature = (template, cloud, seen=None, trusted=None))]
pub fn chamfer<'py>(
    py: Python<'py>,
    template: &Bound<'_, PyAny>,
    cloud: &Bound<'_, PyAny>,
    seen: Option<&Bound<'_, PyAny>>,
    trusted: Option<&Bound<'_, PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let (template, cloud) = (points("template", template)?, points("cloud", cloud)?);
    let (seen, trusted) = (
        weights("seen", seen, template.len())?,
        weights("trusted", trusted, cloud.len())?,
    );
    let (found, gradient) = py.detach(|| {
        let found = Chamfer::new(&template, &cloud, &seen, &trusted)?;
        let gradient = found.gradient(&template, &cloud, &seen, &trusted, (1.0, 1.0));
        Ok::<_, Error>((found, gradient))
    })?;
    let out = PyDict::new(py);
    out.set_item("there", found.there)?;
    out.set_item("back", found.back)?;
    out.set_item(
        "to_cloud",
        (
            found.to_cloud.distance.into_pyarray(py),
            found.to_cloud.index.into_pyarray(py),
        ),
    )?;
    out.set_item(
        "to_template",
        (
            found.to_template.distance.into_pyarray(py),
            found.to_template.index.into_pyarray(py),
        ),
    )?;
    out.set_item("gradient", rows(py, gradient)?)?;
    Ok(out)
}

/// A triangle surface: `vertices` (N, 3) mm, `triangles` (T, 3), outwards by the order of their
/// corners.
#[pyclass(name = "Surface", module = "softmap_edge._core", frozen)]
pub struct PySurface {
    inner: Surface,
}

#[pymethods]
impl PySurface {
    #[new]
    fn new(vertices: &Bound<'_, PyAny>, triangles: Vec<[usize; 3]>) -> PyResult<PySurface> {
        let inner = Surface::new(&points("vertices", vertices)?, &triangles)?;
        Ok(PySurface { inner })
    }

    /// The nearest place of the surface to each of `points` (M, 3): places (M, 3), distances (M,)
    /// mm.
    fn nearest<'py>(
        &self,
        py: Python<'py>,
        of: &Bound<'_, PyAny>,
    ) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyArray1<f64>>)> {
        let of = points("points", of)?;
        let feet: Vec<_> = py.detach(|| of.par_iter().map(|p| self.inner.foot(*p)).collect());
        let distance: Vec<f64> = feet.iter().map(|foot| foot.distance).collect();
        Ok((
            rows(py, feet.iter().map(|foot| foot.place).collect())?,
            distance.into_pyarray(py),
        ))
    }

    /// Which of the places (M, 3) of the surface, with outward `normals` (M, 3), an `eye` (3,)
    /// sees.
    fn seen<'py>(
        &self,
        py: Python<'py>,
        eye: [f64; 3],
        places: &Bound<'_, PyAny>,
        normals: &Bound<'_, PyAny>,
    ) -> PyResult<Bound<'py, PyArray1<bool>>> {
        let (places, normals) = (points("places", places)?, points("normals", normals)?);
        let pairs = places.par_iter().zip(&normals);
        let seen: Vec<bool> = py.detach(|| {
            pairs
                .map(|(p, n)| self.inner.sees(eye.into(), *p, *n))
                .collect()
        });
        Ok(seen.into_pyarray(py))
    }
}

/// The surface of a finger, ready to be registered: `rest` (N, 3) mm, `triangles` (T, 3), `base`
/// the vertices that the clamp holds.
#[pyclass(name = "Registration", module = "softmap_edge._core", frozen)]
pub struct PyRegistration {
    template: Template,
}

#[pymethods]
impl PyRegistration {
    #[new]
    fn new(
        rest: &Bound<'_, PyAny>,
        triangles: Vec<[usize; 3]>,
        base: Vec<usize>,
    ) -> PyResult<PyRegistration> {
        let template = Template::new(points("rest", rest)?, triangles, base)?;
        Ok(PyRegistration { template })
    }

    /// The edges of the surface: one end (E,), the other (E,), and their cotangent weights (E,).
    fn edges<'py>(&self, py: Python<'py>) -> Edges<'py> {
        let edges = self.template.arap.edges();
        let (mut first, mut other, mut weight) = (vec![], vec![], vec![]);
        for i in 0..edges.len() {
            for (j, w) in edges.of(i).filter(|(j, _)| i < *j) {
                first.push(i as i64);
                other.push(j as i64);
                weight.push(w);
            }
        }
        (
            first.into_pyarray(py),
            other.into_pyarray(py),
            weight.into_pyarray(py),
        )
    }

    /// Deform the surface as rigidly as possible, from rest, for so many `rounds`: vertices (N, 3),
    /// drawn to `goals` (N, 3) with `strength` (N,), 0 for those that go where the others want
    /// them.
    fn deformed<'py>(
        &self,
        py: Python<'py>,
        goals: &Bound<'_, PyAny>,
        strength: &Bound<'_, PyAny>,
        rounds: usize,
    ) -> PyResult<Bound<'py, PyAny>> {
        let count = self.template.len();
        let goals = floats("goals", goals, &[("N", Some(count)), ("xyz", Some(3))])?.data;
        let goals: Vec<Vec3> = goals.chunks_exact(3).map(Vec3::from_slice).collect();
        let strength = weights("strength", Some(strength), count)?;
        let arap = &self.template.arap;
        let places = py.detach(|| {
            let (mut held, mut pose) = (arap.held(strength)?, arap.pose());
            (0..rounds).for_each(|_| held.step(&mut pose, &goals));
            Ok::<_, Error>(pose.places)
        })?;
        rows(py, places)
    }

    /// Register `clouds` [(M, 3)] mm in parallel, each from the shape of the model nearest to it
    /// among the commands `candidates` (G, C), which stay between `low` and `high` (C,). One dict
    /// each: vertices (N, 3), support (N,), command (C,), start (N, 3), start_cost, scale, other
    /// (its cost, mm), residual_mm, noise_mm, used, rounds, settled.
    #[pyo3(signature = (shape, clouds, candidates, low, high, cloud=3.0, points=2000, rounds=25, base=100.0))]
    fn robust<'py>(
        &self,
        py: Python<'py>,
        shape: PyRef<'_, PyShape>,
        clouds: Vec<Bound<'_, PyAny>>,
        candidates: Vec<Vec<f64>>,
        low: Vec<f64>,
        high: Vec<f64>,
        cloud: f64,
        points: usize,
        rounds: usize,
        base: f64,
    ) -> PyResult<Vec<Bound<'py, PyDict>>> {
        let clouds = clouds
            .iter()
            .map(|c| self::points("cloud", c))
            .collect::<PyResult<Vec<_>>>()?;
        let recipe = Recipe {
            cloud,
            points,
            rounds,
            base,
        };
        let (shape, template) = (shape.inner.clone(), &self.template);
        let found: Vec<(Start, Registered)> = py.detach(|| {
            let one = |registrar: &mut Result<Registrar<'_>, Error>, cloud: &Vec<Vec3>| {
                let start = start::start(
                    &*shape,
                    &template.triangles,
                    cloud,
                    &candidates,
                    &low,
                    &high,
                )?;
                let registrar = registrar.as_mut().map_err(|error| error.clone())?;
                let found = registrar.register(cloud, start.places.clone())?;
                Ok((start, found))
            };
            let each = clouds
                .par_iter()
                .map_init(|| Registrar::new(template, recipe), one);
            each.collect::<Result<Vec<_>, Error>>()
        })?;
        found
            .into_iter()
            .map(|(start, found)| result(py, start, found))
            .collect()
    }

    /// Register a cloud (M, 3) by the published objective, with λ as `strength` (N,): vertices (N,
    /// 3) and rounds.
    fn published<'py>(
        &self,
        py: Python<'py>,
        cloud: &Bound<'_, PyAny>,
        strength: &Bound<'_, PyAny>,
        rounds: usize,
    ) -> PyResult<(Bound<'py, PyAny>, usize)> {
        let cloud = points("cloud", cloud)?;
        let strength = weights("strength", Some(strength), self.template.len())?;
        let (places, rounds) =
            py.detach(|| register_as_published(&self.template.arap, &cloud, strength, rounds))?;
        Ok((rows(py, places)?, rounds))
    }
}

fn result<'py>(py: Python<'py>, start: Start, found: Registered) -> PyResult<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    out.set_item("vertices", rows(py, found.places)?)?;
    out.set_item("support", found.support.into_pyarray(py))?;
    out.set_item("command", start.command.into_pyarray(py))?;
    out.set_item("start", rows(py, start.places)?)?;
    out.set_item("start_cost", start.cost)?;
    out.set_item("scale", start.scale)?;
    out.set_item("other", start.other)?;
    out.set_item("residual_mm", found.residual_mm)?;
    out.set_item("noise_mm", found.noise_mm)?;
    out.set_item("used", found.used)?;
    out.set_item("rounds", found.rounds)?;
    out.set_item("settled", found.settled)?;
    Ok(out)
}
