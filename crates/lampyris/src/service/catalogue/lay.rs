//! Lays an upload over what counts, and takes windows out of their place. All of it is work for a blocking
//! thread.

use crate::service::error::ServiceError;
use crate::store::days::{ARRIVING, DaysChange, NewDay, whole_days};
use crate::store::samples::{LaidIn, Open};
use crate::store::shares::PackedShares;
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
    pub shares: PackedShares,
    /// The days in which it does.
    pub days: Vec<NewDay>,
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
    let mut shares = BTreeMap::new();
    let mut days = DaysChange::default();
    // Both windows as one, as long as the upload goes on with the newest.
    let newest =
        found.newest.as_ref().map(|(newest, shares)| Ok::<_, ServiceError>((newest, shares.decode()?)));
    let mut both = newest
        .transpose()?
        .filter(|(_, newest)| newest.keys().all(|channel| window.series(channel).is_some()));
    let (mut whole, mut joined, mut overlaps) = (Vec::new(), BTreeMap::new(), false);
    for series in window.iter() {
        let channel = series.channel();
        let mut view = found.days.view(channel)?;
        let share = view.share(series).map_err(fault)?;
        if let Some((_, newest)) = &both {
            let newest = newest.get(channel).cloned().unwrap_or_default();
            if goes_on(&view, &newest, &share, from).map_err(fault)? {
                overlaps |= !share.repeats.is_empty();
                whole.extend(view.content(&newest).map_err(fault)?);
                joined.insert(channel.to_owned(), newest.and(&share).map_err(fault)?);
            } else {
                both = None;
            }
        }
        if let Some(own) = &share.own {
            view.put(own, ARRIVING);
        }
        days.touch(channel, &view, &share)?;
        shares.insert(channel.to_owned(), share);
    }
    let is_silent = shares.values().all(|share| share.own.is_none());
    let (shares, place) = match both.filter(|_| overlaps) {
        Some((newest, _)) => (joined, go_on(newest, arriving, whole)?),
        None => (shares, new(arriving)),
    };
    Ok(Laid { shares: PackedShares::new(shares)?, days: days.over(&found.days)?, place, is_silent })
}

fn new(arriving: &Arriving) -> UploadPlace {
    let report = arriving.report.clone();
    UploadPlace::New { from_ms: arriving.window.from(), to_ms: arriving.window.to(), report }
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
    let report = earlier.going_on(arriving.report.clone(), &both, later.len());
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
    let mut shares = open.shares.as_ref().map(PackedShares::decode).transpose()?.unwrap_or_default();
    let mut days = DaysChange::default();
    for (channel, rows) in arriving {
        let mut view = open.days.view(channel)?;
        for series in &rows {
            view.put(series, open.window.sequence);
        }
        let newer = merged(&rows.iter().map(|series| Some((*series).clone())).collect::<Vec<_>>());
        let newer = WindowShare { own: newer.map_err(fault)?, repeats: Vec::new() };
        days.touch(channel, &view, &newer)?;
        let earlier = shares.remove(channel).unwrap_or_default();
        shares.insert(channel.to_owned(), earlier.and(&newer).map_err(fault)?);
    }
    let whole = shares.values().filter_map(|share| share.own.clone()).collect();
    let report = WindowReport::of(&Window::from_series(whole).map_err(ServiceError::Faults)?);
    Ok(LaidIn { shares: PackedShares::new(shares)?, report, days: days.over(&open.days)? })
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
) -> Result<(PackedShares, Rebuilt), ServiceError> {
    let span = whole_days((window.from_ms, window.to_ms));
    let to = to_the_top.then_some(ARRIVING);
    let (mut own, mut days) = (BTreeMap::new(), DaysChange::default());
    let decoded = stack.windows.iter().map(|one| Ok((one.sequence, (one.id.clone(), one.shares.decode()?))));
    let mut all: BTreeMap<i64, (String, BTreeMap<String, WindowShare>)> =
        decoded.collect::<Result<_, ServiceError>>()?;
    let channels: Vec<String> =
        all.get(&window.sequence).into_iter().flat_map(|(_, shares)| shares.keys().cloned()).collect();
    let mut changed = BTreeSet::new();
    for channel in channels {
        let part = |(number, (_, shares)): (&i64, &(String, BTreeMap<String, WindowShare>))| {
            Some((*number, shares.get(&channel)?.within(span.0, span.1)))
        };
        let parts: Vec<(i64, WindowShare)> = all.iter().filter_map(part).collect();
        let replayed = replay(&channel, &parts, window.sequence, to).map_err(fault)?;
        days.cover(&channel, &replayed.view, span)?;
        for (number, part) in replayed.shares {
            if number == ARRIVING {
                own.insert(channel.clone(), part);
            } else if let Some(share) = all.get_mut(&number).and_then(|(_, shares)| shares.get_mut(&channel))
            {
                let whole = share.with_part(span, &part).map_err(fault)?;
                if whole != *share {
                    *share = whole;
                    changed.insert(number);
                }
            }
        }
    }
    let rebuilt = all.into_iter().filter(|(number, _)| changed.contains(number));
    let shares = rebuilt.map(|(_, (id, shares))| Ok((id, PackedShares::new(shares)?)));
    let rebuilt =
        Rebuilt { shares: shares.collect::<Result<_, ServiceError>>()?, days: days.over(&stack.days)? };
    Ok((PackedShares::new(own)?, rebuilt))
}

fn fault(fault: Fault) -> ServiceError {
    ServiceError::Faults(vec![fault])
}
