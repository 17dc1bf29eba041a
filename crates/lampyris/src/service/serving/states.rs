//! The bodies of `/state`, rendered once per event.

use super::body::tag_of;
use lampyris_core::estimate::assess::metrics::CurrentState;
use serde::Serialize;
use std::sync::Arc;
use utoipa::ToSchema;

/// A finished body.
#[derive(Debug, Clone)]
pub struct RenderedStates {
    /// JSON.
    pub body: Arc<[u8]>,
    /// A strong tag: the quoted hash of the body.
    pub etag: Arc<str>,
    /// The revision by whose parameters they were found.
    pub revision: i64,
    /// The instant of the sample, RFC 3339.
    pub at: String,
}

/// The states of a system, as a controller reads them.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = StateAnswer)]
pub struct StateBody {
    #[serde(flatten)]
    #[schema(inline)]
    state: CurrentState,
    /// The revision by whose parameters they were found.
    revision: i64,
}

impl StateBody {
    /// States, and by which revision they were found.
    pub fn of(revision: i64, state: CurrentState) -> Self {
        Self { state, revision }
    }
}

/// The body of states as they are kept. What cannot be read are none: the parameters beside them count on.
pub(super) fn rendered(system: &str, revision: i64, document: &str) -> Option<RenderedStates> {
    let render = || {
        let body = StateBody { state: serde_json::from_str(document)?, revision };
        Ok::<_, serde_json::Error>((serde_json::to_vec(&body)?, body.state.at))
    };
    match render() {
        Ok((body, at)) => {
            let etag = tag_of(&body).into();
            Some(RenderedStates { body: body.into(), etag, revision, at })
        }
        Err(error) => {
            tracing::error!(%error, system, "the states cannot be read");
            None
        }
    }
}
