//! Binding of the simulator: one class that holds a solid, its reported points and its drive.

use super::mesh::{Mesh, Pairs, flat, matrix, paired, vectors};
use super::watch::watched;
use crate::error::invalid;
use crate::fem::cable::Drive;
use crate::fem::change::{self, Change};
use crate::fem::embed::Points;
use crate::fem::guide::Averaging;
use crate::fem::material::{Body, Region};
use crate::fem::newton::newton_step;
use crate::fem::route::Route;
use crate::fem::solid::{Design, Solid as FemSolid};
use crate::fem::sweep::{Configuration, Simulation};
use crate::response::loads::{FIELDS, LOADS, MODULI, PUSH};
use numpy::{PyArray1, PyArray2, PyArray3, PyArray4, PyArrayMethods, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;

type Bent<'py> = (Bound<'py, PyArray3<f64>>, Bound<'py, PyArray2<f64>>);
type Bends<'py> = (
    Bound<'py, PyArray4<f64>>,
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray2<f64>>,
);

/// A region of another modulus: box (low, high) mm, the angle its side faces (rad) or None, modulus
/// MPa, and whether it holds each cell, None for all.
type Boxed = ([f64; 3], [f64; 3], Option<f64>, f64, Option<Vec<bool>>);

/// A tendon by points (n, 3) mm, or by (angle, turn, (z, radius) pairs) in rad and mm.
#[derive(FromPyObject)]
enum Way {
    Formula((f64, f64, Pairs)),
    Points(Vec<[f64; 3]>),
}

/// A finger's solid; `points` (rest places of another template, mm) are reported instead of its own
/// surface.
#[pyclass(frozen, module = "softmap_edge._core")]
pub struct Solid {
    simulation: Simulation,
}

#[pymethods]
impl Solid {
    /// `drive[t][c]` is the command of tendon t per unit of command c: mm of shortening, or N if
    /// `by_tension`. `change` says by how much the body differs from the rest: names and amounts of
    /// the fields of a design.
    #[new]
    #[pyo3(signature = (mesh, young, poisson, density, regions, cable_stiffness, ring, disc, routes, drive, by_tension=false, pretension=0.0, load_at=None, points=None, tolerance=2.5, change=Vec::new()))]
    fn new(
        py: Python<'_>,
        mesh: &Mesh,
        young: f64,
        poisson: f64,
        density: f64,
        regions: Vec<Boxed>,
        cable_stiffness: f64,
        ring: f64,
        disc: f64,
        routes: Vec<Way>,
        drive: Vec<Vec<f64>>,
        by_tension: bool,
        pretension: f64,
        load_at: Option<[f64; 3]>,
        points: Option<PyReadonlyArray2<f64>>,
        tolerance: f64,
        change: Vec<(String, f64)>,
    ) -> PyResult<Solid> {
        let count = mesh.mesh.each_cell().count();
        let region = |(low, high, side, young, cells): Boxed| match cells {
            Some(cells) if cells.len() != count => Err(invalid(format!(
                "a region of {} cells, the mesh has {count}; mark each of its cells",
                cells.len()
            ))),
            cells => Ok(Region {
                low: low.into(),
                high: high.into(),
                side,
                cells: cells.map(Into::into),
                young,
            }),
        };
        let route = |way| match way {
            Way::Formula((angle, turn, path)) => Route::Formula {
                angle,
                turn,
                path: paired(path),
            },
            Way::Points(points) => Route::Points(points.into_iter().map(Into::into).collect()),
        };
        let mut design = Design {
            mesh: mesh.mesh.clone(),
            body: Body::new(
                young,
                poisson,
                density,
                regions.into_iter().map(region).collect::<Result<_, _>>()?,
            )?,
            cable_stiffness,
            pretension,
            load_at: load_at.map(Into::into),
            averaging: Averaging { ring, disc },
            routes: routes.into_iter().map(route).collect(),
            drive: if by_tension {
                Drive::Tension
            } else {
                Drive::Shortening
            },
            change: Change::default(),
        };
        for (name, by) in change {
            let field = FIELDS[LOADS..PUSH].iter().position(|field| *field == name);
            let changed = field
                .filter(|_| by.is_finite())
                .and_then(|f| change::changed(&design, &drive, LOADS + f, by));
            design = changed.ok_or_else(|| {
                invalid(format!(
                    "change {name} by {by}: allowed are finite amounts of {}, and of routing only \
                    for commands there are",
                    FIELDS[LOADS..PUSH].join(", ")
                ))
            })?;
        }
        let template = points.map(|p| vectors(&p, "points")).transpose()?;
        let simulation = py.detach(|| {
            // Points are material: they are found in the body as it is described, and go where it
            // goes.
            let points = match template {
                None => Points::surface(&design.mesh),
                Some(places) => Points::embedded(&design.mesh, &places, tolerance)?,
            };
            let solid = FemSolid::build(design)?;
            Simulation::new(solid, points, drive)
        })?;
        Ok(Solid { simulation })
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

    /// One Newton step of the elements alone at node places (n, 3): the displacement (n, 3) mm.
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
        gravity: [f64; 3],
        load: [f64; 3],
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Bent<'py>> {
        let total = axes.iter().map(Vec::len).product();
        let shapes = watched(py, total, progress, |p| {
            self.simulation.sweep(&axes, gravity.into(), load.into(), p)
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
        load: [f64; 3],
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Bent<'py>> {
        self.simulation
            .room("a path", &[commands.as_array().nrows()], 1)?; // before its rows are copied one by one
        let (commands, gravity) = (rows(&commands), vectors(&gravity, "gravity")?);
        let shapes = watched(py, commands.len(), progress, |p| {
            self.simulation.path(&commands, &gravity, load.into(), p)
        })?;
        self.bent(py, shapes)
    }

    /// Places (K, N, 3) at commands (K, C) under one gravity, Newton's method starting where
    /// `other` puts the nodes.
    #[pyo3(signature = (other, commands, gravity, load, progress=None))]
    fn path_from<'py>(
        &self,
        py: Python<'py>,
        other: &Solid,
        commands: PyReadonlyArray2<f64>,
        gravity: [f64; 3],
        load: [f64; 3],
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let commands = rows(&commands);
        let shapes = watched(py, commands.len(), progress, |p| {
            self.simulation
                .path_from(&other.simulation, &commands, gravity.into(), load.into(), p)
        })?;
        Ok(self.bent(py, shapes)?.0)
    }

    /// At the equilibria of commands (S, C): second derivatives (S, P, N, 3) of the vertices and
    /// (S, P, T) of the stretch of the cables, for each pair of `LOADS`, `MODULI` and the tensions,
    /// row by row; growth of the answers for each of these.
    #[pyo3(signature = (commands, gravity, load, progress=None))]
    fn bends<'py>(
        &self,
        py: Python<'py>,
        commands: PyReadonlyArray2<f64>,
        gravity: [f64; 3],
        load: [f64; 3],
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Bends<'py>> {
        let commands = rows(&commands);
        let found = watched(py, commands.len(), progress, |p| {
            self.simulation
                .bends(&commands, gravity.into(), load.into(), p)
        })?;
        let (samples, points) = (found.len(), self.simulation.points.weights.len());
        let cables = self.simulation.solid.cables.len();
        let causes = LOADS + MODULI + cables;
        let pairs = causes * (causes + 1) / 2;
        let moved: Vec<f64> = found
            .iter()
            .flat_map(|s| s.fields.iter().flat_map(|field| flat(field)))
            .collect();
        let growth = found
            .iter()
            .flat_map(|s| s.growth.iter().copied())
            .collect();
        let stretch = found.iter().flat_map(|s| {
            (0..pairs).flat_map(move |p| (0..cables).map(move |c| s.stretch[c * pairs + p]))
        });
        Ok((
            PyArray1::from_vec(py, moved).reshape([samples, pairs, points, 3])?,
            PyArray1::from_vec(py, stretch.collect()).reshape([samples, pairs, cables])?,
            PyArray1::from_vec(py, growth).reshape([samples, causes])?,
        ))
    }

    /// At the equilibria of commands (S, C), all tensions as they are: displacement (S, N, 3) per
    /// unit of each field, by name, then per 1 N in each cable as `tension_0…`, and `stretch` (S,
    /// T, F + T) of the cables under the same: `FIELDS`, zero where there is none, then tensions.
    /// Changes of `design` are answered if asked.
    #[pyo3(signature = (commands, gravity, load, design=false, progress=None))]
    fn fields<'py>(
        &self,
        py: Python<'py>,
        commands: PyReadonlyArray2<f64>,
        gravity: [f64; 3],
        load: [f64; 3],
        design: bool,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let commands = rows(&commands);
        let found = watched(py, commands.len(), progress, |p| {
            self.simulation
                .fields(&commands, gravity.into(), load.into(), design, p)
        })?;
        let answer = PyDict::new(py);
        let (samples, points) = (found.len(), self.simulation.points.weights.len());
        let cables = self.simulation.solid.cables.len();
        let names = FIELDS.iter().map(|name| name.to_string());
        for (f, name) in names
            .chain((0..cables).map(|c| format!("tension_{c}")))
            .enumerate()
        {
            if found.iter().any(|s| s.fields[f].len() != points) {
                continue;
            }
            let moved: Vec<f64> = found.iter().flat_map(|s| flat(&s.fields[f])).collect();
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
        let places: Vec<f64> = shapes.iter().flat_map(|s| flat(&s.places)).collect();
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

fn rows(array: &PyReadonlyArray2<f64>) -> Vec<Vec<f64>> {
    let view = array.as_array();
    (0..view.nrows()).map(|i| view.row(i).to_vec()).collect()
}
