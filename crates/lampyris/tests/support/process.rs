//! The built binary: a service in a process of its own, and the verbs that ask it.

use super::Client;
use serde_json::Value;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Longest from start to the first answer.
const START: Duration = Duration::from_secs(120);

/// A service in a process of its own.
pub struct Process {
    child: Child,
    pub client: Client,
    base: String,
}

/// How a verb ended.
#[derive(Debug)]
pub struct Said {
    pub code: Option<i32>,
    pub out: String,
    pub err: String,
}

impl Process {
    pub fn start(database: &Path) -> Self {
        Self::start_with(database, &[])
    }

    /// A service with more variables in its environment.
    pub fn start_with(database: &Path, environment: &[(&str, &str)]) -> Self {
        let mut command = program();
        command.envs(environment.iter().copied());
        Self::run(command, database)
    }

    /// A service that ends as if it were killed where it passes a point of its code (`store::failpoint`);
    /// none where that is before it listens.
    pub fn start_to_die_at(point: &str, database: &Path) -> Option<Self> {
        let mut command = program();
        command.env("LAMPYRIS_ABORT_AT", point);
        Self::attempt(command, database, Stdio::null())
    }

    /// A service none of whose files may grow beyond two megabytes.
    pub fn start_with_small_files(database: &Path) -> Self {
        let mut command = Command::new("bash");
        command.args([
            "-c",
            "trap '' XFSZ; ulimit -f 2048; exec \"$@\"",
            "bash",
            env!("CARGO_BIN_EXE_lampyris"),
        ]);
        Self::run(command, database)
    }

    fn run(command: Command, database: &Path) -> Self {
        Self::attempt(command, database, Stdio::null()).expect("the service ended before it listened")
    }

    /// Starts a service that may end before it listens; then there is none. What it says of itself goes to
    /// `log`.
    pub fn attempt(mut command: Command, database: &Path, log: Stdio) -> Option<Self> {
        if command.get_envs().all(|(name, _)| name != "LAMPYRIS_THREADS") {
            command.env("LAMPYRIS_THREADS", "1");
        }
        let mut child = command
            .args(["serve", "--bind", "127.0.0.1:0", "--database"])
            .arg(database)
            .stdout(Stdio::piped())
            .stderr(log)
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let begun = Instant::now();
        let base = loop {
            let Some(line) = lines.next() else {
                child.wait().unwrap();
                return None;
            };
            if let Some((_, base)) = line.unwrap().split_once("listening on ") {
                break base.trim().to_owned();
            }
            assert!(begun.elapsed() < START, "the service does not listen");
        };
        Some(Self { child, client: Client::new(base.clone()), base })
    }

    /// Waits until the process has taken itself down.
    #[track_caller]
    pub fn gone(mut self) {
        let begun = Instant::now();
        while self.child.try_wait().unwrap().is_none() {
            assert!(begun.elapsed() < super::PATIENCE, "the process lives on");
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    /// SIGKILL: nothing of the process gets a chance to tidy up.
    pub fn kill(mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }

    /// Its number.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Whether the process has ended by itself.
    pub fn has_ended(&mut self) -> bool {
        self.child.try_wait().unwrap().is_some()
    }

    /// Sends a signal by its name, such as `HUP`.
    pub fn signal(&self, name: &str) {
        Command::new("kill").args([&format!("-{name}"), &self.child.id().to_string()]).status().unwrap();
    }

    /// SIGTERM, as a supervisor would; gives the exit code and how long it took.
    pub fn terminate(mut self) -> (Option<i32>, Duration) {
        let start = Instant::now();
        self.signal("TERM");
        let status = self.child.wait().unwrap();
        (status.code(), start.elapsed())
    }

    /// A service whose wall clock is what a file says, by a library that the system loads before its own.
    pub fn start_by_clock(library: &str, clock: &Path, database: &Path) -> Self {
        let mut command = program();
        command
            .env("LD_PRELOAD", library)
            .env("FAKETIME_TIMESTAMP_FILE", clock)
            .env("FAKETIME_NO_CACHE", "1")
            .env("FAKETIME_DONT_FAKE_MONOTONIC", "1");
        Self::run(command, database)
    }

    /// Where it listens, `http://…`.
    pub fn base(&self) -> &str {
        &self.base
    }

    /// A line of what the system knows of the process, such as `VmRSS`, as a number.
    pub fn status(&self, name: &str) -> u64 {
        let text = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).unwrap();
        let line = text.lines().find(|line| line.starts_with(name)).unwrap();
        line.split_whitespace().nth(1).unwrap().parse().unwrap()
    }

    /// Seconds of CPU time that it has used.
    pub fn cpu(&self) -> f64 {
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", self.child.id())).unwrap();
        let fields = stat.rsplit_once(')').unwrap().1.split_whitespace().skip(11).take(2);
        fields.map(|ticks| ticks.parse::<f64>().unwrap()).sum::<f64>() / 100.0
    }

    /// How many files and connections it has open.
    pub fn open_files(&self) -> usize {
        std::fs::read_dir(format!("/proc/{}/fd", self.child.id())).unwrap().count()
    }

    /// A verb of the command line that asks this service.
    pub fn verb(&self, arguments: &[&str]) -> Said {
        verb(&self.base, arguments)
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // After a failed assertion nothing is left running.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The built binary, without a verb.
pub fn program() -> Command {
    Command::new(env!("CARGO_BIN_EXE_lampyris"))
}

/// Starts a service that must refuse to start, and gives what it said.
#[track_caller]
pub fn serve(database: &Path) -> Said {
    let mut child = program()
        .args(["serve", "--bind", "127.0.0.1:0", "--database"])
        .arg(database)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let begun = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if begun.elapsed() > START {
            child.kill().unwrap();
            child.wait().unwrap();
            panic!("the service did not refuse {}", database.display());
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    let output = child.wait_with_output().unwrap();
    Said { code: output.status.code(), out: String::new(), err: String::from_utf8(output.stderr).unwrap() }
}

/// Runs a verb of the command line against an address.
pub fn verb(url: &str, arguments: &[&str]) -> Said {
    let output = program().args(arguments).env("LAMPYRIS_URL", url).stdin(Stdio::null()).output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    Said { code: output.status.code(), out: text(output.stdout), err: text(output.stderr) }
}

impl Said {
    /// What was said, by a verb that must have ended with this code.
    #[track_caller]
    pub fn expect(self, code: i32) -> Self {
        assert_eq!(self.code, Some(code), "{}\n{}", self.out, self.err);
        self
    }

    /// The document that was printed.
    #[track_caller]
    pub fn json(&self) -> Value {
        serde_json::from_str(&self.out).unwrap_or_else(|error| panic!("{error}: {}", self.out))
    }
}
