//! The progress of a long computation for another thread, which can stop it.

use crate::error::{Error, Result};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// The progress of a long computation, and its stop flag.
#[derive(Debug, Default)]
pub struct Progress {
    pub done: AtomicUsize,
    pub stop: AtomicBool,
}

impl Progress {
    /// Count one more finished command; an error once the computation must stop.
    pub(super) fn count(&self) -> Result<()> {
        self.done.fetch_add(1, Ordering::Relaxed);
        if self.stop.load(Ordering::Relaxed) {
            Err(Error::Interrupted)
        } else {
            Ok(())
        }
    }
}
