//! Bodies with the room that they take, and packed ones unpacked within it.

use super::places::BodyPlace;
use super::problem::ApiError;
use axum::body::Bytes;
use flate2::bufread::MultiGzDecoder;
use std::io::Read;

/// So much is unpacked at a time.
const PART: usize = 64 << 10;

/// A body with the room that it takes, as long as somebody works on it.
pub struct Housed {
    bytes: Vec<u8>,
    _place: Option<BodyPlace>,
}

impl Housed {
    /// These bytes, which hold their place until the last of who has them lets go.
    pub fn bytes(bytes: Vec<u8>, place: Option<BodyPlace>) -> Bytes {
        Bytes::from_owner(Self { bytes, _place: place })
    }
}

impl AsRef<[u8]> for Housed {
    fn as_ref(&self) -> &[u8] {
        &self.bytes
    }
}

/// Unpacks a body up to a limit. No more than the limit is ever kept, and no more than there is room for.
///
/// # Errors
/// 413 beyond the limit, 503 where there is no room, 400 where it is damaged.
pub fn gzip(packed: &[u8], limit: usize, mut place: Option<BodyPlace>) -> Result<Bytes, ApiError> {
    // Some clients say of nothing that it is packed.
    if packed.is_empty() {
        return Ok(Bytes::new());
    }
    let mut decoder = MultiGzDecoder::new(packed);
    let (mut kept, mut part) = (Vec::new(), vec![0; PART]);
    loop {
        let length = decoder.read(&mut part).map_err(|_| ApiError::BrokenBody)?;
        if length == 0 {
            return Ok(Housed::bytes(kept, place));
        }
        if kept.len() + length > limit {
            return Err(ApiError::TooLarge(limit));
        }
        if place.as_mut().is_some_and(|place| !place.grow(length)) {
            return Err(ApiError::TooMuchAtOnce);
        }
        kept.extend_from_slice(&part[..length]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flate2::Compression;
    use flate2::write::GzEncoder;
    use std::io::Write;

    #[test]
    fn a_body_is_unpacked_up_to_its_limit() {
        let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
        encoder.write_all(&vec![b'a'; 1_000_000]).unwrap();
        let packed = encoder.finish().unwrap();
        assert!(packed.len() < 2_000);
        assert_eq!(gzip(&packed, 1_000_000, None).unwrap().len(), 1_000_000);
        assert!(matches!(gzip(&packed, 999_999, None), Err(ApiError::TooLarge(999_999))));
        assert!(matches!(gzip(&packed[..packed.len() - 9], 1 << 20, None), Err(ApiError::BrokenBody)));
        assert!(matches!(gzip(b"plain", 1 << 20, None), Err(ApiError::BrokenBody)));
        assert!(gzip(&[], 1, None).is_ok_and(|body| body.is_empty()));
    }
}
