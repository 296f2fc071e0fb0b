//! Real-time priority where the system grants it; what it did not grant is told, not hidden.

use rustix::mm::{MlockAllFlags, mlockall};

/// Above ordinary threads, below those of the kernel.
const PRIORITY: i32 = 50;

/// What is not granted to this process, in sentences for the user.
pub fn warnings() -> Vec<String> {
    let mut said = vec![];
    if !scheduled(true) {
        said.push(
            "no real-time priority: periods may begin late while the computer is busy; allow it with `rtprio 50` for \
             your user in /etc/security/limits.d"
                .to_owned(),
        );
    }
    scheduled(false);
    if mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE).is_err() {
        said.push(
            "memory is not locked: a period may wait for the disk; allow it with `memlock unlimited` for your user in \
             /etc/security/limits.d"
                .to_owned(),
        );
    }
    said
}

/// The calling thread runs before all ordinary ones from now on, where that is granted.
pub fn enter() {
    scheduled(true);
}

fn scheduled(first: bool) -> bool {
    let policy = if first {
        libc::SCHED_FIFO
    } else {
        libc::SCHED_OTHER
    };
    let param = libc::sched_param {
        sched_priority: if first { PRIORITY } else { 0 },
    };
    // SAFETY: `param` is a valid structure for the duration of the call; 0 is the calling thread.
    unsafe { libc::sched_setscheduler(0, policy, &param) == 0 }
}
