//! The catalogue that everybody reads: built-in documents and those of users.

use crate::store::{Store, StoreError, models};
use arc_swap::ArcSwap;
use lampyris_core::model::Catalogue;
use std::sync::Arc;

/// The catalogue that everybody reads. A new document makes a new catalogue; readers keep the one they have.
#[derive(Debug)]
pub struct SharedCatalogue(ArcSwap<Catalogue>);

impl SharedCatalogue {
    /// The built-in documents and those of the database.
    ///
    /// # Errors
    /// Where the database fails or holds unreadable documents.
    pub async fn load(store: &Store, mut builtin: Catalogue) -> Result<Self, StoreError> {
        models::models(store).await?.into_iter().for_each(|document| builtin.add_model(document));
        models::effects(store).await?.into_iter().for_each(|effect| builtin.add_effect(effect));
        Ok(Self(ArcSwap::from_pointee(builtin)))
    }

    /// Puts another in its place.
    pub(in crate::service) fn replace(&self, catalogue: Self) {
        self.0.store(catalogue.0.into_inner());
    }

    /// The catalogue as it is now.
    pub fn current(&self) -> Arc<Catalogue> {
        self.0.load_full()
    }

    pub(super) fn change(&self, change: impl Fn(&mut Catalogue)) {
        self.0.rcu(|catalogue| {
            let mut changed = Catalogue::clone(catalogue);
            change(&mut changed);
            changed
        });
    }
}
