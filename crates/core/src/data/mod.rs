//! Measurements: from the text that a user sends to columns on a common grid.
//!
//! ```text
//! CSV or JSON --dialect, channel, stamp, parse, table--> Window --resample--> Grid --split--> train | validation | test
//!                                                 |                    ^
//!                                     series: one block per channel    sun, calendar: computed columns
//! ```
//!
//! | file | what it owns |
//! |---|---|
//! | `system` | `SystemId` (`room/4`) and the patterns that select several (`room/*`) |
//! | `channel` | the known channels: unit, hold, plausible range |
//! | `header` | column headers and the units of columns |
//! | `bindings` | which column a channel is taken from |
//! | `stamp` | RFC 3339 time stamps |
//! | `proposal` | what the columns of a file are probably, for somebody to confirm |
//! | `role`, `parts` | columns that are no measurements, but forecasts, and both in one body |
//! | `csv_text` | a CSV apart: separator, header, rows with their lines |
//! | `parse` | the CSV and the JSON form of a window |
//! | `dialect` | how other programs write files, and those files in the form that `parse` reads |
//! | `json_cell` | what a JSON window may have in its lists |
//! | `table` | the rules for rows and cells: what is rejected, what is a fault |
//! | `seconds` | lengths of time that documents count in seconds |
//! | `series` | the samples of one channel and their statistics |
//! | `block` | the binary form of a series |
//! | `pack` | the binary form of several, as a day of a system has them |
//! | `window` | the measurements of one system over a stretch of time |
//! | `grid` | columns on a common time grid |
//! | `resample` | from a window to a grid, without inventing data across gaps |
//! | `drops` | openings of a window, read off sharp drops of a room temperature |
//! | `envelope` | fewer points for a chart, without losing an extreme |
//! | `sun` | altitude and azimuth of the sun |
//! | `calendar` | hour of the day and day of the week |
//! | `duration` | ISO 8601 durations |
//! | `intake` | single values on their way to a channel |
//! | `influent` | what arrives at a plant in dry weather |
//! | `line_protocol` | the line protocol of InfluxDB |
//! | `layout` | rooms and neighbours from the correlations of many sensors |
//! | `view` | what counts where several windows have samples of a channel, and who gave it |
//! | `thin` | points for a chart: all samples, or an envelope that keeps every extreme |
//! | `write` | columns as CSV that reads back to the same values |
//! | `split` | training, validation and test parts |
//!
//! Times are whole milliseconds since 1970-01-01T00:00:00Z everywhere behind the parsers, and so are
//! distances of times, but for those that a document names by their unit. The folder reads no file, no clock
//! and no environment: the same input gives the same window, and hence the same content hash.
//!
//! Two invariants hold throughout. Times of a [`Series`] increase strictly and its values are finite; a
//! [`Grid`] has a finite value at every index, and a mask that says which of them stand for a measurement.

mod bindings;
mod block;
mod calendar;
mod channel;
mod computed;
mod csv_text;
mod dialect;
mod drops;
mod duration;
mod envelope;
mod grid;
mod header;
mod influent;
mod intake;
mod json_cell;
mod layout;
mod line_protocol;
mod pack;
mod parse;
mod parts;
mod proposal;
mod resample;
mod role;
mod seconds;
mod series;
mod split;
mod stamp;
mod sun;
mod system;
mod table;
mod thin;
mod view;
mod window;
mod write;

pub use bindings::ColumnBindings;
pub use block::CorruptBlock;
pub use calendar::{add_calendar, hour_of_day, local_zone};
pub use channel::{ChannelKind, Hold, is_compass};
pub use computed::{CALENDAR, COMPUTED, ComputedChannel, DROPS, SUN, is_computed};
pub use csv_text::csv_headers;
pub use dialect::{CsvDialect, DateForm, DecimalMark, DialectAsked, Recognised, recognise};
pub use drops::add_drops;
pub use duration::{BadDuration, DAY, Duration, HOUR, Length, MINUTE, SECOND};
pub use envelope::{Envelope, Thinning};
pub use grid::{Column, Grid};
pub use header::{ColumnHeader, ColumnUnit};
pub use influent::DRY_INFLUENT;
pub use intake::ChannelIntake;
pub use layout::{Layout, LayoutPair, LeftOut, NEIGHBOUR, Room, SAME_ROOM, Sensor, propose_layout};
pub use line_protocol::{FieldValue, LinePoint, LinePoints, TimePrecision, line_points};
pub use pack::{pack, unpack};
pub use parse::WindowDocument;
pub use parts::WindowParts;
pub use proposal::{ColumnReading, FileReading, ProposedNeighbours, ProposedRoom, RejectedRows, read_file};
pub use resample::{DEFAULT_MAX_GAP_STEPS, GridRequest};
pub use role::ColumnRole;
pub use seconds::Seconds;
pub use series::{Series, SeriesStatistics};
pub use split::{Split, SplitRequest};
pub use stamp::{read_time, rfc3339};
pub use sun::{SunPosition, add_sun, sun_position};
pub use system::{BadSystemId, SystemId, SystemPattern};
pub use thin::{Bucket, Thinned};
pub use view::{ChannelView, Layer, Replayed, WindowShare, goes_on, lay, merged, replay};
pub use window::{RejectedRow, Window, WindowReport};
pub use write::{CsvChannel, write_csv};

#[cfg(test)]
mod layout_tests;
#[cfg(test)]
mod resample_tests;
#[cfg(test)]
mod view_tests;
#[cfg(test)]
mod window_tests;
