//! Numbers from Python: anything NumPy reads as float64, checked for shape and finiteness, with
//! one-line errors.

use crate::Error;
use numpy::{AllowTypeChange, PyArrayLike1, PyArrayLikeDyn, PyUntypedArrayMethods, TypeMustMatch};
use pyo3::prelude::*;

/// Numbers that are looked at together.
const CHUNK: usize = 256;

/// Row-major numbers and their shape.
pub struct Floats {
    pub shape: Vec<usize>,
    pub data: Vec<f64>,
}

/// Read `value` as float64 of as many axes as `axes`, whose names are for the error; `None` entries
/// may have any length.
pub fn floats(
    name: &str,
    value: &Bound<'_, PyAny>,
    axes: &[(&str, Option<usize>)],
) -> PyResult<Floats> {
    let wanted = || {
        let list: Vec<String> = axes
            .iter()
            .map(|(axis, length)| {
                length.map_or(axis.to_string(), |length| format!("{axis} = {length}"))
            })
            .collect();
        format!("({})", list.join(", "))
    };
    let array: PyArrayLikeDyn<'_, f64, AllowTypeChange> = value.extract().map_err(|_| {
        Error::Invalid(format!(
            "{name} must be an array of numbers {}, got {}",
            wanted(),
            kind(value)
        ))
    })?;
    let shape = array.shape().to_vec();
    let fits = shape.len() == axes.len()
        && shape
            .iter()
            .zip(axes)
            .all(|(have, (_, want))| want.is_none_or(|want| want == *have));
    if !fits {
        return Err(
            Error::Invalid(format!("{name} has shape {shape:?}, expected {}", wanted())).into(),
        );
    }
    let view = array.as_array();
    let data = view
        .as_slice()
        .map_or_else(|| view.iter().copied().collect(), <[f64]>::to_vec);
    // Full chunks without a branch in them: fits ask again and again with records of tens of
    // thousands of numbers.
    let finite = |part: &[f64]| part.iter().fold(true, |all, value| all & value.is_finite());
    if data.chunks(CHUNK).all(finite) {
        return Ok(Floats { shape, data });
    }
    let bad = data.iter().position(|value| !value.is_finite());
    let bad = bad.unwrap_or_default();
    Err(Error::Invalid(format!(
        "{name} holds {} at position {bad}; all its numbers must be finite",
        data[bad]
    ))
    .into())
}

/// Read `value` as a one-dimensional array of int64. Floats are rejected, even if integral.
pub fn integers(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Vec<i64>> {
    let array: PyArrayLike1<'_, i64, TypeMustMatch> = value.extract().map_err(|_| {
        Error::Invalid(format!(
            "{name} must be a one-dimensional array of integers (int64), got {}",
            kind(value)
        ))
    })?;
    Ok(array.as_array().iter().copied().collect())
}

fn kind(value: &Bound<'_, PyAny>) -> String {
    value
        .get_type()
        .name()
        .map_or("something else".into(), |name| name.to_string())
}
