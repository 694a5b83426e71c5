//! The calendar, for the headers of foreign formats.

use std::time::Duration;

/// A second of UTC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Moment {
    pub(super) year: u16,
    /// From 1.
    pub(super) month: u16,
    /// From 1.
    pub(super) day: u16,
    /// From Sunday, 0.
    pub(super) weekday: u16,
    pub(super) hour: u16,
    pub(super) minute: u16,
    pub(super) second: u16,
}

impl Moment {
    /// The moment this long after the beginning of 1970; at most the end of 9999.
    pub(super) fn utc(time: Duration) -> Self {
        const LAST_SECOND: u64 = 253_402_300_799;
        let seconds = time.as_secs().min(LAST_SECOND);
        let (mut days, rest) = (seconds / 86_400, seconds % 86_400);
        let weekday = (days + 4) % 7;
        let mut year = 1970;
        while days >= days_of(year) {
            days -= days_of(year);
            year += 1;
        }
        let february = if days_of(year) == 366 { 29 } else { 28 };
        let months = [31, february, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31];
        let mut month = 1;
        for length in months {
            if days < length {
                break;
            }
            days -= length;
            month += 1;
        }
        let small = |number: u64| u16::try_from(number).unwrap_or(u16::MAX);
        Self {
            year: small(year),
            month,
            day: small(days + 1),
            weekday: small(weekday),
            hour: small(rest / 3600),
            minute: small(rest / 60 % 60),
            second: small(rest % 60),
        }
    }
}

/// The Gregorian calendar.
fn days_of(year: u64) -> u64 {
    let is_leap = year.is_multiple_of(4) && (!year.is_multiple_of(100) || year.is_multiple_of(400));
    if is_leap { 366 } else { 365 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn days_are_those_of_the_calendar() {
        let parts = |seconds| {
            let moment = Moment::utc(Duration::from_secs(seconds));
            let Moment {
                year,
                month,
                day,
                weekday,
                hour,
                minute,
                second,
            } = moment;
            [year, month, day, weekday, hour, minute, second]
        };
        // As `date -u -d @SECONDS` says.
        assert_eq!(parts(0), [1970, 1, 1, 4, 0, 0, 0]);
        assert_eq!(parts(951_782_400), [2000, 2, 29, 2, 0, 0, 0]);
        assert_eq!(parts(1_735_689_599), [2024, 12, 31, 2, 23, 59, 59]);
        assert_eq!(parts(4_107_542_400), [2100, 3, 1, 1, 0, 0, 0]);
        assert_eq!(parts(u64::MAX), [9999, 12, 31, 5, 23, 59, 59]);
    }
}
