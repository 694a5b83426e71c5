//! The drawing's own units, and the way from values to them.

/// Width and height of the drawing in its own units; it is stretched to the place that the page gives it. They are so many
/// since the page's script reads values from the curves.
pub(crate) const SIDE: f64 = 64_000.0;

/// From values to the drawing's units, by way of the upper left corner.
pub(super) struct DrawingScale {
    pub(super) x: f64,
    pub(super) y: f64,
    pub(super) right: f64,
    pub(super) down: f64,
}

impl DrawingScale {
    /// Units from the left.
    pub(super) fn along(&self, x: f64) -> f64 {
        (x - self.x) * self.right
    }

    /// Units from the top.
    pub(super) fn down(&self, y: f64) -> f64 {
        (y - self.y) * self.down
    }

    pub(super) fn place(&self, x: f64, y: f64) -> (f64, f64) {
        (self.along(x), self.down(y))
    }
}
