//! What becomes of memory that was freed, and how new memory comes from the system.
#![expect(unsafe_code, reason = "mallopt, sbrk and madvise have no safe wrapper")]

/// Larger blocks come from the system one by one and go back to it at once.
const BLOCK_BYTES_MAX: i32 = 8 << 20;
/// So much stays with the process at the end of its heap.
const KEPT_BYTES_MAX: i32 = 64 << 20;
/// The heap grows by so much at once, which most runs do not exceed.
const GROWTH_BYTES: i32 = 16 << 20;

/// Prepares the heap for recordings, whose large buffers are made and dropped in turn.
///
/// Another C library than glibc does as it likes.
pub fn prepare_heap() {
    #[cfg(target_env = "gnu")]
    {
        keep_freed();
        prefer_large_pages();
    }
}

/// Lets memory that was freed stay with the process, which uses it again soon. Otherwise it comes from the system anew each
/// time, which clears each page of it.
#[cfg(target_env = "gnu")]
fn keep_freed() {
    for (parameter, bytes) in [
        (libc::M_MMAP_THRESHOLD, BLOCK_BYTES_MAX),
        (libc::M_TRIM_THRESHOLD, KEPT_BYTES_MAX),
        (libc::M_TOP_PAD, GROWTH_BYTES),
    ] {
        // SAFETY: changes how blocks are handed out from now on; those that are out stay valid.
        unsafe { libc::mallopt(parameter, bytes) };
    }
}

/// Asks for large pages for the heap that comes next: every small page costs a trap when it is touched first, thousands in
/// a run. A system without large pages does without.
#[cfg(target_env = "gnu")]
fn prefer_large_pages() {
    const LARGE_PAGE_BYTES: usize = 2 << 20;
    // More than the first heap has left, so that the heap grows now.
    std::hint::black_box(Vec::<u8>::with_capacity(1 << 20));
    // SAFETY: asks where the heap ends and does not move it.
    let end = unsafe { libc::sbrk(0) };
    let length = end.addr() % LARGE_PAGE_BYTES + (GROWTH_BYTES as usize - LARGE_PAGE_BYTES);
    let begin = end.wrapping_byte_sub(length);
    // SAFETY: advice about pages that belong to the heap; their content does not change.
    unsafe { libc::madvise(begin, length, libc::MADV_HUGEPAGE) };
}
