//! Where the sun stands: altitude and azimuth by the NREL solar position algorithm.
//!
//! Positions are geometric, without refraction: near the horizon, where refraction lifts the sun by half a
//! degree, no model of a room can tell the difference.

use super::duration::DAY;
use solar_positioning::time::JulianDate;
use solar_positioning::{Location, RefractionCorrection, SolarPositions, delta_t};

use super::computed::{ALTITUDE, AZIMUTH, ComputedChannel};
use super::grid::Grid;
use crate::fault::Fault;

const UNIX_EPOCH_JULIAN: f64 = 2_440_587.5;
const DAYS_PER_YEAR: f64 = 365.242_5;

/// The direction to the sun in degrees.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SunPosition {
    /// Above the horizon; negative at night.
    pub altitude: f64,
    /// Clockwise from north, 0 to 360.
    pub azimuth: f64,
}

/// Where the sun stands at a time (Unix milliseconds) and a place (degrees north, degrees east).
///
/// # Errors
/// A fault where the latitude is outside -90..90, the longitude outside -180..180, or the time thousands of
/// years away.
pub fn sun_position(time: i64, latitude: f64, longitude: f64) -> Result<SunPosition, Fault> {
    let year = 1970.0 + time as f64 / DAY as f64 / DAYS_PER_YEAR;
    let delta =
        delta_t::estimate(year).map_err(|error| Fault::new("/time", "bad-time", error.to_string()))?;
    position(time, delta, latitude, longitude, 0.0, None)
}

/// The grid with the columns `sun_altitude` and `sun_azimuth`, computed for this place where they are not
/// measured.
///
/// # Errors
/// As [`sun_position`].
pub fn add_sun(grid: Grid, latitude: f64, longitude: f64) -> Result<Grid, Fault> {
    let absent: Vec<ComputedChannel> =
        [ALTITUDE, AZIMUTH].into_iter().filter(|sun| grid.column(sun.channel).is_none()).collect();
    if absent.is_empty() {
        return Ok(grid);
    }
    let mut altitudes = Vec::with_capacity(grid.len());
    let mut azimuths = Vec::with_capacity(grid.len());
    for index in 0..grid.len() {
        let sun = sun_position(grid.time(index), latitude, longitude)?;
        altitudes.push(sun.altitude);
        azimuths.push(sun.azimuth);
    }
    let mut grid = grid;
    for sun in absent {
        let values = if sun == ALTITUDE { altitudes.clone() } else { azimuths.clone() };
        grid = grid.with_column(sun.channel, sun.column(values)?)?;
    }
    Ok(grid)
}

fn position(
    time: i64,
    delta_t: f64,
    latitude: f64,
    longitude: f64,
    height: f64,
    refraction: Option<RefractionCorrection>,
) -> Result<SunPosition, Fault> {
    let fault = |error: solar_positioning::Error| Fault::new("/location", "bad-location", error.to_string());
    let julian = JulianDate::new(UNIX_EPOCH_JULIAN + time as f64 / DAY as f64, delta_t).map_err(fault)?;
    let sun = SolarPositions::new()
        .at_from_julian(julian, Location { latitude, longitude }, height, refraction)
        .map_err(fault)?;
    Ok(SunPosition { altitude: sun.elevation_angle(), azimuth: sun.azimuth() })
}

#[cfg(test)]
mod tests {
    use super::{RefractionCorrection, add_sun, position, sun_position};
    use crate::data::window_tests::real_file;
    use crate::data::{Column, ColumnBindings, Grid, HOUR, Hold, Window, read_time};

    #[test]
    fn the_published_example_of_the_algorithm() {
        let time = read_time("", "2003-10-17T12:30:30-07:00").unwrap();
        let air = RefractionCorrection::new(820.0, 11.0).unwrap();
        let sun = position(time, 67.0, 39.742476, -105.1786, 1830.14, Some(air)).unwrap();
        assert!((90.0 - sun.altitude - 50.11162).abs() < 1e-5, "{sun:?}");
        assert!((sun.azimuth - 194.34024).abs() < 1e-5, "{sun:?}");
        let plain = sun_position(time, 39.742476, -105.1786).unwrap();
        assert!((plain.altitude - sun.altitude).abs() < 0.03, "{plain:?}");
    }

    #[test]
    fn the_columns_of_the_belgian_house() {
        let Some(text) = real_file("belgian_house/belgian_house_10min.csv.gz") else {
            return;
        };
        let (window, _) = Window::parse_csv(&text, &ColumnBindings::none()).unwrap();
        let (altitude, azimuth) =
            (window.series("sun_altitude").unwrap(), window.series("sun_azimuth").unwrap());
        let (mut worst_altitude, mut worst_azimuth) = (0.0f64, 0.0f64);
        for (index, time) in altitude.times().iter().enumerate() {
            let sun = sun_position(*time, 50.51, 3.71).unwrap();
            worst_altitude = worst_altitude.max((sun.altitude - altitude.values()[index]).abs());
            let way = (sun.azimuth - azimuth.values()[index] + 180.0).rem_euclid(360.0) - 180.0;
            worst_azimuth = worst_azimuth.max(way.abs());
        }
        assert!(worst_altitude < 0.5 && worst_azimuth < 0.5, "{worst_altitude} {worst_azimuth}");
    }

    #[test]
    fn measured_columns_are_kept() {
        let grid = Grid::new(1_466_510_400_000, HOUR, 3).unwrap();
        let measured = Column::complete("deg", Hold::Linear, vec![1.0, 2.0, 3.0]).unwrap();
        let grid = add_sun(grid.with_column("sun_altitude", measured).unwrap(), 50.51, 3.71).unwrap();
        assert_eq!(grid.column("sun_altitude").unwrap().values(), [1.0, 2.0, 3.0]);
        let azimuth = grid.column("sun_azimuth").unwrap().values();
        assert!(
            azimuth[0] > 180.0 && azimuth.is_sorted(),
            "noon in UTC is afternoon in Belgium: {azimuth:?}"
        );
        assert!(sun_position(0, 91.0, 0.0).is_err() && sun_position(0, 0.0, f64::NAN).is_err());
        assert!(sun_position(i64::MAX, 0.0, 0.0).is_err());
    }
}
