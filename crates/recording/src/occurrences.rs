//! Occurrences with their times. There may be as many as frames, but most are like earlier ones, so only the time and the number
//! of its kind are kept for each.

use std::collections::BTreeMap;
use std::ops::Deref;

use bytemuck::{Pod, Zeroable};
use platform::series::{Series, SeriesWriter};

/// Row of an occurrence.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
struct Row {
    time_seconds: f64,
    /// Index of its kind.
    kind: u64,
}

/// Occurrence at a time.
#[derive(Debug)]
pub struct Occurrence<'a, T> {
    /// Scenario time; negative before scenario time 0.
    pub time_seconds: f64,
    pub what: &'a T,
}

impl<T> Deref for Occurrence<'_, T> {
    type Target = T;

    fn deref(&self) -> &T {
        self.what
    }
}

/// Occurrences in the order of time.
#[derive(Clone, Debug, Default)]
pub struct Occurrences<T> {
    rows: Series<Row>,
    kinds: Vec<T>,
}

impl<T> Occurrences<T> {
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Iterates over the occurrences.
    pub fn iter(&self) -> impl Iterator<Item = Occurrence<'_, T>> + Clone {
        self.rows.iter().map(|row| self.occurrence(row))
    }

    pub fn first(&self) -> Option<Occurrence<'_, T>> {
        self.rows.first().map(|row| self.occurrence(row))
    }

    pub fn last(&self) -> Option<Occurrence<'_, T>> {
        self.rows.last().map(|row| self.occurrence(row))
    }

    fn occurrence(&self, row: Row) -> Occurrence<'_, T> {
        Occurrence {
            time_seconds: row.time_seconds,
            what: &self.kinds[place(row.kind)],
        }
    }
}

impl<T: Clone> Occurrences<T> {
    /// Returns the occurrences at times that `is_wanted` accepts.
    pub fn at_times(&self, is_wanted: impl Fn(f64) -> bool) -> Self {
        let rows = self.rows.iter();
        Self {
            rows: rows.filter(|row| is_wanted(row.time_seconds)).collect(),
            kinds: self.kinds.clone(),
        }
    }

    /// Merges two sequences; at equal times those of `self` come first.
    #[must_use]
    pub fn merged(mut self, others: Self) -> Self {
        if others.is_empty() {
            return self;
        }
        let first_kind = self.kinds.len() as u64;
        self.kinds.extend(others.kinds);
        let mut later = others.rows.iter().map(|row| Row {
            kind: row.kind + first_kind,
            ..row
        });
        let mut next = later.next();
        let mut rows = SeriesWriter::default();
        for row in &self.rows {
            while let Some(other) = next.filter(|other| other.time_seconds < row.time_seconds) {
                rows.push(other);
                next = later.next();
            }
            rows.push(row);
        }
        rows.extend(next.into_iter().chain(later));
        self.rows = rows.finish();
        self
    }
}

/// Collector of occurrences in any order.
#[derive(Debug, Default)]
pub(crate) struct Notes<T> {
    rows: SeriesWriter<Row>,
    kinds: Vec<T>,
    places: BTreeMap<T, u64>,
    is_out_of_order: bool,
}

impl<T: Clone + Ord> Notes<T> {
    pub(crate) fn add(&mut self, time_seconds: f64, what: T) {
        let kind = *self.places.entry(what).or_insert_with_key(|what| {
            self.kinds.push(what.clone());
            self.kinds.len() as u64 - 1
        });
        let latest = self.rows.last();
        self.is_out_of_order |= latest.is_some_and(|latest| latest.time_seconds > time_seconds);
        self.rows.push(Row { time_seconds, kind });
    }

    /// Takes the occurrences since the last call, with times relative to `zero_seconds`.
    pub(crate) fn take_since(&mut self, zero_seconds: f64) -> Occurrences<T> {
        let mut rows: Series<Row> = self.rows.take(self.rows.len());
        // Time rarely goes back.
        if std::mem::take(&mut self.is_out_of_order) {
            let mut sorted = rows.to_vec();
            sorted.sort_by(|left, right| left.time_seconds.total_cmp(&right.time_seconds));
            rows = sorted.into();
        }
        let since = rows.iter().map(|row| Row {
            time_seconds: row.time_seconds - zero_seconds,
            ..row
        });
        Occurrences {
            rows: since.collect(),
            kinds: self.kinds.clone(),
        }
    }
}

impl<T: Clone + Default + Ord> FromIterator<(f64, T)> for Occurrences<T> {
    fn from_iter<I: IntoIterator<Item = (f64, T)>>(occurrences: I) -> Self {
        let mut notes = Notes::default();
        for (time_seconds, what) in occurrences {
            notes.add(time_seconds, what);
        }
        notes.take_since(0.0)
    }
}

/// Converts the number of a kind, which fits, since all kinds are in memory.
fn place(kind: u64) -> usize {
    usize::try_from(kind).unwrap_or(usize::MAX)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn pairs(occurrences: &Occurrences<String>) -> Vec<(f64, String)> {
        let pairs = occurrences.iter();
        pairs
            .map(|one| (one.time_seconds, one.what.clone()))
            .collect()
    }

    proptest! {
        /// The result is the same as a list of all of them, sorted by time.
        #[test]
        fn what_is_noted_stands_in_the_order_of_time(
            some in prop::collection::vec((0..20_u8, 0..4_u8), 0..30),
            others in prop::collection::vec((0..20_u8, 0..4_u8), 0..30),
        ) {
            let named = |list: &[(u8, u8)]| {
                let named = list.iter().map(|(time, kind)| (f64::from(*time), format!("kind {kind}")));
                Vec::from_iter(named)
            };
            let noted = |list: &[(u8, u8)]| named(list).into_iter().collect::<Occurrences<String>>();
            let mut expected = [named(&some), named(&others)].concat();
            expected.sort_by(|left, right| left.0.total_cmp(&right.0));
            let all = noted(&some).merged(noted(&others));
            prop_assert_eq!(pairs(&all), expected.clone());
            prop_assert_eq!(all.first().map(|one| one.time_seconds), expected.first().map(|one| one.0));
            prop_assert_eq!(all.last().map(|one| one.time_seconds), expected.last().map(|one| one.0));
            expected.retain(|one| one.0 < 10.0);
            prop_assert_eq!(pairs(&all.at_times(|time| time < 10.0)), expected);
        }
    }

    #[test]
    fn each_is_taken_once_and_few_kinds_are_kept() {
        let mut notes = Notes::default();
        for second in 0..1000 {
            notes.add(f64::from(second), second % 3);
        }
        let first = notes.take_since(10.0);
        assert_eq!((first.len(), first.kinds.len()), (1000, 3));
        assert_eq!(first.first().map(|one| one.time_seconds), Some(-10.0));
        notes.add(1.0, 2);
        let rest = notes.take_since(10.0);
        assert_eq!((rest.len(), *rest.first().unwrap()), (1, 2));
    }
}
