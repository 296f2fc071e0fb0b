//! The one error type of the core: what was wrong, with numbers; what is allowed; what to do.

/// Everything that can go wrong in the core. Each message is complete: the front prints it as it
/// is.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// The caller's numbers are outside what is allowed.
    #[error("{0}")]
    Invalid(String),
    /// The solver found no equilibrium.
    #[error("{0}")]
    NoEquilibrium(String),
    /// The caller asked to stop (Ctrl-C).
    #[error("interrupted")]
    Interrupted,
}

pub type Result<T> = std::result::Result<T, Error>;

/// Shorthand: `Err(invalid(format!(...)))`.
pub fn invalid(message: impl Into<String>) -> Error {
    Error::Invalid(message.into())
}
