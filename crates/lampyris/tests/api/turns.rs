//! Who is next where several tenants wait.

use crate::support::{cluster, stubs};
use lampyris::store::jobs::Priority;
use lampyris::store::{DatabasePlace, Store};
use lampyris_core::data::SystemId;

/// A store in which these tenants submit so many jobs each, of as many rooms, one tenant after another;
/// everything that waits is then claimed and ended. Gives the tenants in the order of their claims.
fn claimed(crowds: &[(&str, usize, Priority)]) -> Vec<String> {
    let folder = tempfile::tempdir().unwrap();
    let place = cluster::database().unwrap_or_else(|| DatabasePlace::from(folder.path().join("turns.db")));
    let work = async {
        let store = Store::open(&place, None).await.unwrap();
        for (tenant, rooms, priority) in crowds {
            let rooms: Vec<SystemId> =
                (0..*rooms).map(|room| format!("room/{tenant}-{room}").parse().unwrap()).collect();
            for room in &rooms {
                stubs::put_room(&store, room, tenant).await;
            }
            stubs::submit(&store, &stubs::batch(rooms, *priority)).await;
        }
        let worker = stubs::enlist(&store, "one").await;
        let mut order = Vec::new();
        while let Some((room, _)) = stubs::claim_and_end(&store, worker).await {
            order.push(room.to_string()["room/".len()..].split('-').next().unwrap().to_owned());
        }
        store.close().await;
        order
    };
    let order = tokio::runtime::Runtime::new().unwrap().block_on(work);
    cluster::drop_database(&place);
    assert_eq!(order.len(), crowds.iter().map(|(_, rooms, _)| rooms).sum::<usize>());
    order
}

#[test]
fn ten_equal_tenants_get_equal_shares_whoever_came_first() {
    let names: Vec<String> = (0..10).map(|tenant| format!("t{tenant}")).collect();
    let crowds: Vec<_> = names.iter().map(|name| (name.as_str(), 20, Priority::Operator)).collect();
    let order = claimed(&crowds);
    let share = |name: &String| order[..100].iter().filter(|tenant| *tenant == name).count();
    assert!(names.iter().all(|name| share(name) == 10), "{order:?}");
}

#[test]
fn a_tenant_of_few_jobs_waits_for_one_of_a_tenant_of_many() {
    let order = claimed(&[("many", 200, Priority::Nightly), ("few", 10, Priority::Interactive)]);
    let places: Vec<usize> = (0..order.len()).filter(|place| order[*place] == "few").collect();
    assert!(places.iter().enumerate().all(|(nth, place)| *place <= 2 * nth + 1), "{places:?}");
}
