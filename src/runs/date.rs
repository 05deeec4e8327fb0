//! Dates in UTC, and the ids of runs that are made of them.
//!
//! Source of the calendar: H. Hinnant, "chrono-Compatible Low-Level Date Algorithms", `civil_from_days`.

const DAY: u64 = 86_400;

/// Year, month and day of seconds since 1970.
fn day_of(seconds: u64) -> (u64, u64, u64) {
    let days = seconds / DAY + 719_468;
    let (era, of_era) = (days / 146_097, days % 146_097);
    let year_of_era = (of_era - of_era / 1460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let shifted = (5 * of_year + 2) / 153; // months from March
    let day = of_year - (153 * shifted + 2) / 5 + 1;
    let month = if shifted < 10 { shifted + 3 } else { shifted - 9 };
    (year_of_era + era * 400 + u64::from(month <= 2), month, day)
}

/// Hour, minute and second.
fn time_of(seconds: u64) -> (u64, u64, u64) {
    let of_day = seconds % DAY;
    (of_day / 3600, of_day / 60 % 60, of_day % 60)
}

/// Seconds since 1970 as `2026-11-25 07:41:05`, in UTC.
pub fn date_text(seconds: u64) -> String {
    let ((year, month, day), (hour, minute, second)) = (day_of(seconds), time_of(seconds));
    format!("{year:04}-{month:02}-{day:02} {hour:02}:{minute:02}:{second:02}")
}

/// The id of a run that started then: `20261125-074105`.
pub(super) fn id(seconds: u64) -> String {
    let ((year, month, day), (hour, minute, second)) = (day_of(seconds), time_of(seconds));
    format!("{year:04}{month:02}{day:02}-{hour:02}{minute:02}{second:02}")
}

/// The number of an id among those of its second.
pub(super) fn number(id: &str) -> u32 {
    id.splitn(3, '-').nth(2).and_then(|number| number.parse().ok()).unwrap_or(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_follow_the_calendar() {
        assert_eq!(date_text(0), "1970-01-01 00:00:00");
        assert_eq!(date_text(951_782_399), "2000-02-28 23:59:59");
        assert_eq!(date_text(951_782_400), "2000-02-29 00:00:00");
        assert_eq!(date_text(1_735_689_599), "2024-12-31 23:59:59");
        assert_eq!(id(4_107_542_400), "21000301-000000");
    }

    #[test]
    fn ids_of_one_second_are_numbered() {
        assert_eq!(["20261125-074105", "20261125-074105-2", "20261125-074105-10"].map(number), [1, 2, 10]);
    }
}
