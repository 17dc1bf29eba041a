//! Pages of the lists that are cut by what a caller may see.

use super::database::Store;
use super::error::StoreError;
use super::reach::SystemScope;
use super::statement::{FromEither, query_as};
use lampyris_core::data::SystemId;

/// The rows of one page of a list, of one system or of all within a reach. The statement knows the system as
/// `$1`, the place before which the page lies as `$2`, its length as `$3` and the reach as `$4`.
pub(super) async fn rows<R: FromEither>(
    store: &Store,
    sql: &'static str,
    reach: &SystemScope,
    system: Option<&SystemId>,
    before: i64,
    limit: i64,
) -> Result<Vec<R>, StoreError> {
    let query = query_as(sql).bind(system.map(ToString::to_string)).bind(before).bind(limit);
    Ok(query.bind(reach.sql()?).fetch_all(&store.reader).await?)
}
