//! What happens to jobs and to what is served, for those who listen.
//!
//! `events` is the numbered log that any number of listeners follow; `follow` brings the submissions and ends
//! of the database into it, `fleet` follows what other services do on the same database, and `notify` tells
//! an address of it.

pub mod events;
pub mod fleet;
pub mod follow;
pub mod notify;
