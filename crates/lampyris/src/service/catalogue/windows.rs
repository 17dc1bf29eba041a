//! Takes measurements in: parsed, packed and kept, once per content.

use super::systems;
use crate::service::decode::{self, Read, Unread};
use crate::service::error::{Refusal, ServiceError};
use crate::service::state::Service;
use crate::service::threads::blocking;
use crate::store::idempotency::RequestKey;
use crate::store::windows::{self, Blocks, NewWindow, WindowDeletion, WindowInsertion, WindowRecord};
use jiff::Timestamp;
use lampyris_core::data::{
    ChannelKind, ColumnBindings, ColumnHeader, SystemId, Window, WindowDocument, WindowReport,
};
use lampyris_core::fault::Fault;
use lampyris_core::units::Unit;
use serde_json::Value;
use std::str::Utf8Error;

/// How far ahead of the service's clock measurements may be.
const MOST_AHEAD_S: i64 = 86_400;
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
}

/// A window ready to be kept.
struct Packed {
    id: String,
    from_s: i64,
    to_s: i64,
    report: String,
    blocks: Vec<(String, Vec<u8>)>,
    /// The units of channels whose name does not fix one.
    free_units: Vec<(String, String)>,
}

/// Takes a window of a system. The same content again is the same window.
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
    let bindings = systems::require(service, system).await?.channels;
    let name = system.clone();
    let packed = blocking(move || pack(&name, format, body.as_ref(), &bindings)).await??;
    let mut faults = conflicts(service, system, &packed).await?;
    faults.extend(ahead_of_clock(packed.to_s, service.now()));
    if !faults.is_empty() {
        return Err(ServiceError::Faults(faults));
    }
    let new = NewWindow {
        id: &packed.id,
        system,
        from_s: packed.from_s,
        to_s: packed.to_s,
        report: &packed.report,
        blocks: &packed.blocks,
    };
    let is_new = match windows::insert(&service.store, &new, key, service.now()).await? {
        WindowInsertion::New => {
            service.arrivals.note(system);
            true
        }
        WindowInsertion::Known => false,
        WindowInsertion::KeyReused => return Err(ServiceError::KeyReused),
        WindowInsertion::NoSystem => return Err(ServiceError::NoSystem(system.clone())),
    };
    let window = windows::get(&service.store, &packed.id).await?;
    window
        .map(|window| TakenWindow { window, is_new })
        .ok_or_else(|| ServiceError::NotFound("window", packed.id))
}

/// Channels in a unit that does not convert to the one that they have in earlier windows: the two could never
/// be stitched, and every later job of the system would fail.
async fn conflicts(
    service: &Service,
    system: &SystemId,
    packed: &Packed,
) -> Result<Vec<Fault>, ServiceError> {
    let mut faults = Vec::new();
    for (channel, unit) in &packed.free_units {
        let Some(earlier) = windows::unit(&service.store, system, channel).await? else { continue };
        let converts = Unit::parse(unit)
            .ok()
            .zip(Unit::parse(&earlier).ok())
            .is_some_and(|(unit, earlier)| unit.same_dimension(&earlier));
        if !converts {
            let detail = format!("`{channel}` is in {unit} here and in {earlier} in earlier windows");
            let fault = Fault::new(format!("/values/{channel}"), "unit-conflict", detail);
            faults.push(fault.suggest(format!(
                "rename the column, state the unit, such as {channel}[{earlier}], or \
                    delete the earlier windows"
            )));
        }
    }
    Ok(faults)
}

/// Measurements of tomorrow are stamped by a clock that is wrong, or were never measured. They would be the
/// newest for as long as it takes, and every default window would end with them.
fn ahead_of_clock(newest_s: i64, now: Timestamp) -> Option<Fault> {
    (newest_s > now.as_second().saturating_add(MOST_AHEAD_S)).then(|| {
        let newest =
            Timestamp::from_second(newest_s).map_or_else(|_| newest_s.to_string(), |time| time.to_string());
        let detail = format!(
            "the newest time is {newest}, more than a day ahead of the clock of this service, {now:.0}"
        );
        Fault::new("rows", "future-time", detail)
            .suggest("check the clock that wrote the times, and that of the service")
    })
}

/// Deletes a window.
///
/// # Errors
/// Where there is none, a fit cites it, a running job may be reading it, or the database fails.
pub async fn delete(service: &Service, id: &str, who: &str) -> Result<(), ServiceError> {
    let refused =
        |slug, detail, because| Err(ServiceError::Refused(Refusal { slug, detail, because: Some(because) }));
    match windows::delete(&service.store, id, who, service.now()).await? {
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
    }
}

/// Parses and packs a body.
fn pack(
    system: &SystemId,
    format: Format,
    body: &[u8],
    bindings: &ColumnBindings,
) -> Result<Packed, ServiceError> {
    let (window, report) = read(format, body, bindings)?;
    let identity = format!("{system} {}", window.content_hash());
    Ok(Packed {
        id: format!("win_{}", &blake3::hash(identity.as_bytes()).to_hex()[..20]),
        from_s: window.from(),
        to_s: window.to(),
        report: serde_json::to_string(&report).map_err(|error| ServiceError::Internal(error.to_string()))?,
        blocks: window.iter().map(|series| (series.channel().to_owned(), series.encode())).collect(),
        free_units: window
            .iter()
            .filter(|series| ChannelKind::of_name(series.channel()).is_none())
            .map(|series| (series.channel().to_owned(), series.unit().to_owned()))
            .collect(),
    })
}

/// Unpacks the samples of windows, in their order; [`Window::stitch`] then makes one of them. This is work
/// for a blocking thread or the CPU pool.
///
/// # Errors
/// Where a block is not what was written.
pub fn unpack(windows: &[Blocks]) -> Result<Vec<Window>, ServiceError> {
    windows.iter().map(|blocks| Window::from_series(blocks.decode()?).map_err(ServiceError::Faults)).collect()
}

/// Parses a body. A column that the system binds may be absent: not every file has every channel. The report
/// says so, because a slip in a binding looks the same.
pub(super) fn read(
    format: Format,
    body: &[u8],
    bindings: &ColumnBindings,
) -> Result<(Window, WindowReport), ServiceError> {
    let faults = match parse(format, body, bindings) {
        Err(ServiceError::Faults(faults)) if faults.iter().any(|fault| fault.code == "unknown-column") => {
            faults
        }
        other => return other,
    };
    let columns = columns(format, body);
    let (there, absent): (Vec<_>, Vec<_>) = bindings.iter().partition(|(_, column)| {
        columns.iter().any(|header| header.column == *column || header.channel == *column)
    });
    if absent.is_empty() {
        return Err(ServiceError::Faults(faults));
    }
    let mut present = ColumnBindings::none();
    there.into_iter().for_each(|(channel, column)| present.bind(channel, column));
    let (window, mut report) = parse(format, body, &present)?;
    report.warnings.extend(absent.into_iter().map(|(channel, column)| {
        format!("`{channel}` is bound to a column `{column}` that this window does not have")
    }));
    Ok((window, report))
}

fn parse(
    format: Format,
    body: &[u8],
    bindings: &ColumnBindings,
) -> Result<(Window, WindowReport), ServiceError> {
    match format {
        Format::Json => {
            Window::parse_json(body, bindings).map_err(|faults| unreadable(body, bindings, faults))
        }
        Format::Csv => {
            let not_text = |error: Utf8Error| {
                vec![Fault::new("csv", "not-utf8", format!("byte {} is no UTF-8", error.valid_up_to()))]
            };
            std::str::from_utf8(body)
                .map_err(not_text)
                .and_then(|text| Window::parse_csv(text, bindings))
                .map_err(ServiceError::Faults)
        }
    }
}

/// All that is wrong with a JSON window whose form is wrong: the parser of large bodies stops at the first.
fn unreadable(body: &[u8], bindings: &ColumnBindings, faults: Vec<Fault>) -> ServiceError {
    if faults.iter().all(|fault| fault.code != "unreadable") {
        return ServiceError::Faults(faults);
    }
    match decode::parse(body) {
        Err(Unread::Malformed(fault)) => ServiceError::Malformed(fault),
        Err(Unread::Repeated(faults)) => ServiceError::Faults(faults),
        Ok(value) => {
            let Read { document, faults: mut found, .. } =
                decode::read::<WindowDocument>(value, &Value::Null);
            found.extend(
                document.and_then(|document| Window::read(document, bindings).err()).into_iter().flatten(),
            );
            ServiceError::Faults(if found.is_empty() { faults } else { found })
        }
    }
}

/// The columns of a body that is well-formed enough to have some.
fn columns(format: Format, body: &[u8]) -> Vec<ColumnHeader> {
    match format {
        Format::Csv => {
            let text = String::from_utf8_lossy(body);
            let line = text
                .lines()
                .find(|line| !line.trim().is_empty() && !line.starts_with('#'))
                .unwrap_or_default();
            line.split([',', ';', '\t'])
                .map(|cell| ColumnHeader::parse(cell.trim().trim_matches('"')))
                .collect()
        }
        Format::Json => {
            let document: Value = serde_json::from_slice(body).unwrap_or_default();
            let values = document.get("values").and_then(Value::as_object);
            values
                .into_iter()
                .flat_map(|values| values.keys())
                .map(|name| ColumnHeader::parse(name))
                .collect()
        }
    }
}
