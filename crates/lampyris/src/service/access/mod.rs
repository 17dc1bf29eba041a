//! Who may ask.
//!
//! `tokens` makes and revokes tokens, follows the database, and judges what a request shows from memory.

pub mod tokens;
