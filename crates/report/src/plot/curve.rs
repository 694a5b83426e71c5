//! Elements of a plot: curves, the patches behind them, and the extent of the height.

use platform::series::Series;

/// Number of places at which two curves are compared.
const LOOKED_AT: u32 = 400;

/// Colour from the style sheet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Colour {
    /// Colour of a wanted value.
    Wanted,
    /// Colour of a measured value.
    Measured,
    /// Colour of a true value, which is known in emulation only.
    True,
    /// Colour of a value that the controller estimates or derives.
    Estimated,
    /// Colour of the n-th of several runs.
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

/// Way in which the points of a curve are joined.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// Line over time: x grows.
    Line,
    /// Dashed line over time, for wanted values.
    Dashed,
    /// Path in a plane: x may grow and fall.
    Path,
    /// Dashed path in a plane, for wanted values.
    DashedPath,
    /// Area down to the lower edge.
    Area,
    /// Points over time, not joined, since values between them are unknown.
    Points,
}

impl Shape {
    /// Returns whether the shape is in a plane.
    pub(super) fn is_path(self) -> bool {
        matches!(self, Self::Path | Self::DashedPath)
    }

    /// Returns the class of the style sheet that distinguishes the shape from a line.
    pub(crate) fn class(self) -> Option<&'static str> {
        match self {
            Self::Dashed | Self::DashedPath => Some("dashed"),
            Self::Area => Some("area"),
            Self::Points => Some("points"),
            Self::Line | Self::Path => None,
        }
    }
}

/// Curve of a plot.
pub struct PlotCurve {
    pub label: String,
    pub colour: Colour,
    pub shape: Shape,
    pub x: Series<f64>,
    pub y: Series<f64>,
}

impl PlotCurve {
    /// Returns the value at a place of the horizontal axis; `None` before the first point, and if the value is not finite.
    fn value_at(&self, x: f64) -> Option<f64> {
        let place = self.x.partition_point(|point| point <= x).checked_sub(1)?;
        self.y.get(place).filter(|y| y.is_finite())
    }

    /// Returns whether the curve covers another for most of a stretch of x, so near that it hides it.
    pub(super) fn hides(&self, other: &Self, (from, until): (f64, f64), near: f64) -> bool {
        let is_line = |shape| matches!(shape, Shape::Line | Shape::Dashed);
        if !is_line(self.shape) || !is_line(other.shape) {
            return false;
        }
        let places = (0..=LOOKED_AT)
            .map(|place| f64::from(place) / f64::from(LOOKED_AT))
            .map(|share| from + share * (until - from));
        let both = places.filter_map(|x| Some((self.value_at(x)?, other.value_at(x)?)));
        let (near, all) = both.fold((0, 0), |(count, all), (value, other)| {
            (count + usize::from((value - other).abs() <= near), all + 1)
        });
        2 * near > all
    }

    /// Returns the points in a stretch of x, or all points of a path in the plane.
    pub(super) fn within(&self, stretch: Option<(f64, f64)>) -> (Series<f64>, Series<f64>) {
        match stretch {
            Some((from, until)) if !self.shape.is_path() => {
                let first = self.x.partition_point(|x| x < from);
                let end = self.x.partition_point(|x| x <= until);
                (self.x.part(first..end), self.y.part(first..end))
            }
            _ => (self.x.clone(), self.y.clone()),
        }
    }
}

/// Rectangle behind the curves; infinite sides reach the edge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Patch {
    /// Class in the style sheet.
    pub class: &'static str,
    /// Left and right edge.
    pub x: (f64, f64),
    /// Lower and upper edge.
    pub y: (f64, f64),
}

/// Range that reaches both edges of a plot.
pub const EDGES: (f64, f64) = (f64::NEG_INFINITY, f64::INFINITY);

impl Patch {
    /// Returns the rectangle in which values must lie.
    pub fn band(x: (f64, f64), y: (f64, f64)) -> Self {
        let class = "band";
        Self { class, x, y }
    }

    /// Returns a stretch of x.
    pub fn stretch(class: &'static str, x: (f64, f64)) -> Self {
        Self { class, x, y: EDGES }
    }
}

/// Range of the values that the height of a plot shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extent {
    /// All values.
    All,
    /// All values, and 0.
    FromZero,
    /// Nearly all values: rare peaks that would flatten the rest are cut, which the caption says.
    Typical,
    /// All values, which are decimal logarithms.
    Logarithmic,
    /// All values, with the same scale in both directions: a circle is round.
    Plane,
}
