//! Measurements: from the text that a user sends to columns on a common grid.
//!
//! ```text
//! CSV or JSON --channel, stamp, parse, table--> Window --resample--> Grid --split--> train | validation | test
//!                                                 |                    ^
//!                                     series: one block per channel    sun: computed columns
//! ```
//!
//! | file | what it owns |
//! |---|---|
//! | `system` | `SystemId` (`room/4`) and the patterns that select several (`room/*`) |
//! | `channel` | the known channels: unit, hold, plausible range |
//! | `header` | column headers, bindings of columns to channels, the units of columns |
//! | `stamp` | RFC 3339 time stamps |
//! | `parse` | the CSV and the JSON form of a window |
//! | `table` | the rules for rows and cells: what is rejected, what is a fault |
//! | `series` | the samples of one channel and their statistics |
//! | `block` | the binary form of a series |
//! | `window` | the measurements of one system over a stretch of time |
//! | `grid` | columns on a common time grid |
//! | `resample` | from a window to a grid, without inventing data across gaps |
//! | `sun` | altitude and azimuth of the sun |
//! | `duration` | ISO 8601 durations |
//! | `split` | training, validation and test parts |
//!
//! Times are whole seconds since 1970-01-01T00:00:00Z everywhere behind the parsers. The folder reads no
//! file, no clock and no environment: the same input gives the same window, and hence the same content hash.
//!
//! Two invariants hold throughout. Times of a [`Series`] increase strictly and its values are finite; a
//! [`Grid`] has a finite value at every index, and a mask that says which of them stand for a measurement.

mod block;
mod channel;
mod duration;
mod grid;
mod header;
mod parse;
mod resample;
mod series;
mod split;
mod stamp;
mod sun;
mod system;
mod table;
mod window;

pub use block::CorruptBlock;
pub use channel::{ChannelKind, Hold};
pub use duration::{BadDuration, Duration, Length};
pub use grid::{Column, Grid};
pub use header::{Bindings, ColumnHeader, ColumnUnit};
pub use parse::WindowDocument;
pub use resample::{DEFAULT_MAX_GAP_STEPS, GridRequest};
pub use series::{Series, SeriesStatistics};
pub use split::{Split, SplitRequest};
pub use stamp::{read_time, rfc3339};
pub use sun::{SunPosition, add_sun, sun_position};
pub use system::{BadSystemId, SystemId, SystemPattern};
pub use window::{RejectedRow, Window, WindowReport};

#[cfg(test)]
mod resample_tests;
#[cfg(test)]
mod window_tests;
