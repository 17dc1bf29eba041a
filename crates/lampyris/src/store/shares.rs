//! What every window gave to what counts, as its row keeps it.

use super::engine::Session;
use super::error::StoreError;
use super::months;
use super::packed::{self, PackedChannel};
use super::statement::{query, query_as};
use super::value::to_json;
use jiff::Timestamp;
use lampyris_core::data::{DAY, WindowShare};
use std::collections::BTreeMap;

/// The shares of a window by channel, packed.
#[derive(Debug, Clone, PartialEq)]
pub struct PackedShares {
    channels: String,
    block: Vec<u8>,
}

impl PackedShares {
    /// Packs shares. This is work for a blocking thread.
    ///
    /// # Errors
    /// Where their stretches cannot be written.
    pub fn new(shares: BTreeMap<String, WindowShare>) -> Result<Self, StoreError> {
        let packed = |(channel, share): (String, WindowShare)| PackedChannel {
            channel,
            series: share.own,
            pairs: share.repeats,
        };
        let (channels, block) = packed::write(shares.into_iter().map(packed).collect());
        Ok(Self { channels: to_json("what a window gave", &channels)?, block })
    }

    /// Unpacks them. This is work for a blocking thread.
    ///
    /// # Errors
    /// Where they are not what was written.
    pub fn decode(&self) -> Result<BTreeMap<String, WindowShare>, StoreError> {
        let share = |one: PackedChannel| (one.channel, WindowShare { own: one.series, repeats: one.pairs });
        let channels = packed::read("what a window gave", &self.channels, &self.block)?;
        Ok(channels.into_iter().map(share).collect())
    }

    /// How much room they take, about.
    pub(super) fn bytes(&self) -> usize {
        self.block.len() + self.channels.len()
    }

    pub(super) fn from_row((channels, block): (String, Vec<u8>)) -> Self {
        Self { channels, block }
    }
}

/// What a window gave; `None` of one whose samples are not laid into the days yet.
pub(super) async fn of(tx: &mut Session, window: &str) -> Result<Option<PackedShares>, StoreError> {
    let sql = "SELECT channels, block FROM shares WHERE window_id = $1";
    let row: Option<(String, Vec<u8>)> = query_as(sql).bind(window).fetch_optional(tx).await?;
    Ok(row.map(PackedShares::from_row))
}

/// Writes the shares of a window in place of those that it had.
pub(super) async fn write(
    tx: &mut Session,
    window: &str,
    shares: &PackedShares,
    now: Timestamp,
) -> Result<(), StoreError> {
    let sql = "UPDATE shares SET channels = $2, block = $3 WHERE window_id = $1";
    let known = query(sql).bind(window).bind(&shares.channels).bind(&shares.block).execute(&mut *tx).await?;
    if known > 0 {
        return Ok(());
    }
    let today = now.as_millisecond().div_euclid(DAY);
    months::keep(tx, "shares", std::iter::once(today)).await?;
    query("INSERT INTO shares (window_id, day, channels, block) VALUES ($1, $2, $3, $4)")
        .bind(window)
        .bind(today)
        .bind(&shares.channels)
        .bind(&shares.block)
        .execute(tx)
        .await?;
    Ok(())
}
