//! The only SQL. One file per noun; functions take the [`Store`] and return records, never open transactions.
//!
//! SQLite in WAL mode with `synchronous = FULL`: what was acknowledged survives the power cord. There is one
//! writer connection and a small pool of readers, and every writing transaction is `BEGIN IMMEDIATE`, because
//! SQLite refuses a transaction that reads first and writes later as soon as somebody else has written.
//!
//! | file | what it keeps |
//! |---|---|
//! | `systems` | documents of rooms and plants |
//! | `windows` | uploaded measurements |
//! | `shares` | what each of them gave to what counts |
//! | `days`, `measured` | what counts, by day, and what readers ask of it |
//! | `months`, `expiry` | the months that tables of samples are kept by, and how they are forgotten |
//! | `packed` | channels and documents as rows have them, compressed |
//! | `taking_in` | measurements of earlier programs on their way there |
//! | `uploads` | how an upload is taken |
//! | `sources` | where measurements of other programs belong |
//! | `samples`, `open_rows` | live samples, until they are laid into the days |
//! | `forecast_inputs` | what was forecast of inputs, apart from measurements |
//! | `said` | what forecasts said, until it is compared with what came |
//! | `models` | model and effect documents of users, versions made by adding effects |
//! | `job`, `job_record` | what a job is: its words, and what its state implies |
//! | `jobs` | jobs as they are listed |
//! | `entry`, `entering` | how jobs enter the queue, one or very many |
//! | `queue` | how jobs wait: submit, claim with a lease, cancel, recover |
//! | `events` | jobs that came or ended after a number |
//! | `finish` | the end of a job: job, fit, verdict and revision in one transaction |
//! | `batches` | recalibrations and diagnoses of several systems |
//! | `fits` | what was found, with its verdict |
//! | `overview` | what a list of systems reads of each |
//! | `diagnoses` | which effects models are missing, and the error ladders |
//! | `evidence` | what every window showed of every effect, for longer than its diagnosis |
//! | `params` | what is served, with all that is said of it |
//! | `revisions` | everything that was ever served |
//! | `offers` | what waits for an operator: one condition for all statements |
//! | `decisions`, `pins` | an operator's word: on held and suggested fits, and on what stays in service |
//! | `audit` | what operators did, when, and under which name |
//! | `degradations` | what newer measurements say of what is served |
//! | `metrics` | how long the queue is |
//! | `retry` | jobs that are done again |
//! | `retention` | what is old and goes |
//! | `schedules` | when batches are submitted |
//! | `tokens`, `reach` | who may ask, and about which systems |
//! | `idempotency` | keys of requests that created something |
//! | `database`, `file` | the writer and the readers of one service; how the file is opened |
//! | `lock`, `files` | who has a database, and whether its files are still those that were opened |
//! | `schema`, `migrate` | which schema a database has, and how it is brought up to date |
//! | `page` | pages of the lists that are cut by what a caller may see |
//! | `sequence`, `value`, `words`, `row` | how ids are made, and how values stand in columns |
//! | `write` | write transactions, and what they tell of the disk |
//! | `changes` | which systems a commit was about, for the one who follows what is served |
//! | `backup` | copies of a database, and their way back |
//! | `doctor`, `server` | how a database fares, in a file and on a server |
//! | `failpoint` | where tests let the process die |

pub mod audit;
pub mod backup;
pub mod batches;
mod changes;
mod database;
pub mod days;
pub mod decisions;
pub mod degradations;
pub mod diagnoses;
pub mod doctor;
mod engine;
pub mod entering;
pub mod entry;
mod error;
pub mod events;
pub mod evidence;
pub mod expiry;
pub mod failpoint;
pub mod feed;
mod file;
mod files;
pub mod finish;
pub mod fits;
pub mod forecast_inputs;
pub mod idempotency;
mod job;
mod job_record;
pub mod jobs;
mod lock;
pub mod measured;
pub mod metrics;
pub mod migrate;
pub mod models;
mod months;
pub mod moving;
mod offers;
mod open_rows;
pub mod overview;
mod packed;
mod page;
pub mod params;
pub mod pins;
mod place;
mod postgres;
pub mod queue;
pub mod reach;
pub mod retention;
pub mod retry;
pub mod revisions;
mod row;
pub mod said;
pub mod samples;
pub mod schedules;
mod schema;
mod sequence;
pub mod server;
pub mod shares;
pub mod sources;
mod statement;
pub mod systems;
mod taking_in;
pub mod tokens;
pub mod uploads;
mod value;
pub mod windows;
mod words;
pub mod workers;
mod write;

pub use changes::Change;
pub use database::Store;
pub use error::{StoreError, busy};
pub use place::DatabasePlace;
pub use words::UnknownWord;
