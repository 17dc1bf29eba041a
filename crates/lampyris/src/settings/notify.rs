//! Whom the service tells what happens.

use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::fmt;

/// Whom the service tells what happens, by HTTP.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NotifySettings {
    /// Where notices are posted.
    pub url: String,
    /// Of what; of all of it where nothing is named.
    pub events: Vec<NoticeKind>,
    /// The key by which notices are signed; without one they are not.
    pub secret: NoticeSecret,
    /// How a notice is written.
    pub format: NoticeFormat,
    /// The address at which people reach the page, for links: `https://lampyris.example.org`.
    pub page: String,
}

/// What a notice is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum NoticeKind {
    /// All jobs of a schedule have ended.
    Night,
    /// A system serves new parameters.
    Published,
    /// A fit waits for an operator's word.
    Held,
    /// The gate has refused a fit.
    Rejected,
    /// An estimate for the controller has failed.
    Failed,
    /// Newer measurements contradict what is served.
    Degraded,
    /// What is served is older than its policy wants.
    Stale,
    /// A parameter of a system is another one since a day.
    Changed,
}

/// How a notice is written.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum NoticeFormat {
    /// A document with everything that is known.
    #[default]
    Json,
    /// A sentence, with title and link in the header fields that ntfy reads.
    Ntfy,
}

/// A key that no log shows.
#[derive(Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct NoticeSecret(pub String);

impl fmt::Debug for NoticeSecret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if self.0.is_empty() { "none" } else { "set" })
    }
}

impl NoticeKind {
    /// The word in settings and notices.
    pub const fn as_str(self) -> &'static str {
        match self {
            NoticeKind::Night => "night",
            NoticeKind::Published => "published",
            NoticeKind::Held => "held",
            NoticeKind::Rejected => "rejected",
            NoticeKind::Failed => "failed",
            NoticeKind::Degraded => "degraded",
            NoticeKind::Stale => "stale",
            NoticeKind::Changed => "changed",
        }
    }
}

impl NotifySettings {
    /// Whether somebody wants to hear of this.
    pub fn wants(&self, kind: NoticeKind) -> bool {
        self.events.is_empty() || self.events.contains(&kind)
    }

    /// Sets one field from a text.
    pub(super) fn set(&mut self, field: &str, text: &str) -> Result<(), String> {
        fn word<T: for<'de> Deserialize<'de>>(text: &str) -> Result<T, String> {
            serde_json::from_value(Value::from(text.trim())).map_err(|error| error.to_string())
        }
        match field {
            "/notify/url" => self.url = text.to_owned(),
            "/notify/secret" => self.secret = NoticeSecret(text.to_owned()),
            "/notify/page" => self.page = text.to_owned(),
            "/notify/format" => self.format = word(text)?,
            _ => self.events = text.split(',').map(word).collect::<Result<_, _>>()?,
        }
        Ok(())
    }

    /// What makes no sense: fields with sentences.
    pub(super) fn faults(&self) -> Vec<(&'static str, &'static str)> {
        let is_address = |text: &str| {
            let rest = text.strip_prefix("https://").or_else(|| text.strip_prefix("http://"));
            rest.is_some_and(|rest| !rest.is_empty()) && !text.contains(char::is_whitespace)
        };
        let mut faults = Vec::new();
        if !is_address(&self.url) {
            faults.push(("/notify/url", "notices go to an address such as `https://ntfy.sh/my-topic`"));
        }
        if !self.page.is_empty() && !is_address(&self.page) {
            faults.push(("/notify/page", "this is no address such as `https://lampyris.example.org`"));
        }
        faults
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_read_from_texts_and_no_log_shows_the_secret() {
        let mut settings = NotifySettings::default();
        for (field, text) in [
            ("/notify/url", "https://ntfy.sh/topic"),
            ("/notify/events", "night, stale"),
            ("/notify/format", "ntfy"),
            ("/notify/secret", "hidden"),
        ] {
            settings.set(field, text).unwrap();
        }
        assert_eq!((settings.format, settings.faults().len()), (NoticeFormat::Ntfy, 0));
        assert!(settings.wants(NoticeKind::Stale) && !settings.wants(NoticeKind::Published));
        assert!(!format!("{settings:?}").contains("hidden"), "{settings:?}");
        let said = settings.set("/notify/events", "nights").unwrap_err();
        assert!(said.contains("`nights`") && said.contains("`degraded`"), "{said}");
        let empty = NotifySettings { page: "lampyris".into(), ..NotifySettings::default() };
        assert_eq!(empty.faults().len(), 2);
        for kind in ["night", "published", "held", "rejected", "failed", "degraded", "stale"] {
            let read: NoticeKind = serde_json::from_value(kind.into()).unwrap();
            assert_eq!(read.as_str(), kind);
        }
    }
}
