//! Model and effect documents of users, and the versions made by adding effects.

use super::audit::{Action, AuditEntry, note};
use super::database::Store;
use super::engine::Session;
use super::error::StoreError;
use super::idempotency::{KeyState, RequestKey, look_up, remember};
use super::statement::{query, query_as, query_scalar};
use super::value::{corrupt, from_json, instant, millis, parse, to_json};
use jiff::Timestamp;
use lampyris_core::model::ModelId;
use lampyris_core::model::document::ModelDocument;
use lampyris_core::model::spec::EffectSpec;

/// A model made by adding an effect.
#[derive(Debug, Clone, PartialEq)]
pub struct VersionRecord {
    /// Its id.
    pub id: ModelId,
    /// The model that it was made from.
    pub parent: ModelId,
    /// The effect that was added.
    pub effect: String,
    /// The answer that its maker got: id, parent, difference and hash.
    pub document: serde_json::Value,
    /// When.
    pub created_at: Timestamp,
}

/// What became of a document that was to be kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DocumentInsertion {
    /// It is new.
    New,
    /// The same document was there.
    Known,
    /// Another document has this id; documents do not change, because fits refer to them.
    Conflict,
    /// The idempotency key belongs to another request.
    KeyReused,
}

/// All model documents of users, by id.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn models(store: &Store) -> Result<Vec<ModelDocument>, StoreError> {
    let texts: Vec<String> =
        query_scalar("SELECT document FROM models ORDER BY id").fetch_all(&store.reader).await?;
    let read = |text: &String| -> Result<ModelDocument, StoreError> {
        ModelDocument::from_json(&from_json("a model document", text)?)
            .map_err(|fault| corrupt("a model document", &fault))
    };
    texts.iter().map(read).collect()
}

/// All effect documents of users, by id.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn effects(store: &Store) -> Result<Vec<EffectSpec>, StoreError> {
    let texts: Vec<String> =
        query_scalar("SELECT document FROM effects ORDER BY id").fetch_all(&store.reader).await?;
    texts.iter().map(|text| from_json("an effect document", text)).collect()
}

/// All versions made by adding effects, by id.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn versions(store: &Store) -> Result<Vec<VersionRecord>, StoreError> {
    let sql = "SELECT id, parent, effect, document, created_at FROM model_versions ORDER BY id";
    let rows: Vec<(String, String, String, String, i64)> = query_as(sql).fetch_all(&store.reader).await?;
    rows.into_iter()
        .map(|(id, parent, effect, document, created_at)| {
            Ok(VersionRecord {
                id: parse("a model", &id)?,
                parent: parse("a model", &parent)?,
                effect,
                document: from_json("a model version", &document)?,
                created_at: instant(created_at)?,
            })
        })
        .collect()
}

/// Keeps a model document.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn insert_model(
    store: &Store,
    model: &ModelDocument,
    who: &str,
    key: Option<&RequestKey>,
    now: Timestamp,
) -> Result<DocumentInsertion, StoreError> {
    let document = to_json("a model document", model)?;
    let mut tx = store.write().await?;
    let earlier = query_scalar("SELECT document FROM models WHERE id = $1")
        .bind(model.id())
        .fetch_optional(&mut *tx)
        .await?;
    let kept = settle(&mut tx, earlier, &document, model.id(), key, now).await?;
    if kept == DocumentInsertion::New {
        let sql = "INSERT INTO models (id, document, created_at) VALUES ($1, $2, $3)";
        query(sql).bind(model.id()).bind(&document).bind(millis(now)).execute(&mut *tx).await?;
        note(
            &mut tx,
            &AuditEntry { who, action: Action::PostModel, system: None, subject: model.id(), reason: None },
            now,
        )
        .await?;
    }
    tx.commit().await?;
    Ok(kept)
}

/// Keeps an effect document.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn insert_effect(
    store: &Store,
    effect: &EffectSpec,
    who: &str,
    key: Option<&RequestKey>,
    now: Timestamp,
) -> Result<DocumentInsertion, StoreError> {
    let document = to_json("an effect document", effect)?;
    let mut tx = store.write().await?;
    let earlier = query_scalar("SELECT document FROM effects WHERE id = $1")
        .bind(&effect.id)
        .fetch_optional(&mut *tx)
        .await?;
    let kept = settle(&mut tx, earlier, &document, &effect.id, key, now).await?;
    if kept == DocumentInsertion::New {
        let sql = "INSERT INTO effects (id, document, created_at) VALUES ($1, $2, $3)";
        query(sql).bind(&effect.id).bind(&document).bind(millis(now)).execute(&mut *tx).await?;
        note(
            &mut tx,
            &AuditEntry { who, action: Action::PostEffect, system: None, subject: &effect.id, reason: None },
            now,
        )
        .await?;
    }
    tx.commit().await?;
    Ok(kept)
}

/// Keeps a version, and the effect that it was made with where that is new.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn insert_version(
    store: &Store,
    version: &VersionRecord,
    effect: Option<&EffectSpec>,
    who: &str,
    key: Option<&RequestKey>,
) -> Result<DocumentInsertion, StoreError> {
    let document = to_json("a model version", &version.document)?;
    let (id, now) = (version.id.to_string(), version.created_at);
    let mut tx = store.write().await?;
    let earlier = query_scalar("SELECT document FROM model_versions WHERE id = $1")
        .bind(&id)
        .fetch_optional(&mut *tx)
        .await?;
    let kept = settle(&mut tx, earlier, &document, &id, key, now).await?;
    if kept == DocumentInsertion::New {
        if let Some(effect) = effect {
            let sql = "INSERT INTO effects (id, document, created_at) VALUES ($1, $2, $3) ON CONFLICT (id) \
                DO NOTHING";
            let text = to_json("an effect document", effect)?;
            let done = query(sql).bind(&effect.id).bind(text).bind(millis(now)).execute(&mut *tx).await?;
            if done > 0 {
                note(
                    &mut tx,
                    &AuditEntry {
                        who,
                        action: Action::PostEffect,
                        system: None,
                        subject: &effect.id,
                        reason: None,
                    },
                    now,
                )
                .await?;
            }
        }
        query(
            "INSERT INTO model_versions (id, parent, effect, document, created_at) VALUES ($1, $2, \
            $3, $4, $5)",
        )
        .bind(&id)
        .bind(version.parent.to_string())
        .bind(&version.effect)
        .bind(&document)
        .bind(millis(now))
        .execute(&mut *tx)
        .await?;
        note(
            &mut tx,
            &AuditEntry { who, action: Action::PostModel, system: None, subject: &id, reason: None },
            now,
        )
        .await?;
    }
    tx.commit().await?;
    Ok(kept)
}

/// Decides about a document that may be there already, and remembers the request.
async fn settle(
    tx: &mut Session,
    earlier: Option<String>,
    document: &str,
    id: &str,
    key: Option<&RequestKey>,
    now: Timestamp,
) -> Result<DocumentInsertion, StoreError> {
    let kept = match &earlier {
        None => DocumentInsertion::New,
        Some(earlier) if earlier == document => DocumentInsertion::Known,
        Some(_) => DocumentInsertion::Conflict,
    };
    match look_up(tx, key).await? {
        KeyState::Reused => return Ok(DocumentInsertion::KeyReused),
        KeyState::Fresh if kept != DocumentInsertion::Conflict => {
            remember(tx, key, id, if kept == DocumentInsertion::New { 201 } else { 200 }, now).await?;
        }
        KeyState::Fresh | KeyState::Seen(_) => {}
    }
    Ok(kept)
}
