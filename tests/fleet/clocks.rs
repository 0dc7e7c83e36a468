//! A server that is away when a run begins, and machines whose clocks differ by an hour: both are waited for, and
//! nothing is lost.

use crate::support::wait::until;
use crate::test_bench::{Process, TestBench, finished, made_here, models, said, simulated};
use std::path::PathBuf;
use std::process::{Command, Stdio};

/// What stands between a program and the wall clock (package libfaketime). It has no power over the server, whose
/// language asks the kernel itself: so the server has the true time, and the others are wrong.
fn wall_clock_library() -> PathBuf {
    let architectures = std::fs::read_dir("/usr/lib").unwrap();
    let mut libraries = architectures.map(|a| a.unwrap().path().join("faketime/libfaketime.so.1"));
    let found = libraries.find(|library| library.exists());
    found.expect("package libfaketime; tests/deps.sh installs it")
}

/// Sets the wall clock of a process and of its children apart.
fn with_clock(mut command: Command, offset: &str) -> Command {
    command.env("LD_PRELOAD", wall_clock_library());
    command.env("FAKETIME", offset);
    command
        .env("DONT_FAKE_MONOTONIC", "1")
        .env("NO_FAKE_STAT", "1");
    command
}

#[test]
fn a_server_that_is_away_and_clocks_that_differ_are_waited_for_and_lose_nothing() {
    let Some(bench) = TestBench::without_server("") else {
        return;
    };
    let recording = simulated(6);
    let here = made_here(&bench, &recording);
    let shows = |offset: &str| {
        let mut date = Command::new("/bin/date");
        date.arg("+%s");
        let output = with_clock(date, offset).output().unwrap();
        let text = String::from_utf8(output.stdout).unwrap();
        text.trim().parse::<i64>().unwrap()
    };
    let apart = shows("+1h") - shows("-1h");
    assert!((7190..7210).contains(&apart), "{apart} s");
    let mut worker = bench.worker_command("w", &bench.address(), &[]);
    worker.arg("--scratch").arg(bench.path("scratch"));
    let worker = bench.logged(with_clock(worker, "+1h"), "w").spawn();
    let _worker = Process(worker.unwrap());
    let mut replay = with_clock(bench.by_fleet(&recording, "out", &[]), "-1h");
    replay.stdout(Stdio::piped());
    replay.stderr(std::fs::File::create(bench.path("replay.log")).unwrap());
    let replay = replay.spawn().unwrap();
    until("both wait for the server", || {
        bench.log("replay").contains("it is away") && !bench.log("w").is_empty()
    });
    bench.start_server();
    let output = finished(replay);
    let words = (said(&output), bench.log("replay"), bench.log("w"));
    assert!(output.status.success(), "{words:?}");
    assert!(models(&bench.path("out")) == here);
    let told = "the clock of worker w is 7";
    assert!(
        words.1.contains(told) && words.1.contains("ahead of"),
        "{}",
        words.1
    );
}
