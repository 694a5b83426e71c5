//! Occurrences with their times. There may be as many as frames, but most are like earlier ones, which they share.

use std::collections::BTreeSet;
use std::mem;
use std::ops::Deref;
use std::sync::Arc;

/// Occurrence at a time.
#[derive(Clone, Debug, PartialEq)]
pub struct Occurrence<T> {
    /// Scenario time; negative before scenario time 0.
    pub time_seconds: f64,
    pub what: Arc<T>,
}

impl<T> Occurrence<T> {
    pub fn new(time_seconds: f64, what: T) -> Self {
        let what = Arc::new(what);
        Self { time_seconds, what }
    }
}

impl<T> Deref for Occurrence<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.what
    }
}

/// Returns occurrences in the order of time, those of equal times in the given order.
pub(crate) fn in_order<T>(
    occurrences: impl IntoIterator<Item = Occurrence<T>>,
) -> Vec<Occurrence<T>> {
    let mut all = Vec::from_iter(occurrences);
    all.sort_by(|left, right| left.time_seconds.total_cmp(&right.time_seconds));
    all
}

/// Collector of occurrences in any order.
#[derive(Debug, Default)]
pub(crate) struct Notes<T> {
    occurrences: Vec<Occurrence<T>>,
    kinds: BTreeSet<Arc<T>>,
}

impl<T: Ord> Notes<T> {
    pub(crate) fn add(&mut self, time_seconds: f64, what: T) {
        let known = self.kinds.get(&what).cloned();
        let what = known.unwrap_or_else(|| {
            let what = Arc::new(what);
            self.kinds.insert(Arc::clone(&what));
            what
        });
        self.occurrences.push(Occurrence { time_seconds, what });
    }

    /// Takes the occurrences since the last call, with times relative to `zero_seconds`.
    pub(crate) fn take_since(&mut self, zero_seconds: f64) -> Vec<Occurrence<T>> {
        let mut all = in_order(mem::take(&mut self.occurrences));
        all.iter_mut()
            .for_each(|one| one.time_seconds -= zero_seconds);
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_is_taken_once_in_the_order_of_time_and_few_kinds_are_kept() {
        let mut notes = Notes::default();
        for second in (0..1000).rev() {
            notes.add(f64::from(second), second % 3);
        }
        let first = notes.take_since(10.0);
        assert_eq!((first.len(), notes.kinds.len()), (1000, 3));
        let expected = [(-10.0, 0), (-9.0, 1), (-8.0, 2), (-7.0, 0)];
        let begin = first[..4].iter().map(|one| (one.time_seconds, *one.what));
        assert_eq!(Vec::from_iter(begin), expected);
        notes.add(1.0, 2);
        assert_eq!(notes.take_since(10.0), [Occurrence::new(-9.0, 2)]);
    }

    #[test]
    fn what_is_at_one_time_stays_in_the_given_order() {
        let some = [(2.0, 'c'), (1.0, 'a'), (1.0, 'b')];
        let ordered = in_order(some.map(|(time, what)| Occurrence::new(time, what)));
        assert_eq!(
            Vec::from_iter(ordered.iter().map(|one| *one.what)),
            ['a', 'b', 'c']
        );
    }
}
