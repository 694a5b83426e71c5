//! What becomes of memory that was freed.
#![expect(unsafe_code, reason = "mallopt and malloc_trim have no safe wrapper")]

/// Larger blocks come from the system one by one and go back to it at once.
const BLOCK_BYTES_MAX: i32 = 8 << 20;
/// So much stays with the process at the end of its heap.
const KEPT_BYTES_MAX: i32 = 64 << 20;
/// The heap grows by so much at once, which most runs do not exceed.
const GROWTH_BYTES: i32 = 16 << 20;

/// Lets memory that was freed stay with the process, which uses it again soon: run after run makes and drops large buffers.
/// Otherwise the system clears each of their pages anew, which costs a sweep 10 % of its time.
///
/// Another C library than glibc does as it likes.
pub fn keep_freed() {
    #[cfg(target_env = "gnu")]
    for (parameter, bytes) in [
        (libc::M_MMAP_THRESHOLD, BLOCK_BYTES_MAX),
        (libc::M_TRIM_THRESHOLD, KEPT_BYTES_MAX),
        (libc::M_TOP_PAD, GROWTH_BYTES),
    ] {
        // SAFETY: changes how blocks are handed out from now on; those that are out stay valid.
        unsafe { libc::mallopt(parameter, bytes) };
    }
}

/// Gives the system back what was freed, when no run is to follow that would use it.
pub(crate) fn return_freed() {
    // SAFETY: only blocks that nobody uses go back.
    #[cfg(target_env = "gnu")]
    unsafe {
        libc::malloc_trim(0)
    };
}
