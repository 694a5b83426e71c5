//! Times as whole numbers, for what is worked out at every frame.

use std::time::Duration;

/// A time in 64 bits, which last for 584 years. They are compared and added in one step each, unlike a [`Duration`].
pub type Nanoseconds = u64;

/// The whole of a duration; the longest time for what is beyond it.
#[must_use]
#[inline]
pub fn nanoseconds(duration: Duration) -> Nanoseconds {
    let seconds = duration.as_secs().saturating_mul(1_000_000_000);
    seconds.saturating_add(duration.subsec_nanos().into())
}
