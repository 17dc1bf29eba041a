//! The clock on the wall: hour of the day and day of the week in the local time zone.
//!
//! People, set-backs and ventilation follow the local clock, so both columns jump where summer time begins
//! and ends. The zones come with the program: the same measurements give the same columns on every machine.

use super::duration;
use jiff::Timestamp;
use jiff::tz::{TimeZone, TimeZoneDatabase};

use super::computed::{HOUR, WEEKDAY};
use super::grid::Grid;
use crate::fault::Fault;

/// The hour of the local day of a sample, 0 to 23; of the day in UTC where the grid has no calendar.
pub fn hour_of_day(grid: &Grid, k: usize) -> usize {
    match grid.column(HOUR.channel) {
        Some(column) => column.values()[k] as usize % 24,
        None => (grid.time(k).rem_euclid(duration::DAY) / duration::HOUR) as usize,
    }
}

/// The grid with the columns `hour_of_day` (h) and `weekday` (-), computed for this IANA time zone where they
/// are not measured. Both hold their value over the interval that a point starts.
///
/// # Errors
/// A fault where the zone is unknown or a time lies thousands of years away.
pub fn add_calendar(mut grid: Grid, zone: &str) -> Result<Grid, Fault> {
    let zone = local_zone(zone)?;
    let (mut hours, mut weekdays) = (Vec::with_capacity(grid.len()), Vec::with_capacity(grid.len()));
    for index in 0..grid.len() {
        let time = Timestamp::from_millisecond(grid.time(index))
            .map_err(|error| Fault::new("/time", "bad-time", error.to_string()))?;
        let local = zone.to_datetime(time);
        hours.push(
            f64::from(local.hour())
                + f64::from(local.minute()) / 60.0
                + (f64::from(local.second()) + f64::from(local.subsec_nanosecond()) / 1e9) / 3600.0,
        );
        weekdays.push(f64::from(local.weekday().to_monday_one_offset()));
    }
    for (computed, values) in [(HOUR, hours), (WEEKDAY, weekdays)] {
        if grid.column(computed.channel).is_none() {
            grid = grid.with_column(computed.channel, computed.column(values)?)?;
        }
    }
    Ok(grid)
}

/// The rules of an IANA time zone, as they come with the program.
///
/// # Errors
/// A fault where it is unknown.
pub fn local_zone(name: &str) -> Result<TimeZone, Fault> {
    let unknown = || {
        Fault::new(
            "/location/zone",
            "unknown-zone",
            format!("`{}` is no IANA time zone", name.escape_debug()),
        )
    };
    TimeZoneDatabase::bundled().get(name).map_err(|_| unknown())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::read_time;
    use crate::data::{Column, Hold};

    fn columns(from: &str, step: i64, len: usize, zone: &str) -> (Vec<f64>, Vec<f64>) {
        let grid = add_calendar(
            Grid::new(read_time("", from).unwrap(), step * duration::SECOND, len).unwrap(),
            zone,
        )
        .unwrap();
        let values = |name: &str| grid.column(name).unwrap().values().to_vec();
        (values(HOUR.channel), values(WEEKDAY.channel))
    }

    #[test]
    fn the_clock_on_the_wall_jumps_with_summer_time() {
        // Sunday 29 March 2026: 2 o'clock does not exist in Copenhagen.
        let (hours, weekdays) = columns("2026-03-28T22:30:00Z", 3600, 5, "Europe/Copenhagen");
        assert_eq!(hours, [23.5, 0.5, 1.5, 3.5, 4.5]);
        assert_eq!(weekdays, [6.0, 7.0, 7.0, 7.0, 7.0]);
        // Sunday 25 October 2026: 2 o'clock comes twice.
        let (hours, _) = columns("2026-10-24T23:00:00Z", 1800, 6, "Europe/Copenhagen");
        assert_eq!(hours, [1.0, 1.5, 2.0, 2.5, 2.0, 2.5]);
    }

    #[test]
    fn every_hour_of_a_year_agrees_with_the_zoned_clock() {
        for zone in ["Europe/Copenhagen", "America/St_Johns", "Asia/Kathmandu", "Australia/Lord_Howe", "UTC"]
        {
            let (hours, weekdays) = columns("2025-12-31T00:20:00Z", 3600, 366 * 24, zone);
            let start = read_time("", "2025-12-31T00:20:00Z").unwrap();
            for (k, (hour, weekday)) in hours.iter().zip(&weekdays).enumerate() {
                let stamp = Timestamp::from_millisecond(start + duration::HOUR * k as i64).unwrap();
                let text = stamp.in_tz(zone).unwrap().strftime("%H %M %u").to_string();
                let parts: Vec<f64> = text.split(' ').map(|part| part.parse().unwrap()).collect();
                assert!(
                    (hour - parts[0] - parts[1] / 60.0).abs() < 1e-12 && *weekday == parts[2],
                    "{zone} {stamp}: {hour} {weekday}"
                );
            }
        }
    }

    #[test]
    fn measured_columns_are_kept_and_unknown_zones_refused() {
        let grid = Grid::new(0, duration::HOUR, 2).unwrap();
        let own = Column::complete("h", Hold::ZeroOrder, vec![5.0, 6.0]).unwrap();
        let grid = add_calendar(grid.with_column(HOUR.channel, own).unwrap(), "UTC").unwrap();
        assert_eq!(grid.column(HOUR.channel).unwrap().values(), [5.0, 6.0]);
        // The first of January 1970 was a Thursday.
        assert_eq!(grid.column(WEEKDAY.channel).unwrap().values(), [4.0, 4.0]);
        assert_eq!(add_calendar(grid, "Mars/Olympus").unwrap_err().code, "unknown-zone");
    }
}
