//! A span of scenario time, in which values are judged.

/// Span of scenario time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// First instant.
    pub from_seconds: f64,
    /// Last instant.
    pub until_seconds: f64,
}

impl Window {
    /// Makes the span between two instants.
    pub fn new(from_seconds: f64, until_seconds: f64) -> Self {
        Self {
            from_seconds,
            until_seconds,
        }
    }
}

/// Writes a text such as `from 1.000 to 2.500 s`.
impl std::fmt::Display for Window {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (from, until) = (self.from_seconds, self.until_seconds);
        write!(formatter, "from {from:.3} to {until:.3} s")
    }
}
