//! `lampyris doctor`: looks at everything that the service stands on, and says what to do.

use super::database::Database;
use super::output::Failure;
use super::serve;
use crate::settings::Settings;
use crate::store::doctor::{DatabaseState, look};
use crate::store::server::{self, ServerState};
use crate::store::{DatabasePlace, StoreError};
use Status::{Fail, Fine, Warn};
use jiff::tz::TimeZone;
use lampyris_core::cpu::Cpu;
use rustix::process::{Resource, getrlimit};
use serde::Serialize;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

/// A log beyond this is not folded into the database as it should be.
const LONG_LOG: u64 = 64 << 20;
/// With less room than this the next window may not fit.
const NO_ROOM: u64 = 64 << 20;
/// Room that a service should have beside what its database needs for a copy of itself.
const ROOM: u64 = 1 << 30;
/// Open files that serve a few hundred controllers.
const OPEN_FILES: u64 = 1024;

/// How a check ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
enum Status {
    #[serde(rename = "ok")]
    Fine,
    Warn,
    Fail,
}

/// One line of the doctor.
#[derive(Debug, Serialize)]
struct Check {
    name: &'static str,
    status: Status,
    /// What was found, and what to do about it.
    detail: String,
}

impl Check {
    fn line(&self) -> String {
        let word = match self.status {
            Fine => "ok",
            Warn => "warn",
            Fail => "FAIL",
        };
        format!("{word:<5} {:<14} {}", self.name, self.detail)
    }
}

pub fn run(arguments: &Database) -> Result<(), Failure> {
    let mut checks = Vec::new();
    let mut say = |name, (status, detail)| checks.push(Check { name, status, detail });
    let settings = match arguments.settings() {
        Ok(settings) => {
            say("configuration", (Fine, "every setting makes sense".to_owned()));
            settings
        }
        Err(found) => {
            let list: Vec<String> = found.iter().map(ToString::to_string).collect();
            say(
                "configuration",
                (
                    Fail,
                    format!("correct the settings, the defaults were looked at instead: {}", list.join("; ")),
                ),
            );
            Settings::default()
        }
    };
    match &settings.database {
        DatabasePlace::Server(url) => match serve::runtime()?.block_on(server::look(url)) {
            Ok(found) => server_state(&found, &mut say),
            Err(error) => say("database", (Fail, error.to_string())),
        },
        DatabasePlace::File(path) => {
            let folder =
                path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
            let found = serve::runtime()?.block_on(look(path));
            let bytes = found.as_ref().map_or(0, |found| found.bytes);
            match found {
                Ok(found) => {
                    say("database", database(&found));
                    say("schema", schema(&found));
                    say("log", log(&found));
                    say("clock", clock(&found, &settings.zone));
                }
                Err(StoreError::NoFile(file)) => {
                    say(
                        "database",
                        (Warn, format!("there is no {}: `lampyris serve` makes it", file.display())),
                    );
                }
                Err(error) => say("database", (Fail, error.to_string())),
            }
            say("disk", disk(folder, bytes));
            say("folder", permissions(folder, path));
        }
    }
    say("files", open_files());
    say("cpu", cpu());
    let failed = checks.iter().filter(|check| check.status == Fail).count();
    let lines: Vec<String> = checks.iter().map(Check::line).collect();
    arguments.show(&serde_json::json!({"healthy": failed == 0, "checks": checks}), &lines.join("\n"));
    if failed == 0 {
        Ok(())
    } else {
        Err(Failure::Error(format!("{failed} of {} checks failed", checks.len())))
    }
}

/// What there is to say of a database on a server.
fn server_state(found: &ServerState, say: &mut impl FnMut(&'static str, (Status, String))) {
    let megabytes = found.bytes >> 20;
    say("database", (Fine, format!("PostgreSQL {}, {megabytes} MiB", found.release)));
    let (alive, silent) = found.processes;
    let status = if silent == 0 { Fine } else { Warn };
    say("processes", (status, format!("{alive} have a lease, {silent} are silent")));
    say(
        "transactions",
        match found.idle {
            0 => (Fine, "none is idle".to_owned()),
            idle => {
                (Warn, format!("{idle} are idle for a minute: nothing old can be cleared away behind them"))
            }
        },
    );
    say(
        "tables",
        match found.bloated.join(", ") {
            none if none.is_empty() => (Fine, "few rows are dead".to_owned()),
            bloated => (Warn, format!("most rows of {bloated} are dead: let autovacuum go there more often")),
        },
    );
    say(
        "statistics",
        match found.unknown.join(", ") {
            none if none.is_empty() => (Fine, "the server knows what the tables hold".to_owned()),
            unknown => (Warn, format!("there are none of {unknown}: run ANALYZE")),
        },
    );
    say(
        "standby",
        match found.standbys {
            (0, _) => (Warn, "there is none that this role can see".to_owned()),
            (all, 0) => {
                (Warn, format!("no commit waits for any of {all}: a failover may lose what was acknowledged"))
            }
            (all, waits) => (Fine, format!("commits wait for {waits} of {all}")),
        },
    );
}

fn database(found: &DatabaseState) -> (Status, String) {
    let user = if found.in_use { "a service has it open" } else { "no service has it open" };
    match &found.soundness {
        Ok(()) => {
            (Fine, format!("every page, index and reference is in order; {} bytes, {user}", found.bytes))
        }
        Err(error) => (Fail, error.to_string()),
    }
}

fn schema(found: &DatabaseState) -> (Status, String) {
    match &found.schema {
        Ok((schema, newest)) if schema == newest => (Fine, format!("schema {schema}, the newest")),
        Ok((schema, newest)) => (
            Warn,
            format!(
                "schema {schema}, and this program has {newest}: `lampyris migrate` or the next start brings \
                it up to date"
            ),
        ),
        Err(error) => (Fail, error.to_string()),
    }
}

fn log(found: &DatabaseState) -> (Status, String) {
    let size = found.log_bytes;
    if size <= LONG_LOG {
        return (Fine, format!("the write-ahead log has {size} bytes"));
    }
    (
        Warn,
        format!(
            "the write-ahead log has {size} bytes: something reads the database for long; end that, or \
            restart the service"
        ),
    )
}

fn clock(found: &DatabaseState, zone: &str) -> (Status, String) {
    let now = crate::service::now();
    if let Err(error) = TimeZone::get(zone) {
        return (Fail, format!("the time zone of schedules is not known: {error}"));
    }
    match &found.newest_row {
        Ok(Some(newest)) if *newest > now => (
            Fail,
            format!(
                "it is {now:.0}, and the database was written at {newest:.0}: set the clock of this machine"
            ),
        ),
        Ok(_) => (Fine, format!("it is {now:.0}, schedules follow {zone}")),
        Err(_) => (
            Warn,
            format!("it is {now:.0}; the database cannot tell whether that is later than its newest row"),
        ),
    }
}

fn disk(folder: &Path, database: u64) -> (Status, String) {
    match rustix::fs::statvfs(folder) {
        Ok(disk) => {
            let free = disk.f_bavail.saturating_mul(disk.f_frsize);
            let place = folder.display();
            if free < NO_ROOM {
                (Fail, format!("{free} bytes are free in {place}: make room, or writes will be refused"))
            } else if free < ROOM.saturating_add(database) {
                (
                    Warn,
                    format!(
                        "{free} bytes are free in {place}: a migration needs as much again as the database, \
                        so make room soon"
                    ),
                )
            } else {
                (Fine, format!("{free} bytes are free in {place}"))
            }
        }
        Err(error) => (
            Fail,
            format!("{} cannot be looked at ({error}): make the folder, or set `database`", folder.display()),
        ),
    }
}

/// SQLite makes files beside the database, so the folder must be writable as well.
fn permissions(folder: &Path, database: &Path) -> (Status, String) {
    let probe = folder.join(".lampyris-doctor");
    // A page, since a disk without room for one still takes an empty file.
    if let Err(error) = fs::write(&probe, [0; 4096]).and_then(|()| fs::remove_file(&probe)) {
        // A part of it may be there.
        let _ = fs::remove_file(&probe);
        return (
            Fail,
            format!(
                "{} cannot be written ({error}): make room, or give it to the user who runs the service; \
                until then a service only reads what is there",
                folder.display()
            ),
        );
    }
    for path in [folder, database] {
        let Ok(found) = fs::metadata(path) else { continue };
        // A sticky folder such as /tmp lets nobody touch the files of others.
        let mode = found.permissions().mode();
        if mode & 0o002 != 0 && mode & 0o1000 == 0 {
            return (
                Warn,
                format!("everybody on this machine can change {0}: `chmod o-w {0}`", path.display()),
            );
        }
    }
    (Fine, format!("{} can be written", folder.display()))
}

fn open_files() -> (Status, String) {
    match getrlimit(Resource::Nofile).current {
        Some(limit) if limit < OPEN_FILES => (
            Warn,
            format!(
                "{limit} files may be open at once, and every connection is one: raise it with `ulimit -n \
                {OPEN_FILES}`"
            ),
        ),
        Some(limit) => (Fine, format!("{limit} files may be open at once")),
        None => (Fine, "any number of files may be open at once".to_owned()),
    }
}

fn cpu() -> (Status, String) {
    let cpu = Cpu::detect();
    match cpu.name() {
        "baseline" => (
            Warn,
            "this CPU has no AVX2: fits take several times as long, their results are the same".to_owned(),
        ),
        name => (Fine, format!("simulations use {name}")),
    }
}
