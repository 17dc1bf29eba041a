//! What handlers are given, and what their answers share.

use crate::service::Service;
use axum::body::{Body, Bytes};
use std::sync::Arc;

/// What every handler is given.
pub type Shared = Arc<Service>;

/// A body that many answers share; it is not copied.
pub fn shared_body(body: Arc<[u8]>) -> Body {
    struct Shared(Arc<[u8]>);
    impl AsRef<[u8]> for Shared {
        fn as_ref(&self) -> &[u8] {
            &self.0
        }
    }
    Body::from(Bytes::from_owner(Shared(body)))
}
