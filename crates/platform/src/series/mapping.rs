//! Files that are read like memory, and the release of their pages after reading.

use std::fmt;
use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt;
use std::ptr::{self, NonNull};
use std::sync::{Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use rustix::mm::{Advice, MapFlags, ProtFlags, madvise, mmap, munmap};

use crate::clock::sleep;

/// Bytes of a file that an iterator has in memory.
pub(super) const READ_BYTES: usize = 1 << 16;
/// Bytes that the kernel maps around each byte that is read, aligned to a multiple of this size (Linux, `fault_around_bytes`).
const WINDOW_BYTES: usize = 1 << 16;
/// Bytes of a file that are read ahead of a sequential reader.
const AHEAD_BYTES: usize = 1 << 18;
/// Period of the check how much of all files is in memory, since slices are read without an iterator.
const LOOK_PERIOD: Duration = Duration::from_millis(1);
/// Growth of the resident bytes of files after which the pages of all series are released.
const RESIDENT_BYTES_MAX: usize = 8 << 20;

/// File that is read like memory. Its pages count as the process's own memory once they are read, so they are released again and
/// again; the file still holds them.
pub(super) struct Mapping {
    pub(super) begin: NonNull<u8>,
    bytes: usize,
}

// SAFETY: the mapping is only read.
unsafe impl Send for Mapping {}
// SAFETY: as above.
unsafe impl Sync for Mapping {}

/// All mappings of the process.
static MAPPINGS: Mutex<Mappings> = Mutex::new(Mappings {
    places: Vec::new(),
    is_watched: false,
});

struct Mappings {
    /// Address and length in bytes of each mapping.
    places: Vec<(usize, usize)>,
    /// Whether a thread releases their pages.
    is_watched: bool,
}

impl Mapping {
    pub(super) fn new(file: &File, bytes: usize) -> io::Result<Self> {
        // SAFETY: a new mapping at a place that the system chooses.
        let begin = unsafe {
            mmap(
                ptr::null_mut(),
                bytes,
                ProtFlags::READ,
                MapFlags::PRIVATE,
                file,
                0,
            )
        }?;
        let begin =
            NonNull::new(begin.cast::<u8>()).ok_or_else(|| io::Error::other("mapped nowhere"))?;
        // Otherwise the system reads ahead by itself, into pages of up to 2 MB, each of which is loaded whole with its first
        // byte.
        // SAFETY: no other code has the mapping.
        let _ = unsafe { madvise(begin.as_ptr().cast(), bytes, Advice::Random) };
        let mut mappings = MAPPINGS.lock().unwrap_or_else(PoisonError::into_inner);
        mappings
            .places
            .push((begin.as_ptr().expose_provenance(), bytes));
        let mapping = Self { begin, bytes };
        if !mappings.is_watched {
            let thread = thread::Builder::new().name("pages".to_owned());
            mappings.is_watched = thread.spawn(watch_pages).is_ok();
        }
        Ok(mapping)
    }

    /// Releases the pages of some of its values.
    pub(super) fn give_back<T>(&self, values: &[T]) {
        advise(self.place(), values, Advice::LinuxDontNeed);
    }

    /// Has the first of some of its values read ahead.
    pub(super) fn expect<T>(&self, values: &[T]) {
        advise(self.place(), ahead(values), Advice::WillNeed);
    }

    fn place(&self) -> (usize, usize) {
        (self.begin.as_ptr().expose_provenance(), self.bytes)
    }
}

impl fmt::Debug for Mapping {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter
            .debug_struct("Mapping")
            .field("bytes", &self.bytes)
            .finish_non_exhaustive()
    }
}

impl Drop for Mapping {
    fn drop(&mut self) {
        let mut mappings = MAPPINGS.lock().unwrap_or_else(PoisonError::into_inner);
        let begins = self.begin.addr().get();
        mappings.places.retain(|(begin, _)| *begin != begins);
        // SAFETY: it was mapped with this length, and no slice of it is left. The list does not name it any more either.
        let unmapped = unsafe { munmap(self.begin.as_ptr().cast(), self.bytes) };
        debug_assert!(unmapped.is_ok());
    }
}

/// Gives the system advice on exactly the pages that are loaded when some values of a mapping are read: a call for a whole
/// mapping takes longer, the longer the mapping is.
fn advise<T>((begin, bytes): (usize, usize), values: &[T], advice: Advice) {
    if values.is_empty() {
        return;
    }
    let first = values.as_ptr().addr() / WINDOW_BYTES * WINDOW_BYTES;
    let end = (values.as_ptr().addr() + size_of_val(values)).next_multiple_of(WINDOW_BYTES);
    let (first, end) = (
        first.max(begin),
        end.min((begin + bytes).next_multiple_of(page_size())),
    );
    if first < end {
        let first = ptr::with_exposed_provenance_mut(first);
        // SAFETY: the values are borrowed, so the mapping exists. A page that was released is read from the file again.
        let _ = unsafe { madvise(first, end - first.addr(), advice) };
    }
}

fn page_size() -> usize {
    // SAFETY: the call only returns a number.
    let bytes = unsafe { libc::sysconf(libc::_SC_PAGESIZE) };
    usize::try_from(bytes).unwrap_or(1 << 16)
}

/// Releases the pages that were read as slices, as long as there are mappings.
fn watch_pages() {
    let resident = ResidentFiles::open();
    let mut kept = resident.bytes();
    loop {
        sleep(LOOK_PERIOD);
        let mut mappings = MAPPINGS.lock().unwrap_or_else(PoisonError::into_inner);
        if mappings.places.is_empty() {
            mappings.is_watched = false;
            return;
        }
        let now = resident.bytes();
        if now < kept.saturating_add(RESIDENT_BYTES_MAX) {
            kept = kept.min(now);
            continue;
        }
        for (begin, bytes) in &mappings.places {
            let begin = ptr::with_exposed_provenance_mut(*begin);
            // SAFETY: the list is locked, so the range is mapped. A page that was released is read from the file again.
            let _ = unsafe { madvise(begin, *bytes, Advice::LinuxDontNeed) };
        }
        kept = resident.bytes();
    }
}

/// Meter of the file pages in the process's memory, those of the program itself included.
struct ResidentFiles {
    /// `None` if the system does not tell.
    statm: Option<File>,
}

impl ResidentFiles {
    fn open() -> Self {
        let statm = File::open("/proc/self/statm").ok();
        Self { statm }
    }

    fn bytes(&self) -> usize {
        let pages = self.pages();
        pages.map_or(usize::MAX, |pages| pages.saturating_mul(page_size()))
    }

    fn pages(&self) -> Option<usize> {
        let mut text = [0; 128];
        let length = self.statm.as_ref()?.read_at(&mut text, 0).ok()?;
        let text = str::from_utf8(&text[..length]).ok()?;
        // All pages, resident pages, and resident pages of files.
        text.split(' ').nth(2)?.parse().ok()
    }
}

/// Declares values that were read as not needed soon: if they are in a file, their pages are released. For readers of the slice
/// of a long series.
pub fn give_back<T>(values: &[T]) {
    advise_any(values, Advice::LinuxDontNeed);
}

/// Declares values as needed soon, in order: if they are in a file, the first of them are read ahead.
pub(super) fn expect<T>(values: &[T]) {
    advise_any(ahead(values), Advice::WillNeed);
}

fn ahead<T>(values: &[T]) -> &[T] {
    let count = AHEAD_BYTES / size_of::<T>().max(1);
    values.get(..count).unwrap_or(values)
}

/// As [`advise`], for the mapping that holds the values, if there is one.
fn advise_any<T>(values: &[T], advice: Advice) {
    let mappings = MAPPINGS.lock().unwrap_or_else(PoisonError::into_inner);
    let begin = values.as_ptr().addr();
    let of_them = |place: &&(usize, usize)| place.0 <= begin && begin < place.0 + place.1;
    if let Some(place) = mappings.places.iter().find(of_them) {
        advise(*place, values, advice);
    }
}
