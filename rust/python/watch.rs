//! Long work on another thread, while the interpreter shows its progress and can be interrupted.

use crate::Result;
use crate::error::invalid;
use crate::fem::progress::Progress;
use pyo3::prelude::*;
use std::sync::atomic::Ordering;
use std::sync::{Condvar, Mutex, PoisonError};
use std::time::Duration;

/// How often a waiting interpreter looks for Ctrl-C and reports progress.
const LOOK: Duration = Duration::from_millis(50);

/// Run on another thread while this one reports `progress(share)` and watches for Ctrl-C.
pub fn watched<T: Send>(
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

/// Run on another thread a law that a user wrote, which may never end, while this one watches for
/// Ctrl-C and passes it on.
pub fn patiently<T: Send>(py: Python<'_>, work: impl FnOnce() -> Result<T> + Send) -> PyResult<T> {
    let own_effect = py.import("softmap_edge.model.user_effect")?; // before there is anything to wait for
    let (done, told) = (Mutex::new(false), Condvar::new());
    let tell = || {
        *done.lock().unwrap_or_else(PoisonError::into_inner) = true;
        told.notify_all();
    };
    let wait = || {
        let guard = done.lock().unwrap_or_else(PoisonError::into_inner);
        let waited = told.wait_timeout_while(guard, LOOK, |done| !*done);
        *waited.unwrap_or_else(PoisonError::into_inner).0
    };
    std::thread::scope(|scope| {
        let worker = scope.spawn(|| {
            let found = work();
            tell();
            found
        });
        let mut trouble = None;
        while !py.detach(wait) && !worker.is_finished() {
            if let Err(error) = py.check_signals() {
                let passed_on = own_effect.call_method0("interrupt");
                trouble.get_or_insert(passed_on.map_or_else(|fault| fault, |_| error));
            }
        }
        let found = py
            .detach(|| worker.join())
            .map_err(|_| invalid("a Python effect stopped unexpectedly; please report it"))?;
        trouble.map_or_else(|| Ok(found?), Err)
    })
}
