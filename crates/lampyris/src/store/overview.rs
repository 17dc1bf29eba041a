//! What a list of systems reads of each, a statement for a page of them: their fits, what diagnoses say of
//! their models, their newest samples. What has to be unpacked or parsed is left as it is, for a blocking
//! thread.

use super::database::Store;
use super::diagnoses::MissingEffect;
use super::error::StoreError;
use super::fits::FitText;
use super::measured;
use super::offers::waits;
use super::row::row;
use super::statement::{query_as, query_scalar};
use super::value::{from_json, from_word, to_json};
use jiff::Timestamp;
use lampyris_core::diagnose::report::Adequacy;
use std::collections::{HashMap, HashSet};

/// Validation errors that a trend has at most.
const TREND: i64 = 14;

/// The newest diagnosis of the model that a system has.
#[derive(Debug, Clone, PartialEq)]
pub struct PresentDiagnosis {
    /// Its verdict.
    pub verdict: Adequacy,
    /// The first effect that it has named.
    pub missing: Option<MissingEffect>,
}

/// What is read of a page of systems, each by its name where there is any.
#[derive(Debug, Default)]
pub struct Overview {
    /// The fit that is served; of a system that serves none the newest one of its model.
    pub fits: HashMap<String, FitText>,
    /// The newest diagnosis of its model.
    pub diagnoses: HashMap<String, PresentDiagnosis>,
    /// The instant of its newest sample.
    pub measured_to: HashMap<String, Timestamp>,
    /// Systems in which a fit of their model, newer than what is served, waits for an operator.
    pub waiting: HashSet<String>,
}

row! {
    struct FitRow {
        system: String,
        listed: Option<String>,
        document: Option<Vec<u8>>,
    }
}

row! {
    struct DiagnosisRow {
        system: String,
        verdict: String,
        missing: Option<String>,
    }
}

/// Everything but the trends.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn read(store: &Store, systems: &[String]) -> Result<Overview, StoreError> {
    let mut overview = Overview { fits: fits(store, systems).await?, ..Overview::default() };
    let sql = "SELECT d.system, d.verdict, d.missing FROM diagnoses d WHERE d.sequence IN (SELECT \
        MAX(n.sequence) FROM diagnoses n JOIN jobs j ON j.id = n.job \
        JOIN systems s ON s.system = n.system AND s.model = j.model \
        WHERE n.system IN (SELECT value FROM json_each($1)) GROUP BY n.system)";
    let rows: Vec<DiagnosisRow> =
        query_as(sql).bind(to_json("systems", systems)?).fetch_all(&store.reader).await?;
    for DiagnosisRow { system, verdict, missing } in rows {
        let missing = missing.map(|missing| from_json("a missing effect", &missing)).transpose()?;
        let verdict = from_word("a verdict", &verdict)?;
        overview.diagnoses.insert(system, PresentDiagnosis { verdict, missing });
    }
    overview.measured_to = measured::newest(store, systems).await?;
    let sql = concat!(
        "SELECT f.system FROM fits f JOIN systems s ON s.system = f.system AND s.model = f.model \
        WHERE f.system IN (SELECT value FROM json_each($1)) AND f.rowid > COALESCE(\
        (SELECT v.rowid FROM revisions r JOIN fits v ON v.id = r.fit WHERE r.system = f.system AND r.current), 0) AND ",
        waits!("f.id")
    );
    let waiting: Vec<String> =
        query_scalar(sql).bind(to_json("systems", systems)?).fetch_all(&store.reader).await?;
    overview.waiting = waiting.into_iter().collect();
    Ok(overview)
}

async fn fits(store: &Store, systems: &[String]) -> Result<HashMap<String, FitText>, StoreError> {
    macro_rules! listed {
        ($which:literal) => {
            concat!(
                "SELECT f.system, f.listed, CASE WHEN f.listed IS NULL THEN f.document END AS document FROM fits f WHERE ",
                $which
            )
        };
    }
    let served = listed!(
        "f.id IN (SELECT fit FROM revisions WHERE current AND system IN (SELECT value FROM json_each($1)))"
    );
    let newest = listed!(
        "f.rowid IN (SELECT MAX(n.rowid) FROM fits n JOIN systems s ON s.system = n.system AND s.model = n.model \
        WHERE n.system IN (SELECT value FROM json_each($1)) GROUP BY n.system)"
    );
    let mut found = HashMap::new();
    for sql in [served, newest] {
        let left: Vec<&String> = systems.iter().filter(|system| !found.contains_key(*system)).collect();
        let rows: Vec<FitRow> =
            query_as(sql).bind(to_json("systems", &left)?).fetch_all(&store.reader).await?;
        found.extend(rows.into_iter().map(|row| (row.system, FitText::new(row.listed, row.document))));
    }
    Ok(found)
}

/// The last validation errors of each of these systems, the newest at the end: of fits of the model that it
/// has, without experiments and without those that kept a test part aside.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn trends(
    store: &Store,
    systems: &[String],
) -> Result<HashMap<String, Vec<f64>>, StoreError> {
    let sql = "SELECT t.system, t.validation_rmse FROM (SELECT f.system, f.validation_rmse, f.rowid AS place, \
        ROW_NUMBER() OVER (PARTITION BY f.system ORDER BY f.rowid DESC) AS back FROM fits f \
        JOIN systems s ON s.system = f.system AND s.model = f.model WHERE f.validation_rmse IS NOT NULL \
        AND f.system IN (SELECT value FROM json_each($1))) t WHERE t.back <= $2 ORDER BY t.system, t.place";
    let rows: Vec<(String, f64)> =
        query_as(sql).bind(to_json("systems", systems)?).bind(TREND).fetch_all(&store.reader).await?;
    let mut trends: HashMap<String, Vec<f64>> = HashMap::new();
    for (system, error) in rows {
        trends.entry(system).or_default().push(error);
    }
    Ok(trends)
}
