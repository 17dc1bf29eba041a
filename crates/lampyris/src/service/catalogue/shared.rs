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

    /// Puts another in the place of one that was read before, and says whether that was still the newest:
    /// what has been added meanwhile may not be in the other one, and stays.
    pub(in crate::service) fn replace(&self, before: &Arc<Catalogue>, catalogue: Self) -> bool {
        Arc::ptr_eq(&self.0.compare_and_swap(before, catalogue.0.into_inner()), before)
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

#[cfg(test)]
mod tests {
    use super::*;
    use lampyris_core::model::document::ModelDocument;

    #[test]
    fn what_was_added_meanwhile_stays() {
        let shared = || SharedCatalogue(ArcSwap::from_pointee(Catalogue::default()));
        let text = "id = \"lone\"\ntitle = \"alone\"\nbase = \"rc1\"\neffects = []";
        let document = ModelDocument::from_toml(text).unwrap();
        let (catalogue, before) = (shared(), Arc::new(Catalogue::default()));
        assert!(!catalogue.replace(&before, shared()), "that is not what stands there");
        let before = catalogue.current();
        catalogue.change(|catalogue| catalogue.add_model(document.clone()));
        let added = catalogue.current();
        assert!(!catalogue.replace(&before, shared()) && Arc::ptr_eq(&catalogue.current(), &added));
        assert!(catalogue.replace(&added, shared()) && !Arc::ptr_eq(&catalogue.current(), &added));
    }
}
