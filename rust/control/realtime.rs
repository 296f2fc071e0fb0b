//! Real-time priority, if the system grants it; a refusal is reported.

use rustix::mm::{MlockAllFlags, mlockall};
use softmap_servo::urgent::urgent;

/// Above ordinary threads, below those of the kernel.
const PRIORITY: i32 = 50;

/// The permissions that this process lacks, as sentences for the user.
pub fn warnings() -> Vec<String> {
    let mut said = vec![];
    if !urgent(PRIORITY) {
        said.push(
            "no real-time priority: periods may begin late while the computer is busy; allow it \
             with `rtprio 50` for your user in /etc/security/limits.d"
                .to_owned(),
        );
    }
    urgent(0);
    if mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE).is_err() {
        said.push(
            "memory is not locked: a period may wait for the disk; allow it with `memlock \
             unlimited` for your user in /etc/security/limits.d"
                .to_owned(),
        );
    }
    said
}

/// Give the calling thread priority over all ordinary ones, if granted.
pub fn enter() {
    urgent(PRIORITY);
}
