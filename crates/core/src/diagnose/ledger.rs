//! Evidence adds up: what the windows of a system show of one effect, each for itself and together.
//!
//! One window of two weeks shows an effect of the size of its noise. Windows that do not overlap are
//! independent of each other, so their t add up by Stouffer's sum and their sizes by inverse variance; Q and
//! I2 say whether it is one size at all (Higgins and Thompson 2002, Stat. Med. 21, 1539-1558).

use crate::data::read_time;
use crate::schema::Interval;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use statrs::distribution::{ChiSquared, ContinuousCDF};
use std::cmp::Reverse;
use utoipa::ToSchema;

/// Deviations on both sides that hold 95 of a hundred, and 99.
const Z95: f64 = 1.96;
const Z99: f64 = 2.58;
/// Only what stands out of a catalogue of some twenty effects can be taken back: of twenty, with the days of
/// a fortnight, one shows a t of 2.6 in every fourth room by chance, and one of 4 in one of seventy.
const STANDS_OUT: f64 = 4.0;
/// Below this pooled t an effect cannot be told from chance.
pub const CLEAR_T: f64 = 2.0;
/// From this I2 on most of what sizes differ by is no chance ("considerable" in the Cochrane Handbook).
const UNSTEADY: f64 = 0.75;

/// What segments of hours show of every effect that could be tried, named or not: one window of a ledger.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Looked {
    /// The first sample that was looked at.
    #[schema(format = DateTime)]
    pub from: String,
    /// The end of the last one.
    #[schema(format = DateTime)]
    pub to: String,
    /// Hours of a segment, the same in all windows.
    pub hours: f64,
    /// By effect.
    pub effects: Vec<EffectScore>,
}

/// What one window shows of one effect, over the hours at which effects are ranked.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct EffectScore {
    /// The effect's id.
    pub effect: String,
    /// Its size, as a change of its first parameter from where it does nothing.
    pub size: f64,
    /// The deviation of that size, robust by days.
    pub deviation: f64,
    /// The unit of both.
    pub unit: String,
    /// The share of the squared error over these hours that it explains.
    pub share: f64,
    /// The size of the whole effect over its deviation; negative where physics does not allow the sign.
    pub t: f64,
    /// The same beyond whatever happens at the same hours every day.
    pub beyond_clock: f64,
    /// Days that were looked at.
    pub days: usize,
    /// The share of shifts of its channels by whole days, itself counted, with which it does as well; `null`
    /// where no logged channel drives it, or where it explains too little to ask.
    pub shift_p: Option<f64>,
}

/// The stretch of time that a window looked at.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LookedSpan {
    /// Its first sample, milliseconds since 1970.
    pub from: i64,
    /// The end of its last sample.
    pub to: i64,
    /// Hours of a segment.
    pub hours: f64,
}

impl LookedSpan {
    fn overlaps(&self, other: &Self) -> bool {
        self.from < other.to && other.from < self.to
    }
}

/// What one window shows of one effect.
#[derive(Debug, Clone, PartialEq)]
pub struct LedgerEntry {
    /// The diagnosis that looked.
    pub diagnosis: String,
    /// The model that was diagnosed.
    pub model: String,
    /// Its content hash; where two differ, the windows speak of different models.
    pub model_hash: Option<String>,
    /// When it looked.
    pub span: LookedSpan,
    /// What it saw.
    pub score: EffectScore,
}

/// Why a window is listed and not added up with the others.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Apart {
    /// It shares samples with a newer window.
    Overlaps,
    /// The model has another content now.
    OtherModel,
    /// Its segments have another length.
    OtherHours,
    /// Its size has another unit.
    OtherUnit,
    /// It has no size, or one without a deviation.
    NoSize,
}

/// A window in the ledger of an effect.
#[derive(Debug, Clone, PartialEq)]
pub struct LedgerWindow {
    /// What it shows.
    pub entry: LedgerEntry,
    /// Why it is not added up; nothing where it is.
    pub apart: Option<Apart>,
}

/// All that the windows of a system show of one effect beyond one base model.
#[derive(Debug, Clone, PartialEq)]
pub struct Ledger {
    /// The effect's id.
    pub effect: String,
    /// The base model.
    pub model: String,
    /// Newest first.
    pub windows: Vec<LedgerWindow>,
    /// What they show together.
    pub pooled: Option<Pooled>,
}

/// What windows that do not overlap show together of one effect.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Pooled {
    /// How many windows were added up.
    pub windows: usize,
    /// The first sample of the oldest.
    #[schema(value_type = String, format = DateTime)]
    pub from: Timestamp,
    /// The end of the newest.
    #[schema(value_type = String, format = DateTime)]
    pub to: Timestamp,
    /// The sum of their t over the root of their number (Stouffer).
    pub t: f64,
    /// The same beyond whatever happens at the same hours every day.
    pub beyond_clock: f64,
    /// The mean size, each window weighted by the inverse of its variance.
    pub size: f64,
    /// The deviation of that mean, were it the same size in all windows.
    pub deviation: f64,
    /// Its 95 % interval.
    #[schema(value_type = Interval)]
    pub ci95: [f64; 2],
    /// The unit of size, deviation and interval.
    pub unit: String,
    /// Cochran's Q: squared distances from the mean, each over its variance.
    pub q: f64,
    /// The share of what the sizes differ by that is no chance; `null` for one window.
    pub i2: Option<f64>,
    /// The share of the squared error that it explains, windows weighted by their days.
    pub share: f64,
    /// The chances that a shifted channel does as well, of all windows that have one, by Fisher's sum of
    /// logarithms; `null` where none has. Shifts are counted, so what this says is on the safe side.
    pub shift_p: Option<f64>,
    /// For people.
    pub sentence: String,
    /// Where the newest window speaks against what the others have shown.
    pub taken_back: Option<TakenBack>,
}

/// Evidence that was clear and is contradicted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct TakenBack {
    /// The first sample of the window that contradicts.
    #[schema(value_type = String, format = DateTime)]
    pub from: Timestamp,
    /// How far its size is from that of the others, over the deviation of the difference.
    pub z: f64,
    /// For people.
    pub sentence: String,
}

impl Looked {
    /// When it looked; `None` where it is at no time, which could not be told from other windows.
    pub fn span(&self) -> Option<LookedSpan> {
        Some(LookedSpan {
            from: read_time("", &self.from).ok()?,
            to: read_time("", &self.to).ok()?,
            hours: self.hours,
        })
    }
}

/// What a window adds to the ledger of its system beside one model; effects without finite figures are left
/// out.
pub fn entries<'a>(
    span: LookedSpan,
    diagnosis: &str,
    (model, model_hash): (&str, Option<&str>),
    scores: impl Iterator<Item = &'a EffectScore>,
) -> Vec<LedgerEntry> {
    let entry = |score: &EffectScore| LedgerEntry {
        diagnosis: diagnosis.to_owned(),
        model: model.to_owned(),
        model_hash: model_hash.map(str::to_owned),
        span,
        score: score.clone(),
    };
    scores.filter(|score| is_finite(score)).map(entry).collect()
}

fn is_finite(score: &EffectScore) -> bool {
    let EffectScore { size, deviation, share, t, beyond_clock, .. } = score;
    [size, deviation, share, t, beyond_clock]
        .into_iter()
        .chain(&score.shift_p)
        .all(|figure| figure.is_finite())
}

/// Those of some entries that speak of a model with this content. Windows that were judged beside another
/// content speak of something else.
pub fn beside(entries: &[LedgerEntry], model: &str, hash: &str) -> Vec<LedgerEntry> {
    let is_same = |entry: &&LedgerEntry| {
        entry.model == model && entry.model_hash.as_ref().is_none_or(|known| known == hash)
    };
    entries.iter().filter(is_same).cloned().collect()
}

/// The ledgers of a system, by effect and base model, the most telling first. Entries stand in the order in
/// which they were made.
pub fn ledgers(entries: &[LedgerEntry]) -> Vec<Ledger> {
    let mut names: Vec<(&str, &str)> =
        entries.iter().map(|entry| (entry.score.effect.as_str(), entry.model.as_str())).collect();
    names.sort_unstable();
    names.dedup();
    let ledger = |(effect, model): (&str, &str)| {
        let windows =
            newest_first(entries.iter().filter(|entry| entry.score.effect == effect && entry.model == model));
        let apart = chosen(&windows);
        Ledger {
            effect: effect.to_owned(),
            model: model.to_owned(),
            pooled: pooled(&added(&windows, &apart)),
            windows: windows
                .into_iter()
                .zip(apart)
                .map(|(entry, apart)| LedgerWindow { entry: entry.clone(), apart })
                .collect(),
        }
    };
    let mut all: Vec<Ledger> = names.into_iter().map(ledger).collect();
    let weight = |ledger: &Ledger| ledger.pooled.as_ref().map_or(0.0, |pooled| pooled.t.abs());
    all.sort_by(|one, other| weight(other).total_cmp(&weight(one)));
    all
}

/// What a window shows together with earlier ones of the same base model, whatever else they tell of; nothing
/// where it has no size. Earlier windows that overlap it are not added.
pub fn pooled_with(earlier: &[LedgerEntry], now: &EffectScore, span: LookedSpan) -> Option<Pooled> {
    let own = LedgerEntry {
        diagnosis: String::new(),
        model: String::new(),
        model_hash: None,
        span,
        score: now.clone(),
    };
    let mut windows = newest_first(earlier.iter().filter(|entry| entry.score.effect == now.effect));
    windows.insert(0, &own);
    let apart = chosen(&windows);
    if apart[0].is_some() { None } else { pooled(&added(&windows, &apart)) }
}

/// Those that end last come first; of equal windows those that were looked at last.
fn newest_first<'a>(entries: impl DoubleEndedIterator<Item = &'a LedgerEntry>) -> Vec<&'a LedgerEntry> {
    let mut windows: Vec<&LedgerEntry> = entries.rev().collect();
    windows.sort_by_key(|entry| Reverse(entry.span.to));
    windows
}

/// Which windows can be added to the first, in this order, and why the others cannot.
fn chosen<'a>(windows: &[&'a LedgerEntry]) -> Vec<Option<Apart>> {
    let mut taken: Vec<&LedgerEntry> = Vec::new();
    let judge = |entry: &&'a LedgerEntry| {
        let first = windows[0];
        let hashes = entry.model_hash.as_ref().zip(first.model_hash.as_ref());
        if !is_finite(&entry.score) || entry.score.deviation <= 0.0 {
            Some(Apart::NoSize)
        } else if hashes.is_some_and(|(one, other)| one != other) {
            Some(Apart::OtherModel)
        } else if entry.span.hours != first.span.hours {
            Some(Apart::OtherHours)
        } else if entry.score.unit != first.score.unit {
            Some(Apart::OtherUnit)
        } else if taken.iter().any(|one| one.span.overlaps(&entry.span)) {
            Some(Apart::Overlaps)
        } else {
            taken.push(entry);
            None
        }
    };
    windows.iter().map(judge).collect()
}

fn added<'a>(windows: &[&'a LedgerEntry], apart: &[Option<Apart>]) -> Vec<&'a LedgerEntry> {
    windows.iter().zip(apart).filter(|(_, apart)| apart.is_none()).map(|(entry, _)| *entry).collect()
}

/// A size that several windows agree on, by inverse variance, with its deviation.
#[derive(Debug, Clone, Copy)]
struct Mean {
    size: f64,
    deviation: f64,
}

impl Mean {
    fn of(windows: &[&LedgerEntry]) -> Self {
        let weight = |entry: &&LedgerEntry| entry.score.deviation.powi(-2);
        let total: f64 = windows.iter().map(weight).sum();
        let size = windows.iter().map(|entry| weight(entry) * entry.score.size).sum::<f64>() / total;
        Self { size, deviation: total.sqrt().recip() }
    }

    /// Its digits are those that its interval leaves meaning.
    fn in_words(self, unit: &str) -> String {
        let half = Z95 * self.deviation;
        let digits = (1.0 - half.log10().floor()).clamp(0.0, 9.0) as usize;
        format!("{:.digits$} ± {half:.digits$} {unit}", self.size)
    }
}

/// Stouffer's sum.
fn stouffer(windows: &[&LedgerEntry], t: impl Fn(&EffectScore) -> f64) -> f64 {
    windows.iter().map(|entry| t(&entry.score)).sum::<f64>() / (windows.len() as f64).sqrt()
}

/// What windows show together; nothing of none.
fn pooled(windows: &[&LedgerEntry]) -> Option<Pooled> {
    let from = windows.iter().map(|entry| entry.span.from).min().and_then(instant)?;
    let to = windows.iter().map(|entry| entry.span.to).max().and_then(instant)?;
    let mean = Mean::of(windows);
    let q: f64 =
        windows.iter().map(|entry| ((entry.score.size - mean.size) / entry.score.deviation).powi(2)).sum();
    let freedom = (windows.len() - 1) as f64;
    let days: f64 = windows.iter().map(|entry| entry.score.days as f64).sum();
    let mut pooled = Pooled {
        windows: windows.len(),
        from,
        to,
        t: stouffer(windows, |score| score.t),
        beyond_clock: stouffer(windows, |score| score.beyond_clock),
        size: mean.size,
        deviation: mean.deviation,
        ci95: [mean.size - Z95 * mean.deviation, mean.size + Z95 * mean.deviation],
        unit: windows[0].score.unit.clone(),
        q,
        i2: (freedom > 0.0).then(|| if q > freedom { (q - freedom) / q } else { 0.0 }),
        share: windows.iter().map(|entry| entry.score.days as f64 * entry.score.share).sum::<f64>()
            / days.max(1.0),
        shift_p: fisher(windows.iter().filter_map(|entry| entry.score.shift_p)),
        sentence: String::new(),
        taken_back: taken_back(windows),
    };
    pooled.sentence = sentence(&pooled, windows);
    Some(pooled)
}

/// One chance for several, each uniform where nothing is there: minus twice the sum of their logarithms
/// follows chi squared with two degrees of freedom for each (Fisher 1932).
fn fisher(chances: impl Iterator<Item = f64>) -> Option<f64> {
    let (count, sum) = chances
        .fold((0_u32, 0.0), |(count, sum), p| (count + 1, sum - 2.0 * p.clamp(f64::MIN_POSITIVE, 1.0).ln()));
    ChiSquared::new(2.0 * f64::from(count)).ok().map(|chi| chi.sf(sum))
}

/// Whether the newest window contradicts the others: they are clear, it shows nothing or the opposite, and
/// that is no chance.
fn taken_back(windows: &[&LedgerEntry]) -> Option<TakenBack> {
    let newest = windows.iter().max_by_key(|entry| entry.span.to)?;
    let others: Vec<&LedgerEntry> =
        windows.iter().copied().filter(|entry| entry.span != newest.span).collect();
    if others.is_empty() || stouffer(&others, |score| score.t) < STANDS_OUT {
        return None;
    }
    let (before, now) = (Mean::of(&others), Mean::of(&[newest]));
    let supports = now.size * before.size > 0.0 && now.size.abs() > Z95 * now.deviation;
    let z = (now.size - before.size) / now.deviation.hypot(before.deviation);
    if supports || z.abs() <= Z99 {
        return None;
    }
    let unit = &newest.score.unit;
    let sentence = format!(
        "The newest window, {} to {}, speaks against it: its size is {} there and {} in {} before (z \
        {z:.1}).",
        day(newest.span.from),
        day(newest.span.to),
        now.in_words(unit),
        before.in_words(unit),
        counted(others.len()),
    );
    Some(TakenBack { from: instant(newest.span.from)?, z, sentence })
}

/// What windows show together, for people.
fn sentence(pooled: &Pooled, windows: &[&LedgerEntry]) -> String {
    let since = windows.iter().map(|entry| entry.span.from).min().map(day).unwrap_or_default();
    let same = windows.iter().filter(|entry| entry.score.size * pooled.size > 0.0).count();
    let signs = match (same, pooled.windows) {
        (_, 1) => String::new(),
        (same, all) if same == all => ", always with the same sign".to_owned(),
        (same, all) => format!(", with the same sign in {same} of {all}"),
    };
    let shows = if pooled.t <= -CLEAR_T {
        "the data ask for it with a sign that physics does not allow".to_owned()
    } else if pooled.t < CLEAR_T {
        "it cannot be told from chance".to_owned()
    } else {
        format!(
            "it explains {:.0} % of the error {:.0} h ahead{signs}",
            100.0 * pooled.share,
            windows[0].span.hours
        )
    };
    let mean = Mean { size: pooled.size, deviation: pooled.deviation };
    let name = if pooled.windows == 1 { "t" } else { "pooled t" };
    let spread = pooled.i2.map(|i2| format!("; I2 {:.0} %", 100.0 * i2)).unwrap_or_default();
    let unsteady = if pooled.i2.is_some_and(|i2| i2 >= UNSTEADY) {
        "; its size differs from window to window"
    } else {
        ""
    };
    format!(
        "In {} since {since} {shows} ({name} {:.1}, size {}{spread}){unsteady}.",
        counted(pooled.windows),
        pooled.t,
        mean.in_words(&pooled.unit)
    )
}

fn counted(windows: usize) -> String {
    if windows == 1 { "one window".to_owned() } else { format!("{windows} windows") }
}

fn instant(millis: i64) -> Option<Timestamp> {
    Timestamp::from_millisecond(millis).ok()
}

/// A day of the world's time, such as `12 January 2016`.
fn day(millis: i64) -> String {
    instant(millis).map(|at| at.strftime("%-d %B %Y").to_string()).unwrap_or_default()
}
