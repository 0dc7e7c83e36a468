//! The sample configuration of a server: what each role may do works, what it may not is denied, and no secret is where
//! somebody else could read it.

use crate::support::wait::{until, until_or};
use crate::test_bench::{
    Process, free_port, has_server, models, program, runtime, said, simulated,
};
use async_nats::{Client, ConnectOptions, Event};
use scand::config::Config;
use scand::workers::{Job, Jobs};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;
use tokio::sync::mpsc;

/// The sample, for a server of the test's own, with keys and a certificate.
struct Sample {
    home: tempfile::TempDir,
    port: u16,
    _server: Process,
}

impl Sample {
    /// `None` on a machine that has no server.
    fn start() -> Option<Self> {
        if !has_server() {
            return None;
        }
        let home = tempfile::tempdir().unwrap();
        let port = free_port();
        let path = |name: &str| home.path().join(name);
        certificate(home.path());
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let mut text = std::fs::read_to_string(root.join("config/fleet-server.conf")).unwrap();
        let mut put = |from: &str, to: &str| {
            assert!(text.contains(from), "{from}");
            text = text.replace(from, to);
        };
        put("0.0.0.0:4222", &format!("127.0.0.1:{port}"));
        for (from, to) in [
            ("/etc/nats/server.pem", "server.pem"),
            ("/etc/nats/server-key.pem", "server.key"),
            ("/var/lib/nats", "store"),
        ] {
            put(from, path(to).to_str().unwrap());
        }
        for name in ["hall", "attic", "office"] {
            let made = program()
                .args(["fleet", "key"])
                .arg(path(name))
                .output()
                .unwrap();
            assert!(made.status.success(), "{}", said(&made));
            put(
                &format!("PUBLIC KEY OF {name}"),
                String::from_utf8(made.stdout).unwrap().trim(),
            );
        }
        std::fs::write(path("server.conf"), text).unwrap();
        let server = Command::new("nats-server")
            .arg("--config")
            .arg(path("server.conf"))
            .stdout(Stdio::null())
            .stderr(std::fs::File::create(path("server.log")).unwrap())
            .spawn();
        let server = Process(server.unwrap());
        until("the server listens", || {
            std::net::TcpStream::connect(("127.0.0.1", port)).is_ok()
        });
        Some(Self {
            home,
            port,
            _server: server,
        })
    }

    fn path(&self, name: &str) -> PathBuf {
        self.home.path().join(name)
    }

    fn address(&self) -> String {
        format!("tls://localhost:{}", self.port)
    }

    /// The arguments with which somebody of this name reaches the server.
    fn access(&self, name: &str) -> Vec<String> {
        let path = |name: &str| self.path(name).to_str().unwrap().to_owned();
        let words = [
            "--fleet",
            &self.address(),
            "--name",
            name,
            "--credentials",
            &path(name),
            "--authority",
            &path("ca.pem"),
        ];
        words.map(str::to_owned).into()
    }

    async fn connect(&self, role: &str, name: &str) -> (Client, mpsc::Receiver<String>) {
        let (told, heard) = mpsc::channel(100);
        let seed = std::fs::read_to_string(self.path(name))
            .unwrap()
            .trim()
            .to_owned();
        let client = ConnectOptions::with_nkey(seed)
            .add_root_certificates(self.path("ca.pem"))
            .require_tls(true)
            .custom_inbox_prefix(format!("_INBOX_{role}_{name}"))
            .event_callback(move |event| {
                let told = told.clone();
                async move {
                    if let Event::ServerError(error) = event {
                        let _ = told.send(error.to_string()).await;
                    }
                }
            })
            .connect(self.address())
            .await
            .unwrap();
        (client, heard)
    }
}

/// An authority, and the certificate of a server of this machine.
fn certificate(folder: &Path) {
    let run = |arguments: &str| {
        let made = Command::new("openssl")
            .args(arguments.split(' '))
            .current_dir(folder)
            .output()
            .unwrap();
        assert!(made.status.success(), "{}", said(&made));
    };
    run("req -x509 -newkey rsa:2048 -nodes -keyout ca.key -out ca.pem -days 2 -subj /CN=test");
    run("req -newkey rsa:2048 -nodes -keyout server.key -out server.csr -subj /CN=localhost");
    std::fs::write(
        folder.join("names"),
        "subjectAltName=DNS:localhost,IP:127.0.0.1\n",
    )
    .unwrap();
    run(
        "x509 -req -in server.csr -CA ca.pem -CAkey ca.key -CAcreateserial -out server.pem -days 2 -extfile names",
    );
}

#[test]
fn each_role_does_its_work_with_the_sample_and_no_secret_is_anywhere_else() {
    let Some(sample) = Sample::start() else {
        return;
    };
    let recording = sample.path("fleet-6.mcap");
    std::fs::copy(simulated(6), &recording).unwrap();
    let mut worker = program();
    worker
        .arg("worker")
        .args(sample.access("attic"))
        .arg("--scratch")
        .arg(sample.path("scratch"));
    let log = std::fs::File::create(sample.path("attic.log")).unwrap();
    worker.stdout(Stdio::null()).stderr(log);
    let _worker = Process(worker.spawn().unwrap());
    let mut replay = program();
    replay
        .arg("--replay")
        .arg(&recording)
        .args(["--set", "hull.resolution=24"]);
    replay
        .arg("--out")
        .arg(sample.path("out"))
        .args(sample.access("hall"));
    let output = replay.output().unwrap();
    let log = std::fs::read_to_string(sample.path("attic.log")).unwrap();
    assert!(output.status.success(), "{}\n{log}", said(&output));
    assert_eq!(models(&sample.path("out")).len(), 6);
    // Nobody was denied anything.
    assert!(!said(&output).contains("ermission"), "{}", said(&output));
    assert!(!log.contains("ermission"), "{log}");
    let status = program()
        .args(["fleet", "status"])
        .args(sample.access("office"))
        .output()
        .unwrap();
    let words = String::from_utf8_lossy(&status.stdout).into_owned();
    assert!(
        words.contains("0 waiting, 0 running, 0 failed; 1 worker"),
        "{words}{}",
        said(&status)
    );
    assert!(!said(&status).contains("ermission"), "{}", said(&status));

    // A rig that has such an address: its job, and what became of it; and then its support bundle.
    let address = sample.address();
    let rig = rig_with_a_job(&sample, &recording);
    let mut process = program();
    process.args(["fleet", "run", "--config"]).arg(&rig);
    // The address is that of the configuration.
    process.args(&sample.access("hall")[2..]);
    let log = std::fs::File::create(sample.path("hall.log")).unwrap();
    process.stdout(Stdio::null()).stderr(log);
    let mut process = Process(process.spawn().unwrap());
    let rig_log = || std::fs::read_to_string(sample.path("hall.log")).unwrap();
    let is_answered = |file: std::fs::DirEntry| file.path().extension() == Some("answer".as_ref());
    until_or("the rig has its model", rig_log, || {
        let jobs = std::fs::read_dir(sample.path("recordings/jobs")).unwrap();
        jobs.flatten().any(is_answered)
    });
    process.kill();
    assert!(sample.path("models/fleet-6/ball-000/model.glb").exists());
    assert!(!rig_log().contains("ermission"), "{}", rig_log());
    let packed = sample.path("support.tar.zst");
    let mut check = program();
    check.args(["check", "--no-speed", "--config"]).arg(&rig);
    let checked = check.arg("--bundle").arg(&packed).output().unwrap();
    let support = std::fs::File::open(&packed);
    let support = support.unwrap_or_else(|e| panic!("{e}: {}", said(&checked)));
    let support = zstd::decode_all(support).unwrap();
    let holds_address = |part: &[u8]| part == address.as_bytes();
    assert!(support.windows(address.len()).any(holds_address));
    std::fs::write(sample.path("support.tar"), support).unwrap();

    // The keys are in their own files and nowhere else: not in a recording, a
    // job, a model, a log, what is on the server, or the support bundle.
    let seeds = ["hall", "attic", "office"].map(|name| std::fs::read(sample.path(name)).unwrap());
    let mut looked = 0;
    let mut folders = vec![sample.home.path().to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_str().unwrap().to_owned();
            if path.is_dir() {
                folders.push(path);
            } else if !["hall", "attic", "office"].contains(&name.as_str()) {
                let bytes = std::fs::read(&path).unwrap();
                looked += 1;
                for seed in &seeds {
                    let seed = &seed[..seed.len() - 1];
                    assert!(
                        !bytes.windows(seed.len()).any(|part| part == seed),
                        "{}",
                        path.display()
                    );
                }
            }
        }
    }
    assert!(looked > 30, "{looked}");
}

/// A rig's configuration, and a job in its folder as its daemon writes it.
fn rig_with_a_job(sample: &Sample, recording: &Path) -> PathBuf {
    let [recordings, models] = ["recordings", "models"].map(|name| sample.path(name));
    let address = sample.address();
    let text = format!(
        "[recording]\nfolder = {recordings:?}\n[workers]\nfolder = {models:?}\nfleet = \"{address}\"\n"
    );
    let file = sample.path("rig.toml");
    std::fs::write(&file, text).unwrap();
    std::fs::create_dir(&recordings).unwrap();
    let own = recordings.join("fleet-6.mcap");
    std::fs::copy(recording, &own).unwrap();
    let jobs = Jobs::open(&recordings).unwrap();
    let config = Config::load(Some(&file), &["hull.resolution=24".to_owned()]).unwrap();
    jobs.set_settings(&config.replay_toml().unwrap()).unwrap();
    let session = scand::recording::Recording::open(&own).unwrap();
    let message = session.messages(&scand::recording::Topic::Trigger).first();
    let trigger = session.trigger(message.unwrap()).unwrap();
    let job = Job::new(&own, trigger.id.as_str(), trigger.time.0, &trigger.source);
    jobs.enqueue(&job).unwrap();
    file
}

#[test]
fn the_sample_for_later_servers_adds_what_debians_server_does_not_know() {
    let Some(sample) = Sample::start() else {
        return;
    };
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let later = std::fs::read_to_string(root.join("config/fleet-server-2.10.conf")).unwrap();
    let check = |name: &str, text: &str| {
        std::fs::write(sample.path(name), text).unwrap();
        let mut command = Command::new("nats-server");
        command.arg("-t").arg("--config").arg(sample.path(name));
        let checked = command.output().unwrap();
        (checked.status.success(), said(&checked))
    };
    std::fs::copy(sample.path("server.conf"), sample.path("fleet-server.conf")).unwrap();
    let (is_valid, told) = check("later.conf", &later);
    assert!(
        is_valid || told.contains("unknown field \"sync_interval\""),
        "{told}"
    );
    let known = later.replace("sync_interval: always", "");
    assert!(known != later);
    let (is_valid, told) = check("known.conf", &known);
    assert!(is_valid, "{told}");
}

#[test]
fn what_a_role_may_not_do_the_server_denies() {
    let Some(sample) = Sample::start() else {
        return;
    };
    let digest = "a".repeat(64);
    #[rustfmt::skip]
    let forbidden: [(&str, &str, &[&str], &[&str]); 3] = [
        ("rig", "hall",
            &["scand.job.p.m4.tower.D", "scand.capture.tower.D.0", "scand.result.tower.D", "scand.part.tower.D.w.i.0",
              "scand.failure.tower.D", "scand.started.hall.D.attic", "scand.worker.attic", "scand.retry.tower",
              "$JS.API.DIRECT.GET.SCAND_RESULTS.scand.result.tower.D", "$JS.API.DIRECT.GET.SCAND_CAPTURES.scand.capture.tower.D.0",
              "$JS.API.STREAM.DELETE.SCAND_JOBS", "$JS.API.STREAM.UPDATE.SCAND_JOBS", "$JS.API.STREAM.PURGE.SCAND_JOBS",
              "$JS.API.STREAM.MSG.GET.SCAND_RESULTS", "$JS.API.STREAM.MSG.DELETE.SCAND_JOBS", "$JS.API.STREAM.CREATE.OTHER",
              "$JS.API.CONSUMER.CREATE.SCAND_JOBS.x.y", "$JS.API.CONSUMER.MSG.NEXT.SCAND_JOBS.x", "$JS.ACK.SCAND_JOBS.x",
              "$SYS.REQ.SERVER.PING"],
            &[">", "scand.>", "scand.result.tower.*", "scand.job.>", "_INBOX_rig_tower.>", "_INBOX_worker_attic.>", "scand.retry.tower"]),
        ("worker", "attic",
            &["scand.job.p.m4.hall.D", "scand.capture.hall.D.0", "scand.failure.hall.D", "scand.worker.cellar", "scand.stop.cellar",
              "scand.part.hall.D.cellar.i.0", "scand.started.hall.D.cellar",
              "scand.retry.hall", "$JS.API.STREAM.CREATE.SCAND_JOBS", "$JS.API.STREAM.DELETE.SCAND_JOBS",
              "$JS.API.STREAM.INFO.SCAND_RESULTS", "$JS.API.DIRECT.GET.SCAND_RESULTS.scand.result.hall.D",
              "$JS.API.STREAM.MSG.GET.SCAND_CAPTURES", "$JS.API.CONSUMER.CREATE.SCAND_RESULTS.x.y",
              "$JS.API.CONSUMER.DELETE.SCAND_JOBS.x", "$SYS.REQ.SERVER.PING"],
            &[">", "scand.>", "scand.result.hall.*", "scand.job.>", "_INBOX_worker_cellar.>", "_INBOX_rig_hall.>", "scand.stop.cellar"]),
        ("viewer", "office",
            &["scand.job.p.m4.hall.D", "scand.capture.hall.D.0", "scand.result.hall.D", "scand.part.hall.D.w.i.0", "scand.started.hall.D.w",
              "scand.worker.attic", "scand.stop.attic", "scand.failure.hall.D", "$JS.API.STREAM.CREATE.SCAND_JOBS",
              "$JS.API.DIRECT.GET.SCAND_CAPTURES.scand.capture.hall.D.0", "$JS.API.DIRECT.GET.SCAND_RESULTS.scand.result.hall.D",
              "$JS.API.CONSUMER.CREATE.SCAND_JOBS.x.y", "$JS.API.STREAM.PURGE.SCAND_FAILURES"],
            &[">", "scand.>", "scand.result.hall.*", "scand.started.hall.>", "_INBOX_rig_hall.>", "_INBOX_viewer_other.>"]),
    ];
    runtime().block_on(async {
        for (role, name, publish, subscribe) in forbidden {
            let (client, mut denied) = sample.connect(role, name).await;
            for subject in publish {
                let parts = subject.split('.');
                let parts: Vec<&str> = parts.map(|p| if p == "D" { &digest } else { p }).collect();
                let subject = parts.join(".");
                client.publish(subject.clone(), "x".into()).await.unwrap();
                client.flush().await.unwrap();
                expect(&mut denied, name, &subject).await;
            }
            for subject in subscribe {
                let _subscribed = client.subscribe((*subject).to_owned()).await.unwrap();
                client.flush().await.unwrap();
                expect(&mut denied, name, subject).await;
            }
            // And what it may do is no violation.
            let own = client
                .subscribe(format!("_INBOX_{role}_{name}.>"))
                .await
                .unwrap();
            client.flush().await.unwrap();
            let quiet = tokio::time::timeout(Duration::from_millis(300), denied.recv()).await;
            assert!(quiet.is_err(), "{name}: {quiet:?}");
            drop(own);
        }
    });
}

/// The server says that it denied this.
async fn expect(denied: &mut mpsc::Receiver<String>, name: &str, subject: &str) {
    let words = tokio::time::timeout(Duration::from_secs(5), denied.recv()).await;
    let Ok(Some(words)) = words else {
        panic!("{name} may {subject}")
    };
    assert!(
        words.to_lowercase().contains("permissions violation"),
        "{name}, {subject}: {words}"
    );
}

#[test]
fn an_address_with_a_password_and_an_open_network_are_refused() {
    let told = |arguments: &[&str]| {
        let output = program().args(arguments).output().unwrap();
        assert!(!output.status.success(), "{arguments:?}");
        said(&output)
    };
    for command in [["worker", "--fleet"], ["--replay=x.mcap", "--fleet"]] {
        let refused = told(&[&command[..], &["nats://me:hidden@127.0.0.1"]].concat());
        let is_told = refused.contains("a user or a password");
        assert!(is_told && !refused.contains("hidden"), "{refused}");
    }
    let refused = told(&["worker", "--fleet", "nats://192.0.2.1"]);
    assert!(refused.contains("--plain-text"), "{refused}");
    let home = tempfile::tempdir().unwrap();
    let file = home.path().join("rig.toml");
    std::fs::write(&file, "[workers]\nfleet = \"nats://me:hidden@h\"\n").unwrap();
    let refused = told(&["fleet", "run", "--config", file.to_str().unwrap()]);
    assert!(
        refused.contains("a user or a password") && !refused.contains("hidden@"),
        "{refused}"
    );
}

#[test]
fn the_support_bundle_and_a_recording_carry_the_address_and_no_key() {
    // What both carry is the configuration, which cannot hold a secret: the only keys that concern a fleet are these.
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let sample = std::fs::read_to_string(root.join("config/rig.toml")).unwrap();
    let keys: Vec<&str> = sample
        .lines()
        .map(|line| line.trim_start_matches(['#', ' ']))
        .filter(|line| line.starts_with("fleet") || line.starts_with("credential"))
        .filter_map(|line| Some(line.split_once(" =")?.0))
        .collect();
    assert_eq!(keys, ["fleet", "fleet_or_local", "fleet_wait_s"]);
}
