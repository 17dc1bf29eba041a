//! What a commit tells of: the systems of which something has changed that is served, or is said of what is
//! served.
//!
//! Triggers of the writer note these systems, so no function that writes has to say so and none can forget
//! it. The commit tells one follower, and whoever has written waits until that has followed.

use super::engine::{Session, Texts};
use super::error::StoreError;
use super::statement::query_scalar;
use super::value::parse;
use lampyris_core::data::SystemId;
use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, PoisonError};
use tokio::sync::mpsc::{self, UnboundedReceiver, UnboundedSender};
use tokio::sync::oneshot;

/// The notes of a transaction, which are taken back with it, and who makes them. What `params` reads is what
/// they are about; of jobs, only which one is the newest and where it stands, which is told of systems that
/// serve nothing yet.
pub(super) const NOTES: &str = "
    CREATE TEMP TABLE touched (system TEXT NOT NULL);
    CREATE TEMP TRIGGER a_system_came AFTER INSERT ON main.systems
        BEGIN INSERT INTO touched VALUES (NEW.system); END;
    CREATE TEMP TRIGGER a_system_changed AFTER UPDATE ON main.systems
        BEGIN INSERT INTO touched VALUES (NEW.system); END;
    CREATE TEMP TRIGGER a_system_went AFTER DELETE ON main.systems
        BEGIN INSERT INTO touched VALUES (OLD.system); END;
    CREATE TEMP TRIGGER a_revision_came AFTER INSERT ON main.revisions
        BEGIN INSERT INTO touched VALUES (NEW.system); END;
    CREATE TEMP TRIGGER a_revision_was_confirmed AFTER UPDATE ON main.revisions
        BEGIN INSERT INTO touched VALUES (NEW.system); END;
    CREATE TEMP TRIGGER a_fallback_came AFTER INSERT ON main.fallbacks
        BEGIN INSERT INTO touched VALUES (NEW.system); END;
    CREATE TEMP TRIGGER a_fallback_changed AFTER UPDATE ON main.fallbacks
        BEGIN INSERT INTO touched VALUES (NEW.system); END;
    CREATE TEMP TRIGGER a_fallback_went AFTER DELETE ON main.fallbacks
        BEGIN INSERT INTO touched VALUES (OLD.system); END;
    CREATE TEMP TRIGGER a_degradation_came AFTER INSERT ON main.degradations
        BEGIN INSERT INTO touched VALUES (NEW.system); END;
    CREATE TEMP TRIGGER a_degradation_went AFTER DELETE ON main.degradations
        BEGIN INSERT INTO touched VALUES (OLD.system); END;
    CREATE TEMP TRIGGER states_came AFTER INSERT ON main.states
        BEGIN INSERT INTO touched VALUES (NEW.system); END;
    CREATE TEMP TRIGGER states_changed AFTER UPDATE ON main.states
        WHEN OLD.revision <> NEW.revision OR OLD.document <> NEW.document
        BEGIN INSERT INTO touched VALUES (NEW.system); END;
    CREATE TEMP TRIGGER a_pin_came AFTER INSERT ON main.pins
        BEGIN INSERT INTO touched VALUES (NEW.system); END;
    CREATE TEMP TRIGGER a_pin_changed AFTER UPDATE ON main.pins
        BEGIN INSERT INTO touched VALUES (NEW.system); END;
    CREATE TEMP TRIGGER a_pin_went AFTER DELETE ON main.pins
        BEGIN INSERT INTO touched VALUES (OLD.system); END;
    CREATE TEMP TRIGGER a_job_came AFTER INSERT ON main.jobs
        WHEN NOT EXISTS (SELECT 1 FROM revisions WHERE system = NEW.system)
        BEGIN INSERT INTO touched VALUES (NEW.system); END;
    CREATE TEMP TRIGGER a_job_stands_elsewhere AFTER UPDATE OF state ON main.jobs
        WHEN NOT EXISTS (SELECT 1 FROM revisions WHERE system = NEW.system)
        BEGIN INSERT INTO touched VALUES (NEW.system); END;";

/// What was noted. On PostgreSQL the notes stay, for the other services (`0001_initial.sql`).
const TOUCHED: Texts = Texts {
    sqlite: "DELETE FROM touched RETURNING system",
    postgres: "SELECT name FROM changes WHERE xact = pg_current_xact_id_if_assigned() AND topic = 'system'",
};

/// A commit that has changed what is served, or what is said of it.
#[derive(Debug)]
pub struct Change {
    /// Of which systems.
    pub systems: BTreeSet<SystemId>,
    followed: oneshot::Sender<()>,
}

impl Change {
    /// Lets go on whoever has written it, who also goes on where this is dropped.
    pub fn followed(self) {
        // Somebody who has left meanwhile needs to hear nothing.
        let _ = self.followed.send(());
    }
}

/// The way from the commits to their follower.
#[derive(Debug, Clone, Default)]
pub(super) struct Changes(Arc<Mutex<Option<UnboundedSender<Change>>>>);

impl Changes {
    /// What is committed from now on; a later follower takes the place of an earlier one.
    pub(super) fn follow(&self) -> UnboundedReceiver<Change> {
        let (sender, receiver) = mpsc::unbounded_channel();
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(sender);
        receiver
    }

    /// Tells the follower, if there is one. What comes back ends when it has followed.
    pub(super) fn tell(&self, systems: BTreeSet<SystemId>) -> Option<oneshot::Receiver<()>> {
        if systems.is_empty() {
            return None;
        }
        let (followed, wait) = oneshot::channel();
        let follower = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        follower.as_ref()?.send(Change { systems, followed }).ok()?;
        Some(wait)
    }
}

/// The systems that a transaction has touched so far.
pub(super) async fn touched(tx: &mut Session) -> Result<BTreeSet<SystemId>, StoreError> {
    let sql = tx.text(TOUCHED);
    let names: Vec<String> = query_scalar(sql).fetch_all(tx).await?;
    names.iter().map(|name| parse("a system", name)).collect()
}
