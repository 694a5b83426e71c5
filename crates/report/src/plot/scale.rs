//! The drawing's own units, and the way from values to them.

/// Size of the drawing in its own units; it is stretched to the place that the page gives it.
pub(crate) const WIDTH: f64 = 3200.0;
pub(crate) const HEIGHT: f64 = 1000.0;

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
