//! How far a long computation is, seen from another thread, and how that one stops it.

use crate::error::{Error, Result};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// How far a long computation is, and whether to stop it.
#[derive(Debug, Default)]
pub struct Progress {
    pub done: AtomicUsize,
    pub stop: AtomicBool,
}

impl Progress {
    /// One command more is done; refused once the computation is to stop.
    pub(super) fn count(&self) -> Result<()> {
        self.done.fetch_add(1, Ordering::Relaxed);
        if self.stop.load(Ordering::Relaxed) {
            Err(Error::Interrupted)
        } else {
            Ok(())
        }
    }
}
