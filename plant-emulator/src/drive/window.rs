//! A condition that counts only once it has lasted.
//!
//! In: the condition at each step, and the time of a window object. Out: whether it has lasted for that time without a break.
//! [`super::motion`] has one for each of the windows 0x6066, 0x6068, 0x606E and 0x6070.

use std::time::Duration;

/// Start of the condition.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Window {
    since: Option<Duration>,
}

impl Window {
    /// Returns whether the condition has lasted for a time.
    pub(super) fn lasts(&mut self, is_met: bool, now: Duration, needed: Duration) -> bool {
        if !is_met {
            self.since = None;
            return false;
        }
        let since = *self.since.get_or_insert(now);
        now.saturating_sub(since) >= needed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_restarts_at_each_break() {
        let mut window = Window::default();
        let mut lasts = |is_met, now| {
            let [now, needed] = [now, 10].map(Duration::from_millis);
            window.lasts(is_met, now, needed)
        };
        assert!(!lasts(true, 0) && !lasts(true, 9) && lasts(true, 10));
        assert!(!lasts(false, 11) && !lasts(true, 12) && !lasts(true, 21) && lasts(true, 22));
    }
}
