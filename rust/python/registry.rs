//! Binding of the effect registry.

use crate::effects::{Each, Kind, Law, Parameter, Reach, WithMap, registry};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use std::collections::HashMap;

/// The registry in stage order, one dictionary an effect.
#[pyfunction]
pub fn effects<'py>(py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
    let list = PyList::empty(py);
    for effect in registry() {
        let (d, entry) = (&effect.declaration, PyDict::new(py));
        entry.set_item("name", d.name)?;
        entry.set_item("family", d.family)?;
        entry.set_item("stage", d.stage.name())?;
        entry.set_item("role", effect.law.role())?;
        let kind = if d.kind == Kind::Fault {
            "fault"
        } else {
            "effect"
        };
        entry.set_item("kind", kind)?;
        entry.set_item("remembers", matches!(effect.law, Law::Remembering(_)))?;
        entry.set_item("own", matches!(effect.law, Law::Record(_)))?;
        entry.set_item("formula", d.formula)?;
        entry.set_item("doc", d.doc)?;
        entry.set_item("signature", d.signature)?;
        entry.set_item("reference", d.reference)?;
        entry.set_item("experiment", d.experiment)?;
        entry.set_item("alike", d.alike.iter().copied().collect::<HashMap<_, _>>())?;
        entry.set_item("needs", d.needs.to_vec())?;
        let parameters = PyList::empty(py);
        for p in d.parameters {
            parameters.append(parameter(py, p)?)?;
        }
        entry.set_item("parameters", parameters)?;
        list.append(entry)?;
    }
    Ok(list)
}

fn parameter<'py>(py: Python<'py>, p: &Parameter) -> PyResult<Bound<'py, PyDict>> {
    let entry = PyDict::new(py);
    entry.set_item("name", p.name)?;
    entry.set_item("unit", p.unit)?;
    entry.set_item("null", p.null)?;
    entry.set_item("start", p.start)?;
    entry.set_item("low", p.low)?;
    entry.set_item("high", p.high)?;
    entry.set_item(
        "per_channel",
        matches!(p.each, Each::Channel | Each::Shared),
    )?;
    entry.set_item("shared", p.tied())?;
    entry.set_item("per_cable", p.each == Each::Cable)?;
    entry.set_item("per_pair", p.each == Each::Pair)?;
    let (half_ranges, lengths) = match p.reach {
        Reach::High => (0.0, 0.0),
        Reach::HalfRanges(times) => (times, 0.0),
        Reach::Lengths(times) => (0.0, times),
    };
    entry.set_item("half_ranges", half_ranges)?;
    entry.set_item("lengths", lengths)?;
    let (map_half_ranges, map_high) = match p.with_map {
        WithMap::High => (0.0, 0.0),
        WithMap::HalfRanges(times) => (times, 0.0),
        WithMap::UpTo(most) => (0.0, most),
    };
    entry.set_item("map_half_ranges", map_half_ranges)?;
    entry.set_item("map_high", map_high)?;
    entry.set_item("integer", p.integer)?;
    entry.set_item("instant", p.instant)?;
    entry.set_item("doc", p.doc)?;
    entry.set_item("log", p.log())?;
    Ok(entry)
}
