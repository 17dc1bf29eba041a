//! The built binary: a service in a process of its own, and the verbs that ask it.

use super::Client;
use serde_json::Value;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Longest from start to the first answer.
const START: Duration = Duration::from_secs(10);

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
        Self::run(Command::new(env!("CARGO_BIN_EXE_lampyris")), database, environment)
    }

    /// A service none of whose files may grow beyond a megabyte.
    pub fn start_with_small_files(database: &Path) -> Self {
        let mut command = Command::new("bash");
        command.args(["-c", "trap '' XFSZ; ulimit -f 1024; exec \"$@\"", "bash", env!("CARGO_BIN_EXE_lampyris")]);
        Self::run(command, database, &[])
    }

    fn run(mut command: Command, database: &Path, environment: &[(&str, &str)]) -> Self {
        let mut child = command
            .args(["serve", "--bind", "127.0.0.1:0", "--database"])
            .arg(database)
            .env("LAMPYRIS_THREADS", "1")
            .envs(environment.iter().copied())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let begun = Instant::now();
        let base = loop {
            let line = lines.next().expect("the service ended before it listened").unwrap();
            if let Some((_, base)) = line.split_once("listening on ") {
                break base.trim().to_owned();
            }
            assert!(begun.elapsed() < START, "the service does not listen");
        };
        Self { child, client: Client::new(base.clone()), base }
    }

    /// The memory that the process holds now, in bytes.
    pub fn resident(&self) -> u64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).unwrap();
        let kilobytes = status.lines().find_map(|line| line.strip_prefix("VmRSS:")?.trim().strip_suffix(" kB")?.parse::<u64>().ok());
        kilobytes.unwrap() << 10
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

    /// SIGTERM, as a supervisor would; gives the exit code and how long it took.
    pub fn terminate(mut self) -> (Option<i32>, Duration) {
        let start = Instant::now();
        Command::new("kill").args(["-TERM", &self.child.id().to_string()]).status().unwrap();
        let status = self.child.wait().unwrap();
        (status.code(), start.elapsed())
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

/// Starts a service that must refuse to start, and gives what it said.
#[track_caller]
pub fn serve(database: &Path) -> Said {
    let mut child = Command::new(env!("CARGO_BIN_EXE_lampyris"))
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
    let output =
        Command::new(env!("CARGO_BIN_EXE_lampyris")).args(arguments).env("LAMPYRIS_URL", url).stdin(Stdio::null()).output().unwrap();
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
