//! Measurements of earlier programs, which kept every channel by itself, are taken into days and shares.

use super::days::{self, DaysChange};
use super::engine::Session;
use super::error::StoreError;
use super::shares::{self, PackedShares};
use super::statement::{query, query_as, query_scalar};
use super::value::{from_json, instant};
use lampyris_core::data::{ChannelView, Layer, Series, WindowShare, lay};
use std::collections::BTreeMap;

/// Takes in all that waits. Every transaction is a system or a window: no more of it is held in memory.
pub(super) async fn take_in(connection: &mut Session) -> Result<(), StoreError> {
    let sql = "SELECT DISTINCT system FROM channel_days ORDER BY system";
    let systems: Vec<String> = query_scalar(sql).fetch_all(&mut *connection).await?;
    for system in systems {
        take_days(connection, &system).await?;
    }
    let sql = "SELECT w.id, w.system, w.sequence, w.uploaded_at FROM windows w WHERE w.id IN (SELECT window_id \
        FROM window_blocks) ORDER BY w.sequence";
    let windows: Vec<(String, String, i64, i64)> = query_as(sql).fetch_all(&mut *connection).await?;
    for (window, system, sequence, uploaded_at) in windows {
        take_window(connection, (&window, &system, sequence), uploaded_at).await?;
    }
    Ok(())
}

/// The days of a system by channel, as they were.
async fn take_days(connection: &mut Session, system: &str) -> Result<(), StoreError> {
    let sql = "SELECT channel, block, owners FROM channel_days WHERE system = $1 ORDER BY channel, day";
    let rows: Vec<(String, Vec<u8>, String)> = query_as(sql).bind(system).fetch_all(&mut *connection).await?;
    let mut change = DaysChange::default();
    for rows in rows.chunk_by(|one, next| one.0 == next.0) {
        let channel = &rows[0].0;
        let mut layers = Vec::new();
        for (_, block, owners) in rows {
            match Series::decode(block) {
                Ok(series) => {
                    layers.push(Layer { series, owners: from_json("the owners of a day", owners)? })
                }
                // What was lost of one day keeps no controller from being answered. The block is still in the
                // backup that was made before.
                Err(error) => tracing::error!(%error, system, channel, "a damaged day counts no more"),
            }
        }
        if layers.is_empty() {
            continue;
        }
        let view =
            ChannelView::of_layers(channel, layers.iter()).map_err(|fault| days::unfit(channel, &fault))?;
        let (from, to) = layers.iter().fold((i64::MAX, i64::MIN), |(from, to), layer| {
            (from.min(layer.series.from()), to.max(layer.series.to()))
        });
        change.cover(channel, &view, (from, to))?;
    }
    query("BEGIN").execute(&mut *connection).await?;
    days::write(connection, system, &change.over(&days::Days::default())?, 0).await?;
    query("DELETE FROM channel_days WHERE system = $1").bind(system).execute(&mut *connection).await?;
    query("COMMIT").execute(&mut *connection).await?;
    Ok(())
}

/// What a window gave; the oldest programs kept all that it had, which is laid over the days first.
async fn take_window(
    connection: &mut Session,
    (window, system, sequence): (&str, &str, i64),
    uploaded_at: i64,
) -> Result<(), StoreError> {
    let sql = "SELECT channel, block, repeats FROM window_blocks WHERE window_id = $1";
    let rows: Vec<(String, Option<Vec<u8>>, Option<String>)> =
        query_as(sql).bind(window).fetch_all(&mut *connection).await?;
    let mut given = BTreeMap::new();
    let mut whole = Vec::new();
    for (channel, block, repeats) in rows {
        let own = match block.map(|block| Series::decode(&block)).transpose() {
            Ok(own) => own,
            Err(error) => {
                tracing::error!(%error, window, system, channel, "a damaged block counts no more");
                continue;
            }
        };
        match repeats {
            Some(repeats) => {
                let repeats = from_json("what a window repeats", &repeats)?;
                given.insert(channel, WindowShare { own, repeats });
            }
            None => whole.extend(own),
        }
    }
    let span = (
        whole.iter().map(Series::from).min().unwrap_or_default(),
        whole.iter().map(Series::to).max().unwrap_or_default(),
    );
    let days = days::laid_in(connection, system, span).await?;
    let mut change = DaysChange::default();
    for series in &whole {
        let channel = series.channel();
        let mut view = days.view(channel)?;
        let share = lay(&mut view, series, sequence).map_err(|fault| days::unfit(channel, &fault))?;
        change.touch(channel, &view, &share)?;
        given.insert(channel.to_owned(), share);
    }
    let (given, changed) = (PackedShares::new(given)?, change.over(&days)?);
    let then = instant(uploaded_at)?;
    query("BEGIN").execute(&mut *connection).await?;
    shares::write(connection, window, &given, then).await?;
    if !changed.is_empty() {
        days::write(connection, system, &changed, sequence).await?;
    }
    query("DELETE FROM window_blocks WHERE window_id = $1").bind(window).execute(&mut *connection).await?;
    query("COMMIT").execute(&mut *connection).await?;
    Ok(())
}
