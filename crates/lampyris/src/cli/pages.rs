//! Lists of a running server, a page at a time.

use super::output::Failure;
use super::server::{self, Answer, Server};
use super::table;

/// Which part of a list.
#[derive(Debug, clap::Args)]
pub struct Page {
    /// Rows, at most 500.
    #[arg(long, default_value_t = 50)]
    limit: u16,
    /// Goes on where a list said that there is more.
    #[arg(long, value_name = "TOKEN")]
    page_token: Option<String>,
}

/// Asks for a page of a list and shows it.
pub fn list(
    server: &Server,
    path: &str,
    page: &Page,
    query: &[(&str, &Option<String>)],
    columns: &[table::Column],
) -> Result<(), Failure> {
    let limit = Some(page.limit.to_string());
    let parameters = [&[("page_size", &limit)], query, &[("page_token", &page.page_token)]].concat();
    let asked = format!("{path}{}", server::query(&parameters));
    shown_list(server, &server.get(&asked)?, columns)
}

/// Shows a list; an empty one is nothing found.
pub fn shown_list(server: &Server, answer: &Answer, columns: &[table::Column]) -> Result<(), Failure> {
    let is_empty = answer.document["items"].as_array().is_none_or(Vec::is_empty);
    if !is_empty || server.json() {
        server.show(answer, |list| table::items(list, columns));
    }
    if is_empty { Err(Failure::Nothing("the list is empty".to_owned())) } else { Ok(()) }
}
