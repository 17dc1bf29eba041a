//! Months of measurements: on PostgreSQL the tables that hold samples are kept by month of UTC, so that to
//! forget one is to drop a table. On SQLite a table is one.

use super::engine::Session;
use super::error::StoreError;
use super::statement::query;
use super::value::corrupt;
use jiff::civil::Date;
use jiff::{Timestamp, ToSpan};
use lampyris_core::data::DAY;
use std::collections::BTreeSet;

/// The tables that are kept by month.
pub(super) const TABLES: [&str; 2] = ["days", "shares"];
/// What is older than this year is one month, so that nobody makes thousands of tables by old clocks.
const FIRST_YEAR: i16 = 2020;

/// A month of UTC, by its first day.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Month(Date);

impl Month {
    /// The month of a day, counted from 1970.
    fn of(day: i64) -> Result<Self, StoreError> {
        let instant = Timestamp::from_millisecond(day.saturating_mul(DAY));
        let instant = instant.map_err(|error| corrupt("a day", &error))?;
        Ok(Self(instant.to_zoned(jiff::tz::TimeZone::UTC).date().first_of_month()))
    }

    /// The first day and the first one behind those of the table that holds it; `None` where that has no
    /// beginning.
    fn span(self) -> (Option<i64>, i64) {
        match self.0.year() < FIRST_YEAR {
            true => (None, number(Date::constant(FIRST_YEAR, 1, 1))),
            false => (Some(number(self.0)), number(self.0.saturating_add(1.month()))),
        }
    }

    /// The name of the table that holds it.
    fn table(self, of: &str) -> String {
        match self.span() {
            (None, _) => format!("{of}_before"),
            _ => format!("{of}_{:04}_{:02}", self.0.year(), self.0.month()),
        }
    }
}

/// A day as it is counted from 1970.
fn number(date: Date) -> i64 {
    date.duration_since(Date::constant(1970, 1, 1)).as_hours() / 24
}

/// The tables that these days need: name, first day and the first one behind.
pub(super) fn needed(
    table: &str,
    days: impl Iterator<Item = i64>,
) -> Result<Vec<(String, Option<i64>, i64)>, StoreError> {
    let months: BTreeSet<Month> = days.map(Month::of).collect::<Result<_, _>>()?;
    let part = |month: Month| {
        let (from, to) = month.span();
        (month.table(table), from, to)
    };
    Ok(months.into_iter().map(part).collect())
}

/// What makes a month of a table.
pub(super) const KEEP: &str = "SELECT keep_month($1, $2, $3, $4)";

/// Makes the tables that these days need.
pub(super) async fn keep(
    tx: &mut Session,
    table: &str,
    days: impl Iterator<Item = i64>,
) -> Result<(), StoreError> {
    if !tx.is_postgres() {
        return Ok(());
    }
    for (name, from, to) in needed(table, days)? {
        query(KEEP).bind(table).bind(name).bind(from).bind(to).execute(&mut *tx).await?;
    }
    Ok(())
}

/// The first day of the month of an instant.
pub(super) fn beginning(instant: Timestamp) -> Result<i64, StoreError> {
    Ok(number(Month::of(instant.as_millisecond().div_euclid(DAY))?.0))
}

#[cfg(test)]
mod tests {
    use super::Month;

    #[test]
    fn a_month_is_named_by_its_days() {
        let of = |day| Month::of(day).unwrap();
        // 1 March 2024, behind a leap day, and the days at both of its ends.
        assert_eq!(of(19_783).span(), (Some(19_783), 19_814));
        assert_eq!(
            (of(19_782).table("days"), of(19_783).table("days")),
            ("days_2024_02".into(), "days_2024_03".into())
        );
        assert_eq!(of(19_813), of(19_783));
        // 31 December 2019 and all before.
        assert_eq!((of(18_261).span(), of(-40_000).span()), ((None, 18_262), (None, 18_262)));
        assert_eq!(of(18_262).span(), (Some(18_262), 18_293));
        assert_eq!(of(-40_000).table("shares"), "shares_before");
    }
}
