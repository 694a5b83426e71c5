//! The set-points of profile position, and their handshake (CiA 402-2, 10.3).
//!
//! In: controlwords, and the target (0x607A) with its reference (0x60F2). Out: the set-point that the drive moves to, the next
//! one, and bit 12 of the statusword. [`super::motion`] passes on each controlword, and each arrival.

const NEW_SET_POINT: u16 = 1 << 4;
const CHANGE_AT_ONCE: u16 = 1 << 5;
const RELATIVE: u16 = 1 << 6;
const CHANGE_ON_SET_POINT: u16 = 1 << 9;

/// A target position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SetPoint {
    pub(super) target: f64,
    /// Whether the move before passes its own target without a stop.
    pub(super) passes_the_last: bool,
}

/// Positions to which a relative target may refer.
#[derive(Clone, Copy, Debug)]
pub(super) struct References {
    pub(super) demand: f64,
    pub(super) actual: f64,
    /// 0x60F2.
    pub(super) positioning_option_code: u16,
}

/// The set-points of a drive.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct SetPoints {
    active: Option<SetPoint>,
    next: Option<SetPoint>,
    /// Latest target, if there was one.
    last: Option<f64>,
    controlword: u16,
    is_acknowledged: bool,
}

impl SetPoints {
    /// Forgets all set-points, as when the drive is disabled; the controlword's edges go on.
    pub(super) fn clear(&mut self) {
        *self = Self {
            controlword: self.controlword,
            ..Self::default()
        };
    }

    /// Takes note of a controlword. Returns whether a set-point was taken over; `target` is 0x607A within its limits once a
    /// relative one is absolute.
    pub(super) fn on_controlword(
        &mut self,
        controlword: u16,
        is_enabled: bool,
        references: &References,
        target: f64,
        limit: impl Fn(f64) -> f64,
    ) -> bool {
        let rising = controlword & !self.controlword;
        self.controlword = controlword;
        let is_new = is_enabled && rising & NEW_SET_POINT != 0;
        let is_at_once = controlword & CHANGE_AT_ONCE != 0;
        let is_taken = is_new && (is_at_once || self.active.is_none() || self.next.is_none());
        if is_taken {
            let last = self.last.unwrap_or(references.demand);
            let base = match (
                controlword & RELATIVE,
                references.positioning_option_code & 3,
            ) {
                (0, _) => 0.0,
                (_, 0) => last,
                (_, 1) => references.demand,
                _ => references.actual,
            };
            let set_point = SetPoint {
                target: limit(base + target),
                passes_the_last: !is_at_once && controlword & CHANGE_ON_SET_POINT != 0,
            };
            self.last = Some(set_point.target);
            if is_at_once || self.active.is_none() {
                (self.active, self.next) = (Some(set_point), None);
            } else {
                self.next = Some(set_point);
            }
            self.is_acknowledged = true;
        }
        self.release();
        is_taken
    }

    /// The acknowledge falls when the master has lowered bit 4 and the drive can take another set-point.
    fn release(&mut self) {
        let is_asked = self.controlword & NEW_SET_POINT != 0;
        self.is_acknowledged &= is_asked || self.next.is_some();
    }

    /// Ends the move to the active set-point.
    pub(super) fn on_arrival(&mut self) {
        self.active = self.next.take();
        self.release();
    }

    /// Returns the set-point that the drive moves to.
    pub(super) fn active(&self) -> Option<SetPoint> {
        self.active
    }

    /// Returns whether the active move passes its target without a stop.
    pub(super) fn is_passing(&self) -> bool {
        self.next.is_some_and(|next| next.passes_the_last)
    }

    /// Returns the latest target.
    pub(super) fn last(&self) -> Option<f64> {
        self.last
    }

    /// Returns bit 12 of the statusword.
    pub(super) fn is_acknowledged(&self) -> bool {
        self.is_acknowledged
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ENABLED: u16 = 0x0F;
    const NEW: u16 = ENABLED | NEW_SET_POINT;

    fn send(points: &mut SetPoints, controlword: u16, target: f64) -> bool {
        let references = References {
            demand: 7.0,
            actual: 5.0,
            positioning_option_code: 0,
        };
        points.on_controlword(controlword, true, &references, target, |target| target)
    }

    fn target(points: &SetPoints) -> Option<f64> {
        points.active().map(|point| point.target)
    }

    #[test]
    fn a_single_set_point_replaces_the_move_and_is_acknowledged_until_bit_4_falls() {
        let mut points = SetPoints::default();
        assert!(send(&mut points, NEW, 10.0));
        assert!(points.is_acknowledged());
        assert!(!send(&mut points, NEW, 20.0), "no edge");
        send(&mut points, ENABLED, 20.0);
        assert!(!points.is_acknowledged());
        assert!(send(&mut points, NEW | CHANGE_AT_ONCE, 30.0));
        assert_eq!(target(&points), Some(30.0));
        points.on_arrival();
        assert_eq!((target(&points), points.last()), (None, Some(30.0)));
    }

    #[test]
    fn a_set_of_set_points_is_one_deep_and_stays_acknowledged_while_it_is_full() {
        let mut points = SetPoints::default();
        for position in [10.0, 20.0] {
            assert!(send(&mut points, NEW, position));
            send(&mut points, ENABLED, position);
        }
        assert!(points.is_acknowledged(), "the buffer is full");
        assert!(!send(&mut points, NEW, 30.0), "a third one is ignored");
        send(&mut points, ENABLED, 30.0);
        assert_eq!(target(&points), Some(10.0));
        points.on_arrival();
        assert!(!points.is_acknowledged());
        assert_eq!(target(&points), Some(20.0));
        assert!(!points.is_passing());
        assert!(send(&mut points, NEW | CHANGE_ON_SET_POINT, 40.0));
        assert!(points.is_passing());
    }

    #[test]
    fn a_relative_target_refers_to_what_0x60f2_names() {
        for (positioning_option_code, expected) in [(0, 103.0), (1, 10.0), (2, 8.0)] {
            let mut points = SetPoints::default();
            send(&mut points, NEW, 100.0);
            send(&mut points, ENABLED, 3.0);
            let references = References {
                demand: 7.0,
                actual: 5.0,
                positioning_option_code,
            };
            let controlword = NEW | RELATIVE | CHANGE_AT_ONCE;
            points.on_controlword(controlword, true, &references, 3.0, |target| target);
            assert_eq!(target(&points), Some(expected));
        }
    }

    #[test]
    fn a_disabled_drive_takes_none_and_forgets() {
        let mut points = SetPoints::default();
        send(&mut points, NEW, 10.0);
        points.clear();
        assert_eq!((target(&points), points.is_acknowledged()), (None, false));
        assert!(!send(&mut points, NEW, 10.0), "bit 4 stayed");
    }
}
