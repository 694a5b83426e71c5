//! What a plot consists of: curves, what stands behind them, and what its height stands for.

/// Places at which two curves are compared.
const LOOKED_AT: u32 = 400;

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
    /// Over time, not joined: between them nothing is known.
    Points,
}

impl Shape {
    /// Whether it is in a plane.
    pub(super) fn is_path(self) -> bool {
        matches!(self, Self::Path | Self::DashedPath)
    }

    /// The class of the style sheet that tells it from a line.
    pub(crate) fn class(self) -> Option<&'static str> {
        match self {
            Self::Dashed | Self::DashedPath => Some("dashed"),
            Self::Area => Some("area"),
            Self::Points => Some("points"),
            Self::Line | Self::Path => None,
        }
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
    /// The value at a place of the horizontal axis; none before the first one, and where it is not finite.
    fn value_at(&self, x: f64) -> Option<f64> {
        let place = self.x.partition_point(|own| *own <= x).checked_sub(1)?;
        self.y.get(place).copied().filter(|y| y.is_finite())
    }

    /// Whether the curve runs over another for most of a stretch of x, so near that it hides it.
    pub(super) fn hides(&self, other: &Self, (from, until): (f64, f64), near: f64) -> bool {
        let is_line = |shape| matches!(shape, Shape::Line | Shape::Dashed);
        if !is_line(self.shape) || !is_line(other.shape) {
            return false;
        }
        let places = (0..=LOOKED_AT).map(|place| f64::from(place) / f64::from(LOOKED_AT));
        let places = places.map(|share| from + share * (until - from));
        let both = places.filter_map(|x| Some((self.value_at(x)?, other.value_at(x)?)));
        let (near, all) = both.fold((0, 0), |(count, all), (own, other)| {
            (count + usize::from((own - other).abs() <= near), all + 1)
        });
        2 * near > all
    }

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
