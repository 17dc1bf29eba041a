//! Takes measurements in: parsed, laid over what counts and kept, once per content.

use super::lay::{self, Arriving};
use super::open;
use super::system::SystemDocument;
use super::systems;
use crate::service::decode::{self, Read, Unread};
use crate::service::error::{Refusal, ServiceError};
use crate::service::state::Service;
use crate::service::threads::blocking;
use crate::store::days;
use crate::store::idempotency::{KeyState, RequestKey};
use crate::store::shares::PackedShares;
use crate::store::uploads::{self, Upload, UploadPlace, Written};
use crate::store::windows::{self, Rebuilt, WindowDeletion, WindowRecord};
use jiff::Timestamp;
use lampyris_core::data::{
    ChannelKind, ColumnBindings, ColumnHeader, ColumnRole, DAY, DialectAsked, FileReading, SystemId, Window,
    WindowDocument, WindowParts, WindowReport, csv_headers, read_file, recognise, rfc3339,
};
use lampyris_core::fault::Fault;
use lampyris_core::units::Unit;
use serde_json::Value;
use std::sync::Arc;

/// How far ahead of the service's clock measurements may be.
pub(super) const MOST_AHEAD: i64 = DAY;
/// How often a change of measurements is tried that others, outside of this process, come before.
const TRIES: usize = 8;
/// Most fits that a refusal names.
const MOST_NAMED: usize = 20;

/// How a window is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// `text/csv`.
    Csv,
    /// `application/json`.
    Json,
}

/// A window that was taken.
#[derive(Debug, Clone)]
pub struct TakenWindow {
    /// The window as it is kept.
    pub window: WindowRecord,
    /// Whether it is new.
    pub is_new: bool,
    /// Whether it was known, and is the newest again where something newer had covered it.
    pub again: bool,
}

/// Takes a window of a system. The same content again is the same window, and becomes the newest where
/// something newer covers it.
///
/// # Errors
/// Every fault of the body, an unknown system, or where the database fails.
pub async fn take(
    service: &Service,
    system: &SystemId,
    format: Format,
    body: impl AsRef<[u8]> + Send + 'static,
    key: Option<&RequestKey>,
) -> Result<TakenWindow, ServiceError> {
    let document = systems::require(service, system).await?;
    let (bindings, asked) = (document.columns(), BodyAsked::default().for_system(&document));
    let read = blocking(move || read(format, body.as_ref(), &bindings, &asked)).await??;
    let faults = faults(service, system, &read.0).await?;
    if !faults.is_empty() {
        return Err(ServiceError::Faults(faults));
    }
    keep(service, system, read, key).await
}

/// What is wrong with measurements that were read, beside the clock and what was there before.
pub(super) async fn faults(
    service: &Service,
    system: &SystemId,
    window: &Window,
) -> Result<Vec<Fault>, ServiceError> {
    let mut faults = conflicts(service, system, window).await?;
    faults.extend(ahead_of_clock(window.to(), service.now()));
    Ok(faults)
}

/// Keeps measurements without faults.
pub(super) async fn keep(
    service: &Service,
    system: &SystemId,
    (window, report): (Window, WindowReport),
    key: Option<&RequestKey>,
) -> Result<TakenWindow, ServiceError> {
    let name = system.clone();
    let id = move |window: &Window| window_id(&format!("{name} {}", window.content_hash()));
    let arriving = Arc::new(blocking(move || Arriving { id: id(&window), window, report }).await?);
    let _turn = service.turns.of(system).await;
    for _ in 0..TRIES {
        let Some(taken) = place(service, system, &arriving, key).await? else { continue };
        let window = windows::get(&service.store, &taken.window).await?;
        return window
            .map(|window| TakenWindow { window, is_new: taken.is_new, again: taken.again })
            .ok_or(ServiceError::NotFound("window", taken.window));
    }
    Err(ServiceError::Busy)
}

/// What became of an upload.
struct Placed {
    window: String,
    is_new: bool,
    again: bool,
}

/// Lays an upload over what counts now, and writes it; nothing where somebody else has changed that
/// meanwhile.
async fn place(
    service: &Service,
    system: &SystemId,
    arriving: &Arc<Arriving>,
    key: Option<&RequestKey>,
) -> Result<Option<Placed>, ServiceError> {
    let now = service.now();
    open::lay_in(service, system).await?;
    let span = (arriving.window.from(), arriving.window.to());
    let may_go_on = |newest: &WindowRecord| lay::may_go_on(newest, span, now);
    let found = uploads::find(&service.store, system, (&arriving.id, span), key, may_go_on).await?;
    if found.key == KeyState::Reused {
        return Err(ServiceError::KeyReused);
    }
    let is_known = |window: String| Placed { window, is_new: false, again: false };
    if let (KeyState::Seen(earlier), Some(_)) = (&found.key, &found.known) {
        // The answer to the same request was lost; what has come since is newer.
        return Ok(Some(is_known(earlier.resource.clone())));
    }
    let (content, key_state, version) = (arriving.clone(), found.key.clone(), found.version);
    let known = found.known.clone();
    let laid = blocking(move || lay::lay(&content, &found)).await??;
    let again = known.is_some();
    let upload = match known {
        // It counts already, and nothing newer hides it where something else is taken away.
        Some(known)
            if laid.is_silent
                && (known.uploads > 1 || !uploads::is_below(&service.store, &known).await?) =>
        {
            uploads::acknowledge(&service.store, key, &known.id, now).await?;
            return Ok(Some(is_known(known.id)));
        }
        Some(known) if known.uploads == 1 => {
            let (version, shares, rebuilt) = taken_out(service, &known, true).await?;
            Upload { id: known.id.clone(), version, place: UploadPlace::Raised(known), shares, rebuilt }
        }
        // One of several uploads that are one window: it comes again as a window of its own.
        Some(known) if known.id == arriving.id => {
            let id = window_id(&format!("{} {version}", arriving.id));
            laid.upload(id, version)
        }
        _ => laid.upload(arriving.id.clone(), version),
    };
    match uploads::write(&service.store, system, &upload, (key, &key_state), now).await? {
        Written::Kept(window) => {
            service.arrivals.note(system);
            Ok(Some(Placed { window, is_new: !again, again }))
        }
        Written::Stale => Ok(None),
        Written::NoSystem => Err(ServiceError::NoSystem(system.clone())),
    }
}

/// Computes what follows where a window leaves its place, and of which version of the measurements.
async fn taken_out(
    service: &Service,
    window: &WindowRecord,
    to_the_top: bool,
) -> Result<(i64, PackedShares, Rebuilt), ServiceError> {
    let stack =
        windows::stack(&service.store, window, days::whole_days((window.from_ms, window.to_ms))).await?;
    let window = window.clone();
    let (version, (shares, rebuilt)) =
        blocking(move || lay::take_out(&stack, &window, to_the_top).map(|out| (stack.version, out)))
            .await??;
    Ok((version, shares, rebuilt))
}

/// Channels in a unit that does not convert to the one that they have in earlier windows: the two could never
/// be stitched, and every later job of the system would fail.
pub(super) async fn conflicts(
    service: &Service,
    system: &SystemId,
    window: &Window,
) -> Result<Vec<Fault>, ServiceError> {
    let mut faults = Vec::new();
    // The names of the others fix their units.
    for series in window.iter().filter(|series| ChannelKind::of_name(series.channel()).is_none()) {
        let (channel, unit) = (series.channel(), series.unit());
        let Some(earlier) = windows::unit(&service.store, system, channel).await? else { continue };
        if !converts(unit, &earlier) {
            faults.push(unit_conflict(channel, unit, &earlier));
        }
    }
    Ok(faults)
}

/// Whether one unit converts to another.
pub(super) fn converts(unit: &str, other: &str) -> bool {
    let [unit, other] = [unit, other].map(Unit::parse);
    unit.ok().zip(other.ok()).is_some_and(|(unit, other)| unit.same_dimension(&other))
}

/// That a channel is in a unit here that does not convert to that of earlier measurements.
pub(super) fn unit_conflict(channel: &str, unit: &str, earlier: &str) -> Fault {
    let detail = format!("`{channel}` is in {unit} here and in {earlier} in earlier windows");
    Fault::new(format!("/values/{channel}"), "unit-conflict", detail).suggest(format!(
        "rename the column, state the unit, such as {channel}[{earlier}], or delete the earlier windows"
    ))
}

/// Measurements of tomorrow are stamped by a clock that is wrong, or were never measured. They would be the
/// newest for as long as it takes, and every default window would end with them.
pub(super) fn ahead_of_clock(newest_ms: i64, now: Timestamp) -> Option<Fault> {
    (newest_ms > now.as_millisecond().saturating_add(MOST_AHEAD)).then(|| {
        let newest = rfc3339(newest_ms);
        let detail = format!(
            "the newest time is {newest}, more than a day ahead of the clock of this service, {now:.0}"
        );
        Fault::new("rows", "future-time", detail)
            .suggest("check the clock that wrote the times, and that of the service")
    })
}

/// Deletes a window; what it covered counts again.
///
/// # Errors
/// Where there is none, a fit cites it, a running job may be reading it, or the database fails.
pub(crate) async fn delete(service: &Service, id: &str, who: &str) -> Result<(), ServiceError> {
    let refused =
        |slug, detail, because| Err(ServiceError::Refused(Refusal { slug, detail, because: Some(because) }));
    match remove(service, id, who, None).await? {
        WindowDeletion::Gone => Ok(()),
        WindowDeletion::NotThere => Err(ServiceError::NotFound("window", id.to_owned())),
        WindowDeletion::Cited(mut fits) => {
            let detail = format!("{} fits cite `{id}` and could not be explained without it", fits.len());
            fits.truncate(MOST_NAMED);
            refused("window-cited", detail, ("fits", fits))
        }
        WindowDeletion::InUse(jobs) => {
            let detail =
                "a job that may be reading the window runs: wait for its end, or cancel it".to_owned();
            refused("window-in-use", detail, ("jobs", jobs))
        }
        WindowDeletion::Stale => Err(ServiceError::Busy),
    }
}

/// Deletes a window, if nothing stands in the way.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn remove(
    service: &Service,
    id: &str,
    who: &str,
    reason: Option<&str>,
) -> Result<WindowDeletion, ServiceError> {
    let Some(window) = windows::get(&service.store, id).await? else { return Ok(WindowDeletion::NotThere) };
    let _turn = service.turns.of(&window.system).await;
    for _ in 0..TRIES {
        // Within the turn: it may have changed while others had theirs.
        let Some(window) = windows::get(&service.store, id).await? else {
            return Ok(WindowDeletion::NotThere);
        };
        if let Some(obstacle) = windows::obstacle(&service.store, &window).await? {
            return Ok(obstacle);
        }
        open::lay_in(service, &window.system).await?;
        let (version, _, rebuilt) = taken_out(service, &window, false).await?;
        let deleted =
            windows::delete(&service.store, &window, (version, &rebuilt), (who, reason), service.now());
        match deleted.await? {
            WindowDeletion::Stale => {}
            ended => return Ok(ended),
        }
    }
    Ok(WindowDeletion::Stale)
}

fn window_id(identity: &str) -> String {
    format!("win_{}", &blake3::hash(identity.as_bytes()).to_hex()[..20])
}

/// What a sender says of a body, beside the body.
#[derive(Debug, Clone, Default)]
pub struct BodyAsked {
    /// What columns are that say nothing of their role.
    pub role: Option<ColumnRole>,
    /// How a CSV is written, where it does not say it itself.
    pub dialect: DialectAsked,
    /// Whether only columns count that the system binds.
    pub bound_only: bool,
}

impl BodyAsked {
    /// The same for a system: its zone where no other is said, and its columns where only those count.
    #[must_use]
    pub(super) fn for_system(self, system: &SystemDocument) -> Self {
        let only =
            self.bound_only.then(|| system.columns().iter().map(|(_, column)| column.to_owned()).collect());
        let zone = self.dialect.zone.or_else(|| system.site().zone);
        Self { dialect: DialectAsked { zone, only, ..self.dialect }, ..self }
    }
}

/// How a CSV file would be read.
///
/// # Errors
/// Where there is no table in it.
pub(crate) async fn reading(
    body: impl AsRef<[u8]> + Send + 'static,
    asked: DialectAsked,
) -> Result<FileReading, ServiceError> {
    blocking(move || read_file(body.as_ref(), &asked).map_err(ServiceError::Faults)).await?
}

/// Parses the measurements of a body.
pub(super) fn read(
    format: Format,
    body: &[u8],
    bindings: &ColumnBindings,
    asked: &BodyAsked,
) -> Result<(Window, WindowReport), ServiceError> {
    let forecasts = || vec![Fault::new("header", "no-data-column", "all columns are forecasts")];
    read_parts(format, body, bindings, asked)?.measured.ok_or_else(|| ServiceError::Faults(forecasts()))
}

/// Parses a body. A column that the system binds may be absent: not every file has every channel. The report
/// says so, because a slip in a binding looks the same.
pub(super) fn read_parts(
    format: Format,
    body: &[u8],
    bindings: &ColumnBindings,
    asked: &BodyAsked,
) -> Result<WindowParts, ServiceError> {
    let role = asked.role;
    if format == Format::Json {
        return with_absent(
            bindings,
            || json_columns(body),
            |bindings| {
                WindowParts::parse_json(body, bindings, role)
                    .map_err(|faults| unreadable(body, bindings, role, faults))
            },
        );
    }
    let found = recognise(body, &asked.dialect).map_err(ServiceError::Faults)?;
    let mut parts = with_absent(
        bindings,
        || csv_headers(&found.text),
        |bindings| WindowParts::parse_csv(&found.text, bindings, role).map_err(ServiceError::Faults),
    )?;
    if let Some(summary) = found.dialect.and_then(|dialect| dialect.summary()) {
        let reports = [&mut parts.measured, &mut parts.forecast].into_iter().flatten();
        reports.for_each(|(_, report)| report.warnings.insert(0, summary.clone()));
    }
    Ok(parts)
}

/// Parses with the bindings whose columns are there, and warns of the others.
fn with_absent(
    bindings: &ColumnBindings,
    columns: impl Fn() -> Vec<ColumnHeader>,
    parse: impl Fn(&ColumnBindings) -> Result<WindowParts, ServiceError>,
) -> Result<WindowParts, ServiceError> {
    let faults = match parse(bindings) {
        Err(ServiceError::Faults(faults)) if faults.iter().any(|fault| fault.code == "unknown-column") => {
            faults
        }
        other => return other,
    };
    let columns = columns();
    let (there, absent): (Vec<_>, Vec<_>) =
        bindings.iter().partition(|(_, column)| columns.iter().any(|header| header.is_named(column)));
    if absent.is_empty() {
        return Err(ServiceError::Faults(faults));
    }
    let mut present = ColumnBindings::none();
    there.into_iter().for_each(|(channel, column)| present.bind(channel, column));
    let mut parts = parse(&present)?;
    if let Some((_, report)) = &mut parts.measured {
        report.warnings.extend(absent.into_iter().map(|(channel, column)| {
            format!("`{channel}` is bound to a column `{column}` that this window does not have")
        }));
    }
    Ok(parts)
}

/// All that is wrong with a JSON window whose form is wrong: the parser of large bodies stops at the first.
fn unreadable(
    body: &[u8],
    bindings: &ColumnBindings,
    unmarked: Option<ColumnRole>,
    faults: Vec<Fault>,
) -> ServiceError {
    if faults.iter().all(|fault| fault.code != "unreadable") {
        return ServiceError::Faults(faults);
    }
    match decode::parse(body) {
        Err(Unread::Malformed(fault)) => ServiceError::Malformed(fault),
        Err(Unread::Repeated(faults)) => ServiceError::Faults(faults),
        Ok(value) => {
            let Read { document, faults: mut found, .. } =
                decode::read::<WindowDocument>(value, &Value::Null);
            let more = document.and_then(|document| WindowParts::read(&document, bindings, unmarked).err());
            found.extend(more.into_iter().flatten());
            ServiceError::Faults(if found.is_empty() { faults } else { found })
        }
    }
}

/// The columns of a JSON window.
fn json_columns(body: &[u8]) -> Vec<ColumnHeader> {
    let document: Value = serde_json::from_slice(body).unwrap_or_default();
    let values = document.get("values").and_then(Value::as_object);
    values.into_iter().flat_map(|values| values.keys()).map(|name| ColumnHeader::parse(name)).collect()
}
