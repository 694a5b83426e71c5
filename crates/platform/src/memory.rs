//! Treatment of freed memory by the C library.
#![expect(unsafe_code, reason = "mallopt and malloc_trim have no safe wrapper")]

/// Size above which a block comes from the system by itself and returns to it when freed.
const BLOCK_BYTES_MAX: i32 = 8 << 20;
/// Free bytes at the end of the heap that stay with the process.
const KEPT_BYTES_MAX: i32 = 64 << 20;
/// Growth of the heap at once, enough for most runs.
const GROWTH_BYTES: i32 = 16 << 20;

/// Keeps freed memory with the process, which uses it again soon: each run makes and drops large buffers. Otherwise the system
/// clears each of their pages anew, which costs a sweep 10 % of its time.
///
/// Has no effect with a C library other than glibc.
pub fn keep_freed() {
    #[cfg(target_env = "gnu")]
    for (parameter, bytes) in [
        (libc::M_MMAP_THRESHOLD, BLOCK_BYTES_MAX),
        (libc::M_TRIM_THRESHOLD, KEPT_BYTES_MAX),
        (libc::M_TOP_PAD, GROWTH_BYTES),
    ] {
        // SAFETY: changes how blocks are handed out from now on; blocks in use stay valid.
        unsafe { libc::mallopt(parameter, bytes) };
    }
}

/// Returns freed memory to the system, when no following run would use it.
pub(crate) fn return_freed() {
    // SAFETY: only unused blocks are returned.
    #[cfg(target_env = "gnu")]
    unsafe {
        libc::malloc_trim(0)
    };
}
