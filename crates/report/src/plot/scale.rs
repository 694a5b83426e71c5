//! The drawing's own units, and the conversion of values to them.

/// Width and height of the drawing in its own units; it is stretched to its place on the page. They are large since the page's
/// script reads values from the curves.
pub(crate) const SIDE: f64 = 64_000.0;

/// Conversion from values to the drawing's units, from the upper left corner on.
pub(super) struct DrawingScale {
    pub(super) x: f64,
    pub(super) y: f64,
    pub(super) right: f64,
    pub(super) down: f64,
}

impl DrawingScale {
    /// Converts x to units from the left.
    pub(super) fn along(&self, x: f64) -> f64 {
        (x - self.x) * self.right
    }

    /// Converts y to units from the top.
    pub(super) fn down(&self, y: f64) -> f64 {
        (y - self.y) * self.down
    }

    pub(super) fn place(&self, x: f64, y: f64) -> (f64, f64) {
        (self.along(x), self.down(y))
    }
}
