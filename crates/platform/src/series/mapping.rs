//! Files that are read like memory, and how what was read of them goes back to the system.

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
/// Who reads a byte of a file gets this much of it, from a multiple of this on (Linux, `fault_around_bytes`).
const WINDOW_BYTES: usize = 1 << 16;
/// Bytes of a file that are read ahead of who goes through it.
const AHEAD_BYTES: usize = 1 << 18;
/// How often it is looked how much of all files is in memory, since slices are read without an iterator.
const LOOK_PERIOD: Duration = Duration::from_millis(1);
/// With so many bytes more of files in memory, those of all series go back to the system.
const RESIDENT_BYTES_MAX: usize = 8 << 20;

/// A file that is read like memory. Its pages count as the process's own memory from when they are read, so they are given
/// back again and again; the file has them still.
pub(super) struct Mapping {
    pub(super) begin: NonNull<u8>,
    bytes: usize,
}

// SAFETY: what is mapped is only read.
unsafe impl Send for Mapping {}
// SAFETY: as above.
unsafe impl Sync for Mapping {}

/// All mappings of the process.
static MAPPINGS: Mutex<Mappings> = Mutex::new(Mappings {
    places: Vec::new(),
    is_watched: false,
});

struct Mappings {
    /// Where each begins, and its bytes.
    places: Vec<(usize, usize)>,
    /// Whether a thread gives their pages back.
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
        // Else the system reads ahead by itself, into pages of up to 2 MB, of which each is there as a whole with its first byte.
        // SAFETY: nobody else has the mapping.
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

    /// Gives the pages of some of its values back.
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
        // SAFETY: it was mapped so, and nobody has a slice of it any more. The list does not name it any more either.
        let unmapped = unsafe { munmap(self.begin.as_ptr().cast(), self.bytes) };
        debug_assert!(unmapped.is_ok());
    }
}

/// Says of the pages that come when some values of a mapping are read, and of no others, what becomes of them: the longer a
/// mapping, the longer it takes to look through all of it.
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
        // SAFETY: the values are borrowed, so the mapping is there. A page that was given back is read from the file again.
        let _ = unsafe { madvise(first, end - first.addr(), advice) };
    }
}

fn page_size() -> usize {
    // SAFETY: it only answers.
    let bytes = unsafe { libc::sysconf(libc::_SC_PAGESIZE) };
    usize::try_from(bytes).unwrap_or(1 << 16)
}

/// Gives the pages back that were read as slices, as long as there are mappings.
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
            // SAFETY: the list is locked, so it is mapped. A page that was given back is read from the file again.
            let _ = unsafe { madvise(begin, *bytes, Advice::LinuxDontNeed) };
        }
        kept = resident.bytes();
    }
}

/// How much of all files is in the process's memory; the program itself is among them.
struct ResidentFiles {
    /// None where the system does not say.
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
        // All pages, those in memory, and of these the ones of files.
        text.split(' ').nth(2)?.parse().ok()
    }
}

/// Says that values were read which are not needed soon: if they are of a file, they go back to the system. For who goes through
/// the slice of a long series.
pub fn give_back<T>(values: &[T]) {
    advise_any(values, Advice::LinuxDontNeed);
}

/// Says that values are needed soon, one after the other: if they are of a file, the first of them are read ahead.
pub(super) fn expect<T>(values: &[T]) {
    advise_any(ahead(values), Advice::WillNeed);
}

fn ahead<T>(values: &[T]) -> &[T] {
    let count = AHEAD_BYTES / size_of::<T>().max(1);
    values.get(..count).unwrap_or(values)
}

/// As [`advise`], of the values of any mapping, or of none.
fn advise_any<T>(values: &[T], advice: Advice) {
    let mappings = MAPPINGS.lock().unwrap_or_else(PoisonError::into_inner);
    let begin = values.as_ptr().addr();
    let of_them = |place: &&(usize, usize)| place.0 <= begin && begin < place.0 + place.1;
    if let Some(place) = mappings.places.iter().find(of_them) {
        advise(*place, values, advice);
    }
}
