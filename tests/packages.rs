//! Checks which of our packages are built into which program, as cargo resolves them.

use std::collections::BTreeSet;
use std::process::Command;

/// All packages in the program `scand` that is built with these options.
fn all_packages(options: &[&str]) -> BTreeSet<String> {
    let output = Command::new(env!("CARGO"))
        .args(["tree", "--offline", "--locked", "--package", "scand"])
        .args(["--edges", "normal", "--prefix", "none", "--format", "{lib}"])
        .args(options)
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    let names = String::from_utf8(output.stdout).unwrap();
    // What was listed already comes with a mark behind its name.
    let names = names.lines().filter_map(|line| line.split(' ').next());
    names.map(str::to_owned).collect()
}

/// Our packages in it.
fn packages(options: &[&str]) -> BTreeSet<String> {
    let mut packages = all_packages(options);
    packages.retain(|name| name.starts_with("scand"));
    packages
}

#[test]
fn only_the_feature_fleet_brings_its_client() {
    let has = |names: [&str; 2], options: &[&str]| {
        let packages = all_packages(options);
        names.map(|name| packages.contains(name))
    };
    let (client, ciphers) = (["async_nats", "nkeys"], ["rustls", "ring"]);
    assert_eq!(has(client, &["--features", "rig,page"]), [false; 2]);
    assert_eq!(has(client, &["--features", "fleet"]), [true; 2]);
    // The page has TLS of its own.
    assert_eq!(has(ciphers, &[]), [false; 2]);
    assert_eq!(has(ciphers, &["--features", "rig"]), [false; 2]);
}

#[test]
fn an_installed_rig_holds_no_simulator() {
    let script = include_str!("../scripts/deb.sh");
    let options = ["--no-default-features", "--features", "rig"];
    assert!(
        script.contains(&options.join(" ")),
        "how the package is built"
    );
    assert_eq!(
        packages(&options),
        ["scand", "scand_core"].map(str::to_owned).into()
    );
    // What is built otherwise has it.
    let all = ["scand", "scand_core", "scand_lab"].map(str::to_owned);
    assert_eq!(packages(&["--features", "rig"]), all.into());
}

#[test]
fn an_installed_worker_holds_no_camera_no_page_and_no_simulator() {
    let script = include_str!("../scripts/deb.sh");
    let options = ["--no-default-features", "--features", "fleet"];
    let built = format!("features=({})\n", options.join(" "));
    assert!(script.contains(&built), "how the package is built");
    let expected = ["scand", "scand_core"].map(str::to_owned);
    assert_eq!(packages(&options), expected.into());
    let of_rigs = ["aravis", "gio", "v4l", "evdev", "axum", "hyper"];
    let has = |options: &[&str]| {
        let packages = all_packages(options);
        of_rigs.map(|name| packages.contains(name))
    };
    assert_eq!(has(&options), [false; 6]);
    assert_eq!(has(&["--features", "rig,page,fleet"]), [true; 6]);
}

/// Both packages can be installed at once, so no file may be in both.
#[test]
fn the_packages_share_no_file() {
    let manifest: toml::Table = include_str!("../Cargo.toml").parse().unwrap();
    let rig = &manifest["package"]["metadata"]["deb"];
    let worker = &rig["variants"]["worker"];
    assert_eq!(worker["name"].as_str(), Some("scand-worker"));
    let files = |of: &toml::Value| -> BTreeSet<String> {
        let assets = of["assets"].as_array().unwrap().iter();
        let name = |asset: &toml::Value| {
            let [from, to] = [0, 1].map(|i| asset[i].as_str().unwrap());
            let is_folder = to.ends_with('/');
            let name = from.rsplit('/').next().unwrap();
            format!("{to}{}", if is_folder { name } else { "" })
        };
        assets.map(name).collect()
    };
    let (rig, worker) = (files(rig), files(worker));
    assert!(worker.contains("usr/bin/scand-worker") && rig.contains("usr/bin/scand"));
    assert_eq!(rig.intersection(&worker).count(), 0, "{rig:?} {worker:?}");
}

#[test]
fn every_program_of_tests_that_needs_cameras_is_run_with_them() {
    let run = include_str!("../Makefile");
    let run = run
        .lines()
        .find(|line| line.starts_with("RIG_TESTS"))
        .unwrap();
    let run: BTreeSet<&str> = run.trim_end_matches(')').split([' ', ',']).collect();
    let manifest: toml::Table = include_str!("../Cargo.toml").parse().unwrap();
    let mut needed = 0;
    for test in manifest["test"].as_array().unwrap() {
        let name = test["name"].as_str().unwrap();
        let features = test["required-features"].as_array().unwrap();
        if features
            .iter()
            .any(|feature| feature.as_str() != Some("lab"))
        {
            assert!(run.contains(name), "{name} is not in RIG_TESTS: {run:?}");
            needed += 1;
        }
    }
    assert!(needed > 0);
}
