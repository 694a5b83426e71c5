//! A span of scenario time, for whoever judges one.

/// A span of scenario time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// First instant.
    pub from_seconds: f64,
    /// Last instant.
    pub until_seconds: f64,
}
