//! Bindings of columns to channels, such as `T_room=T_indoor_degC`.

use indexmap::IndexMap;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::fault::{Fault, shown};

/// Which column feeds which channel, where the names alone do not say it.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(transparent)]
#[schema(as = Bindings)]
pub struct ColumnBindings(IndexMap<String, String>);

impl ColumnBindings {
    /// No bindings: every column is taken for the channel of its name.
    pub fn none() -> Self {
        Self::default()
    }

    /// Reads bindings from texts `channel=column`.
    ///
    /// # Errors
    /// One fault for every text without `=` or with an empty side, and for every channel that is bound twice.
    pub fn parse<'a>(texts: impl IntoIterator<Item = &'a str>) -> Result<Self, Vec<Fault>> {
        let mut bindings = Self::default();
        let mut faults = Vec::new();
        for text in texts {
            match text.split_once('=').map(|(channel, column)| (channel.trim(), column.trim())) {
                Some((channel, column)) if !channel.is_empty() && !column.is_empty() => {
                    if bindings.0.insert(channel.to_owned(), column.to_owned()).is_some() {
                        faults.push(Fault::new(
                            "/bind",
                            "bound-twice",
                            format!("`{}` is bound twice", shown(channel)),
                        ));
                    }
                }
                _ => faults.push(
                    Fault::new("/bind", "bad-binding", format!("`{}` is not a binding", shown(text)))
                        .suggest("write channel=column, such as T_room=T_indoor_degC"),
                ),
            }
        }
        if faults.is_empty() { Ok(bindings) } else { Err(faults) }
    }

    /// Binds a channel to a column, in place of what it was bound to.
    pub fn bind(&mut self, channel: impl Into<String>, column: impl Into<String>) {
        self.0.insert(channel.into(), column.into());
    }

    /// The column that a channel is bound to.
    pub fn column(&self, channel: &str) -> Option<&str> {
        self.0.get(channel).map(String::as_str)
    }

    /// All pairs of channel and column, in the order in which they were bound.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &str)> {
        self.0.iter().map(|(channel, column)| (channel.as_str(), column.as_str()))
    }

    /// Whether nothing is bound.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}
