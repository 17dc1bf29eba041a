//! Channels with their samples as one row keeps them: names, units and pairs of numbers as a JSON text, into
//! which statements can look, and the samples of all of them as one block. And documents, compressed.

use super::error::StoreError;
use super::value::{corrupt, from_json, to_json};
use lampyris_core::data::{Series, pack, unpack};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::io::{Read, Write};

/// A channel of a row: name, unit (`None` without samples), and whose or which stretches they are.
pub(super) type ChannelEntry = (String, Option<String>, Vec<(i64, i64)>);

/// No document of ours is longer; a damaged one could claim to be.
const LONGEST_DOCUMENT: u64 = 256 << 20;

/// A channel with its samples and its pairs.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct PackedChannel {
    /// The channel.
    pub channel: String,
    /// Its samples, if it has any.
    pub series: Option<Series>,
    /// What the row says of them.
    pub pairs: Vec<(i64, i64)>,
}

/// Packs channels. This is work for a blocking thread.
pub(super) fn write(channels: Vec<PackedChannel>) -> (Vec<ChannelEntry>, Vec<u8>) {
    let mut entries = Vec::with_capacity(channels.len());
    let mut all = Vec::with_capacity(channels.len());
    for PackedChannel { channel, series, pairs } in channels {
        entries.push((channel, series.as_ref().map(|series| series.unit().to_owned()), pairs));
        all.extend(series);
    }
    (entries, pack(&all))
}

/// Unpacks channels. This is work for a blocking thread.
pub(super) fn read(what: &str, channels: &str, block: &[u8]) -> Result<Vec<PackedChannel>, StoreError> {
    let entries: Vec<ChannelEntry> = from_json(what, channels)?;
    let names: Vec<(&str, &str)> =
        entries.iter().filter_map(|(channel, unit, _)| Some((channel.as_str(), unit.as_deref()?))).collect();
    let mut series = unpack(&names, block).map_err(|error| corrupt(what, &error))?.into_iter();
    let channel = |(channel, unit, pairs): ChannelEntry| PackedChannel {
        series: unit.and_then(|_| series.next()),
        channel,
        pairs,
    };
    Ok(entries.into_iter().map(channel).collect())
}

/// Compresses a document.
pub(super) fn compress<T: Serialize + ?Sized>(what: &str, document: &T) -> Result<Vec<u8>, StoreError> {
    let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::new(6));
    let written = encoder.write_all(to_json(what, document)?.as_bytes()).and_then(|()| encoder.finish());
    written.map_err(|error| corrupt(what, &error))
}

/// Reads a document that was compressed, or is a text still, as earlier programs have written it.
pub(super) fn decompress<T: DeserializeOwned>(what: &str, document: &[u8]) -> Result<T, StoreError> {
    let mut text = String::new();
    match document.first() {
        Some(b'{' | b'[') => {
            text.push_str(std::str::from_utf8(document).map_err(|error| corrupt(what, &error))?)
        }
        _ => {
            let mut decoder = flate2::read::ZlibDecoder::new(document).take(LONGEST_DOCUMENT);
            decoder.read_to_string(&mut text).map_err(|error| corrupt(what, &error))?;
        }
    }
    from_json(what, &text)
}
