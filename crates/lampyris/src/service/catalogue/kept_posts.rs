//! How many live samples were kept since somebody last looked for those to lay in.

use std::sync::atomic::{AtomicUsize, Ordering};
use tokio::sync::Notify;

/// After so many posts somebody looks before it is time: a flood of them would leave its size in the file of
/// the database.
const MANY: usize = 240;

/// A count of posts, with a bell.
#[derive(Debug, Default)]
pub struct KeptPosts {
    since_last_look: AtomicUsize,
    many: Notify,
}

impl KeptPosts {
    /// Counts posts that were kept.
    pub(in crate::service) fn add(&self, posts: usize) {
        if self.since_last_look.fetch_add(posts, Ordering::Relaxed) + posts >= MANY {
            self.many.notify_one();
        }
    }

    /// Begins to count anew.
    pub(super) fn look(&self) {
        self.since_last_look.store(0, Ordering::Relaxed);
    }

    /// Waits until there are many.
    pub(super) async fn many(&self) {
        self.many.notified().await;
    }
}
