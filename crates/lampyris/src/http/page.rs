//! Lists come in pages: `?page_size=&page_token=` and `{"items": […], "next_page_token": null}`.

use super::problem::ApiError;
use lampyris_core::fault::Fault;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

const DEFAULT_SIZE: i64 = 50;
const LARGEST_SIZE: i64 = 500;

/// Which page of a list.
#[derive(Debug, Clone, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct PageQuery {
    /// Items per page, 50 by default, at most 500.
    #[param(minimum = 1, maximum = 500)]
    pub page_size: Option<i64>,
    /// The `next_page_token` of the page before.
    pub page_token: Option<String>,
}

/// One page of a list.
#[derive(Debug, Serialize, ToSchema)]
pub struct Page<T> {
    /// What is on it.
    pub items: Vec<T>,
    /// Asks for the next page; `null` on the last one.
    pub next_page_token: Option<String>,
}

impl PageQuery {
    /// Items per page.
    pub fn size(&self) -> Result<i64, ApiError> {
        match self.page_size {
            None => Ok(DEFAULT_SIZE),
            Some(size) if (1..=LARGEST_SIZE).contains(&size) => Ok(size),
            Some(size) => {
                let detail = format!("a page has between 1 and {LARGEST_SIZE} items, not {size}");
                Err(ApiError::Invalid(vec![Fault::new("query page_size", "out-of-range", detail)]))
            }
        }
    }

    /// The number before which a list that counts down goes on.
    pub fn before(&self) -> Result<i64, ApiError> {
        match &self.page_token {
            None => Ok(i64::MAX),
            Some(token) => token.parse().map_err(|_| {
                ApiError::Invalid(vec![Fault::new(
                    "query page_token",
                    "invalid-token",
                    "this is no token of an earlier page",
                )])
            }),
        }
    }
}

impl<T> Page<T> {
    /// The page of records that were read with one more than fit: that one only shows that there are more.
    pub fn of<R>(
        mut records: Vec<R>,
        size: i64,
        token: impl Fn(&R) -> String,
        item: impl Fn(R) -> T,
    ) -> Self {
        let size = usize::try_from(size).unwrap_or(usize::MAX);
        let more = records.len() > size;
        records.truncate(size);
        let next_page_token = if more { records.last().map(token) } else { None };
        Self { items: records.into_iter().map(item).collect(), next_page_token }
    }
}
