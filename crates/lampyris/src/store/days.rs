//! What counts of a system's measurements, by channel and UTC day: what all its windows come to where the
//! newest wins. It follows from the windows, is written with them, and is all that readers of samples read.

use super::engine::Session;
use super::error::StoreError;
use super::open_rows::{OpenRows, open_in};
use super::sequence::next;
use super::statement::{query, query_as, query_scalar};
use super::value::{corrupt, from_json, to_json};
use lampyris_core::data::{ChannelView, DAY, Layer, Series, WindowShare};
use lampyris_core::fault::Fault;
use std::collections::BTreeSet;

/// Stands in owners for the window that is being written, whose number is not known yet. It is the newest.
pub const ARRIVING: i64 = i64::MAX;

/// Days as they are kept, still packed, in the order of channels, and the live samples that are not laid into
/// them yet.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Days {
    packed: Vec<PackedDay>,
    open: Vec<OpenRows>,
}

#[derive(Debug, Clone, PartialEq)]
struct PackedDay {
    channel: String,
    block: Vec<u8>,
    owners: String,
}

/// Days of a channel that take the place of those that were there.
#[derive(Debug, Clone, PartialEq)]
pub struct DaysChange {
    channel: String,
    /// The first and the last day that is replaced, counted from 1970.
    span: (i64, i64),
    days: Vec<NewDay>,
}

#[derive(Debug, Clone, PartialEq)]
struct NewDay {
    day: i64,
    unit: String,
    from_ms: i64,
    to_ms: i64,
    block: Vec<u8>,
    owners: Vec<(i64, usize)>,
}

impl Days {
    /// The channels, by name.
    pub fn channels(&self) -> BTreeSet<&str> {
        let packed = self.packed.iter().map(|day| day.channel.as_str());
        packed.chain(self.open.iter().map(|rows| rows.series.channel())).collect()
    }

    /// The numbers of the windows that gave the samples.
    pub(super) fn owners(&self) -> Result<BTreeSet<i64>, StoreError> {
        let mut numbers: BTreeSet<i64> = self.open.iter().map(|rows| rows.owner).collect();
        for day in &self.packed {
            let owners: Vec<(i64, usize)> = from_json("the owners of a day", &day.owners)?;
            numbers.extend(owners.into_iter().map(|(owner, _)| owner));
        }
        Ok(numbers)
    }

    /// Unpacks what counts of a channel. This is work for a blocking thread or the CPU pool.
    ///
    /// # Errors
    /// Where a day is not what was written.
    pub fn view(&self, channel: &str) -> Result<ChannelView, StoreError> {
        let broken = |error: &dyn std::fmt::Display| corrupt(format!("a day of `{channel}`"), error);
        let mut layers = Vec::new();
        for day in self.packed.iter().filter(|day| day.channel == channel) {
            layers.push(Layer {
                series: Series::decode(&day.block).map_err(|error| broken(&error))?,
                owners: from_json("the owners of a day", &day.owners)?,
            });
        }
        let mut view = ChannelView::of_layers(channel, &layers).map_err(|fault| broken(&fault))?;
        for rows in self.open.iter().filter(|rows| rows.series.channel() == channel) {
            view.put(&rows.series, rows.owner);
        }
        Ok(view)
    }

    /// Unpacks what counts of a channel as one series, `None` where there is nothing. This is work for a
    /// blocking thread or the CPU pool.
    ///
    /// # Errors
    /// Where a day is not what was written.
    pub fn series(&self, channel: &str) -> Result<Option<Series>, StoreError> {
        self.view(channel)?.stitched().map_err(|fault| unfit(channel, &fault))
    }
}

impl DaysChange {
    /// Packs the days in which a window has given something to a view. This is work for a blocking thread.
    ///
    /// # Errors
    /// Where the samples are no series.
    pub fn touched(channel: &str, view: &ChannelView, share: &WindowShare) -> Result<Vec<Self>, StoreError> {
        let times = share.own.iter().flat_map(|own| own.times());
        let days: BTreeSet<i64> = times.map(|time| time.div_euclid(DAY)).collect();
        days.into_iter().map(|day| Self::pack(channel, view, (day, day))).collect()
    }

    /// Packs the days of a view that covers whole days between two instants. This is work for a blocking
    /// thread.
    ///
    /// # Errors
    /// Where the samples are no series.
    pub fn between(channel: &str, view: &ChannelView, (from, to): (i64, i64)) -> Result<Self, StoreError> {
        Self::pack(channel, view, (from.div_euclid(DAY), to.div_euclid(DAY)))
    }

    fn pack(channel: &str, view: &ChannelView, span: (i64, i64)) -> Result<Self, StoreError> {
        let layers = view.days(span).map_err(|fault| unfit(channel, &fault))?;
        let pack = |(day, layer): (i64, Layer)| NewDay {
            day,
            unit: layer.series.unit().to_owned(),
            from_ms: layer.series.from(),
            to_ms: layer.series.to(),
            block: layer.series.encode(),
            owners: layer.owners,
        };
        Ok(Self { channel: channel.to_owned(), span, days: layers.into_iter().map(pack).collect() })
    }

    /// How much room it takes, about.
    pub(super) fn bytes(&self) -> usize {
        self.days.iter().map(|day| day.block.len() + 16 * day.owners.len()).sum()
    }
}

/// The whole days that touch a stretch of time: their first and their last second.
pub fn whole_days((from, to): (i64, i64)) -> (i64, i64) {
    (from.div_euclid(DAY) * DAY, to.div_euclid(DAY) * DAY + DAY - 1)
}

pub(super) fn unfit(channel: &str, fault: &Fault) -> StoreError {
    corrupt(format!("the samples of `{channel}`"), fault)
}

/// The days that touch a stretch of time, with the live samples that belong to them; of some channels, or of
/// all.
pub(super) async fn read_in(
    connection: &mut Session,
    system: &str,
    span: (i64, i64),
    channels: Option<&[String]>,
) -> Result<Days, StoreError> {
    let open = open_in(connection, system, whole_days(span), channels).await?;
    Ok(Days { open, ..laid_in(connection, system, span, channels).await? })
}

/// The days that touch a stretch of time, without the samples that are not laid into them yet.
pub(super) async fn laid_in(
    connection: &mut Session,
    system: &str,
    (from, to): (i64, i64),
    channels: Option<&[String]>,
) -> Result<Days, StoreError> {
    macro_rules! laid {
        ($which:literal) => {
            concat!(
                "SELECT channel, block, owners FROM days WHERE system = $1 AND channel IN (",
                $which,
                ") AND day BETWEEN $2 AND $3 ORDER BY channel, day"
            )
        };
    }
    // By name in either case: so the index leads to the days.
    let sql = match channels {
        Some(_) => laid!("SELECT value FROM json_each($4)"),
        None => laid!("SELECT DISTINCT channel FROM days WHERE system = $1 AND $4 IS NULL"),
    };
    let rows: Vec<(String, Vec<u8>, String)> = query_as(sql)
        .bind(system)
        .bind(from.div_euclid(DAY))
        .bind(to.div_euclid(DAY))
        .bind(channels.map(|channels| to_json("channels", channels)).transpose()?)
        .fetch_all(connection)
        .await?;
    let packed = |(channel, block, owners)| PackedDay { channel, block, owners };
    Ok(Days { packed: rows.into_iter().map(packed).collect(), open: Vec::new() })
}

/// What tells one state of a system's measurements from another; 0 where there never were any.
pub(super) async fn version_in(connection: &mut Session, system: &str) -> Result<i64, StoreError> {
    let version: Option<i64> = query_scalar("SELECT version FROM measured WHERE system = $1")
        .bind(system)
        .fetch_optional(connection)
        .await?;
    Ok(version.unwrap_or_default())
}

/// Writes days, in which [`ARRIVING`] stands for `arriving`, and gives the measurements a new version.
pub(super) async fn write(
    tx: &mut Session,
    system: &str,
    changes: &[DaysChange],
    arriving: i64,
) -> Result<(), StoreError> {
    for change in changes {
        let sql = "DELETE FROM days WHERE system = $1 AND channel = $2 AND day BETWEEN $3 AND $4";
        query(sql)
            .bind(system)
            .bind(&change.channel)
            .bind(change.span.0)
            .bind(change.span.1)
            .execute(&mut *tx)
            .await?;
        for day in &change.days {
            let number = |(owner, count): &(i64, usize)| match *owner {
                ARRIVING => (arriving, *count),
                owner => (owner, *count),
            };
            let owners: Vec<(i64, usize)> = day.owners.iter().map(number).collect();
            let sql = "INSERT INTO days (system, channel, day, unit, from_ms, to_ms, block, owners) VALUES ($1, \
                $2, $3, $4, $5, $6, $7, $8)";
            query(sql)
                .bind(system)
                .bind(&change.channel)
                .bind(day.day)
                .bind(&day.unit)
                .bind(day.from_ms)
                .bind(day.to_ms)
                .bind(&day.block)
                .bind(to_json("owners", &owners)?)
                .execute(&mut *tx)
                .await?;
        }
    }
    change_version(tx, system).await?;
    Ok(())
}

/// Gives the measurements of a system a new version; says which.
pub(super) async fn change_version(tx: &mut Session, system: &str) -> Result<i64, StoreError> {
    let version = next(tx, "sequence").await?;
    let sql = "INSERT INTO measured (system, version) VALUES ($1, $2) ON CONFLICT (system) DO UPDATE SET \
        version = excluded.version";
    query(sql).bind(system).bind(version).execute(tx).await?;
    Ok(version)
}
