//! Bindings: convert arrays, release the interpreter, forward. No logic lives here.

mod arrays;
mod cables;
mod control;
mod effects;
mod elastic;
mod emulated;
mod families;
mod fem;
mod geometry;
mod inverse;
mod mesh;
mod network;
mod own;
mod predict;
mod registry;
mod rod;
mod scattered;
mod servo;
mod shape;
mod table;
mod watch;

use crate::effects::Chain;
use crate::{Error, Result};
use pyo3::exceptions::PyKeyboardInterrupt;
use pyo3::import_exception;
use pyo3::prelude::*;

// Subclasses of SoftmapError, so that a handler of it catches these too.
import_exception!(softmap_edge.errors, CoreError);
import_exception!(softmap_edge.errors, NoEquilibriumError);

impl From<Error> for PyErr {
    fn from(error: Error) -> PyErr {
        match error {
            Error::Invalid(message) => CoreError::new_err(message),
            Error::NoEquilibrium(message) => NoEquilibriumError::new_err(message),
            Error::Interrupted => PyKeyboardInterrupt::new_err("interrupted"),
        }
    }
}

/// Run what asks a chain without the interpreter, on a thread of rayon's: what is parallel inside
/// then wakes no other by itself, which costs more than many rows where there is one alone. A
/// user's own law can be interrupted meanwhile.
fn at_work<T: Send>(
    py: Python<'_>,
    chain: &Chain,
    work: impl FnOnce() -> Result<T> + Send,
) -> PyResult<T> {
    let work = || rayon::scope(|_| work());
    if chain.stepwise().is_ok() {
        Ok(py.detach(work)?)
    } else {
        watch::patiently(py, work)
    }
}

#[pymodule]
mod _core {
    #[pymodule_export]
    use super::cables::{PyCables, PySecond};
    #[pymodule_export]
    use super::control::{
        PyReading, check_limits, control_loop, limit_ranges, read_recording, replay,
    };
    #[pymodule_export]
    use super::effects::PyChain;
    #[pymodule_export]
    use super::elastic::{PyElasticField, PyElasticRod};
    #[pymodule_export]
    use super::emulated::PyEmulatedBus;
    #[pymodule_export]
    use super::families::{PyBank, PyLevel, PySeries, families};
    #[pymodule_export]
    use super::fem::Solid;
    #[pymodule_export]
    use super::geometry::{PyRegistration, PySurface, chamfer};
    #[pymodule_export]
    use super::inverse::{PyInverse, PyReach};
    #[pymodule_export]
    use super::mesh::Mesh;
    #[pymodule_export]
    use super::network::{PyNetwork, check_onnx};
    #[pymodule_export]
    use super::own::{forget, register};
    #[pymodule_export]
    use super::predict::{PyInputs, PyPredictor};
    #[pymodule_export]
    use super::registry::effects;
    #[pymodule_export]
    use super::rod::{PyRod, PyRodField, monomial_degrees, monomials, tensor_splines};
    #[pymodule_export]
    use super::scattered::PyScattered;
    #[pymodule_export]
    use super::servo::{PyServoBus, servo_models, servo_packet, servo_packets, servo_registers};
    #[pymodule_export]
    use super::shape::{PyShape, PySum};
    #[pymodule_export]
    use super::table::PyTable;

    /// Adds the base of its errors; `FIELDS`, the names of the shape fields in the order of
    /// `Chain.coefficients`; `LOADS`, those of them that are dead loads; `MODULI`, those of the
    /// modulus; `STATIONS`, shares of the height at which an obstacle can push; `FAST_FIRMWARE`,
    /// that from which servos answer in one packet; `HARDWARE_ERRORS`, bits of the hardware error
    /// status and what they mean; and `STANDARD_GRAVITY`.
    #[pymodule_init]
    fn init(module: &pyo3::Bound<'_, pyo3::types::PyModule>) -> pyo3::PyResult<()> {
        use pyo3::types::PyModuleMethods;
        module.add("CoreError", module.py().get_type::<super::CoreError>())?;
        module.add(
            "LOADS",
            &crate::response::loads::FIELDS[..crate::response::loads::LOADS],
        )?;
        let moduli = crate::response::loads::STIFF..crate::response::loads::CURVE;
        module.add("MODULI", &crate::response::loads::FIELDS[moduli])?;
        module.add("STATIONS", crate::response::loads::STATIONS)?;
        module.add("FIELDS", crate::response::loads::FIELDS)?;
        module.add("HARDWARE_ERRORS", softmap_servo::registers::HARDWARE_ERRORS)?;
        module.add("FAST_FIRMWARE", softmap_servo::registers::FAST_FIRMWARE)?;
        module.add("STANDARD_GRAVITY", crate::response::loads::STANDARD_GRAVITY)
    }
}
