//! What counts of a channel where several windows have samples of it, and who gave it: the newest window
//! wins, time by time.
//!
//! A window that only repeats what counts already gives nothing. What it gave, and where it repeated what lay
//! below it, is its [`WindowShare`]; the two together are all that it had.

use super::channel::Hold;
use super::duration::DAY;
use super::series::Series;
use super::window::merge;
use crate::fault::Fault;
use std::ops::Range;

/// The samples of one channel that count, each with the number of the window that gave it. A newer window has
/// a larger number. Values stay in the units in which they came.
#[derive(Debug, Clone, PartialEq)]
pub struct ChannelView {
    channel: String,
    hold: Hold,
    units: Vec<String>,
    samples: Vec<Sample>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Sample {
    time: i64,
    value: f64,
    /// Its place in `units`.
    unit: usize,
    owner: i64,
}

/// Samples of a view that have one unit.
#[derive(Debug, Clone, PartialEq)]
pub struct Layer {
    /// The samples.
    pub series: Series,
    /// Which window gave how many samples, one stretch after the other.
    pub owners: Vec<(i64, usize)>,
}

/// What one window is to the view of a channel at the moment at which it comes.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct WindowShare {
    /// The samples that it gives: new ones, and others than those that counted until then.
    pub own: Option<Series>,
    /// Stretches of time, both ends included, in which it had just what counted until then.
    pub repeats: Vec<(i64, i64)>,
}

impl Layer {
    /// The number of the newest window that gave a sample.
    fn newest(&self) -> i64 {
        self.owners.iter().map(|(owner, _)| *owner).max().unwrap_or(i64::MIN)
    }
}

impl ChannelView {
    /// A channel of which there is nothing yet.
    pub fn empty(channel: &str) -> Self {
        Self { channel: channel.to_owned(), hold: Hold::Linear, units: Vec::new(), samples: Vec::new() }
    }

    /// The view of a channel from what [`ChannelView::layers`] made of it, or of pieces of it.
    ///
    /// # Errors
    /// A fault where a layer is of another channel, its owners are not as many as its samples, or two layers
    /// have a sample at the same time.
    pub fn of_layers<'a>(
        channel: &str,
        layers: impl Iterator<Item = &'a Layer> + Clone,
    ) -> Result<Self, Fault> {
        let broken = |detail| Fault::new(format!("/values/{channel}"), "broken-view", detail);
        let mut view = Self::empty(channel);
        for layer in layers.clone() {
            let counted: usize = layer.owners.iter().map(|(_, count)| *count).sum();
            if layer.series.channel() != channel || counted != layer.series.len() {
                return Err(broken("the samples of a layer are not those of its owners"));
            }
            let unit = view.unit(layer.series.unit());
            let owners = layer.owners.iter().flat_map(|(owner, count)| std::iter::repeat_n(*owner, *count));
            let samples = layer.series.samples().zip(owners);
            view.samples.extend(samples.map(|((time, value), owner)| Sample { time, value, unit, owner }));
        }
        view.samples.sort_by_key(|sample| sample.time);
        if view.samples.windows(2).any(|pair| pair[0].time == pair[1].time) {
            return Err(broken("two samples have the same time"));
        }
        if let Some(newest) = layers.max_by_key(|layer| layer.newest()) {
            view.hold = newest.series.hold();
        }
        Ok(view)
    }

    /// The samples between two instants, both included, by their units; the one with the newest sample is
    /// the last.
    ///
    /// # Errors
    /// A fault where the samples are no series.
    pub fn layers(&self, from: i64, to: i64) -> Result<Vec<Layer>, Fault> {
        let mut layers = Vec::new();
        for (unit, name) in self.units.iter().enumerate() {
            let samples = || self.samples[self.between(from, to)].iter().filter(|sample| sample.unit == unit);
            let mut owners: Vec<(i64, usize)> = Vec::new();
            for sample in samples() {
                match owners.last_mut() {
                    Some((owner, count)) if *owner == sample.owner => *count += 1,
                    _ => owners.push((sample.owner, 1)),
                }
            }
            if !owners.is_empty() {
                let (times, values) = samples().map(|sample| (sample.time, sample.value)).unzip();
                layers.push(Layer {
                    series: Series::new(&self.channel, name, self.hold, times, values)?,
                    owners,
                });
            }
        }
        layers.sort_by_key(Layer::newest);
        Ok(layers)
    }

    /// The layers of each day, counted from 1970, from the first to the last of them.
    ///
    /// # Errors
    /// A fault where the samples are no series.
    pub fn days(&self, (first, last): (i64, i64)) -> Result<Vec<(i64, Layer)>, Fault> {
        let mut all = Vec::new();
        let mut rest = self.between(first * DAY, last * DAY + DAY - 1);
        while let Some(sample) = self.samples[rest.clone()].first() {
            let day = sample.time.div_euclid(DAY);
            let end = day * DAY + DAY - 1;
            all.extend(self.layers(day * DAY, end)?.into_iter().map(|layer| (day, layer)));
            rest.start = self.between(i64::MIN, end).end;
        }
        Ok(all)
    }

    /// All samples in the unit of the newest that was given; `None` where there are none.
    ///
    /// # Errors
    /// A fault where a unit does not convert.
    pub fn stitched(&self) -> Result<Option<Series>, Fault> {
        let layers = self.layers(i64::MIN, i64::MAX)?;
        if layers.is_empty() {
            return Ok(None);
        }
        merge(&layers.iter().map(|layer| &layer.series).collect::<Vec<_>>()).map(Some)
    }

    /// The number of the window that gave the sample at an instant, `None` where there is none.
    pub fn owner(&self, time: i64) -> Option<i64> {
        let index = self.samples.binary_search_by_key(&time, |sample| sample.time).ok()?;
        Some(self.samples[index].owner)
    }

    /// What a window with these samples would be to this view: a sample is repeated where its time, its unit
    /// and every bit of its value are those that count already.
    ///
    /// # Errors
    /// A fault where the samples are no series.
    pub fn share(&self, series: &Series) -> Result<WindowShare, Fault> {
        let unit = self.units.iter().position(|unit| unit == series.unit());
        let mut below = self.samples[self.between(series.from(), series.to())].iter().peekable();
        let (mut times, mut values, mut repeats) = (Vec::new(), Vec::new(), Vec::<(i64, i64)>::new());
        let mut goes_on = false;
        for (time, value) in series.samples() {
            // A stretch must not run over what the window does not have.
            while below.next_if(|sample| sample.time < time).is_some() {
                goes_on = false;
            }
            let counts = below.next_if(|sample| sample.time == time);
            let is_repeated = counts
                .is_some_and(|sample| Some(sample.unit) == unit && sample.value.to_bits() == value.to_bits());
            match repeats.last_mut() {
                Some(stretch) if is_repeated && goes_on => stretch.1 = time,
                _ if is_repeated => repeats.push((time, time)),
                _ => {
                    times.push(time);
                    values.push(value);
                }
            }
            goes_on = is_repeated || (goes_on && counts.is_none());
        }
        let own = match times.is_empty() {
            true => None,
            false => Some(Series::new(series.channel(), series.unit(), series.hold(), times, values)?),
        };
        Ok(WindowShare { own, repeats })
    }

    /// Lays the samples that a window gives over the others.
    pub fn put(&mut self, given: &Series, owner: i64) {
        let unit = self.unit(given.unit());
        self.hold = given.hold();
        let touched = self.between(given.from(), given.to());
        let mut older = self.samples[touched.clone()].iter().copied().peekable();
        let mut merged = Vec::with_capacity(older.len() + given.len());
        for (time, value) in given.samples() {
            while let Some(sample) = older.next_if(|sample| sample.time <= time) {
                if sample.time < time {
                    merged.push(sample);
                }
            }
            merged.push(Sample { time, value, unit, owner });
        }
        // The last sample given ends the stretch, so nothing older is left.
        self.samples.splice(touched, merged);
    }

    /// All that a window had whose share this is; `self` is what lay below it. `None` where that is nothing.
    ///
    /// # Errors
    /// A fault where the samples are no series.
    pub fn content(&self, share: &WindowShare) -> Result<Option<Series>, Fault> {
        let repeated = || {
            let stretch = |(from, to): &(i64, i64)| self.samples[self.between(*from, *to)].iter();
            share.repeats.iter().flat_map(stretch)
        };
        let Some(first) = repeated().next() else { return Ok(share.own.clone()) };
        let (times, values) = repeated().map(|sample| (sample.time, sample.value)).unzip();
        let repeated = Series::new(&self.channel, &self.units[first.unit], self.hold, times, values)?;
        match &share.own {
            None => Ok(Some(repeated)),
            Some(own) => merge(&[&repeated, own]).map(Some),
        }
    }

    fn between(&self, from: i64, to: i64) -> Range<usize> {
        let first = self.samples.partition_point(|sample| sample.time < from);
        let end = self.samples.partition_point(|sample| sample.time <= to);
        first..end.max(first)
    }

    fn unit(&mut self, name: &str) -> usize {
        self.units.iter().position(|unit| unit == name).unwrap_or_else(|| {
            self.units.push(name.to_owned());
            self.units.len() - 1
        })
    }
}

impl WindowShare {
    /// The part between two instants, both included.
    pub fn within(&self, from: i64, to: i64) -> WindowShare {
        let own = self.own.as_ref().and_then(|own| own.slice(from, to));
        let cut = |(start, end): &(i64, i64)| {
            let (start, end) = ((*start).max(from), (*end).min(to));
            (start <= end).then_some((start, end))
        };
        WindowShare { own, repeats: self.repeats.iter().filter_map(cut).collect() }
    }

    /// This share with another part between two instants, both included.
    ///
    /// # Errors
    /// A fault where the parts do not fit together.
    pub fn with_part(&self, (from, to): (i64, i64), part: &WindowShare) -> Result<WindowShare, Fault> {
        let before = self.within(i64::MIN, from.saturating_sub(1));
        let after = self.within(to.saturating_add(1), i64::MAX);
        Ok(WindowShare {
            own: merged(&[before.own, after.own, part.own.clone()])?,
            repeats: [before.repeats, part.repeats.clone(), after.repeats].concat(),
        })
    }

    /// This share of the newest window together with that of an upload on top of it.
    ///
    /// # Errors
    /// A fault where the two do not fit together.
    pub fn and(&self, newer: &WindowShare) -> Result<WindowShare, Fault> {
        let own = merged(&[self.own.clone(), newer.own.clone()])?;
        Ok(WindowShare { own, repeats: self.repeats.clone() })
    }
}

/// Those that are there as one, the last of which counts; `None` where none is.
///
/// # Errors
/// A fault where a unit does not convert.
pub fn merged(parts: &[Option<Series>]) -> Result<Option<Series>, Fault> {
    let parts: Vec<&Series> = parts.iter().filter_map(Option::as_ref).collect();
    if parts.is_empty() { Ok(None) } else { merge(&parts).map(Some) }
}

/// Whether an upload goes on with the newest window of a view: from `from` on it repeats every sample of that
/// window and none of any other, so that the two can be told as one. `newest` is the share of the window, and
/// `arriving` that of the upload.
///
/// # Errors
/// A fault where a share is not of this view.
pub fn goes_on(
    view: &ChannelView,
    newest: &WindowShare,
    arriving: &WindowShare,
    from: i64,
) -> Result<bool, Fault> {
    let had = view.content(newest)?;
    let repeated = view.content(&WindowShare { own: None, repeats: arriving.repeats.clone() })?;
    let unit = arriving.own.as_ref().map(Series::unit);
    let same_unit = had.as_ref().zip(unit).is_none_or(|(had, unit)| had.unit() == unit);
    Ok(same_unit && repeated == had.and_then(|had| had.slice(from, i64::MAX)))
}

/// A view and the shares of the windows that it is made of, after one of them has moved.
#[derive(Debug, Clone, PartialEq)]
pub struct Replayed {
    /// What counts now.
    pub view: ChannelView,
    /// The windows above the place that was left, with their shares now.
    pub shares: Vec<(i64, WindowShare)>,
}

/// Lays the windows of a channel one upon the other again, oldest first, without one of them or with that one
/// as the newest, under another number. `stack` has their numbers and shares; `to` is the other
/// number.
///
/// # Errors
/// A fault where the shares are not of this channel.
pub fn replay(
    channel: &str,
    stack: &[(i64, WindowShare)],
    moved: i64,
    to: Option<i64>,
) -> Result<Replayed, Fault> {
    let (mut before, mut view) = (ChannelView::empty(channel), ChannelView::empty(channel));
    let (mut shares, mut last) = (Vec::new(), None);
    for (number, share) in stack {
        let content = before.content(share)?;
        if let Some(own) = &share.own {
            before.put(own, *number);
        }
        match content {
            Some(content) if *number == moved => last = Some(content),
            Some(content) => {
                let share = lay(&mut view, &content, *number)?;
                if *number > moved {
                    shares.push((*number, share));
                }
            }
            None => {}
        }
    }
    if let Some((content, number)) = last.zip(to) {
        let share = lay(&mut view, &content, number)?;
        shares.push((number, share));
    }
    Ok(Replayed { view, shares })
}

/// Lays a window upon a view, and says what its share is.
///
/// # Errors
/// A fault where the samples are no series.
pub fn lay(view: &mut ChannelView, series: &Series, number: i64) -> Result<WindowShare, Fault> {
    let share = view.share(series)?;
    if let Some(own) = &share.own {
        view.put(own, number);
    }
    Ok(share)
}
