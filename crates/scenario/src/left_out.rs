//! What is left out when a scenario is written.

/// What is 0 by default is left out when written.
#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde asks so")]
pub(crate) fn is_zero(value: &f64) -> bool {
    *value == 0.0
}
