//! Whose turn it is to change the measurements of a system: uploads are looked at beside what counts and then
//! written, so two at once would do one of them in vain.

use lampyris_core::data::SystemId;
use tokio::sync::{Mutex, MutexGuard};

/// Systems of which two may share a turn, which only makes one of them wait.
const TURNS: usize = 64;

/// The turns of all systems. Within a turn they come in the order in which they were asked for.
#[derive(Debug)]
pub struct Turns(Vec<Mutex<()>>);

impl Default for Turns {
    fn default() -> Self {
        Self((0..TURNS).map(|_| Mutex::default()).collect())
    }
}

impl Turns {
    /// Waits for the turn of a system, which lasts as long as what comes back.
    pub(super) async fn of(&self, system: &SystemId) -> MutexGuard<'_, ()> {
        let hash = blake3::hash(system.to_string().as_bytes());
        self.0[usize::from(hash.as_bytes()[0]) % TURNS].lock().await
    }
}
