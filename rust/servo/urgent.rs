//! Real-time priority for the calling thread, where the system grants it.

/// Run before all ordinary threads, higher `priority` first; 0 is ordinary again. Returns whether
/// it was granted.
pub fn urgent(priority: i32) -> bool {
    let policy = if priority > 0 {
        libc::SCHED_FIFO
    } else {
        libc::SCHED_OTHER
    };
    let param = libc::sched_param {
        sched_priority: priority,
    };
    // SAFETY: `param` is a valid structure for the duration of the call; 0 is the calling thread.
    unsafe { libc::sched_setscheduler(0, policy, &param) == 0 }
}
