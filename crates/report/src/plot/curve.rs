//! What a plot consists of: curves, what stands behind them, and what its height stands for.

/// One of the colours that the style sheet defines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Colour {
    /// What is wanted.
    Wanted,
    /// What is measured.
    Measured,
    /// What is true, known only in emulation.
    True,
    /// What the controller estimates or makes of it.
    Estimated,
    /// The n-th of several runs.
    Run(usize),
}

impl Colour {
    /// Number of colours that the style sheet defines.
    const COUNT: usize = 8;

    pub(crate) fn class(self) -> String {
        let number = match self {
            Self::Wanted => 0,
            Self::Measured => 1,
            Self::True => 2,
            Self::Estimated => 3,
            Self::Run(number) => (number + 1) % Self::COUNT,
        };
        format!("c{number}")
    }
}

/// How the points of a curve are joined.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// Over time: x grows.
    Line,
    /// Over time, broken: for what is wanted.
    Dashed,
    /// In a plane: x goes to and fro.
    Path,
    /// In a plane, broken: for what is wanted.
    DashedPath,
    /// An area down to the lower edge.
    Area,
}

impl Shape {
    /// Whether it is in a plane.
    pub(super) fn is_path(self) -> bool {
        matches!(self, Self::Path | Self::DashedPath)
    }

    pub(crate) fn is_dashed(self) -> bool {
        matches!(self, Self::Dashed | Self::DashedPath)
    }
}

/// A curve of a plot.
pub struct PlotCurve<'a> {
    pub label: String,
    pub colour: Colour,
    pub shape: Shape,
    pub x: &'a [f64],
    pub y: &'a [f64],
}

impl PlotCurve<'_> {
    /// The points that a stretch of x shows. In the plane all are shown.
    pub(super) fn within(&self, stretch: Option<(f64, f64)>) -> (&[f64], &[f64]) {
        match stretch {
            Some((from, until)) if !self.shape.is_path() => {
                let first = self.x.partition_point(|x| *x < from);
                let end = self.x.partition_point(|x| *x <= until);
                (&self.x[first..end], &self.y[first..end])
            }
            _ => (self.x, self.y),
        }
    }
}

/// A rectangle behind the curves; infinite sides reach the edge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Patch {
    /// Class in the style sheet.
    pub class: &'static str,
    /// From left to right.
    pub x: (f64, f64),
    /// From bottom to top.
    pub y: (f64, f64),
}

/// What the height of a plot stands for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extent {
    /// Everything.
    All,
    /// Everything, and 0.
    FromZero,
    /// Nearly everything: rare peaks that would press the rest flat are cut, and the caption says so.
    Typical,
    /// Everything; the values are decimal logarithms.
    Logarithmic,
    /// Everything, and as much in both directions: a circle is round.
    Plane,
}
