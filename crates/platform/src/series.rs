//! Series of a run, which may be longer than memory. The first values go to a file without a name, which ends with the process;
//! readers iterate over them as if they were in memory.

use std::fs::File;
use std::io;
use std::mem;
use std::ops::Range;
use std::os::unix::fs::FileExt;
use std::sync::Arc;
use std::{slice, vec};

use bytemuck::{Pod, cast_slice, cast_slice_mut};

use crate::memory::return_freed;

/// Largest number of values that stay in memory: two minutes of a signal at 1 kHz.
pub const KEPT_MAX: usize = 1 << 17;
/// Number of values that go to the file, and come from it, at once. A block of zeros takes no room there.
const BLOCK: usize = 1 << 13;
/// Largest number of values that stay in memory once others are in the file: a run has a hundred series.
const KEPT_BESIDE_FILE_MAX: usize = 4 * BLOCK;

/// Values of a series: the first ones in a file, the others in memory.
#[derive(Debug)]
struct Values<T> {
    file: Option<File>,
    /// Number of values in the file.
    filed: usize,
    kept: Vec<T>,
}

impl<T: Pod> Values<T> {
    fn in_memory(kept: Vec<T>) -> Self {
        Self {
            file: None,
            filed: 0,
            kept,
        }
    }

    fn len(&self) -> usize {
        self.filed + self.kept.len()
    }

    /// Moves the first ones of the values in memory to the file.
    fn move_to_file(&mut self, count: usize) -> io::Result<()> {
        let file = match &self.file {
            Some(file) => file,
            None => self.file.insert(tempfile::tempfile()?),
        };
        let mut place = self.filed;
        for block in self.kept[..count].chunks(BLOCK) {
            let bytes: &[u8] = cast_slice(block);
            if bytes.iter().any(|byte| *byte != 0) {
                file.write_all_at(bytes, byte_place::<T>(place))?;
            }
            place += block.len();
        }
        file.set_len(byte_place::<T>(place))?;
        self.filed = place;
        self.kept.drain(..count);
        Ok(())
    }

    /// Reads some of the values in the file.
    ///
    /// # Panics
    /// If the system refuses to read.
    fn read(&self, places: Range<usize>) -> Vec<T> {
        let mut values = vec![T::zeroed(); places.len()];
        if let Some(file) = &self.file {
            let bytes = cast_slice_mut(&mut values);
            let read = file.read_exact_at(bytes, byte_place::<T>(places.start));
            read.unwrap_or_else(|error| panic!("a temporary file cannot be read: {error}"));
        }
        values
    }
}

/// Returns the place of a value in a file.
fn byte_place<T>(place: usize) -> u64 {
    (place * size_of::<T>()) as u64
}

/// Series that grows.
#[derive(Debug)]
pub struct SeriesWriter<T> {
    values: Values<T>,
    kept_max: usize,
}

impl<T: Pod> Default for SeriesWriter<T> {
    fn default() -> Self {
        Self::keeping(KEPT_MAX)
    }
}

impl<T: Pod> SeriesWriter<T> {
    /// Makes an empty series that keeps at most `kept_max` values in memory.
    pub fn keeping(kept_max: usize) -> Self {
        let values = Values::in_memory(Vec::new());
        Self { values, kept_max }
    }

    /// Reserves room for values, as far as they stay in memory.
    pub fn reserve(&mut self, values: usize) {
        self.values.kept.reserve(values.min(self.kept_max));
    }

    pub fn len(&self) -> usize {
        self.values.len()
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns the latest value.
    pub fn last(&self) -> Option<&T> {
        self.values.kept.last()
    }

    #[inline]
    pub fn push(&mut self, value: T) {
        if self.values.kept.len() >= self.kept_max {
            self.file_blocks();
        }
        self.values.kept.push(value);
    }

    /// Appends copies of a value up to the given length.
    pub fn fill(&mut self, length: usize, value: T) {
        while self.len() < length {
            if self.values.kept.len() >= self.kept_max {
                self.file_blocks();
            }
            let kept = self.values.kept.len();
            let room = self.kept_max.saturating_sub(kept).max(1);
            let missing = (length - self.len()).min(room);
            self.values.kept.resize(kept + missing, value);
        }
    }

    /// Removes the latest value and returns it; values in the file stay.
    pub fn pop(&mut self) -> Option<T> {
        self.values.kept.pop()
    }

    /// Removes the first `count` values and returns them.
    ///
    /// # Panics
    /// If there are fewer.
    pub fn take(&mut self, count: usize) -> Series<T> {
        if self.values.filed == 0 && count < self.len() {
            let rest = self.values.kept.split_off(count);
            return mem::replace(&mut self.values.kept, rest).into();
        }
        let whole = mem::replace(self, Self::keeping(self.kept_max)).finish();
        self.extend(whole.range(count..whole.len()));
        whole.part(0..count)
    }

    /// Returns the whole series.
    pub fn finish(mut self) -> Series<T> {
        if self.values.filed > 0 {
            self.file_first(self.values.kept.len());
            self.values.kept.shrink_to_fit();
            return_freed();
        }
        Series {
            places: 0..self.len(),
            values: Arc::new(self.values),
        }
    }

    /// Moves all but the latest block to the file.
    #[cold]
    fn file_blocks(&mut self) {
        let count = self.values.kept.len();
        self.kept_max = self.kept_max.min(KEPT_BESIDE_FILE_MAX);
        self.file_first(count.saturating_sub(BLOCK.min(self.kept_max / 2)));
        self.values.kept.shrink_to(self.kept_max);
    }

    /// Moves the first values in memory to the file. If the system refuses, they stay, and all that follow: a large process is
    /// better than one that ends.
    fn file_first(&mut self, count: usize) {
        if self.values.move_to_file(count).is_err() {
            self.kept_max = usize::MAX;
        }
    }
}

impl<T: Pod> Extend<T> for SeriesWriter<T> {
    fn extend<I: IntoIterator<Item = T>>(&mut self, values: I) {
        values.into_iter().for_each(|value| self.push(value));
    }
}

/// Sequence of values of any length, which are read by iterators. Copies and parts share the values.
#[derive(Clone, Debug)]
pub struct Series<T> {
    values: Arc<Values<T>>,
    /// Places of the series among the values.
    places: Range<usize>,
}

impl<T: Pod> Series<T> {
    #[inline]
    pub fn len(&self) -> usize {
        self.places.len()
    }

    #[inline]
    pub fn is_empty(&self) -> bool {
        self.places.is_empty()
    }

    /// Iterates over the values.
    #[inline]
    pub fn iter(&self) -> Iter<'_, T> {
        self.range(0..self.len())
    }

    /// Iterates over some of the values.
    ///
    /// # Panics
    /// If the series has no such values.
    #[inline]
    pub fn range(&self, places: Range<usize>) -> Iter<'_, T> {
        let Range { start, end } = self.places_in(&places);
        let filed = self.values.filed;
        let kept = &self.values.kept[start.saturating_sub(filed)..end.saturating_sub(filed)];
        let unread = start.min(filed)..end.min(filed);
        let (open, rest) = if unread.is_empty() {
            (kept, &kept[..0])
        } else {
            (&kept[..0], kept)
        };
        Iter {
            kept: open.iter(),
            read: Vec::new().into_iter(),
            values: &self.values,
            unread,
            rest,
        }
    }

    /// Returns a part of the values, without reading them.
    ///
    /// # Panics
    /// If the series has no such values.
    pub fn part(&self, places: Range<usize>) -> Self {
        Self {
            values: Arc::clone(&self.values),
            places: self.places_in(&places),
        }
    }

    /// Returns the places of a part among the values.
    #[inline]
    fn places_in(&self, part: &Range<usize>) -> Range<usize> {
        assert!(part.start <= part.end && part.end <= self.len());
        self.places.start + part.start..self.places.start + part.end
    }

    /// Returns a value by its place.
    #[inline]
    pub fn get(&self, place: usize) -> Option<T> {
        if place >= self.len() {
            return None;
        }
        let place = self.places.start + place;
        match place.checked_sub(self.values.filed) {
            Some(kept) => Some(self.values.kept[kept]),
            None => self.values.read(place..place + 1).pop(),
        }
    }

    pub fn first(&self) -> Option<T> {
        self.get(0)
    }

    pub fn last(&self) -> Option<T> {
        self.get(self.len().checked_sub(1)?)
    }

    /// Iterates over each value with the next one.
    pub fn pairs(&self) -> impl Iterator<Item = (T, T)> {
        self.iter().zip(self.iter().skip(1))
    }

    /// Iterates over the values at some places, which ascend.
    pub fn at(&self, places: impl IntoIterator<Item = usize>) -> impl Iterator<Item = T> {
        let (mut values, mut next) = (self.iter(), 0);
        places.into_iter().map_while(move |place| {
            let value = values.nth(place - next);
            next = place + 1;
            value
        })
    }

    /// Returns how many values at the begin satisfy a condition that no later value satisfies.
    pub fn partition_point(&self, is_before: impl Fn(T) -> bool) -> usize {
        let (mut low, mut high) = (0, self.len());
        while low < high {
            let middle = low.midpoint(high);
            if self.get(middle).is_some_and(&is_before) {
                low = middle + 1;
            } else {
                high = middle;
            }
        }
        low
    }

    /// Returns the values in memory.
    pub fn to_vec(&self) -> Vec<T> {
        self.iter().collect()
    }
}

impl<T: Pod> From<Vec<T>> for Series<T> {
    fn from(values: Vec<T>) -> Self {
        Self {
            places: 0..values.len(),
            values: Arc::new(Values::in_memory(values)),
        }
    }
}

impl<T: Pod> From<&Series<T>> for Series<T> {
    fn from(series: &Series<T>) -> Self {
        series.clone()
    }
}

/// Copies the values.
impl<T: Pod, V: AsRef<[T]> + ?Sized> From<&V> for Series<T> {
    fn from(values: &V) -> Self {
        values.as_ref().to_vec().into()
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
    type Item = T;
    type IntoIter = Iter<'a, T>;

    #[inline]
    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}

impl<T: Pod + PartialEq> PartialEq for Series<T> {
    fn eq(&self, other: &Self) -> bool {
        self.iter().eq(other)
    }
}

/// Iterator over the values of a [`Series`]. Of the values in a file, one block after another is in memory.
#[derive(Clone, Debug)]
pub struct Iter<'a, T> {
    /// Values in memory, once the file is read.
    kept: slice::Iter<'a, T>,
    /// Rest of the block that was read last.
    read: vec::IntoIter<T>,
    values: &'a Values<T>,
    /// Places in the file that were not read yet.
    unread: Range<usize>,
    /// Values after those in the file.
    rest: &'a [T],
}

impl<T: Pod> Iter<'_, T> {
    /// Returns the next value from a block of the file.
    #[inline(never)]
    fn next_read(&mut self) -> Option<T> {
        self.read.next().or_else(|| self.next_block())
    }

    /// Begins the next block.
    #[cold]
    fn next_block(&mut self) -> Option<T> {
        if self.unread.is_empty() {
            self.kept = mem::take(&mut self.rest).iter();
            return self.kept.next().copied();
        }
        let end = self.unread.end.min(self.unread.start + BLOCK);
        self.read = self.values.read(self.unread.start..end).into_iter();
        self.unread.start = end;
        self.read.next()
    }
}

impl<T: Pod> Iterator for Iter<'_, T> {
    type Item = T;

    #[inline]
    fn next(&mut self) -> Option<T> {
        match self.kept.next() {
            Some(value) => Some(*value),
            None => self.next_read(),
        }
    }

    #[inline]
    fn nth(&mut self, count: usize) -> Option<T> {
        if self.kept.len() > count {
            return self.kept.nth(count).copied();
        }
        (0..count).try_for_each(|_| self.next().map(drop))?;
        self.next()
    }

    #[inline]
    fn size_hint(&self) -> (usize, Option<usize>) {
        let left = self.read.len() + self.unread.len() + self.rest.len() + self.kept.len();
        (left, Some(left))
    }

    #[inline]
    fn fold<B, F: FnMut(B, T) -> B>(mut self, begin: B, mut step: F) -> B {
        let mut folded = begin;
        loop {
            let kept = mem::take(&mut self.kept);
            folded = kept.fold(folded, |folded, value| step(folded, *value));
            folded = mem::take(&mut self.read).fold(folded, &mut step);
            match self.next_block() {
                Some(first) => folded = step(folded, first),
                None => return folded,
            }
        }
    }
}

impl<T: Pod> ExactSizeIterator for Iter<'_, T> {}

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
            assert!(series.values.kept.capacity() <= 2 * kept_max.max(4));
            assert_eq!(series.values.filed == 0, kept_max >= count);
            assert_reads(&series.finish(), &expected);
        }
    }

    /// Values that the disk refuses stay in memory, behind those that it took.
    #[test]
    fn a_series_is_the_same_with_its_end_in_memory() {
        let expected: Vec<u64> = (0..10 * BLOCK).map(number).collect();
        for filed in [1, BLOCK, 4 * BLOCK + 3, 10 * BLOCK - 1] {
            let mut values = SeriesWriter::<u64>::default().values;
            values.kept.clone_from(&expected);
            values.move_to_file(filed).unwrap();
            let series = Series {
                places: 0..values.len(),
                values: Arc::new(values),
            };
            assert_eq!(series.values.kept.len(), expected.len() - filed);
            assert_reads(&series, &expected);
        }
    }

    fn assert_reads(series: &Series<u64>, expected: &[u64]) {
        let values = || expected.iter().copied();
        let count = expected.len();
        assert_eq!(series.to_vec(), expected);
        assert_eq!(*series, values().collect());
        assert_ne!(*series, values().skip(1).collect());
        let (mut both, mut begun) = (series.iter(), values());
        for _ in 0..count / 3 {
            assert_eq!((both.len(), both.next()), (begun.len(), begun.next()));
        }
        assert!(both.clone().eq(begun.clone()));
        let sum = |sum: u64, value: u64| sum.wrapping_mul(3) + value;
        assert_eq!(both.fold(1, sum), begun.fold(1, sum));
        let places = BLOCK + 5..3 * BLOCK;
        assert!(
            series
                .range(places.clone())
                .eq(values().take(places.end).skip(places.start))
        );
        let part = series.part(BLOCK + 3..4 * BLOCK);
        assert_eq!(part.to_vec(), expected[BLOCK + 3..4 * BLOCK]);
        assert_eq!(part.part(5..9).to_vec(), expected[BLOCK + 8..BLOCK + 12]);
        for place in [0, BLOCK - 1, BLOCK, count - 1] {
            assert_eq!(series.get(place), Some(expected[place]));
        }
        assert_eq!((series.get(count), part.get(part.len())), (None, None));
        assert_eq!(series.last(), expected.last().copied());
        for place in [0, 1, BLOCK + 7, count] {
            let numbers: Series<u64> = (0..count as u64).collect();
            assert_eq!(numbers.partition_point(|it| it < place as u64), place);
        }
    }

    #[test]
    #[should_panic(expected = "assertion failed")]
    fn a_part_has_no_value_beyond_its_end() {
        let series: Series<u64> = (0..9).collect();
        let _ = series.part(2..5).range(1..4);
    }

    #[test]
    fn a_writer_that_is_to_keep_less_has_a_file_sooner() {
        let mut series = SeriesWriter::keeping(100);
        series.extend(0..1000_u64);
        assert!(series.values.filed > 0 && series.values.kept.len() <= 100);
        assert!(series.finish().iter().eq(0..1000));
    }

    #[test]
    fn values_are_filled_and_taken_in_pieces() {
        let mut series = SeriesWriter::keeping(100);
        series.fill(1000, 1.0);
        series.push(2.0);
        assert_eq!(series.pop(), Some(2.0));
        series.fill(1200, 3.0);
        let first = series.take(1100);
        assert_eq!((first.get(999), first.get(1000)), (Some(1.0), Some(3.0)));
        assert_eq!(first.len(), 1100);
        series.push(4.0);
        assert_eq!(series.len(), 101);
        let rest = series.finish();
        assert_eq!(rest.to_vec(), [vec![3.0; 100], vec![4.0]].concat());
    }

    #[test]
    fn zeros_take_no_room_on_the_disk() {
        let mut series = SeriesWriter::default();
        series.fill(100 * KEPT_MAX, 0.0);
        series.fill(101 * KEPT_MAX, 1.0);
        let file = series.values.file.as_ref().unwrap();
        let room = std::os::unix::fs::MetadataExt::blocks(&file.metadata().unwrap()) * 512;
        assert!(room <= 2 * (KEPT_MAX * size_of::<f64>()) as u64, "{room}");
        let sum: f64 = series.finish().iter().sum();
        assert_eq!(sum, KEPT_MAX as f64);
    }

    /// 400 MB are read by six readers at once.
    #[test]
    fn a_reader_holds_one_block() {
        let resident_bytes = || {
            let text = std::fs::read_to_string("/proc/self/statm").unwrap();
            let pages = text.split(' ').nth(1).unwrap();
            pages.parse::<usize>().unwrap() * 4096
        };
        let series: Series<u64> = (0..50_000_000).collect();
        let before = resident_bytes();
        let most = Cell::new(0);
        let mut readers = [(); 6].map(|()| series.iter());
        for number in 0..50_000_000 {
            assert!(
                readers
                    .iter_mut()
                    .all(|reader| reader.next() == Some(number))
            );
            if number % 100_000 == 17 {
                most.set(most.get().max(resident_bytes().saturating_sub(before)));
            }
        }
        assert!(most.get() < 40_000_000, "{} bytes", most.get());
    }

    #[test]
    fn the_latest_values_stay_in_memory_and_can_be_taken_back() {
        let mut series = SeriesWriter::keeping(4);
        series.extend(0..5_u64);
        let latest = [(); 4].map(|()| series.pop());
        assert_eq!(latest, [Some(4), Some(3), Some(2), None]);
        assert!(series.finish().iter().eq(0..2));
    }
}
