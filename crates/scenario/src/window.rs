//! A span of scenario time, in which values are judged.

/// Span of scenario time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// First instant.
    pub from_seconds: f64,
    /// Last instant.
    pub until_seconds: f64,
}
