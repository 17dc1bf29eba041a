//! From bytes to text.

use encoding_rs::{Encoding, WINDOWS_1252};
use std::borrow::Cow;

/// The encoding that goes without saying.
pub(super) const UTF_8: &str = "UTF-8";

/// The text of a file, and the name of its encoding: what its first bytes say (UTF-16 of spreadsheets), UTF-8
/// where it is that, and what Windows writes in Western Europe otherwise.
pub(super) fn decode(body: &[u8]) -> (Cow<'_, str>, &'static str) {
    if let Some((encoding, _)) = Encoding::for_bom(body) {
        let (text, _) = encoding.decode_with_bom_removal(body);
        return (text, encoding.name());
    }
    match std::str::from_utf8(body) {
        Ok(text) => (Cow::Borrowed(text), UTF_8),
        Err(_) => (WINDOWS_1252.decode_without_bom_handling(body).0, WINDOWS_1252.name()),
    }
}
