//! Views and shares beside a naive model that keeps every window whole.

use super::view::{ChannelView, Layer, WindowShare, goes_on, lay, replay};
use super::{Hold, Series};
use proptest::prelude::{Just, Strategy, any, prop_oneof, proptest};
use proptest::test_runner::TestCaseResult;
use proptest::{prop_assert, prop_assert_eq};

const CHANNEL: &str = "meter";
/// Days of ten seconds, so that few samples make many of them.
const DAY: i64 = 10;

fn series(unit: &str, samples: &[(i64, f64)]) -> Series {
    let (times, values) = samples.iter().copied().unzip();
    Series::new(CHANNEL, unit, Hold::Linear, times, values).unwrap()
}

fn view_of(windows: &[Series]) -> ChannelView {
    let mut view = ChannelView::empty(CHANNEL);
    for (number, window) in (1..).zip(windows) {
        lay(&mut view, window, number).unwrap();
    }
    view
}

#[test]
fn a_window_gives_what_is_new_and_repeats_the_rest() {
    let mut view = view_of(&[series("kW", &[(0, 1.0), (10, 2.0), (20, 3.0), (30, 4.0)])]);
    // 10 is another value, 15 is new between two that are repeated, 30 is left out.
    let second = series("kW", &[(0, 1.0), (10, 5.0), (15, 6.0), (20, 3.0), (40, 7.0)]);
    let share = view.share(&second).unwrap();
    assert_eq!(share.own.as_ref().unwrap().times(), [10, 15, 40]);
    assert_eq!(share.repeats, [(0, 0), (20, 20)]);
    assert_eq!(view.content(&share).unwrap(), Some(second.clone()));
    view.put(share.own.as_ref().unwrap(), 2);
    assert_eq!([0, 10, 15, 20, 30, 40].map(|time| view.owner(time)), [1, 2, 2, 1, 1, 2].map(Some));
    assert_eq!(view.stitched().unwrap().unwrap().values(), [1.0, 5.0, 6.0, 3.0, 4.0, 7.0]);
    // The same numbers in another unit are others, and the newest unit is that of the whole.
    let share = lay(&mut view, &series("W", &[(0, 1.0)]), 3).unwrap();
    assert_eq!((share.own.map(|own| own.len()), share.repeats), (Some(1), vec![]));
    let stitched = view.stitched().unwrap().unwrap();
    assert_eq!((stitched.unit(), &stitched.values()[..2]), ("W", &[1.0, 5_000.0][..]));
}

#[test]
fn a_rolling_upload_goes_on_with_the_one_before() {
    let first = series("kW", &[(0, 1.0), (10, 2.0), (20, 3.0)]);
    let mut view = view_of(&[series("kW", &[(5, 9.0)]), first.clone()]);
    let newest = WindowShare { own: Some(first), repeats: vec![] };
    let goes = |samples: &[(i64, f64)]| {
        let arriving = view.share(&series("kW", samples)).unwrap();
        goes_on(&view, &newest, &arriving, samples[0].0).unwrap()
    };
    assert!(goes(&[(10, 2.0), (20, 3.0), (30, 4.0)]));
    assert!(goes(&[(10, 2.0), (15, 8.0), (20, 3.0)]), "a sample that comes late");
    assert!(!goes(&[(10, 2.0), (30, 4.0)]), "it does not have 20");
    assert!(!goes(&[(10, 2.5), (20, 3.0), (30, 4.0)]), "it has another value at 10");
    assert!(!goes(&[(0, 1.0), (5, 9.0), (10, 2.0), (20, 3.0)]), "it repeats an older window, too");
    let arriving = view.share(&series("kW", &[(20, 3.0), (30, 4.0)])).unwrap();
    let both = newest.and(&arriving).unwrap();
    view.put(arriving.own.as_ref().unwrap(), 2);
    assert_eq!(view.content(&both).unwrap().unwrap().times(), [0, 10, 20, 30]);
}

#[test]
fn what_is_no_view_is_refused() {
    let layer = |samples: &[(i64, f64)], owners: &[(i64, usize)]| Layer {
        series: series("kW", samples),
        owners: owners.to_vec(),
    };
    let whole = layer(&[(0, 1.0), (1, 2.0)], &[(1, 1), (2, 1)]);
    assert!(ChannelView::of_layers(CHANNEL, [&whole].into_iter()).is_ok());
    assert!(ChannelView::of_layers("other", [&whole].into_iter()).is_err());
    assert!(ChannelView::of_layers(CHANNEL, [layer(&[(0, 1.0), (1, 2.0)], &[(1, 1)])].iter()).is_err());
    assert!(ChannelView::of_layers(CHANNEL, [whole, layer(&[(1, 1.0)], &[(3, 1)])].iter()).is_err());
}

/// What the store keeps of a channel, and beside it every window as it came.
#[derive(Default)]
struct Both {
    next: i64,
    stack: Vec<(i64, WindowShare)>,
    layers: Vec<Layer>,
    whole: Vec<(i64, Series)>,
}

#[derive(Debug, Clone)]
enum Deed {
    Upload {
        unit: &'static str,
        samples: Vec<(i64, f64)>,
    },
    /// Goes on with the newest window from a part of it on.
    Roll {
        keep: usize,
        more: usize,
    },
    /// Sends what one window shows once more, under another name.
    Repeat(usize),
    Delete(usize),
    Raise(usize),
}

impl Both {
    fn view(&self) -> ChannelView {
        ChannelView::of_layers(CHANNEL, self.layers.iter()).unwrap()
    }

    /// A view as the store keeps it.
    fn by_days(view: &ChannelView) -> Vec<Layer> {
        let day = |day: i64| view.layers(day * DAY, day * DAY + DAY - 1).unwrap();
        (-20..60).flat_map(day).collect()
    }

    fn upload(&mut self, window: Series) {
        let mut view = self.view();
        self.next += 1;
        let share = lay(&mut view, &window, self.next).unwrap();
        self.layers = Self::by_days(&view);
        self.stack.push((self.next, share));
        self.whole.push((self.next, window));
    }

    fn roll(&mut self, keep: usize, more: usize) {
        let Some((number, had)) = self.whole.last().cloned() else { return };
        let from = had.times()[keep % had.len()];
        let mut samples: Vec<(i64, f64)> = had.slice(from, i64::MAX).unwrap().samples().collect();
        samples.extend((1..=more as i64).map(|step| (had.to() + 3 * step, step as f64)));
        let window = series(had.unit(), &samples);
        let mut view = self.view();
        let newest = self.stack.last().unwrap().1.clone();
        let arriving = view.share(&window).unwrap();
        if !goes_on(&view, &newest, &arriving, from).unwrap() {
            // It repeats something of an older window by chance.
            return self.upload(window);
        }
        if let Some(own) = &arriving.own {
            view.put(own, number);
        }
        self.layers = Self::by_days(&view);
        self.stack.last_mut().unwrap().1 = newest.and(&arriving).unwrap();
        let later = samples.iter().copied().filter(|(time, _)| *time > had.to());
        let both: Vec<(i64, f64)> = had.samples().chain(later).collect();
        self.whole.last_mut().unwrap().1 = series(had.unit(), &both);
    }

    /// Takes a window out of its place, within the days that it touches, and lays it on top where that is
    /// asked for.
    fn shift(&mut self, index: usize, raise: bool) {
        if self.whole.is_empty() {
            return;
        }
        let (moved, window) = self.whole.remove(index % self.whole.len());
        let range = (window.from().div_euclid(DAY) * DAY, window.to().div_euclid(DAY) * DAY + DAY - 1);
        let to = raise.then(|| {
            self.next += 1;
            self.next
        });
        let parts: Vec<(i64, WindowShare)> =
            self.stack.iter().map(|(number, share)| (*number, share.within(range.0, range.1))).collect();
        let replayed = replay(CHANNEL, &parts, moved, to).unwrap();
        self.stack.retain(|(number, _)| *number != moved);
        if let Some(to) = to {
            self.stack.push((to, WindowShare::default()));
            self.whole.push((to, window));
        }
        for (number, part) in &replayed.shares {
            let share = &mut self.stack.iter_mut().find(|(known, _)| known == number).unwrap().1;
            *share = share.with_part(range, part).unwrap();
        }
        self.layers.retain(|layer| !(range.0..=range.1).contains(&layer.series.from()));
        self.layers.extend(Self::by_days(&replayed.view));
    }

    fn check(&self) -> TestCaseResult {
        let view = self.view();
        let at = |series: &Series, time: i64| {
            let index = series.times().binary_search(&time).ok()?;
            Some((series.unit().to_owned(), series.values()[index].to_bits()))
        };
        // Who gave a sample: the oldest of those that have had it in turn up to the newest.
        for time in -110..600 {
            let having: Vec<(i64, (String, u64))> = self
                .whole
                .iter()
                .rev()
                .filter_map(|(number, window)| Some((*number, at(window, time)?)))
                .collect();
            let owner = having.iter().take_while(|one| one.1 == having[0].1).last();
            prop_assert_eq!(view.owner(time), owner.map(|(number, _)| *number));
            let shown = view.layers(time, time).unwrap();
            prop_assert!(shown.len() <= 1);
            let shown = shown.first().and_then(|layer| at(&layer.series, time));
            prop_assert_eq!(shown, having.first().map(|(_, sample)| sample.clone()));
        }
        let mut below = ChannelView::empty(CHANNEL);
        for ((number, share), (known, window)) in self.stack.iter().zip(&self.whole) {
            prop_assert_eq!(number, known);
            let content = below.content(share).unwrap();
            prop_assert_eq!(content.as_ref(), Some(window));
            if let Some(own) = &share.own {
                below.put(own, *number);
            }
        }
        let stored: usize =
            self.stack.iter().filter_map(|(_, share)| share.own.as_ref()).map(Series::len).sum();
        let shown: usize = view.stitched().unwrap().map_or(0, |series| series.len());
        prop_assert!(stored >= shown);
        Ok(())
    }
}

fn deed() -> impl Strategy<Value = Deed> {
    // Few values, so that many are repeated.
    let steps = proptest::collection::vec((1i64..12, prop_oneof![Just(0.5), Just(1.5)]), 1..12);
    let unit = prop_oneof![4 => Just("kW"), 1 => Just("W")];
    let upload = (-100i64..60, steps, unit).prop_map(|(start, steps, unit)| {
        let mut time = start;
        let sample = |(step, value)| {
            time += step;
            (time, value)
        };
        Deed::Upload { unit, samples: steps.into_iter().map(sample).collect() }
    });
    prop_oneof![
        5 => upload,
        3 => (any::<usize>(), 0usize..3).prop_map(|(keep, more)| Deed::Roll { keep, more }),
        1 => any::<usize>().prop_map(Deed::Repeat),
        2 => any::<usize>().prop_map(Deed::Delete),
        2 => any::<usize>().prop_map(Deed::Raise),
    ]
}

proptest! {
    #[test]
    fn views_and_shares_are_all_that_was_sent(deeds in proptest::collection::vec(deed(), 1..25)) {
        let mut both = Both::default();
        for deed in deeds {
            match deed {
                Deed::Upload { unit, samples } => both.upload(series(unit, &samples)),
                Deed::Roll { keep, more } => both.roll(keep, more),
                Deed::Repeat(index) if !both.whole.is_empty() => {
                    both.upload(both.whole[index % both.whole.len()].1.clone());
                }
                Deed::Repeat(_) => {}
                Deed::Delete(index) => both.shift(index, false),
                Deed::Raise(index) => both.shift(index, true),
            }
            both.check()?;
        }
    }
}
