//! What counts of a system's measurements, by UTC day: what all its windows come to where the newest wins. It
//! follows from the windows, is written with them, and is all that readers of samples read.

use super::engine::Session;
use super::error::StoreError;
use super::months;
use super::open_rows::{OpenRows, open_in};
use super::packed::{self, ChannelEntry, PackedChannel};
use super::sequence::next;
use super::statement::{query, query_as, query_scalar};
use super::value::{corrupt, from_json, to_json};
use lampyris_core::data::{ChannelView, DAY, Layer, Series, WindowShare};
use lampyris_core::fault::Fault;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::OnceLock;

/// Stands in owners for the window that is being written, whose number is not known yet. It is the newest.
pub const ARRIVING: i64 = i64::MAX;

/// Days as they are kept, still packed, and the live samples that are not laid into them yet; of some
/// channels, or of all.
#[derive(Debug, Clone, Default)]
pub struct Days {
    packed: Vec<PackedDay>,
    open: Vec<OpenRows>,
    channels: Option<Vec<String>>,
    /// They are unpacked once, when somebody looks.
    unpacked: OnceLock<BTreeMap<i64, Vec<Layer>>>,
}

#[derive(Debug, Clone, PartialEq)]
struct PackedDay {
    day: i64,
    channels: String,
    block: Vec<u8>,
}

/// Channels of days that have come to something else.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DaysChange {
    /// What there is of them now, by day and channel.
    layers: BTreeMap<i64, BTreeMap<String, Vec<Layer>>>,
    /// Channels of which there is nothing else between two days, both included.
    covered: Vec<(String, (i64, i64))>,
}

/// A whole day as it is written.
#[derive(Debug, Clone, PartialEq)]
pub struct NewDay {
    /// The day, counted from 1970.
    day: i64,
    /// `None` where nothing of it is left.
    content: Option<DayContent>,
}

#[derive(Debug, Clone, PartialEq)]
struct DayContent {
    from_ms: i64,
    to_ms: i64,
    channels: Vec<ChannelEntry>,
    block: Vec<u8>,
}

impl Days {
    fn unpacked(&self) -> Result<&BTreeMap<i64, Vec<Layer>>, StoreError> {
        if let Some(unpacked) = self.unpacked.get() {
            return Ok(unpacked);
        }
        let mut days = BTreeMap::new();
        for day in &self.packed {
            let mut layers = unpack(&day.channels, &day.block)?;
            layers.retain(|layer| self.has(layer.series.channel()));
            days.insert(day.day, layers);
        }
        Ok(self.unpacked.get_or_init(|| days))
    }

    fn has(&self, channel: &str) -> bool {
        self.channels.as_ref().is_none_or(|channels| channels.iter().any(|one| one == channel))
    }

    /// The channels, by name. This is work for a blocking thread or the CPU pool.
    ///
    /// # Errors
    /// Where a day is not what was written.
    pub fn channels(&self) -> Result<BTreeSet<&str>, StoreError> {
        let laid = self.unpacked()?.values().flatten().map(|layer| layer.series.channel());
        Ok(laid.chain(self.open.iter().map(|rows| rows.series.channel())).collect())
    }

    /// The numbers of the windows that gave the samples.
    pub(super) fn owners(&self) -> Result<BTreeSet<i64>, StoreError> {
        let mut numbers: BTreeSet<i64> = self.open.iter().map(|rows| rows.owner).collect();
        for day in &self.packed {
            let channels: Vec<ChannelEntry> = from_json("the channels of a day", &day.channels)?;
            numbers.extend(channels.iter().flat_map(|(_, _, owners)| owners).map(|(owner, _)| owner));
        }
        Ok(numbers)
    }

    /// What counts of a channel. This is work for a blocking thread or the CPU pool.
    ///
    /// # Errors
    /// Where a day is not what was written.
    pub fn view(&self, channel: &str) -> Result<ChannelView, StoreError> {
        let layers = self.unpacked()?.values().flatten().filter(|layer| layer.series.channel() == channel);
        let mut view = ChannelView::of_layers(channel, layers)
            .map_err(|fault| corrupt(format!("a day of `{channel}`"), &fault))?;
        for rows in self.open.iter().filter(|rows| rows.series.channel() == channel) {
            view.put(&rows.series, rows.owner);
        }
        Ok(view)
    }

    /// What counts of a channel as one series, `None` where there is nothing. This is work for a blocking
    /// thread or the CPU pool.
    ///
    /// # Errors
    /// Where a day is not what was written.
    pub fn series(&self, channel: &str) -> Result<Option<Series>, StoreError> {
        self.view(channel)?.stitched().map_err(|fault| unfit(channel, &fault))
    }
}

/// The layers of a day.
fn unpack(channels: &str, block: &[u8]) -> Result<Vec<Layer>, StoreError> {
    let mut layers: Vec<Layer> = Vec::new();
    for PackedChannel { channel, series, pairs } in packed::read("a day", channels, block)? {
        let series = series.ok_or_else(|| corrupt("a day", &format!("`{channel}` has no unit")))?;
        let owners = match layers.last() {
            Some(before) if pairs.is_empty() => before.owners.clone(),
            _ => {
                let counted = |(owner, count): (i64, i64)| Some((owner, usize::try_from(count).ok()?));
                let owners = pairs.into_iter().map(counted).collect::<Option<_>>();
                owners.ok_or_else(|| corrupt("a day", &format!("`{channel}` has fewer than no samples")))?
            }
        };
        layers.push(Layer { series, owners });
    }
    Ok(layers)
}

impl DaysChange {
    /// The days in which a window has given something to a view.
    ///
    /// # Errors
    /// Where the samples are no series.
    pub fn touch(
        &mut self,
        channel: &str,
        view: &ChannelView,
        share: &WindowShare,
    ) -> Result<(), StoreError> {
        let times = share.own.iter().flat_map(|own| own.times());
        let days: BTreeSet<i64> = times.map(|time| time.div_euclid(DAY)).collect();
        days.into_iter().try_for_each(|day| self.put(channel, view, (day, day)))
    }

    /// The whole days between two instants, which a view covers.
    ///
    /// # Errors
    /// Where the samples are no series.
    pub fn cover(
        &mut self,
        channel: &str,
        view: &ChannelView,
        (from, to): (i64, i64),
    ) -> Result<(), StoreError> {
        let span = (from.div_euclid(DAY), to.div_euclid(DAY));
        self.covered.push((channel.to_owned(), span));
        self.put(channel, view, span)
    }

    fn put(&mut self, channel: &str, view: &ChannelView, span: (i64, i64)) -> Result<(), StoreError> {
        let mut days: BTreeMap<i64, Vec<Layer>> = BTreeMap::new();
        for (day, layer) in view.days(span).map_err(|fault| unfit(channel, &fault))? {
            days.entry(day).or_default().push(layer);
        }
        for (day, layers) in days {
            self.layers.entry(day).or_default().insert(channel.to_owned(), layers);
        }
        Ok(())
    }

    /// Whether a channel of a day is something else now.
    fn has(&self, day: i64, channel: &str) -> bool {
        self.layers.get(&day).is_some_and(|changed| changed.contains_key(channel))
            || self.covered.iter().any(|(one, (from, to))| one == channel && (*from..=*to).contains(&day))
    }

    /// Packs the days, with what was there of other channels. This is work for a blocking thread.
    ///
    /// # Errors
    /// Where a day is not what was written.
    pub fn over(self, there: &Days) -> Result<Vec<NewDay>, StoreError> {
        let there = there.unpacked()?;
        let is_covered = |day: &i64| self.covered.iter().any(|(_, (from, to))| (*from..=*to).contains(day));
        let days: BTreeSet<i64> =
            self.layers.keys().chain(there.keys().filter(|day| is_covered(day))).copied().collect();
        let new = |day: i64| {
            let before = there.get(&day).into_iter().flatten();
            let kept = before.filter(|layer| !self.has(day, layer.series.channel()));
            let changed = self.layers.get(&day).into_iter().flat_map(BTreeMap::values).flatten();
            let mut layers: Vec<Layer> = kept.chain(changed).cloned().collect();
            layers.sort_by(|one, other| one.series.channel().cmp(other.series.channel()));
            NewDay { day, content: DayContent::new(layers) }
        };
        Ok(days.into_iter().map(new).collect())
    }
}

impl NewDay {
    /// How much room it takes, about.
    pub(super) fn bytes(&self) -> usize {
        self.content.as_ref().map_or(0, |content| content.block.len() + 64 * content.channels.len())
    }
}

impl DayContent {
    fn new(layers: Vec<Layer>) -> Option<Self> {
        let from_ms = layers.iter().map(|layer| layer.series.from()).min()?;
        let to_ms = layers.iter().map(|layer| layer.series.to()).max()?;
        let mut before: Vec<(i64, usize)> = Vec::new();
        let channels = layers.into_iter().map(|layer| {
            let owners = if layer.owners == before { Vec::new() } else { layer.owners.clone() };
            before = layer.owners;
            PackedChannel {
                channel: layer.series.channel().to_owned(),
                series: Some(layer.series),
                pairs: owners.into_iter().map(|(owner, count)| (owner, count as i64)).collect(),
            }
        });
        let (channels, block) = packed::write(channels.collect());
        Some(Self { from_ms, to_ms, channels, block })
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
    let channels = channels.map(<[String]>::to_vec);
    Ok(Days { open, channels, ..laid_in(connection, system, span).await? })
}

/// The days that touch a stretch of time, without the samples that are not laid into them yet.
pub(super) async fn laid_in(
    connection: &mut Session,
    system: &str,
    (from, to): (i64, i64),
) -> Result<Days, StoreError> {
    let sql =
        "SELECT day, channels, block FROM days WHERE system = $1 AND day BETWEEN $2 AND $3 ORDER BY day";
    let rows: Vec<(i64, String, Vec<u8>)> = query_as(sql)
        .bind(system)
        .bind(from.div_euclid(DAY))
        .bind(to.div_euclid(DAY))
        .fetch_all(connection)
        .await?;
    let packed = |(day, channels, block)| PackedDay { day, channels, block };
    Ok(Days { packed: rows.into_iter().map(packed).collect(), ..Days::default() })
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
    days: &[NewDay],
    arriving: i64,
) -> Result<(), StoreError> {
    months::keep(tx, "days", days.iter().filter(|day| day.content.is_some()).map(|day| day.day)).await?;
    for NewDay { day, content } in days {
        let Some(content) = content else {
            let sql = "DELETE FROM days WHERE system = $1 AND day = $2";
            query(sql).bind(system).bind(day).execute(&mut *tx).await?;
            continue;
        };
        let mut channels = content.channels.clone();
        for (owner, _) in channels.iter_mut().flat_map(|(_, _, owners)| owners) {
            *owner = if *owner == ARRIVING { arriving } else { *owner };
        }
        let sql = "INSERT INTO days (system, day, from_ms, to_ms, channels, block) VALUES ($1, $2, $3, $4, $5, $6) \
            ON CONFLICT (system, day) DO UPDATE SET from_ms = excluded.from_ms, to_ms = excluded.to_ms, \
            channels = excluded.channels, block = excluded.block";
        query(sql)
            .bind(system)
            .bind(day)
            .bind(content.from_ms)
            .bind(content.to_ms)
            .bind(to_json("the channels of a day", &channels)?)
            .bind(&content.block)
            .execute(&mut *tx)
            .await?;
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

#[cfg(test)]
mod tests {
    use super::{Days, DaysChange};
    use lampyris_core::data::{ChannelView, DAY, Hold, Series};

    /// A clock that was wrong once leaves a window of decades: what it costs goes by its samples.
    #[test]
    fn a_change_over_decades_is_as_large_as_its_days() {
        let times = vec![DAY, 20_000 * DAY];
        let series = Series::new("T_room", "degC", Hold::Linear, times, vec![20.0, 21.0]).unwrap();
        let mut view = ChannelView::empty("T_room");
        view.put(&series, 1);
        let mut change = DaysChange::default();
        change.cover("T_room", &view, (DAY, 20_000 * DAY)).unwrap();
        assert_eq!(change.layers.len(), 2);
        let days: Vec<i64> = change.over(&Days::default()).unwrap().iter().map(|new| new.day).collect();
        assert_eq!(days, [1, 20_000]);
    }
}
