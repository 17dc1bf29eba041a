//! What an operator can set: a TOML file, and the environment, which wins.

mod jobs;
mod notify;
mod tls;

pub use jobs::{Diagnose, Estimates};
pub use notify::{NoticeFormat, NoticeKind, NoticeSecret, NotifySettings};
pub use tls::TlsFiles;

use crate::store::DatabasePlace;
use crate::store::workers::ProcessRole;
use lampyris_core::fault::{Fault, nearest};
use serde::{Deserialize, Serialize};
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::Path;
use std::time::Duration;

/// The settings of a service. Every field has a default that serves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Address and port to listen on; port 0 takes a free one.
    pub bind: SocketAddr,
    /// The database: a file, which is made if it is not there, or the URL of a PostgreSQL server.
    pub database: DatabasePlace,
    /// What this process does; all of it by default.
    pub roles: Vec<ProcessRole>,
    /// How long this process may be silent before others that share its database take its jobs over, in
    /// seconds.
    pub lease_seconds: u64,
    /// Jobs that run at the same time.
    pub workers: usize,
    /// CPU threads of each job; 0 takes as many as there are cores.
    pub threads: usize,
    /// The IANA time zone of schedules that name none.
    pub zone: String,
    /// Names by which the service may be asked, beside addresses and `localhost`: those that its proxy passes
    /// on.
    pub hosts: Vec<String>,
    /// The certificate, where the service speaks TLS itself.
    pub tls: Option<TlsFiles>,
    /// What a single user may ask for.
    pub limits: Limits,
    /// How long what is old is kept.
    pub retention: Retention,
    /// What estimates go by.
    pub estimate: Estimates,
    /// What diagnoses go by that are not asked for otherwise.
    pub diagnose: Diagnose,
    /// Whom the service tells what happens.
    pub notify: Option<NotifySettings>,
}

/// How many days something is kept that nothing names any more; 0 keeps it for ever. What was ever served is
/// kept, with its fit and the windows that the fit has read.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Retention {
    /// Jobs that have ended, with their fits and the reports of their batches.
    pub jobs_days: u32,
    /// Diagnoses and ladders; the newest of a system stays.
    pub diagnoses_days: u32,
    /// Windows, counted back from the newest sample of their system.
    pub windows_days: u32,
    /// Samples, by whole months of UTC, whatever fits have read them; what was found in them stays.
    pub samples_days: u32,
    /// The ways of searches, and how estimates err together, of fits that were never served.
    pub traces_days: u32,
}

/// Limits that keep one request from starving the others.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Limits {
    /// Largest window in bytes.
    pub window_bytes: usize,
    /// Largest body of any other request in bytes.
    pub body_bytes: usize,
    /// Most bytes of bodies that are read or worked on at a time, half of them for one token; there is always
    /// room for two of the largest.
    pub bodies_bytes: usize,
    /// Most jobs that wait.
    pub queue: usize,
    /// Most of those jobs of one system.
    pub queue_per_system: usize,
    /// Longest a job may run, in seconds, whatever it asks for.
    pub job_seconds: u64,
    /// Most connections at a time, a quarter of them for those that have shown no token. Whoever comes when
    /// all are taken gets the place of one that has been quiet for long.
    pub connections: usize,
    /// Most of those connections from one address.
    pub connections_per_peer: usize,
    /// Most connections of one token.
    pub connections_per_token: usize,
    /// Most streams of events at a time.
    pub streams: usize,
    /// Most streams of events of one token.
    pub streams_per_token: usize,
    /// Seconds that a client may take for the head of a request, or leave a connection idle.
    pub header_seconds: u64,
    /// Seconds that a client may take to send a body.
    pub body_seconds: u64,
    /// Seconds that a client may leave an answer untaken.
    pub write_seconds: u64,
    /// Largest database in bytes; 0 leaves it to the disk. Windows are refused from nine tenths of it.
    pub database_bytes: u64,
}

impl Limits {
    /// What all bodies may take at a time, in bytes: one of the largest size fits into the half of its token.
    pub fn all_bodies(&self) -> usize {
        self.bodies_bytes.max(self.window_bytes.max(self.body_bytes).saturating_mul(2))
    }

    /// The quota of the database, if there is one.
    pub fn quota(&self) -> Option<u64> {
        (self.database_bytes > 0).then_some(self.database_bytes)
    }
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            bind: SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 8080),
            database: DatabasePlace::File("lampyris.db".into()),
            roles: ProcessRole::ALL.to_vec(),
            lease_seconds: 30,
            workers: 2,
            threads: 0,
            zone: "UTC".to_owned(),
            hosts: Vec::new(),
            tls: None,
            limits: Limits::default(),
            retention: Retention::default(),
            estimate: Estimates::default(),
            diagnose: Diagnose::default(),
            notify: None,
        }
    }
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            window_bytes: 64 << 20,
            body_bytes: 1 << 20,
            bodies_bytes: 128 << 20,
            queue: 10_000,
            queue_per_system: 1_000,
            job_seconds: 3_600,
            connections: 4_096,
            connections_per_peer: 64,
            connections_per_token: 1_024,
            streams: 512,
            streams_per_token: 64,
            header_seconds: 10,
            body_seconds: 30,
            write_seconds: 10,
            database_bytes: 0,
        }
    }
}

impl Default for Retention {
    fn default() -> Self {
        Self { jobs_days: 365, diagnoses_days: 0, windows_days: 0, samples_days: 0, traces_days: 0 }
    }
}

/// The variables of the environment and the fields that they stand for.
const VARIABLES: [(&str, &str); 37] = [
    ("LAMPYRIS_BIND", "/bind"),
    ("LAMPYRIS_DATABASE", "/database"),
    ("LAMPYRIS_ROLES", "/roles"),
    ("LAMPYRIS_LEASE_SECONDS", "/lease_seconds"),
    ("LAMPYRIS_WORKERS", "/workers"),
    ("LAMPYRIS_THREADS", "/threads"),
    ("LAMPYRIS_ZONE", "/zone"),
    ("LAMPYRIS_HOSTS", "/hosts"),
    ("LAMPYRIS_TLS_CERTIFICATE", "/tls/certificate"),
    ("LAMPYRIS_TLS_KEY", "/tls/key"),
    ("LAMPYRIS_LIMITS_WINDOW_BYTES", "/limits/window_bytes"),
    ("LAMPYRIS_LIMITS_BODY_BYTES", "/limits/body_bytes"),
    ("LAMPYRIS_LIMITS_BODIES_BYTES", "/limits/bodies_bytes"),
    ("LAMPYRIS_LIMITS_QUEUE", "/limits/queue"),
    ("LAMPYRIS_LIMITS_QUEUE_PER_SYSTEM", "/limits/queue_per_system"),
    ("LAMPYRIS_LIMITS_JOB_SECONDS", "/limits/job_seconds"),
    ("LAMPYRIS_LIMITS_CONNECTIONS", "/limits/connections"),
    ("LAMPYRIS_LIMITS_CONNECTIONS_PER_PEER", "/limits/connections_per_peer"),
    ("LAMPYRIS_LIMITS_CONNECTIONS_PER_TOKEN", "/limits/connections_per_token"),
    ("LAMPYRIS_LIMITS_STREAMS", "/limits/streams"),
    ("LAMPYRIS_LIMITS_STREAMS_PER_TOKEN", "/limits/streams_per_token"),
    ("LAMPYRIS_LIMITS_HEADER_SECONDS", "/limits/header_seconds"),
    ("LAMPYRIS_LIMITS_BODY_SECONDS", "/limits/body_seconds"),
    ("LAMPYRIS_LIMITS_WRITE_SECONDS", "/limits/write_seconds"),
    ("LAMPYRIS_LIMITS_DATABASE_BYTES", "/limits/database_bytes"),
    ("LAMPYRIS_RETENTION_JOBS_DAYS", "/retention/jobs_days"),
    ("LAMPYRIS_RETENTION_DIAGNOSES_DAYS", "/retention/diagnoses_days"),
    ("LAMPYRIS_RETENTION_WINDOWS_DAYS", "/retention/windows_days"),
    ("LAMPYRIS_RETENTION_SAMPLES_DAYS", "/retention/samples_days"),
    ("LAMPYRIS_RETENTION_TRACES_DAYS", "/retention/traces_days"),
    ("LAMPYRIS_ESTIMATE_BORROW", "/estimate/borrow"),
    ("LAMPYRIS_DIAGNOSE_ACCUSATION_RATE", "/diagnose/accusation_rate"),
    ("LAMPYRIS_NOTIFY_URL", "/notify/url"),
    ("LAMPYRIS_NOTIFY_EVENTS", "/notify/events"),
    ("LAMPYRIS_NOTIFY_SECRET", "/notify/secret"),
    ("LAMPYRIS_NOTIFY_FORMAT", "/notify/format"),
    ("LAMPYRIS_NOTIFY_PAGE", "/notify/page"),
];

/// Variables of the same prefix that are no settings.
const OTHERS: [&str; 6] = ["CA", "CONFIG", "LOG", "TESTS", "TOKEN", "URL"];

impl Settings {
    /// Reads a file, if there is one, and then the environment.
    ///
    /// # Errors
    /// Every fault: a file that cannot be read, unknown fields, values that make no sense, and variables that
    /// look like a slip of the pen.
    pub fn load(
        file: Option<&Path>,
        environment: impl IntoIterator<Item = (String, String)>,
    ) -> Result<Self, Vec<Fault>> {
        let mut faults = Vec::new();
        let mut settings = match file.map(|file| (file, std::fs::read_to_string(file))) {
            None => Self::default(),
            Some((file, Err(error))) => {
                faults.push(Fault::new(file.display().to_string(), "unreadable", error.to_string()));
                Self::default()
            }
            Some((file, Ok(text))) => toml::from_str(&text).unwrap_or_else(|error| {
                let line = error
                    .span()
                    .map_or(1, |span| 1 + text[..span.start.min(text.len())].matches('\n').count());
                faults.push(Fault::new(
                    format!("{} line {line}", file.display()),
                    "invalid-settings",
                    error.message().to_owned(),
                ));
                Self::default()
            }),
        };
        for (name, value) in environment {
            match VARIABLES.iter().find(|(known, _)| *known == name) {
                Some((_, field)) => {
                    if let Err(detail) = settings.set(field, &value) {
                        faults.push(Fault::new(name, "invalid-settings", detail));
                    }
                }
                // Other variables may share the prefix; one that is nearly ours is a slip that must not go
                // unnoticed.
                None if name.starts_with("LAMPYRIS_") && !OTHERS.contains(&&name[9..]) => {
                    let close = nearest(&name[9..], VARIABLES.iter().map(|(known, _)| &known[9..]));
                    if let Some(known) = close {
                        faults.push(
                            Fault::new(&name, "unknown-setting", format!("`{name}` is no setting"))
                                .suggest(format!("did you mean `LAMPYRIS_{known}`?")),
                        );
                    }
                }
                None => {}
            }
        }
        faults.extend(settings.faults());
        if faults.is_empty() { Ok(settings) } else { Err(faults) }
    }

    /// How long this process may be silent.
    pub fn lease(&self) -> Duration {
        Duration::from_secs(self.lease_seconds)
    }

    /// Whether this process has a part.
    pub fn has(&self, role: ProcessRole) -> bool {
        self.roles.contains(&role)
    }

    /// Sets one field from a text.
    fn set(&mut self, field: &str, text: &str) -> Result<(), String> {
        fn read<T: std::str::FromStr<Err: std::fmt::Display>>(
            target: &mut T,
            text: &str,
        ) -> Result<(), String> {
            *target = text.parse().map_err(|error: T::Err| format!("`{text}`: {error}"))?;
            Ok(())
        }
        match field {
            "/bind" => read(&mut self.bind, text),
            "/database" => read(&mut self.database, text),
            "/roles" => {
                self.roles = ProcessRole::list(text).map_err(|error| error.to_string())?;
                Ok(())
            }
            "/lease_seconds" => read(&mut self.lease_seconds, text),
            "/workers" => read(&mut self.workers, text),
            "/threads" => read(&mut self.threads, text),
            "/zone" => read(&mut self.zone, text),
            "/hosts" => {
                self.hosts = text.split(',').map(|host| host.trim().to_owned()).collect();
                Ok(())
            }
            "/tls/certificate" => read(&mut self.tls.get_or_insert_default().certificate, text),
            "/tls/key" => read(&mut self.tls.get_or_insert_default().key, text),
            "/limits/window_bytes" => read(&mut self.limits.window_bytes, text),
            "/limits/body_bytes" => read(&mut self.limits.body_bytes, text),
            "/limits/bodies_bytes" => read(&mut self.limits.bodies_bytes, text),
            "/limits/queue_per_system" => read(&mut self.limits.queue_per_system, text),
            "/limits/queue" => read(&mut self.limits.queue, text),
            "/limits/job_seconds" => read(&mut self.limits.job_seconds, text),
            "/limits/connections" => read(&mut self.limits.connections, text),
            "/limits/connections_per_peer" => read(&mut self.limits.connections_per_peer, text),
            "/limits/connections_per_token" => read(&mut self.limits.connections_per_token, text),
            "/limits/streams" => read(&mut self.limits.streams, text),
            "/limits/streams_per_token" => read(&mut self.limits.streams_per_token, text),
            "/limits/header_seconds" => read(&mut self.limits.header_seconds, text),
            "/limits/body_seconds" => read(&mut self.limits.body_seconds, text),
            "/limits/write_seconds" => read(&mut self.limits.write_seconds, text),
            "/limits/database_bytes" => read(&mut self.limits.database_bytes, text),
            "/retention/jobs_days" => read(&mut self.retention.jobs_days, text),
            "/retention/diagnoses_days" => read(&mut self.retention.diagnoses_days, text),
            "/retention/windows_days" => read(&mut self.retention.windows_days, text),
            "/retention/samples_days" => read(&mut self.retention.samples_days, text),
            "/retention/traces_days" => read(&mut self.retention.traces_days, text),
            "/estimate/borrow" => read(&mut self.estimate.borrow, text),
            "/diagnose/accusation_rate" => read(&mut self.diagnose.accusation_rate, text),
            _ => self.notify.get_or_insert_default().set(field, text),
        }
    }

    /// Values that make no sense.
    pub fn faults(&self) -> Vec<Fault> {
        let mut faults = Vec::new();
        let mut demand = |holds: bool, field: &str, detail: &str| {
            if !holds {
                faults.push(Fault::new(field, "invalid-settings", detail));
            }
        };
        demand(!self.roles.is_empty(), "/roles", "a process has a part: api, worker or scheduler");
        demand((3..=3600).contains(&self.lease_seconds), "/lease_seconds", "a lease lasts 3 s to an hour");
        demand((1..=64).contains(&self.workers), "/workers", "there are between 1 and 64 workers");
        demand(self.threads <= 1024, "/threads", "there are at most 1024 threads");
        demand(
            jiff::tz::TimeZone::get(&self.zone).is_ok(),
            "/zone",
            "this is no IANA time zone, such as `Europe/Copenhagen`",
        );
        for host in &self.hosts {
            let is_host = !host.is_empty()
                && host.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"-_.".contains(&byte));
            let detail =
                format!("`{host}` is no name of a host, such as `lampyris.example.org`, without a port");
            demand(is_host, "/hosts", &detail);
        }
        if let Some(tls) = &self.tls {
            for (field, file) in [("/tls/certificate", &tls.certificate), ("/tls/key", &tls.key)] {
                demand(!file.as_os_str().is_empty(), field, "certificate and key go together");
            }
        }
        demand(
            self.limits.window_bytes >= 1024,
            "/limits/window_bytes",
            "a window needs at least 1024 bytes",
        );
        demand(self.limits.body_bytes >= 1024, "/limits/body_bytes", "a body needs at least 1024 bytes");
        demand(self.limits.queue >= 1, "/limits/queue", "at least one job must be able to wait");
        let quota = self.limits.quota();
        demand(
            quota.is_none_or(|quota| quota >= 1 << 20),
            "/limits/database_bytes",
            "a database needs at least 1048576 bytes; 0 sets no quota",
        );
        demand(self.limits.job_seconds >= 1, "/limits/job_seconds", "a job needs at least a second");
        demand(
            (16..=1_000_000).contains(&self.limits.connections),
            "/limits/connections",
            "there are between 16 and 1000000 connections",
        );
        let parts = [
            ("bodies_bytes", self.limits.bodies_bytes),
            ("queue_per_system", self.limits.queue_per_system),
            ("connections_per_peer", self.limits.connections_per_peer),
            ("connections_per_token", self.limits.connections_per_token),
            ("streams", self.limits.streams),
            ("streams_per_token", self.limits.streams_per_token),
        ];
        for (field, most) in parts {
            demand(most >= 1, &format!("/limits/{field}"), "there is at least one");
        }
        let times = [
            ("header_seconds", "a head takes", self.limits.header_seconds),
            ("body_seconds", "a body takes", self.limits.body_seconds),
            ("write_seconds", "an answer stays untaken", self.limits.write_seconds),
        ];
        for (field, what, seconds) in times {
            let detail = format!("{what} between 1 and 3600 seconds");
            demand((1..=3_600).contains(&seconds), &format!("/limits/{field}"), &detail);
        }
        let Retention { jobs_days, diagnoses_days, windows_days, samples_days, traces_days } = self.retention;
        // Diagnoses read five weeks of measurements, and comparisons look farther back.
        let days = [
            ("jobs_days", jobs_days, 7),
            ("diagnoses_days", diagnoses_days, 7),
            ("windows_days", windows_days, 60),
            ("samples_days", samples_days, 60),
            ("traces_days", traces_days, 7),
        ];
        for (field, days, least) in days {
            let detail = format!("at least {least} days are kept, and at most 36500; 0 keeps everything");
            demand(days == 0 || (least..=36_500).contains(&days), &format!("/retention/{field}"), &detail);
        }
        let rate = self.diagnose.accusation_rate;
        demand(
            rate > 0.0 && rate <= 0.2,
            "/diagnose/accusation_rate",
            "an accusation rate is above 0 and at most 0.2",
        );
        for (field, detail) in self.notify.iter().flat_map(NotifySettings::faults) {
            demand(false, field, detail);
        }
        faults
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn environment(pairs: &[(&str, &str)]) -> Vec<(String, String)> {
        pairs.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned())).collect()
    }

    #[test]
    fn the_example_file_holds_the_defaults() {
        let example: Settings = toml::from_str(include_str!("../../../config/lampyris.toml")).unwrap();
        assert_eq!(example, Settings::default());
    }

    #[test]
    fn the_environment_wins_over_the_file() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("lampyris.toml");
        std::fs::write(&file, "workers = 3\nzone = \"Europe/Copenhagen\"\n[limits]\nqueue = 5\n").unwrap();
        let settings = Settings::load(
            Some(&file),
            environment(&[("LAMPYRIS_WORKERS", "4"), ("PATH", "x"), ("LAMPYRIS_TESTS", "y")]),
        )
        .unwrap();
        assert_eq!(
            (settings.workers, settings.limits.queue, settings.zone.as_str()),
            (4, 5, "Europe/Copenhagen")
        );
        assert_eq!(settings.limits.body_bytes, Limits::default().body_bytes);
    }

    #[test]
    fn an_accusation_rate_lies_above_nothing_and_at_most_at_a_fifth() {
        let load =
            |rate: &str| Settings::load(None, environment(&[("LAMPYRIS_DIAGNOSE_ACCUSATION_RATE", rate)]));
        assert_eq!(load("0.2").unwrap().diagnose.accusation_rate, 0.2);
        for rate in ["0", "-0.1", "0.21", "NaN", "inf"] {
            let faults = load(rate).unwrap_err();
            assert_eq!(
                faults.iter().map(|fault| fault.pointer.as_str()).collect::<Vec<_>>(),
                ["/diagnose/accusation_rate"],
                "{rate}"
            );
        }
    }

    #[test]
    fn all_faults_are_listed_and_slips_are_noticed() {
        let variables = [
            ("LAMPYRIS_BIND", "here"),
            ("LAMPYRIS_ZONE", "Mars/Olympus"),
            ("LAMPYRIS_WORKER", "1"),
            ("LAMPYRIS_WORKERS", "0"),
        ];
        let faults = Settings::load(None, environment(&variables)).unwrap_err();
        let pointers: Vec<&str> = faults.iter().map(|fault| fault.pointer.as_str()).collect();
        assert_eq!(pointers, ["LAMPYRIS_BIND", "LAMPYRIS_WORKER", "/workers", "/zone"]);
        assert_eq!(faults[1].suggestion.as_deref(), Some("did you mean `LAMPYRIS_WORKERS`?"));
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("lampyris.toml");
        std::fs::write(&file, "\nworker = 3\n").unwrap();
        let faults = Settings::load(Some(&file), []).unwrap_err();
        assert!(faults[0].pointer.ends_with("lampyris.toml line 2"), "{faults:?}");
    }
}
