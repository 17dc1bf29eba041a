//! What every window gave to what counts, as its rows keep it, and windows of earlier programs, whose rows
//! held all that they had.

use super::days::{self, DaysChange, unfit};
use super::engine::Session;
use super::error::StoreError;
use super::statement::{query, query_as, query_scalar};
use super::value::{corrupt, from_json, to_json};
use lampyris_core::data::{Series, WindowShare, lay};

/// The share of a window in one channel, packed.
#[derive(Debug, Clone, PartialEq)]
pub struct PackedShare {
    /// The channel.
    pub channel: String,
    block: Option<Vec<u8>>,
    repeats: String,
}

impl PackedShare {
    /// Packs a share. This is work for a blocking thread.
    ///
    /// # Errors
    /// Where its stretches cannot be written.
    pub fn new(channel: &str, share: &WindowShare) -> Result<Self, StoreError> {
        Ok(Self {
            channel: channel.to_owned(),
            block: share.own.as_ref().map(Series::encode),
            repeats: to_json("what a window repeats", &share.repeats)?,
        })
    }

    /// Unpacks it. This is work for a blocking thread.
    ///
    /// # Errors
    /// Where it is not what was written.
    pub fn decode(&self) -> Result<WindowShare, StoreError> {
        let unpack = |block: &Vec<u8>| {
            Series::decode(block).map_err(|error| corrupt(format!("a block of `{}`", self.channel), &error))
        };
        Ok(WindowShare {
            own: self.block.as_ref().map(unpack).transpose()?,
            repeats: from_json("what a window repeats", &self.repeats)?,
        })
    }

    /// How much room it takes, about.
    pub(super) fn bytes(&self) -> usize {
        self.block.as_ref().map_or(0, Vec::len) + self.repeats.len()
    }

    pub(super) fn from_row((channel, block, repeats): (String, Option<Vec<u8>>, String)) -> Self {
        Self { channel, block, repeats }
    }
}

/// Writes shares of a window in place of those that it had in their channels.
pub(super) async fn write(
    tx: &mut Session,
    window: &str,
    shares: impl Iterator<Item = &PackedShare>,
) -> Result<(), StoreError> {
    for share in shares {
        let sql = "INSERT INTO window_blocks (window_id, channel, block, repeats) VALUES ($1, $2, $3, $4) ON \
            CONFLICT (window_id, channel) DO UPDATE SET block = excluded.block, repeats = excluded.repeats";
        query(sql)
            .bind(window)
            .bind(&share.channel)
            .bind(share.block.as_deref())
            .bind(&share.repeats)
            .execute(&mut *tx)
            .await?;
    }
    Ok(())
}

/// Takes the windows of earlier programs into the days, oldest first, each in a transaction of its own: what
/// is held of them in memory is one window and its days.
pub(super) async fn take_in(connection: &mut Session) -> Result<(), StoreError> {
    let sql = "SELECT w.id, w.system, w.sequence FROM windows w WHERE w.id IN (SELECT window_id FROM \
        window_blocks WHERE repeats IS NULL) ORDER BY w.sequence";
    let waiting: Vec<(String, String, i64)> = query_as(sql).fetch_all(&mut *connection).await?;
    for (window, system, sequence) in waiting {
        let sql = "SELECT block FROM window_blocks WHERE window_id = $1 AND repeats IS NULL";
        let blocks: Vec<Vec<u8>> = query_scalar(sql).bind(&window).fetch_all(&mut *connection).await?;
        let (mut shares, mut changes, mut damaged) = (Vec::new(), Vec::new(), Vec::new());
        for block in blocks {
            let series = match Series::decode(&block) {
                Ok(series) => series,
                // What was lost of one window keeps no controller from being answered. The block is still in
                // the backup that was made before.
                Err(error) => {
                    tracing::error!(%error, window, system, "a damaged block counts no more");
                    damaged.push(block);
                    continue;
                }
            };
            let channel = series.channel();
            let span = (series.from(), series.to());
            let days = days::read_in(connection, &system, span, Some(&[channel.to_owned()])).await?;
            let mut view = days.view(channel)?;
            let share = lay(&mut view, &series, sequence).map_err(|fault| unfit(channel, &fault))?;
            changes.extend(DaysChange::touched(channel, &view, &share)?);
            shares.push(PackedShare::new(channel, &share)?);
        }
        query("BEGIN").execute(&mut *connection).await?;
        for block in damaged {
            let sql = "DELETE FROM window_blocks WHERE window_id = $1 AND repeats IS NULL AND block = $2";
            query(sql).bind(&window).bind(&block).execute(&mut *connection).await?;
        }
        write(connection, &window, shares.iter()).await?;
        days::write(connection, &system, &changes, sequence).await?;
        query("COMMIT").execute(&mut *connection).await?;
    }
    Ok(())
}
