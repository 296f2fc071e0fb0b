//! The error type of the core: the error with its numbers, the allowed values, and the remedy.

/// All errors of the core. Each message is complete and printed unchanged.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// The caller's numbers are invalid.
    #[error("{0}")]
    Invalid(String),
    /// The solver found no equilibrium.
    #[error("{0}")]
    NoEquilibrium(String),
    /// The caller interrupted the computation (Ctrl-C).
    #[error("interrupted")]
    Interrupted,
}

pub type Result<T> = std::result::Result<T, Error>;

/// Shorthand: `Err(invalid(format!(...)))`.
pub fn invalid(message: impl Into<String>) -> Error {
    Error::Invalid(message.into())
}
