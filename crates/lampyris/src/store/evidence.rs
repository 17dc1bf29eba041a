//! What every window showed of every effect, also when its diagnosis is forgotten: the long memory of a
//! system.

use super::database::Store;
use super::engine::Session;
use super::error::StoreError;
use super::row::row;
use super::statement::{query, query_as};
use super::value::{corrupt, to_json};
use lampyris_core::data::SystemId;
use lampyris_core::diagnose::ledger::{EffectScore, LedgerEntry, LookedSpan};
use std::collections::HashMap;

row! {
    struct Row {
        diagnosis: String,
        system: String,
        effect: String,
        model: String,
        model_hash: Option<String>,
        from_ms: i64,
        to_ms: i64,
        hours: f64,
        size: f64,
        deviation: f64,
        unit: String,
        share: f64,
        t: f64,
        beyond_clock: f64,
        days: i64,
        shift_p: Option<f64>,
    }
}

impl Row {
    fn entry(self) -> Result<LedgerEntry, StoreError> {
        Ok(LedgerEntry {
            diagnosis: self.diagnosis,
            model: self.model,
            model_hash: self.model_hash,
            span: LookedSpan { from: self.from_ms, to: self.to_ms, hours: self.hours },
            score: EffectScore {
                effect: self.effect,
                size: self.size,
                deviation: self.deviation,
                unit: self.unit,
                share: self.share,
                t: self.t,
                beyond_clock: self.beyond_clock,
                days: usize::try_from(self.days).map_err(|error| corrupt("a number of days", &error))?,
                shift_p: self.shift_p,
            },
        })
    }
}

/// Keeps what the window of a diagnosis showed. `sequence` is that of the diagnosis.
pub(super) async fn keep(
    tx: &mut Session,
    system: &str,
    sequence: i64,
    entries: &[LedgerEntry],
) -> Result<(), StoreError> {
    let sql = "INSERT INTO evidence (diagnosis, effect, sequence, system, model, model_hash, from_ms, to_ms, \
        hours, size, deviation, unit, share, t, \
        beyond_clock, days, shift_p) \
        VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $13, $14, $15, $16, $17)";
    for LedgerEntry { diagnosis, model, model_hash, span, score } in entries {
        query(sql)
            .bind(diagnosis)
            .bind(&score.effect)
            .bind(sequence)
            .bind(system)
            .bind(model)
            .bind(model_hash)
            .bind(span.from)
            .bind(span.to)
            .bind(span.hours)
            .bind(score.size)
            .bind(score.deviation)
            .bind(&score.unit)
            .bind(score.share)
            .bind(score.t)
            .bind(score.beyond_clock)
            .bind(i64::try_from(score.days).unwrap_or(i64::MAX))
            .bind(score.shift_p)
            .execute(&mut *tx)
            .await?;
    }
    Ok(())
}

/// What the windows of a system showed, in the order in which they were looked at: of one effect or all, of
/// one model or all.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn of(
    store: &Store,
    system: &SystemId,
    effect: Option<&str>,
    model: Option<&str>,
) -> Result<Vec<LedgerEntry>, StoreError> {
    let sql = "SELECT * FROM evidence WHERE system = $1 AND ($2 IS NULL OR effect = $2) AND ($3 IS NULL OR \
        model = $3) ORDER BY sequence";
    let rows: Vec<Row> =
        query_as(sql).bind(system.to_string()).bind(effect).bind(model).fetch_all(&store.reader).await?;
    rows.into_iter().map(Row::entry).collect()
}

/// What the windows of some systems showed, by the system's name, each in the order in which they were looked
/// at.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn of_many(
    store: &Store,
    systems: &[String],
) -> Result<HashMap<String, Vec<LedgerEntry>>, StoreError> {
    let sql = "SELECT * FROM evidence WHERE system IN (SELECT value FROM json_each($1)) ORDER BY sequence";
    let rows: Vec<Row> = query_as(sql).bind(to_json("systems", systems)?).fetch_all(&store.reader).await?;
    let mut all: HashMap<String, Vec<LedgerEntry>> = HashMap::new();
    for row in rows {
        all.entry(row.system.clone()).or_default().push(row.entry()?);
    }
    Ok(all)
}
