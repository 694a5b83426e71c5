//! A part of a sweep: every n-th case.

use std::fmt;
use std::str::FromStr;

/// Largest number of parts of a sweep.
pub(crate) const SHARDS_MAX: usize = 10_000;

/// Part of a sweep, written as "2/4".
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub(crate) struct Shard {
    /// Number of the part, from 1.
    pub(crate) number: usize,
    /// Number of all parts.
    pub(crate) of: usize,
}

impl Shard {
    /// Whole sweep as a single part.
    pub(crate) const WHOLE: Self = Self { number: 1, of: 1 };

    /// Returns the cases of the part in a sweep of `runs` runs, in their order.
    pub(crate) fn cases(self, runs: usize) -> impl ExactSizeIterator<Item = usize> + Clone + Send {
        (self.number..runs + 1).step_by(self.of)
    }

    /// Checks whether a case of a sweep of `runs` runs belongs to the part.
    pub(crate) fn has(self, case: usize, runs: usize) -> bool {
        (self.number..=runs).contains(&case) && (case - self.number).is_multiple_of(self.of)
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}/{}", self.number, self.of)
    }
}

impl FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers = text
            .split_once('/')
            .and_then(|(number, of)| Some((number.parse().ok()?, of.parse().ok()?)));
        let (number, of) = numbers.ok_or("a part is expected, such as 2/4")?;
        if of > SHARDS_MAX || !(1..=of).contains(&number) {
            return Err(format!(
                "a part is written as its number and how many there are, such as 2/4, up to {SHARDS_MAX}/{SHARDS_MAX}"
            ));
        }
        Ok(Self { number, of })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_have_each_case_once() {
        let parts = ["1/3", "2/3", "3/3"].map(|text| text.parse::<Shard>().unwrap());
        let mut cases: Vec<usize> = parts.iter().flat_map(|part| part.cases(7)).collect();
        assert_eq!(cases, [1, 4, 7, 2, 5, 3, 6]);
        for (case, part) in cases.iter().zip([0, 0, 0, 1, 1, 2, 2]) {
            let has: Vec<bool> = parts.iter().map(|part| part.has(*case, 7)).collect();
            assert_eq!(has.iter().position(|has| *has), Some(part), "{case}");
        }
        assert!(![0, 8].iter().any(|case| Shard::WHOLE.has(*case, 7)));
        cases.sort_unstable();
        assert!(cases.into_iter().eq(Shard::WHOLE.cases(7)));
    }

    #[test]
    fn a_part_that_is_none_is_refused() {
        for text in ["", "2", "0/4", "5/4", "1/0", "a/b", "-1/4", "1/99999"] {
            assert!(text.parse::<Shard>().is_err(), "{text}");
        }
    }
}
