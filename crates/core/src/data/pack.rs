//! Several series as one compressed block: what was measured of a system on a day, or what a window gave.
//!
//! `LYP1`, 16 bytes of blake3 over the names and the payload, then the payload compressed with zlib. Names
//! and units stand beside the block, where others look for them; the hash ties them to it. The payload has
//! for each series a byte of signs (held, in whole seconds, at the times of the series before), where it has
//! times of its own their number, the first one and their distances, and then the values.
//!
//! Instruments report a few digits. Values that are all whole numbers of some power of ten are written as the
//! differences of those numbers, most of which fit in a byte; others as their bits, as a
//! [`Series::encode`] has them. Either way every bit comes back.

use super::block::{
    CorruptBlock, deflate, differences, inflate, read_values, take, take_varint, write_planes,
};
use super::block::{MAX_PAYLOAD, write_varint};
use super::channel::Hold;
use super::duration::SECOND;
use super::series::{MAX_SAMPLES, Series};

const MAGIC: &[u8; 4] = b"LYP1";
const HASH: usize = 16;
/// What a series says of itself.
const HELD: u8 = 1;
const WHOLE_SECONDS: u8 = 2;
const TIMES_AS_BEFORE: u8 = 4;
/// Most digits behind the point that a value has to be written as a whole number.
const MOST_DIGITS: u8 = 6;
/// Stands for the number of digits where the values are written as their bits.
const BITS: u8 = u8::MAX;
/// The largest whole number up to which `f64` has all of them.
const EXACT: f64 = 9_007_199_254_740_992.0;

/// Packs series. Equal series give equal blocks.
pub fn pack(series: &[Series]) -> Vec<u8> {
    let mut payload = Vec::new();
    let mut before: Option<&Series> = None;
    for one in series {
        let same_times = before.is_some_and(|before| before.times() == one.times());
        let unit_of_time = if one.has_whole_seconds() { SECOND } else { 1 };
        let held = if one.hold() == Hold::ZeroOrder { HELD } else { 0 };
        let seconds = if unit_of_time == SECOND { WHOLE_SECONDS } else { 0 };
        payload.push(held | seconds | if same_times { TIMES_AS_BEFORE } else { 0 });
        if !same_times {
            write_varint(&mut payload, one.len() as u64);
            write_varint(&mut payload, zigzag(one.from() / unit_of_time));
            for pair in one.times().windows(2) {
                write_varint(&mut payload, pair[1].abs_diff(pair[0]) / unit_of_time.unsigned_abs());
            }
        }
        match decimal(one.values()) {
            Some((digits, numbers)) => {
                payload.push(digits);
                let mut previous = 0;
                for number in numbers {
                    write_varint(&mut payload, zigzag(number - previous));
                    previous = number;
                }
            }
            None => {
                payload.push(BITS);
                write_planes(&mut payload, &differences(one.values()));
            }
        }
        before = Some(one);
    }
    let names = series.iter().map(|one| (one.channel(), one.unit()));
    let mut block = MAGIC.to_vec();
    block.extend(&hash(names, &payload).as_bytes()[..HASH]);
    deflate(block, &payload)
}

/// Unpacks the series of a block, whose channels and units are these, in their order.
///
/// Memory is bounded by what a block of that many bytes can honestly hold.
///
/// # Errors
/// [`CorruptBlock`] for anything that [`pack`] did not write, or not with these names.
pub fn unpack(names: &[(&str, &str)], block: &[u8]) -> Result<Vec<Series>, CorruptBlock> {
    let rest = block.strip_prefix(MAGIC).ok_or(CorruptBlock("it does not start as one"))?;
    let (expected, compressed) = rest.split_at_checked(HASH).ok_or(CorruptBlock("it is cut short"))?;
    let payload = inflate(compressed, names.len().saturating_mul(MAX_PAYLOAD))?;
    if hash(names.iter().copied(), &payload).as_bytes()[..HASH] != *expected {
        return Err(CorruptBlock("its hash does not match"));
    }
    let mut rest = payload.as_slice();
    let mut all: Vec<Series> = Vec::with_capacity(names.len());
    for (channel, unit) in names {
        let [signs] = take::<1>(&mut rest)?;
        let times = match all.last() {
            Some(before) if signs & TIMES_AS_BEFORE != 0 => before.times().to_vec(),
            _ => read_times(&mut rest, if signs & WHOLE_SECONDS != 0 { SECOND } else { 1 })?,
        };
        let values = match take::<1>(&mut rest)? {
            [BITS] => read_values(&mut rest, times.len())?,
            [digits @ 0..=MOST_DIGITS] => read_decimal(&mut rest, digits, times.len())?,
            _ => return Err(CorruptBlock("the form of its values is unknown")),
        };
        let hold = if signs & HELD != 0 { Hold::ZeroOrder } else { Hold::Linear };
        let series = Series::new(channel, unit, hold, times, values);
        all.push(series.map_err(|_| CorruptBlock("its samples are not a series"))?);
    }
    if rest.is_empty() { Ok(all) } else { Err(CorruptBlock("its length is wrong")) }
}

fn read_times(rest: &mut &[u8], unit_of_time: i64) -> Result<Vec<i64>, CorruptBlock> {
    let overflows = CorruptBlock("a time overflows");
    let count = usize::try_from(take_varint(rest)?).unwrap_or(usize::MAX);
    // A byte for the time and one for the value of every sample must follow: the check comes before any
    // allocation by `count`.
    if count == 0 || count > MAX_SAMPLES || count > rest.len() / 2 {
        return Err(CorruptBlock("its number of samples is wrong"));
    }
    let mut time = unzigzag(take_varint(rest)?);
    let mut times = Vec::with_capacity(count);
    for place in 0..count {
        if place > 0 {
            time = time.checked_add_unsigned(take_varint(rest)?).ok_or(overflows.clone())?;
        }
        times.push(time.checked_mul(unit_of_time).ok_or(overflows.clone())?);
    }
    Ok(times)
}

/// The fewest digits behind the point with which every value is a whole number, and those numbers.
fn decimal(values: &[f64]) -> Option<(u8, Vec<i64>)> {
    (0..=MOST_DIGITS).find_map(|digits| {
        let power = 10f64.powi(i32::from(digits));
        let number = |value: &f64| {
            let number = Some((value * power).round()).filter(|number| number.abs() < EXACT)? as i64;
            (number as f64 / power).to_bits().eq(&value.to_bits()).then_some(number)
        };
        Some((digits, values.iter().map(number).collect::<Option<_>>()?))
    })
}

fn read_decimal(rest: &mut &[u8], digits: u8, count: usize) -> Result<Vec<f64>, CorruptBlock> {
    let power = 10f64.powi(i32::from(digits));
    let mut number = 0i64;
    let value = |_| {
        number = number.checked_add(unzigzag(take_varint(rest)?)).ok_or(CorruptBlock("a value overflows"))?;
        Ok(number as f64 / power)
    };
    (0..count).map(value).collect()
}

fn hash<'a>(names: impl Iterator<Item = (&'a str, &'a str)>, payload: &[u8]) -> blake3::Hash {
    let mut hasher = blake3::Hasher::new();
    for text in names.flat_map(|(channel, unit)| [channel, unit]) {
        hasher.update(&(text.len() as u64).to_le_bytes()).update(text.as_bytes());
    }
    hasher.update(payload).finalize()
}

/// Numbers near zero as small ones without a sign.
fn zigzag(number: i64) -> u64 {
    ((number << 1) ^ (number >> 63)) as u64
}

fn unzigzag(number: u64) -> i64 {
    ((number >> 1) as i64) ^ -((number & 1) as i64)
}

#[cfg(test)]
mod tests {
    use super::{Series, decimal, pack, unpack};
    use crate::data::{Hold, SECOND};
    use proptest::prelude::{any, prop_assert, prop_assert_eq, prop_oneof, proptest};
    use proptest::strategy::Strategy;

    fn names(series: &[Series]) -> Vec<(&str, &str)> {
        series.iter().map(|one| (one.channel(), one.unit())).collect()
    }

    /// Channels of a day of ten minutes, as a thermometer, a meter and a computer give them.
    fn day() -> Vec<Series> {
        let times: Vec<i64> = (0..144).map(|i| (1_700_006_400 + 600 * i) * SECOND).collect();
        let channel = |name: &str, unit: &str, value: &dyn Fn(f64) -> f64| {
            let values = (0..144).map(|i| value(f64::from(i))).collect();
            Series::new(name, unit, Hold::Linear, times.clone(), values).unwrap()
        };
        vec![
            channel("T_room", "degC", &|i| ((20.0 + (i * 0.05).sin()) * 100.0).round() / 100.0),
            channel("P_appliances", "W", &|i| (i % 7.0) * 3.0),
            channel("sun_altitude", "deg", &|i| 30.0 * (i * 0.04).sin()),
        ]
    }

    #[test]
    fn decimals_take_a_byte_a_sample_and_bits_what_they_need() {
        let day = day();
        assert!(pack(&day[..2]).len() < 300, "{}", pack(&day[..2]).len());
        assert!(day[..2].iter().map(|one| one.encode().len()).sum::<usize>() > 2 * pack(&day[..2]).len());
        assert_eq!(unpack(&names(&day), &pack(&day)), Ok(day));
    }

    #[test]
    fn a_block_belongs_to_its_names() {
        let day = day();
        let block = pack(&day);
        let mut other = names(&day);
        other[0].1 = "K";
        assert!(unpack(&other, &block).is_err());
        assert!(unpack(&names(&day)[..2], &block).is_err());
        assert_eq!(unpack(&[], &pack(&[])), Ok(Vec::new()));
    }

    #[test]
    fn any_flipped_byte_is_noticed() {
        let day = day();
        let block = pack(&day);
        for index in 0..block.len() {
            let mut broken = block.clone();
            broken[index] ^= 0x10;
            // Header bits that do not matter to zlib may flip unseen, but never change a sample.
            assert!(unpack(&names(&day), &broken).map_or(true, |read| read == day), "byte {index}");
            assert!(unpack(&names(&day), &block[..index]).is_err());
        }
    }

    #[test]
    fn minus_zero_and_long_fractions_are_no_decimals() {
        assert_eq!(decimal(&[0.1, -2.5]), Some((1, vec![1, -25])));
        assert_eq!(decimal(&[-0.0]), None);
        assert_eq!(decimal(&[1.0 / 3.0]), None);
        assert_eq!(decimal(&[1e17]), None);
    }

    fn value() -> impl Strategy<Value = f64> {
        let decimal =
            (any::<i32>(), 0i32..8).prop_map(|(number, digits)| f64::from(number) / 10f64.powi(digits));
        prop_oneof![decimal, any::<f64>().prop_map(|value| if value.is_finite() { value } else { 0.0 })]
    }

    proptest! {
        #[test]
        fn blocks_round_trip(
            columns in proptest::collection::vec((any::<bool>(), any::<bool>(), any::<bool>()), 1..5),
            samples in proptest::collection::vec((1i64..1_000_000, value()), 1..60),
        ) {
            let series: Vec<Series> = columns.iter().enumerate().map(|(place, (held, in_millis, own))| {
                let unit = if *in_millis { 1 } else { SECOND };
                let mut time = -5_000;
                let mut of = |(step, value): &(i64, f64)| {
                    time += step * unit * if *own { 2 } else { 1 };
                    (time, *value)
                };
                let (times, values) = samples.iter().map(&mut of).unzip();
                let hold = if *held { Hold::ZeroOrder } else { Hold::Linear };
                Series::new(&format!("x{place}"), "kW", hold, times, values).unwrap()
            }).collect();
            let block = pack(&series);
            prop_assert_eq!(&block, &pack(&series));
            let read = unpack(&names(&series), &block).unwrap();
            for (read, written) in read.iter().zip(&series) {
                let bits = |series: &Series| series.values().iter().map(|v| v.to_bits()).collect::<Vec<_>>();
                prop_assert_eq!(bits(read), bits(written));
            }
            prop_assert_eq!(read, series);
        }

        #[test]
        fn garbage_is_refused(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            let mut block = b"LYP1".to_vec();
            block.extend(bytes);
            prop_assert!(unpack(&[("T_room", "degC")], &block).is_err());
        }
    }
}
