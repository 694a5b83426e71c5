//! Series of a run, which may be longer than memory. The first values go to a file without a name, which ends with the process;
//! they are read as if they were in memory.
#![expect(unsafe_code, reason = "a file as a slice is a mapping of it")]

mod mapping;

use std::fmt;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::ops::{Deref, Range};
use std::slice;
use std::sync::Arc;

use bytemuck::{Pod, cast_slice, cast_slice_mut};

use crate::memory::return_freed;
use mapping::{Mapping, READ_BYTES, expect};

pub use mapping::give_back;

/// Largest number of values that stay in memory: two minutes of a signal at 1 kHz.
pub const KEPT_MAX: usize = 1 << 17;
/// Number of values that go to the file at once. A block of zeros takes no room there.
const BLOCK: usize = 1 << 13;
/// Largest number of values that stay in memory once others are in the file: a run has a hundred series.
const KEPT_BESIDE_FILE_MAX: usize = 4 * BLOCK;

/// Returns the values at the given places, which ascend. Pages of a file that were read are released on the way.
///
/// # Panics
/// If a place is beyond the end.
#[must_use]
pub fn picked<T: Copy>(values: &[T], places: &[usize]) -> Vec<T> {
    let block = |place: usize| place / block_length::<T>();
    let mut picked = Vec::with_capacity(places.len());
    for near in places.chunk_by(|one, next| block(*one) == block(*next)) {
        let (first, last) = (near[0], near[near.len() - 1]);
        expect(&values[first..]);
        picked.extend(near.iter().map(|&place| values[place]));
        give_back(&values[first..=last]);
    }
    picked
}

/// Iterates over the values. Pages of a file that were read are released on the way.
pub fn passing<T>(values: &[T]) -> impl Iterator<Item = &T> {
    blocks(values).flatten()
}

/// Iterates over blocks of the values. Pages of a file that were read are released on the way.
pub fn blocks<T>(values: &[T]) -> Blocks<'_, T> {
    Blocks {
        block: &[],
        rest: values,
        length: block_length::<T>(),
    }
}

/// Iterates over the values, `count` at a time. Pages of a file that were read are released on the way.
///
/// # Panics
/// If `count` is 0.
pub fn parts<T>(values: &[T], count: usize) -> impl Iterator<Item = &[T]> {
    let blocks = Blocks {
        length: block_length::<T>().next_multiple_of(count),
        ..blocks(values)
    };
    blocks.flat_map(move |block| block.chunks(count))
}

/// Iterator over blocks of values, of which only the present one is in memory.
#[derive(Debug)]
pub struct Blocks<'a, T> {
    /// Block that was returned last.
    block: &'a [T],
    /// Values after the block.
    rest: &'a [T],
    /// Number of values in a block.
    length: usize,
}

impl<'a, T> Iterator for Blocks<'a, T> {
    type Item = &'a [T];

    fn next(&mut self) -> Option<&'a [T]> {
        give_back(self.block);
        expect(self.rest);
        let count = self.rest.len().min(self.length);
        (self.block, self.rest) = self.rest.split_at(count);
        (count > 0).then_some(self.block)
    }
}

impl<T> Drop for Blocks<'_, T> {
    fn drop(&mut self) {
        give_back(self.block);
    }
}

/// Returns how many values of a file are in memory at a time.
fn block_length<T>() -> usize {
    (READ_BYTES / size_of::<T>().max(1)).max(1)
}

/// Returns whether the file system is in memory. There, reading a hole takes memory, and the system kills the reader if there is
/// none left.
fn is_in_memory(file: &File) -> bool {
    rustix::fs::fstatfs(file).is_ok_and(|system| system.f_type == libc::TMPFS_MAGIC)
}

/// Series that grows.
#[derive(Debug)]
pub struct SeriesWriter<T> {
    kept_max: usize,
    file: Option<File>,
    /// Whether blocks of zeros take no room in the file.
    has_holes: bool,
    /// Number of values in the file.
    filed: usize,
    /// Whether the system refused the file; then all values stay in memory.
    is_refused: bool,
    tail: Vec<T>,
}

impl<T: Pod> Default for SeriesWriter<T> {
    fn default() -> Self {
        Self::keeping(KEPT_MAX)
    }
}

impl<T: Pod> SeriesWriter<T> {
    /// Makes an empty series that keeps at most `kept_max` values in memory.
    #[must_use]
    pub fn keeping(kept_max: usize) -> Self {
        Self {
            kept_max,
            file: None,
            has_holes: false,
            filed: 0,
            is_refused: false,
            tail: Vec::new(),
        }
    }

    /// Lowers the number of values that are kept in memory to `kept_max`.
    pub fn keep(&mut self, kept_max: usize) {
        self.kept_max = self.kept_max.min(kept_max.max(2));
    }

    /// Reserves room for values, as far as they stay in memory.
    pub fn reserve(&mut self, values: usize) {
        self.tail.reserve(values.min(self.kept_max));
    }

    #[must_use]
    pub fn len(&self) -> usize {
        self.filed + self.tail.len()
    }

    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns the latest value.
    #[must_use]
    pub fn last(&self) -> Option<&T> {
        self.tail.last()
    }

    #[inline]
    pub fn push(&mut self, value: T) {
        if self.tail.len() >= self.kept_max {
            self.file_blocks();
        }
        self.tail.push(value);
    }

    /// Appends copies of a value up to the given length.
    pub fn fill(&mut self, length: usize, value: T) {
        while self.len() < length {
            if self.tail.len() >= self.kept_max {
                self.file_blocks();
            }
            let room = self.kept_max.saturating_sub(self.tail.len()).max(1);
            let missing = (length - self.len()).min(room);
            self.tail.resize(self.tail.len() + missing, value);
        }
    }

    /// Removes the latest value and returns it; values in the file stay.
    pub fn pop(&mut self) -> Option<T> {
        self.tail.pop()
    }

    /// Removes the first `count` values and returns them.
    pub fn take(&mut self, count: usize) -> Series<T> {
        if self.filed == 0 && count < self.tail.len() {
            let rest = self.tail.split_off(count);
            return std::mem::replace(&mut self.tail, rest).into();
        }
        let whole = std::mem::replace(self, Self::keeping(self.kept_max)).finish();
        for value in whole.get(count..).unwrap_or_default() {
            self.push(*value);
        }
        whole.truncated(count)
    }

    /// Returns the whole series. If the system refuses more room on the disk or a mapping, the series is in memory.
    ///
    /// # Panics
    /// If the file cannot be read back.
    #[must_use]
    pub fn finish(mut self) -> Series<T> {
        if self.filed == 0 {
            return self.tail.into();
        }
        let mapped = self.write_tail().and_then(|()| self.map());
        mapped.unwrap_or_else(|_| {
            let read = self.read();
            read.unwrap_or_else(|error| panic!("a temporary file cannot be read: {error}"))
        })
    }

    /// Reads all values into memory.
    fn read(self) -> io::Result<Series<T>> {
        let mut values = vec![T::zeroed(); self.filed];
        if let Some(mut file) = self.file {
            file.seek(SeekFrom::Start(0))?;
            file.read_exact(cast_slice_mut(&mut values))?;
        }
        values.extend(self.tail);
        Ok(values.into())
    }

    /// Moves all but the latest block to the file.
    #[cold]
    fn file_blocks(&mut self) {
        let count = self.tail.len().saturating_sub(BLOCK.min(self.kept_max / 2));
        let is_filed = !self.is_refused && self.write(count).is_ok();
        if is_filed {
            self.tail.drain(..count);
            self.filed += count;
            self.kept_max = self.kept_max.min(KEPT_BESIDE_FILE_MAX);
            self.tail.shrink_to(self.kept_max);
        } else {
            // A large process is better than one that ends.
            self.is_refused = true;
            self.kept_max = usize::MAX;
        }
    }

    fn write_tail(&mut self) -> io::Result<()> {
        let count = self.tail.len();
        self.write(count)?;
        self.filed += count;
        self.tail = Vec::new();
        Ok(())
    }

    /// Writes the first values of the tail after those in the file.
    fn write(&mut self, count: usize) -> io::Result<()> {
        let file = match &mut self.file {
            Some(file) => file,
            none => {
                let file = tempfile::tempfile()?;
                self.has_holes = !is_in_memory(&file);
                none.insert(file)
            }
        };
        let place =
            |values: usize| u64::try_from(values * size_of::<T>()).map_err(io::Error::other);
        file.seek(SeekFrom::Start(place(self.filed)?))?;
        for block in self.tail[..count].chunks(BLOCK) {
            let bytes: &[u8] = cast_slice(block);
            if self.has_holes && bytes.iter().all(|byte| *byte == 0) {
                let hole = i64::try_from(bytes.len()).map_err(io::Error::other)?;
                file.seek(SeekFrom::Current(hole))?;
            } else {
                file.write_all(bytes)?
            }
        }
        file.set_len(place(self.filed + count)?)
    }

    fn map(&self) -> io::Result<Series<T>> {
        let Some(file) = &self.file else {
            return Ok(Vec::new().into());
        };
        let mapping = Mapping::new(file, self.filed * size_of::<T>())?;
        return_freed();
        Ok(Series {
            first: 0,
            length: self.filed,
            values: Values::Filed(Arc::new(mapping)),
        })
    }
}

impl<T: Pod> Extend<T> for SeriesWriter<T> {
    fn extend<I: IntoIterator<Item = T>>(&mut self, values: I) {
        values.into_iter().for_each(|value| self.push(value));
    }
}

/// Sequence of values of any length, used as a slice.
#[derive(Clone)]
pub struct Series<T> {
    /// Index of the first value of the series in the file.
    first: usize,
    length: usize,
    values: Values<T>,
}

#[derive(Clone)]
enum Values<T> {
    Kept(Vec<T>),
    Filed(Arc<Mapping>),
}

impl<T: Pod> Series<T> {
    /// Iterates over the values. Pages of a file that were read are released on the way, however long the series is.
    #[inline]
    #[must_use]
    pub fn iter(&self) -> Iter<'_, T> {
        self.range(0..self.len())
    }

    /// As [`Series::iter`], for some of the values.
    ///
    /// If the series has no such values.
    /// The series has no such values.
    #[inline]
    #[must_use]
    pub fn range(&self, places: Range<usize>) -> Iter<'_, T> {
        let values = &self[places];
        let (open, rest, mapping) = match &self.values {
            Values::Kept(_) => (values, &values[..0], None),
            Values::Filed(mapping) => (&values[..0], values, Some(&**mapping)),
        };
        Iter {
            block: open,
            open: open.iter(),
            rest,
            mapping,
        }
    }

    /// Returns the series with only its first values.
    #[must_use]
    pub fn truncated(mut self, length: usize) -> Self {
        self.truncate(length);
        self
    }

    /// Returns a part of the values, without reading those in a file.
    ///
    /// # Panics
    /// If the series has no such values.
    #[must_use]
    pub fn part(&self, places: Range<usize>) -> Self {
        match &self.values {
            Values::Kept(values) => values[places].to_vec().into(),
            Values::Filed(mapping) => {
                assert!(places.start <= places.end && places.end <= self.length);
                Self {
                    first: self.first + places.start,
                    length: places.len(),
                    values: Values::Filed(Arc::clone(mapping)),
                }
            }
        }
    }

    /// Removes all but the first values.
    pub fn truncate(&mut self, length: usize) {
        self.length = self.length.min(length);
        if let Values::Kept(values) = &mut self.values {
            values.truncate(length);
        }
    }

    /// Returns the values for changes, in memory.
    pub fn to_mut(&mut self) -> &mut [T] {
        if let Values::Filed(_) = self.values {
            *self = self.to_vec().into();
        }
        match &mut self.values {
            Values::Kept(values) => values,
            Values::Filed(_) => unreachable!("they were taken into memory"),
        }
    }
}

impl<T: Pod> Deref for Series<T> {
    type Target = [T];

    #[inline]
    fn deref(&self) -> &[T] {
        match &self.values {
            Values::Kept(values) => values,
            // SAFETY: the mapping holds at least `length` values from the first on, which were written as such: any bytes are a
            // value (`Pod`). It begins at a page, so they are aligned. No other code has the file, so they do not change.
            Values::Filed(mapping) => unsafe {
                let begin = mapping.begin.cast::<T>().add(self.first);
                slice::from_raw_parts(begin.as_ptr(), self.length)
            },
        }
    }
}

impl<T: Pod> From<Vec<T>> for Series<T> {
    fn from(values: Vec<T>) -> Self {
        Self {
            first: 0,
            length: values.len(),
            values: Values::Kept(values),
        }
    }
}

impl<T: Pod> Default for Series<T> {
    fn default() -> Self {
        Vec::new().into()
    }
}

impl<T: Pod> FromIterator<T> for Series<T> {
    fn from_iter<I: IntoIterator<Item = T>>(values: I) -> Self {
        let mut series = SeriesWriter::default();
        let values = values.into_iter();
        series.reserve(values.size_hint().0);
        series.extend(values);
        series.finish()
    }
}

impl<'a, T: Pod> IntoIterator for &'a Series<T> {
    type Item = &'a T;
    type IntoIter = Iter<'a, T>;

    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}

impl<T: Pod + PartialEq> PartialEq for Series<T> {
    fn eq(&self, other: &Self) -> bool {
        **self == **other
    }
}

impl<T: Pod + fmt::Debug> fmt::Debug for Series<T> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        (**self).fmt(formatter)
    }
}

/// Iterator over the values of a [`Series`]. Of the values in a file, one block after another is in memory.
#[derive(Debug)]
pub struct Iter<'a, T> {
    /// Block that is being read.
    block: &'a [T],
    /// Unread rest of the block.
    open: slice::Iter<'a, T>,
    /// Values after the block.
    rest: &'a [T],
    mapping: Option<&'a Mapping>,
}

impl<T> Iter<'_, T> {
    fn give_back(&self) {
        if let Some(mapping) = self.mapping {
            mapping.give_back(self.block);
        }
    }
}

impl<'a, T> Iter<'a, T> {
    /// Releases the block, and begins the next one.
    #[cold]
    fn next_block(&mut self) -> Option<&'a T> {
        self.give_back();
        if let Some(mapping) = self.mapping {
            mapping.expect(self.rest);
        }
        let count = block_length::<T>().clamp(1, self.rest.len().max(1));
        (self.block, self.rest) = self.rest.split_at_checked(count)?;
        self.open = self.block.iter();
        self.open.next()
    }
}

/// Releases the last block, since two series that are read together end at different times.
impl<T> Drop for Iter<'_, T> {
    #[inline]
    fn drop(&mut self) {
        self.give_back();
    }
}

impl<T> Clone for Iter<'_, T> {
    fn clone(&self) -> Self {
        Self {
            open: self.open.clone(),
            ..*self
        }
    }
}

impl<'a, T> Iterator for Iter<'a, T> {
    type Item = &'a T;

    #[inline]
    fn next(&mut self) -> Option<&'a T> {
        self.open.next().or_else(|| self.next_block())
    }

    #[inline]
    fn size_hint(&self) -> (usize, Option<usize>) {
        let left = self.open.len() + self.rest.len();
        (left, Some(left))
    }

    #[inline]
    fn fold<B, F: FnMut(B, Self::Item) -> B>(mut self, begin: B, mut step: F) -> B {
        let mut folded = begin;
        loop {
            folded = self.open.by_ref().fold(folded, &mut step);
            match self.next_block() {
                Some(first) => folded = step(folded, first),
                None => return folded,
            }
        }
    }
}

impl<T> ExactSizeIterator for Iter<'_, T> {}

impl<T> DoubleEndedIterator for Iter<'_, T> {
    #[inline]
    fn next_back(&mut self) -> Option<Self::Item> {
        match self.rest.split_last() {
            Some((last, rest)) => {
                self.rest = rest;
                Some(last)
            }
            None => self.open.next_back(),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;

    fn number(place: usize) -> u64 {
        // Blocks of zeros among others.
        if place / BLOCK % 3 == 1 {
            0
        } else {
            place as u64
        }
    }

    #[test]
    fn a_series_is_the_same_in_memory_and_in_a_file() {
        let count = 10 * BLOCK + 17;
        let expected: Vec<u64> = (0..count).map(number).collect();
        for kept_max in [2, BLOCK, 3 * BLOCK, count, KEPT_MAX] {
            let mut series = SeriesWriter::keeping(kept_max);
            series.extend((0..count).map(number));
            assert_eq!((series.len(), series.last()), (count, expected.last()));
            assert!(series.tail.capacity() <= 2 * kept_max.max(4));
            assert_eq!(series.filed == 0, kept_max >= count);
            let series = series.finish();
            assert_eq!(*series, expected);
            assert!(series.iter().eq(&expected));
            assert!(series.iter().rev().eq(expected.iter().rev()));
            let (mut both, mut ends) = (series.iter(), expected.iter());
            for _ in 0..count / 3 {
                assert_eq!(both.next(), ends.next());
                assert_eq!(both.next_back(), ends.next_back());
            }
            assert_eq!(both.len(), ends.len());
            assert!(both.clone().eq(ends.clone()));
            let sum = |sum: u64, value: &u64| sum.wrapping_mul(3) + value;
            assert_eq!(both.fold(1, sum), ends.fold(1, sum));
            let places = BLOCK + 5..3 * BLOCK;
            assert!(series.range(places.clone()).eq(&expected[places]));
            assert_eq!(*series.clone().truncated(BLOCK + 1), expected[..=BLOCK]);
            let few = Vec::from_iter((5..count).step_by(7));
            let expected_few = few.iter().map(|&place| expected[place]);
            assert!(picked(&series, &few).into_iter().eq(expected_few));
            assert!(passing(&series).eq(&expected));
            assert!(blocks(&series).eq(expected.chunks(block_length::<u64>())));
            assert!(
                [1, 7, BLOCK + 1, 2 * count]
                    .iter()
                    .all(|&few| parts(&series, few).eq(expected.chunks(few)))
            );
            let part = series.part(BLOCK + 3..4 * BLOCK);
            assert_eq!(*part, expected[BLOCK + 3..4 * BLOCK]);
            assert_eq!(*part.part(5..9), expected[BLOCK + 8..BLOCK + 12]);
            let mut changed = part.clone();
            changed.to_mut()[3] = 7;
            assert_eq!((changed[3], part[3]), (7, expected[BLOCK + 6]));
            let mut changed = series.clone();
            changed.to_mut()[3] = 7;
            assert_eq!((changed[3], series[3]), (7, 3));
        }
    }

    #[test]
    fn a_writer_that_is_to_keep_less_has_a_file_sooner() {
        let mut series = SeriesWriter::default();
        series.keep(100);
        series.extend(0..1000_u64);
        assert!(series.filed > 0 && series.tail.len() <= 100);
        assert!(series.finish().iter().copied().eq(0..1000));
    }

    #[test]
    fn what_the_disk_refuses_is_read_into_memory() {
        let mut series = SeriesWriter::keeping(100);
        series.extend(0..1000_u64);
        let whole = series.read().unwrap();
        assert!(matches!(whole.values, Values::Kept(_)));
        assert!(whole.iter().copied().eq(0..1000));
    }

    #[test]
    fn values_are_filled_and_taken_in_pieces() {
        let mut series = SeriesWriter::keeping(100);
        series.fill(1000, 1.0);
        series.push(2.0);
        assert_eq!(series.pop(), Some(2.0));
        series.fill(1200, 3.0);
        let first = series.take(1100);
        assert_eq!((first[999], first[1000], first.len()), (1.0, 3.0, 1100));
        series.push(4.0);
        assert_eq!(series.len(), 101);
        let rest = series.finish();
        assert_eq!((rest[0], rest[99], rest[100]), (3.0, 3.0, 4.0));
    }

    const COUNT: usize = 4_000_000;

    /// Makes a series that the system has to read from the disk: 1, 2, 3 …, or a hole.
    fn on_disk(is_hole: bool) -> Series<u64> {
        let mut writer = SeriesWriter::default();
        if is_hole {
            writer.fill(COUNT, 0)
        } else {
            writer.extend(1..=COUNT as u64)
        }
        let file = writer.file.as_ref().unwrap();
        file.sync_data().unwrap();
        rustix::fs::fadvise(file, 0, None, rustix::fs::Advice::DontNeed).unwrap();
        writer.finish()
    }

    #[test]
    fn series_that_are_read_side_by_side_hold_a_block_each() {
        let all = [false, true, false, true, false, true].map(on_disk);
        let mut columns = all.each_ref().map(Series::iter);
        for row in 1..=COUNT as u64 {
            let values = columns.iter_mut().map(|column| *column.next().unwrap());
            assert_eq!(values.sum::<u64>(), 3 * row);
            if row % 50_000 == 0 {
                let held = all.each_ref().map(held_bytes);
                assert!(held.iter().all(|held| *held <= READ_BYTES), "{held:?}");
            }
        }
    }

    #[test]
    fn of_a_value_that_was_read_nothing_stays_behind() {
        let series = on_disk(false);
        for (place, expected) in (1..=COUNT as u64).enumerate().step_by(1000) {
            assert_eq!(series[place], expected);
            give_back(&series[place..=place]);
            assert_eq!(held_bytes(&series), 0);
        }
    }

    /// Returns how many bytes of a series' file are in memory.
    fn held_bytes(series: &Series<u64>) -> usize {
        let begin = format!("{:x}-", series.as_ptr().addr());
        let text = std::fs::read_to_string("/proc/self/smaps").unwrap();
        let mapping = text.lines().skip_while(|line| !line.starts_with(&begin));
        let mut sizes = mapping.filter_map(|line| line.strip_prefix("Rss:"));
        let kilobytes = sizes.next().unwrap().trim().strip_suffix(" kB").unwrap();
        kilobytes.parse::<usize>().unwrap() << 10
    }

    fn resident_bytes() -> usize {
        let text = std::fs::read_to_string("/proc/self/statm").unwrap();
        let pages = text.split(' ').nth(1).unwrap();
        pages.parse::<usize>().unwrap() * 4096
    }

    /// Pages that were read are released: 400 MB are read twice.
    #[test]
    fn pages_that_were_read_go_back() {
        let before = resident_bytes();
        let series: Series<u64> = (0..50_000_000).collect();
        let most = Cell::new(0);
        let look = || most.set(most.get().max(resident_bytes().saturating_sub(before)));
        for (number, value) in series.iter().enumerate() {
            if number % 100_000 == 17 {
                assert_eq!(*value, number as u64);
                look();
            }
        }
        for (number, part) in series.chunks(100_000).enumerate() {
            assert!(
                part.iter()
                    .copied()
                    .zip(100_000 * number as u64..)
                    .all(|(value, place)| value == place)
            );
            give_back(part);
            look();
        }
        // The system would release them without the advice too, but at an unknown time.
        assert!(most.get() < 40_000_000, "{} bytes", most.get());
        for (number, part) in series.chunks(100_000).enumerate() {
            assert_eq!(part[17], 100_000 * number as u64 + 17);
            look();
        }
        assert!(most.get() < 200_000_000, "{} bytes", most.get());
    }
}
