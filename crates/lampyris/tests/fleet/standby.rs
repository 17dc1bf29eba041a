//! A standby takes the place of a database that is gone for good.

use super::Fleet;
use super::cut::Way;
use super::support::{cluster, full, quick, seeded};
use lampyris::store::DatabasePlace;
use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

/// A server of its own, with its data in a folder.
struct Server {
    port: u16,
    process: Child,
}

/// A command of PostgreSQL, which refuses to be root.
fn command(bin: &Path, name: &str) -> Command {
    let program = bin.join(name);
    let is_root =
        std::fs::metadata("/proc/self").is_ok_and(|own| std::os::unix::fs::MetadataExt::uid(&own) == 0);
    if !is_root {
        return Command::new(program);
    }
    let mut command = Command::new("setpriv");
    command.args(["--reuid", "nobody", "--regid", "nogroup", "--clear-groups"]).arg(program);
    command
}

fn run(command: &mut Command) {
    let out = command.output().unwrap();
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
}

impl Server {
    fn start(bin: &Path, data: &Path) -> Self {
        let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let folder = data.parent().unwrap();
        let process = command(bin, "postgres")
            .arg("-D")
            .arg(data)
            .args(["-p", &port.to_string(), "-h", "127.0.0.1", "-c", "max_connections=100", "-k"])
            .arg(folder)
            .current_dir(folder)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let server = Self { port, process };
        let begun = Instant::now();
        while server.ask("SELECT 'there'").is_err() {
            assert!(begun.elapsed() < Duration::from_secs(60), "the server does not listen");
            sleep(Duration::from_millis(50));
        }
        server
    }

    fn address(&self) -> String {
        format!("127.0.0.1:{}", self.port)
    }

    fn ask(&self, sql: &str) -> Result<Vec<String>, String> {
        cluster::behind(&DatabasePlace::from(format!("postgres://lampyris@{}/postgres", self.address())), sql)
    }

    /// Ends it and all that it has started, as a machine does that loses its power.
    fn kill(&mut self) {
        let children = format!("ps -o pid= --ppid {0}; echo {0}", self.process.id());
        Command::new("bash").args(["-c", &format!("kill -9 $({children}) 2>/dev/null")]).status().unwrap();
        self.process.wait().unwrap();
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.kill();
    }
}

#[test]
fn a_standby_that_takes_over_has_everything_that_was_acknowledged() {
    let Some(fleet) = Fleet::new() else { return };
    let bin =
        std::fs::read_dir("/usr/lib/postgresql").unwrap().flatten().map(|one| one.path().join("bin")).max();
    let bin = bin.unwrap();
    let mut published = 0;
    for round in 0..if full() { 5 } else { 1 } {
        let dir = tempfile::tempdir_in("/tmp").unwrap();
        run(Command::new("chmod").arg("0777").arg(dir.path()));
        let (first, second) = (dir.path().join("first"), dir.path().join("second"));
        run(command(&bin, "initdb").arg("-D").arg(&first).args([
            "-A",
            "trust",
            "-U",
            "lampyris",
            "-E",
            "UTF8",
            "--locale=C.UTF-8",
        ]));
        let mut primary = Server::start(&bin, &first);
        run(command(&bin, "pg_basebackup")
            .args([
                "-R",
                "-h",
                "127.0.0.1",
                "-p",
                &primary.port.to_string(),
                "-U",
                "lampyris",
                "-c",
                "fast",
                "-D",
            ])
            .arg(&second));
        let standby = Server::start(&bin, &second);
        primary.ask("ALTER SYSTEM SET synchronous_standby_names = '*'").unwrap();
        primary.ask("SELECT pg_reload_conf()::TEXT").unwrap();
        let begun = Instant::now();
        while primary.ask("SELECT sync_state FROM pg_stat_replication").unwrap() != ["sync"] {
            assert!(begun.elapsed() < Duration::from_secs(60));
            sleep(Duration::from_millis(20));
        }
        let way = Way::to(&primary.address());
        let place = DatabasePlace::from(format!("postgres://lampyris@127.0.0.1:{}/postgres", way.port));
        let (node, worker) =
            (Fleet::node_on(&place, "api,scheduler", &[]), Fleet::node_on(&place, "worker", &[]));
        node.client.lasting_room("1", 1);
        // What controllers were given, by the number of its revision.
        let mut served: BTreeMap<i64, String> = BTreeMap::new();
        let mut publish = |seeds: std::ops::Range<i64>| {
            for seed in seeds {
                let body = seeded(quick("room/1"), 100 * round + seed);
                node.client.ended(&node.client.post_job(&body));
                let answer = node.client.get("/params/room/1").expect(200);
                let revision = answer.json()["revision"].as_i64().unwrap();
                let parameters = answer.json()["parameters"].to_string();
                let known = served.entry(revision).or_insert_with(|| parameters.clone());
                assert_eq!(*known, parameters, "revision {revision} has come twice");
            }
            *served.keys().next_back().unwrap()
        };
        let before = publish(0..6);
        primary.kill();
        node.client.get("/params/room/1").expect(200);
        run(command(&bin, "pg_ctl").arg("-D").arg(&second).args(["promote", "-w"]));
        way.lead_to(&standby.address());
        let begun = Instant::now();
        while node.client.get("/readyz").status != 200 {
            assert!(begun.elapsed() < Duration::from_secs(60), "the node does not find the standby");
            sleep(Duration::from_millis(50));
        }
        println!("FLEET: a standby has taken over within {:?}", begun.elapsed());
        let kept = standby.ask("SELECT MAX(revision)::TEXT FROM revisions").unwrap();
        assert!(kept[0].parse::<i64>().unwrap() >= before, "{kept:?} of {before}");
        let after = publish(6..12);
        assert!(after >= before);
        published += after;
        drop((worker, node));
    }
    println!("FLEET: {published} revisions over standbys that took over, none lost and none twice");
    drop(fleet);
}
