//! The time since the first sample, for effects that depend on time and not on commands.

use super::conditions::Context;

/// State: whether a sample was seen, and the time of the first. All zero before it.
pub const SIZE: usize = 2;

/// Return the seconds since the first sample.
pub fn elapsed(state: &mut [f64], context: &Context) -> f64 {
    if state[0] == 0.0 {
        state.copy_from_slice(&[1.0, context.t]);
    }
    context.t - state[1]
}
