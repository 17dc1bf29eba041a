//! Lays an upload over what counts, and takes windows out of their place. All of it is work for a blocking
//! thread.

use crate::service::error::ServiceError;
use crate::store::days::{ARRIVING, DaysChange, whole_days};
use crate::store::samples::{LaidIn, Open};
use crate::store::shares::PackedShare;
use crate::store::uploads::{Found, Upload, UploadPlace};
use crate::store::windows::{Rebuilt, Stack, WindowRecord};
use jiff::Timestamp;
use lampyris_core::data::{DAY, Series, Window, WindowReport, WindowShare, goes_on, merged, replay};
use lampyris_core::fault::Fault;
use std::collections::{BTreeMap, BTreeSet};

/// An upload, read.
#[derive(Debug)]
pub struct Arriving {
    /// `win_` and a hash of system and content.
    pub id: String,
    /// The measurements.
    pub window: Window,
    /// What was found in them.
    pub report: WindowReport,
}

/// An upload beside what counts.
#[derive(Debug)]
pub struct Laid {
    /// What it gives.
    pub shares: Vec<PackedShare>,
    /// The days in which it does.
    pub days: Vec<DaysChange>,
    /// Where it belongs, by its content alone.
    pub place: UploadPlace,
    /// Whether it gives nothing: all that it has counts already.
    pub is_silent: bool,
}

impl Laid {
    /// What is to be written, where it is written beside this version of the measurements.
    pub fn upload(self, id: String, version: i64) -> Upload {
        let rebuilt = Rebuilt { shares: Vec::new(), days: self.days };
        Upload { id, version, place: self.place, shares: self.shares, rebuilt }
    }
}

/// Whether an upload over a stretch of time may go on with the newest window: one that came on the same day,
/// and does not begin much earlier.
pub fn may_go_on(newest: &WindowRecord, (from, _): (i64, i64), now: Timestamp) -> bool {
    let day = |time: Timestamp| time.as_millisecond().div_euclid(DAY);
    day(newest.uploaded_at) == day(now)
        && (newest.from_ms..=newest.to_ms).contains(&from)
        && from - newest.from_ms <= DAY
}

/// Lays an upload over what was found.
///
/// # Errors
/// Where something that was found is not what was written.
pub fn lay(arriving: &Arriving, found: &Found) -> Result<Laid, ServiceError> {
    let (window, from) = (&arriving.window, arriving.window.from());
    let mut shares = Vec::new();
    let mut days = Vec::new();
    // Both windows as one, as long as the upload goes on with the newest.
    let mut both = found
        .newest
        .as_ref()
        .filter(|(_, newest)| newest.iter().all(|share| window.series(&share.channel).is_some()));
    let (mut whole, mut joined, mut overlaps) = (Vec::new(), Vec::new(), false);
    for series in window.iter() {
        let channel = series.channel();
        let mut view = found.days.view(channel)?;
        let share = view.share(series).map_err(fault)?;
        if let Some((_, newest)) = both {
            let newest = newest.iter().find(|share| share.channel == channel);
            let newest = newest.map(PackedShare::decode).transpose()?.unwrap_or_default();
            if goes_on(&view, &newest, &share, from).map_err(fault)? {
                overlaps |= !share.repeats.is_empty();
                whole.extend(view.content(&newest).map_err(fault)?);
                joined.push((channel, newest.and(&share).map_err(fault)?));
            } else {
                both = None;
            }
        }
        if let Some(own) = &share.own {
            view.put(own, ARRIVING);
        }
        days.extend(DaysChange::touched(channel, &view, &share)?);
        shares.push((channel, share));
    }
    let is_silent = shares.iter().all(|(_, share)| share.own.is_none());
    let (shares, place) = match both.filter(|_| overlaps) {
        Some((newest, _)) => (joined, go_on(newest, arriving, whole)?),
        None => (shares, new(arriving)?),
    };
    let pack = |(channel, share): &(&str, WindowShare)| PackedShare::new(channel, share);
    let shares = shares.iter().map(pack).collect::<Result<_, _>>()?;
    Ok(Laid { shares, days, place, is_silent })
}

fn new(arriving: &Arriving) -> Result<UploadPlace, ServiceError> {
    let report = text(&arriving.report)?;
    Ok(UploadPlace::New { from_ms: arriving.window.from(), to_ms: arriving.window.to(), report })
}

/// The newest window and an upload that goes on with it as one; `whole` is all that the window had.
fn go_on(
    newest: &WindowRecord,
    arriving: &Arriving,
    whole: Vec<Series>,
) -> Result<UploadPlace, ServiceError> {
    let both = match whole.is_empty() {
        true => arriving.window.clone(),
        false => {
            let whole = Window::from_series(whole).map_err(ServiceError::Faults)?;
            Window::stitch(&[whole, arriving.window.clone()]).map_err(ServiceError::Faults)?
        }
    };
    let earlier: WindowReport = serde_json::from_value(newest.report.clone())
        .map_err(|error| ServiceError::Internal(error.to_string()))?;
    let times = arriving.window.iter().flat_map(Series::times).filter(|time| **time > newest.to_ms);
    let later: BTreeSet<&i64> = times.collect();
    let report = text(&earlier.going_on(arriving.report.clone(), &both, later.len()))?;
    Ok(UploadPlace::GoesOn { window: newest.clone(), to_ms: both.to(), report })
}

/// Lays open posts of one window into the days, newest last.
///
/// # Errors
/// Where something that was kept is not what was written.
pub fn lay_open(open: &Open) -> Result<LaidIn, ServiceError> {
    let mut arriving: BTreeMap<&str, Vec<&Series>> = BTreeMap::new();
    for series in &open.rows {
        arriving.entry(series.channel()).or_default().push(series);
    }
    let (mut shares, mut days, mut whole) = (Vec::new(), Vec::new(), Vec::new());
    for share in open.shares.iter().filter(|share| !arriving.contains_key(share.channel.as_str())) {
        whole.extend(share.decode()?.own);
    }
    for (channel, rows) in arriving {
        let mut view = open.days.view(channel)?;
        for series in &rows {
            view.put(series, open.window.sequence);
        }
        let newer = merged(&rows.iter().map(|series| Some((*series).clone())).collect::<Vec<_>>());
        let newer = WindowShare { own: newer.map_err(fault)?, repeats: Vec::new() };
        days.extend(DaysChange::touched(channel, &view, &newer)?);
        let earlier = open.shares.iter().find(|share| share.channel == channel);
        let earlier = earlier.map(PackedShare::decode).transpose()?.unwrap_or_default();
        let both = earlier.and(&newer).map_err(fault)?;
        whole.extend(both.own.clone());
        shares.push(PackedShare::new(channel, &both)?);
    }
    let whole = Window::from_series(whole).map_err(ServiceError::Faults)?;
    Ok(LaidIn { shares, report: text(&WindowReport::of(&whole))?, days })
}

/// Takes a window out of its place among those that lie over each other, and lays it on top of them again
/// where that is asked for. What it gives then comes apart from what follows for the others.
///
/// # Errors
/// Where something of the stack is not what was written.
pub fn take_out(
    stack: &Stack,
    window: &WindowRecord,
    to_the_top: bool,
) -> Result<(Vec<PackedShare>, Rebuilt), ServiceError> {
    let span = whole_days((window.from_ms, window.to_ms));
    let to = to_the_top.then_some(ARRIVING);
    let (mut own, mut rebuilt) = (Vec::new(), Rebuilt::default());
    let channels = stack.windows.iter().filter(|one| one.sequence == window.sequence);
    for channel in channels.flat_map(|one| &one.shares).map(|share| &share.channel) {
        let mut shares = Vec::new();
        for one in &stack.windows {
            if let Some(share) = one.shares.iter().find(|share| share.channel == *channel) {
                shares.push((one.sequence, share.decode()?));
            }
        }
        let parts: Vec<(i64, WindowShare)> =
            shares.iter().map(|(number, share)| (*number, share.within(span.0, span.1))).collect();
        let replayed = replay(channel, &parts, window.sequence, to).map_err(fault)?;
        for (number, part) in &replayed.shares {
            if *number == ARRIVING {
                own.push(PackedShare::new(channel, part)?);
                continue;
            }
            let Some((_, share)) = shares.iter().find(|(known, _)| known == number) else { continue };
            let changed = share.with_part(span, part).map_err(fault)?;
            let Some(one) = stack.windows.iter().find(|one| one.sequence == *number) else { continue };
            if changed != *share {
                rebuilt.shares.push((one.id.clone(), PackedShare::new(channel, &changed)?));
            }
        }
        rebuilt.days.push(DaysChange::between(channel, &replayed.view, span)?);
    }
    Ok((own, rebuilt))
}

fn fault(fault: Fault) -> ServiceError {
    ServiceError::Faults(vec![fault])
}

/// A report as it is kept.
///
/// # Errors
/// Where it cannot be written.
pub fn text(report: &WindowReport) -> Result<String, ServiceError> {
    serde_json::to_string(report).map_err(|error| ServiceError::Internal(error.to_string()))
}
