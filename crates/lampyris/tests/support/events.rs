//! A client of server-sent events.

use super::Client;
use serde_json::Value;
use std::io::{BufRead, BufReader, Lines, Read};

/// One event.
#[derive(Debug, Clone, PartialEq)]
pub struct Told {
    pub event: String,
    pub data: Value,
    /// The id that a client keeps from here on: that of the event, or of an earlier one where it has none.
    pub last_id: String,
}

/// A stream that is read as slowly as one likes.
pub struct Stream {
    lines: Lines<BufReader<Box<dyn Read + Send>>>,
    /// What a browser would send when it comes back.
    pub last_id: String,
}

impl Client {
    /// Opens a stream of events.
    #[track_caller]
    pub fn listen(&self, path: &str, last_id: &str) -> Stream {
        let headers: &[(&str, &str)] = if last_id.is_empty() { &[] } else { &[("last-event-id", last_id)] };
        let (parts, body) = self.open("GET", path, headers, None).unwrap().into_parts();
        assert_eq!(parts.status, 200);
        assert_eq!(parts.headers["content-type"], "text/event-stream");
        let reader: Box<dyn Read + Send> = Box::new(body.into_reader());
        Stream { lines: BufReader::new(reader).lines(), last_id: last_id.to_owned() }
    }
}

impl Stream {
    /// All events up to the first that satisfies a condition.
    #[track_caller]
    pub fn until(&mut self, holds: impl Fn(&Told) -> bool) -> Vec<Told> {
        let mut told = Vec::new();
        for event in self.by_ref() {
            told.push(event);
            if told.last().is_some_and(&holds) {
                return told;
            }
        }
        panic!("the stream ended after {told:#?}");
    }
}

impl Iterator for Stream {
    type Item = Told;

    /// Reads as the standard says: an id counts even where it comes without data. A stream that is cut off
    /// panics.
    fn next(&mut self) -> Option<Told> {
        let (mut event, mut data) = (String::new(), String::new());
        loop {
            let line = self.lines.next()?.unwrap();
            match line.split_once(": ").unwrap_or((line.as_str(), "")) {
                ("event", name) => name.clone_into(&mut event),
                ("id", id) => id.clone_into(&mut self.last_id),
                ("data", text) => data.push_str(text),
                ("", "") if !data.is_empty() => {
                    return Some(Told {
                        event,
                        data: serde_json::from_str(&data).unwrap(),
                        last_id: self.last_id.clone(),
                    });
                }
                _ => {}
            }
        }
    }
}
