//! What happens to jobs and to what is served, for those who listen.
//!
//! `events` is the numbered log that any number of listeners follow; `follow` brings the submissions and ends
//! of the database into it.

pub mod events;
pub mod follow;
