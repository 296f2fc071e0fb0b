//! Binding of the simulator: one class that holds a solid, its reported points and its drive.

use crate::Result;
use crate::error::invalid;
use crate::fem::Vec3;
use crate::fem::cable::{Averaging, Route};
use crate::fem::embed::Points;
use crate::fem::mesh::Resolution;
use crate::fem::newton::newton_step;
use crate::fem::solid::{Design, Solid as FemSolid};
use crate::fem::sweep::{Configuration, Progress, Simulation};
use crate::loads::FIELDS;
use numpy::{PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::atomic::Ordering;
use std::time::Duration;

/// How often a waiting interpreter looks for Ctrl-C and reports progress.
const LOOK: Duration = Duration::from_millis(50);

type Bent<'py> = (Bound<'py, PyArray3<f64>>, Bound<'py, PyArray2<f64>>);
type Pairs = Vec<(f64, f64)>;

/// A finger's solid; `points` (rest places of another template, mm) are reported instead of its own surface.
#[pyclass(frozen, module = "softmap_edge._core")]
pub struct Solid {
    simulation: Simulation,
}

#[pymethods]
impl Solid {
    #[new]
    #[pyo3(signature = (profile, core, rings, layers, young, poisson, density, cable_stiffness, ring, disc, routes, drive, points=None, tolerance=2.5))]
    fn new(
        profile: Pairs,
        core: usize,
        rings: usize,
        layers: usize,
        young: f64,
        poisson: f64,
        density: f64,
        cable_stiffness: f64,
        ring: f64,
        disc: f64,
        routes: Vec<(f64, Pairs)>,
        drive: Vec<Vec<f64>>,
        points: Option<PyReadonlyArray2<f64>>,
        tolerance: f64,
    ) -> PyResult<Solid> {
        let pairs = |p: Pairs| p.into_iter().map(|(a, b)| [a, b]).collect::<Vec<_>>();
        let routes = routes
            .into_iter()
            .map(|(angle, path)| Route {
                angle,
                path: pairs(path),
            })
            .collect();
        let solid = FemSolid::finger(&Design {
            profile: pairs(profile),
            resolution: Resolution {
                core,
                rings,
                layers,
            },
            young,
            poisson,
            density,
            cable_stiffness,
            averaging: Averaging { ring, disc },
            routes,
        })?;
        let points = match points {
            None => Points::surface(&solid.mesh),
            Some(array) => Points::embedded(&solid.mesh, &vectors(&array, "points")?, tolerance)?,
        };
        Ok(Solid {
            simulation: Simulation::new(solid, points, drive)?,
        })
    }

    /// Surface vertices at rest (N, 3) mm.
    #[getter]
    fn vertices<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let mesh = &self.simulation.solid.mesh;
        matrix(
            py,
            &mesh
                .surface
                .iter()
                .map(|&n| mesh.nodes[n])
                .collect::<Vec<_>>(),
        )
    }

    /// Surface triangles (F, 3), outward.
    #[getter]
    fn triangles<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<i32>>> {
        let flat: Vec<i32> = self
            .simulation
            .solid
            .mesh
            .triangles
            .iter()
            .flatten()
            .map(|&v| v as i32)
            .collect();
        PyArray1::from_vec(py, flat).reshape([self.simulation.solid.mesh.triangles.len(), 3])
    }

    /// Nodes of the bricks at rest (n, 3) mm.
    #[getter]
    fn nodes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        matrix(py, &self.simulation.solid.mesh.nodes)
    }

    /// Corners of the bricks (E, 8).
    #[getter]
    fn bricks<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<i64>>> {
        let bricks = &self.simulation.solid.mesh.bricks;
        PyArray1::from_vec(py, bricks.iter().flatten().map(|&n| n as i64).collect())
            .reshape([bricks.len(), 8])
    }

    /// Numbers of the clamped nodes.
    #[getter]
    fn fixed<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<i64>> {
        let clamped = &self.simulation.solid.mesh.clamped;
        PyArray1::from_vec(
            py,
            (0..clamped.len())
                .filter(|&n| clamped[n])
                .map(|n| n as i64)
                .collect(),
        )
    }

    /// One Newton step of the bricks alone at node places (n, 3): the displacement (n, 3) mm.
    fn newton_step<'py>(
        &self,
        py: Python<'py>,
        x: PyReadonlyArray2<f64>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let x = vectors(&x, "x")?;
        let step = py.detach(|| newton_step(&self.simulation.solid, &x))?;
        matrix(py, &step)
    }

    /// Places (S, N, 3) and pulls (S, T) over the grid `axes`, last axis fastest.
    #[pyo3(signature = (axes, gravity, load, progress=None))]
    fn sweep<'py>(
        &self,
        py: Python<'py>,
        axes: Vec<Vec<f64>>,
        gravity: Vec3,
        load: Vec3,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Bent<'py>> {
        let total = axes.iter().map(Vec::len).product();
        let shapes = watched(py, total, progress, |p| {
            self.simulation.sweep(&axes, gravity, load, p)
        })?;
        self.bent(py, shapes)
    }

    /// Places (K, N, 3) and pulls (K, T) along commands (K, C), each under its gravity (K, 3).
    #[pyo3(signature = (commands, gravity, load, progress=None))]
    fn path<'py>(
        &self,
        py: Python<'py>,
        commands: PyReadonlyArray2<f64>,
        gravity: PyReadonlyArray2<f64>,
        load: Vec3,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Bent<'py>> {
        let (commands, gravity) = (rows(&commands), vectors(&gravity, "gravity")?);
        let shapes = watched(py, commands.len(), progress, |p| {
            self.simulation.path(&commands, &gravity, load, p)
        })?;
        self.bent(py, shapes)
    }

    /// At the equilibria of commands (S, C), all tensions as they are: displacement (S, N, 3) per unit of each field, by
    /// name, then per 1 N in each cable as `tension_0…`, and `stretch` (S, T, fields) of the cables under the same.
    #[pyo3(signature = (commands, gravity, load, progress=None))]
    fn fields<'py>(
        &self,
        py: Python<'py>,
        commands: PyReadonlyArray2<f64>,
        gravity: Vec3,
        load: Vec3,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let commands = rows(&commands);
        let found = watched(py, commands.len(), progress, |p| {
            self.simulation.fields(&commands, gravity, load, p)
        })?;
        let answer = PyDict::new(py);
        let (samples, points) = (found.len(), self.simulation.points.weights.len());
        let cables = self.simulation.solid.cables.len();
        let names = FIELDS.iter().map(|name| name.to_string());
        for (f, name) in names
            .chain((0..cables).map(|c| format!("tension_{c}")))
            .enumerate()
        {
            let moved: Vec<f64> = found
                .iter()
                .flat_map(|s| s.fields[f].iter().flatten().copied())
                .collect();
            answer.set_item(
                name,
                PyArray1::from_vec(py, moved).reshape([samples, points, 3])?,
            )?;
        }
        let stretch: Vec<f64> = found
            .iter()
            .flat_map(|s| s.stretch.iter().copied())
            .collect();
        let shape = [samples, cables, FIELDS.len() + cables];
        answer.set_item("stretch", PyArray1::from_vec(py, stretch).reshape(shape)?)?;
        Ok(answer)
    }
}

impl Solid {
    fn bent<'py>(&self, py: Python<'py>, shapes: Vec<Configuration>) -> PyResult<Bent<'py>> {
        let (count, cables) = (shapes.len(), self.simulation.solid.cables.len());
        let places: Vec<f64> = shapes
            .iter()
            .flat_map(|s| s.places.iter().flatten().copied())
            .collect();
        let pull: Vec<f64> = shapes.iter().flat_map(|s| s.pull.iter().copied()).collect();
        Ok((
            PyArray1::from_vec(py, places).reshape([
                count,
                self.simulation.points.weights.len(),
                3,
            ])?,
            PyArray1::from_vec(py, pull).reshape([count, cables])?,
        ))
    }
}

/// Run on another thread while this one reports `progress(share)` and watches for Ctrl-C.
fn watched<T: Send>(
    py: Python<'_>,
    total: usize,
    progress: Option<Py<PyAny>>,
    work: impl FnOnce(&Progress) -> Result<T> + Send,
) -> PyResult<T> {
    let state = Progress::default();
    std::thread::scope(|scope| {
        let worker = scope.spawn(|| work(&state));
        let mut trouble = None;
        let mut told = usize::MAX;
        while !worker.is_finished() {
            py.detach(|| std::thread::sleep(LOOK));
            let done = state.done.load(Ordering::Relaxed);
            let mut look = py.check_signals();
            if let (Ok(()), Some(call), true) = (&look, &progress, done != told) {
                told = done;
                look = call
                    .call1(py, (done as f64 / total.max(1) as f64,))
                    .map(|_| ());
            }
            if let Err(error) = look {
                state.stop.store(true, Ordering::Relaxed);
                trouble.get_or_insert(error);
            }
        }
        let result = worker
            .join()
            .map_err(|_| invalid("the simulator stopped unexpectedly; please report it"))?;
        match trouble {
            Some(error) => Err(error),
            None => {
                let result = result?;
                if let Some(call) = &progress {
                    call.call1(py, (1.0,))?;
                }
                Ok(result)
            }
        }
    })
}

fn matrix<'py>(py: Python<'py>, points: &[Vec3]) -> PyResult<Bound<'py, PyArray2<f64>>> {
    PyArray1::from_vec(py, points.iter().flatten().copied().collect()).reshape([points.len(), 3])
}

fn rows(array: &PyReadonlyArray2<f64>) -> Vec<Vec<f64>> {
    array
        .as_array()
        .rows()
        .into_iter()
        .map(|r| r.to_vec())
        .collect()
}

fn vectors(array: &PyReadonlyArray2<f64>, name: &str) -> Result<Vec<Vec3>> {
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
        .map(|r| [r[0], r[1], r[2]])
        .collect())
}
