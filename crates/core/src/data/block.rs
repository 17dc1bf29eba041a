//! The binary form of a series: one compressed block per channel and window, as the store keeps it.
//!
//! `LYS1` or `LYS2`, 32 bytes of blake3 over the payload, then the payload compressed with zlib. The payload
//! is the channel and the unit (each with a length of two bytes), the hold, the number of samples, the first
//! time, the distances of the times as variable-length integers, and the values. All integers are
//! little-endian. The times are whole seconds in the first form, and milliseconds in the second one, where
//! some are not whole; the hash of the second form is over its name, too.
//!
//! Measurements change slowly, so a value is written as the difference in bits (exclusive or) from the one
//! before, and the eight bytes of all values are laid out plane by plane: long runs of zeros compress well.

use std::fmt;
use std::io::{Read, Write};

use super::channel::Hold;
use super::duration::SECOND;
use super::series::{MAX_SAMPLES, Series};

/// What a block starts with, and what its times are counted in.
const FORMS: [(&[u8; 4], i64); 2] = [(b"LYS1", SECOND), (b"LYS2", 1)];
const HASH: usize = 32;
/// A variable-length integer of 63 bits has at most nine bytes, a value eight.
pub(super) const MAX_PAYLOAD: usize = 2 * (2 + u16::MAX as usize) + 13 + MAX_SAMPLES * 17;
/// No deflate stream expands by more than this.
const MAX_RATIO: usize = 1_040;

/// A block that is not, or no longer, what `encode` wrote.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CorruptBlock(pub(super) &'static str);

impl fmt::Display for CorruptBlock {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "corrupt series block: {}", self.0)
    }
}

impl std::error::Error for CorruptBlock {}

impl Series {
    /// The series as a compressed, self-checking block. Equal series give equal blocks.
    pub fn encode(&self) -> Vec<u8> {
        let (magic, unit_of_time) = FORMS[usize::from(!self.has_whole_seconds())];
        let mut payload = Vec::with_capacity(64 + self.len() * 10);
        for text in [self.channel(), self.unit()] {
            // A series' names have at most 256 bytes.
            payload.extend((text.len() as u16).to_le_bytes());
            payload.extend(text.as_bytes());
        }
        payload.push(match self.hold() {
            Hold::Linear => 0,
            Hold::ZeroOrder => 1,
        });
        payload.extend((self.len() as u32).to_le_bytes());
        payload.extend((self.from() / unit_of_time).to_le_bytes());
        for pair in self.times().windows(2) {
            write_varint(&mut payload, pair[1].abs_diff(pair[0]) / unit_of_time.unsigned_abs());
        }
        write_planes(&mut payload, &differences(self.values()));
        let mut block = Vec::with_capacity(payload.len() / 3 + 64);
        block.extend(magic);
        block.extend(hash(magic, &payload).as_bytes());
        deflate(block, &payload)
    }

    /// Reads a block.
    ///
    /// Memory is bounded by what a block of that many bytes can honestly hold.
    ///
    /// # Errors
    /// [`CorruptBlock`] for anything that `encode` did not write.
    pub fn decode(block: &[u8]) -> Result<Series, CorruptBlock> {
        let form = |(magic, unit): (&'static [u8; 4], i64)| Some((block.strip_prefix(magic)?, magic, unit));
        let (rest, magic, unit_of_time) =
            FORMS.into_iter().find_map(form).ok_or(CorruptBlock("it does not start as one"))?;
        let (expected, compressed) = rest.split_at_checked(HASH).ok_or(CorruptBlock("it is cut short"))?;
        let payload = inflate(compressed, MAX_PAYLOAD)?;
        if hash(magic, &payload).as_bytes().as_slice() != expected {
            return Err(CorruptBlock("its hash does not match"));
        }
        read_payload(&payload, unit_of_time)
    }
}

/// A payload behind what a block starts with, compressed.
pub(super) fn deflate(start: Vec<u8>, payload: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::ZlibEncoder::new(start, flate2::Compression::new(6));
    encoder.write_all(payload).and_then(|()| encoder.finish()).expect("writing to memory cannot fail")
}

/// A payload of at most so many bytes; memory is bounded by what is there to decompress, too.
pub(super) fn inflate(compressed: &[u8], most: usize) -> Result<Vec<u8>, CorruptBlock> {
    let limit = most.min(compressed.len().saturating_mul(MAX_RATIO));
    let mut payload = Vec::new();
    let mut decoder = flate2::read::ZlibDecoder::new(compressed).take(limit as u64 + 1);
    decoder.read_to_end(&mut payload).map_err(|_| CorruptBlock("it does not decompress"))?;
    if payload.len() > limit { Err(CorruptBlock("it is too large")) } else { Ok(payload) }
}

/// The hash of a payload in the form of a name. That of the first form was there before the others.
fn hash(magic: &[u8; 4], payload: &[u8]) -> blake3::Hash {
    let mut hasher = blake3::Hasher::new();
    if magic != FORMS[0].0 {
        hasher.update(magic);
    }
    hasher.update(payload).finalize()
}

fn read_payload(payload: &[u8], unit_of_time: i64) -> Result<Series, CorruptBlock> {
    let mut rest = payload;
    let channel = take_text(&mut rest)?;
    let unit = take_text(&mut rest)?;
    let hold = match take::<1>(&mut rest)? {
        [0] => Hold::Linear,
        [1] => Hold::ZeroOrder,
        _ => return Err(CorruptBlock("its hold is unknown")),
    };
    let count = u32::from_le_bytes(take::<4>(&mut rest)?) as usize;
    let mut time = i64::from_le_bytes(take::<8>(&mut rest)?);
    // Eight bytes of value per sample must follow: the check comes before any allocation by `count`.
    if count == 0 || count > MAX_SAMPLES || count > rest.len() / 8 {
        return Err(CorruptBlock("its number of samples is wrong"));
    }
    let mut times = Vec::with_capacity(count);
    times.push(time);
    for _ in 1..count {
        let step = take_varint(&mut rest)?;
        time = time.checked_add_unsigned(step).ok_or(CorruptBlock("a time overflows"))?;
        times.push(time);
    }
    let values = read_values(&mut rest, count)?;
    if !rest.is_empty() {
        return Err(CorruptBlock("its length is wrong"));
    }
    let in_millis = |time: i64| time.checked_mul(unit_of_time).ok_or(CorruptBlock("a time overflows"));
    let times = times.into_iter().map(in_millis).collect::<Result<_, _>>()?;
    Series::new(channel, unit, hold, times, values).map_err(|_| CorruptBlock("its samples are not a series"))
}

/// The eight bytes of all words, plane by plane.
pub(super) fn write_planes(payload: &mut Vec<u8>, words: &[u64]) {
    for plane in 0..8 {
        payload.extend(words.iter().map(|word| word.to_le_bytes()[plane]));
    }
}

/// Values whose differences were written plane by plane.
pub(super) fn read_values(rest: &mut &[u8], count: usize) -> Result<Vec<f64>, CorruptBlock> {
    let planes = count.checked_mul(8).and_then(|length| rest.split_at_checked(length));
    let (planes, tail) = planes.ok_or(CorruptBlock("its length is wrong"))?;
    *rest = tail;
    let mut words = vec![[0u8; 8]; count];
    for (plane, bytes) in planes.chunks_exact(count).enumerate() {
        for (word, byte) in words.iter_mut().zip(bytes) {
            word[plane] = *byte;
        }
    }
    let mut previous = 0;
    let value = |word| {
        previous ^= u64::from_le_bytes(word);
        f64::from_bits(previous)
    };
    Ok(words.into_iter().map(value).collect())
}

/// Each value's bits, exclusive or those of the value before.
pub(super) fn differences(values: &[f64]) -> Vec<u64> {
    let mut previous = 0;
    values
        .iter()
        .map(|value| {
            let bits = value.to_bits();
            let difference = bits ^ previous;
            previous = bits;
            difference
        })
        .collect()
}

pub(super) fn write_varint(payload: &mut Vec<u8>, mut number: u64) {
    while number >= 0x80 {
        payload.push((number as u8) | 0x80);
        number >>= 7;
    }
    payload.push(number as u8);
}

pub(super) fn take_varint(rest: &mut &[u8]) -> Result<u64, CorruptBlock> {
    let mut number = 0;
    for shift in (0..64).step_by(7) {
        let [byte] = take::<1>(rest)?;
        number |= u64::from(byte & 0x7f) << shift;
        if byte & 0x80 == 0 {
            return Ok(number);
        }
    }
    Err(CorruptBlock("a step of time is too long"))
}

pub(super) fn take<const N: usize>(rest: &mut &[u8]) -> Result<[u8; N], CorruptBlock> {
    let (head, tail) = rest.split_first_chunk::<N>().ok_or(CorruptBlock("it is cut short"))?;
    *rest = tail;
    Ok(*head)
}

fn take_text<'a>(rest: &mut &'a [u8]) -> Result<&'a str, CorruptBlock> {
    let length = usize::from(u16::from_le_bytes(take::<2>(rest)?));
    let (head, tail) = rest.split_at_checked(length).ok_or(CorruptBlock("it is cut short"))?;
    *rest = tail;
    std::str::from_utf8(head).map_err(|_| CorruptBlock("a name is not text"))
}

#[cfg(test)]
mod tests {
    use super::{FORMS, HASH, Series, read_payload};
    use crate::data::{Hold, SECOND};
    use proptest::prelude::{any, prop_assert, prop_assert_eq, proptest};
    use std::io::Write;

    fn series(samples: usize) -> Series {
        let times = (0..samples as i64).map(|i| (1_452_528_000 + 600 * i) * SECOND).collect();
        let values =
            (0..samples).map(|i| 20.0 + (i as f64 * 0.01).sin()).map(|v| (v * 10.0).round() / 10.0).collect();
        Series::new("T_room", "degC", Hold::Linear, times, values).unwrap()
    }

    #[test]
    fn ten_thousand_samples_fit_in_a_few_kilobytes() {
        let block = series(10_000).encode();
        assert!(block.len() < 8_000, "{}", block.len());
        assert_eq!(Series::decode(&block).unwrap(), series(10_000));
    }

    #[test]
    fn a_bomb_is_refused() {
        // Zeros compress a thousandfold; the declared hash cannot match, and nothing beyond the limit is
        // kept.
        let mut block = FORMS[0].0.to_vec();
        block.extend([0; HASH]);
        let mut encoder = flate2::write::ZlibEncoder::new(block, flate2::Compression::best());
        encoder.write_all(&vec![0; 50_000_000]).unwrap();
        assert!(Series::decode(&encoder.finish().unwrap()).is_err());
    }

    #[test]
    fn any_flipped_byte_is_noticed() {
        let block = series(50).encode();
        for (index, flip) in (0..block.len()).map(|index| (index, 0x10)).chain([(3, 3)]) {
            let mut broken = block.clone();
            broken[index] ^= flip;
            // Header bits that do not matter to zlib may flip unseen, but never change a sample.
            assert!(Series::decode(&broken).map_or(true, |read| read == series(50)), "byte {index}");
            assert!(Series::decode(&block[..index]).is_err());
        }
    }

    proptest! {
        #[test]
        fn blocks_round_trip(
            name in "[A-Za-z_]{1,20}",
            steps in proptest::collection::vec((1i64..1_000_000, any::<f64>()), 1..200),
            held in any::<bool>(),
            in_millis in any::<bool>(),
        ) {
            let mut time = -5_000;
            let unit = if in_millis { 1 } else { SECOND };
            let mut times = Vec::new();
            let mut values = Vec::new();
            for (step, value) in steps {
                time += step * unit;
                times.push(time);
                values.push(if value.is_finite() { value } else { 0.0 });
            }
            let hold = if held { Hold::ZeroOrder } else { Hold::Linear };
            let series = Series::new(&name, "kW", hold, times, values).unwrap();
            let block = series.encode();
            prop_assert_eq!(&block, &series.encode());
            prop_assert_eq!(Series::decode(&block), Ok(series));
        }

        #[test]
        fn no_bytes_panic(mut bytes in proptest::collection::vec(any::<u8>(), 0..400), magic in any::<bool>()) {
            let _ = read_payload(&bytes, SECOND);
            if magic {
                bytes.splice(0..0, *FORMS[0].0);
            }
            prop_assert!(Series::decode(&bytes).is_err());
        }
    }
}
